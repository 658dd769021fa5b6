#!/usr/bin/env bash
# set.sh TRACES SET: makes the training set SET of a folder of traces, with the words of notes.py. A set that is there stays.
#
# REEL (the binary), PYTHON, JOBS.
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
REEL="${REEL:-reel}" PYTHON="${PYTHON:-python3}" JOBS="${JOBS:-1}"
traces="$1" set="$2"
[[ ! -d $set ]] || exit 0
rm -rf "$set.part" "$set.store"
"$REEL" dataset annotate "$traces" >/dev/null
"$PYTHON" "$here/notes.py" --reel "$REEL" --jobs "$JOBS" "$traces"
"$REEL" ingest "$traces" --store "$set.store" >/dev/null
# The same binary recorded the traces a moment ago. The images keep their size: `reel bench` sends them as they were taken.
"$REEL" export sft --store "$set.store" --format ms-swift --style single-turn --annotations notes --image-format png --max-pixels 0 \
  --no-replay --allow-unverified --jobs "$JOBS" --out "$set.part"
mv "$set.part" "$set"
