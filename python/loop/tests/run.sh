#!/usr/bin/env bash
# run.sh [--short]: the unit tests of the learning loop, in an environment with PyTorch; without --short also the loop itself in its short form,
# which needs REEL (the binary). Where the environment cannot be made it says so.
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
if ! python="$("$here/../../../tests/python.sh" lerobot)"; then
  echo "skipped: python: the environment with PyTorch cannot be installed"
  exit 0
fi
"$python" -m unittest discover "$here"
[[ ${1:-} == --short ]] && exit 0
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
SHORT=1 PYTHON="$python" LOOP_DIR="$folder/loop" "$here/../prove.sh"
"$python" "$here/prompts.py" --reel "${REEL:-reel}" --tasks "$folder/loop/train/home_1/tasks" --set "$folder/loop/train-set" --traces "$folder/loop/train-traces/home_1"
"$python" "$here/../gspo.py" --replay-step 2 --out "$folder/loop/gspo" --reel "${REEL:-reel}"
