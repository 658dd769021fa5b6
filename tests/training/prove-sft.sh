#!/usr/bin/env bash
# `make prove-sft`: plays tasks in seven homes, exports what the oracle did, trains a small language model from scratch on six of
# them and measures it on the seventh. Exits 1 when it learned too little (see prove.py).
#
# REEL (a binary; else one is built), REEL_TRAIN_PYTHON (a Python with jax; else a venv is made), TASKS (a home, default 60),
# HOMES (to train on, default 6), TRAINING_DIR (default ~/.cache/reel/training). What was made before is used again.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
here=tests/training
TRAINING_DIR="${TRAINING_DIR:-$HOME/.cache/reel/training}"
TASKS="${TASKS:-60}"
HOMES="${HOMES:-6}"
mkdir -p "$TRAINING_DIR"

if [[ -z ${REEL:-} ]]; then
  export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$HOME/.cache/reel}"
  cargo build --locked --profile fast -p reel-cli --no-default-features --features analytics
  REEL="$CARGO_TARGET_DIR/fast/reel"
fi
PYTHON="${REEL_TRAIN_PYTHON:-$TRAINING_DIR/venv/bin/python}"
if ! "$PYTHON" -c 'import jax' 2>/dev/null; then
  python3 -m venv "$TRAINING_DIR/venv"
  PYTHON="$TRAINING_DIR/venv/bin/python"
  "$PYTHON" -m pip install -q -r $here/requirements.txt
fi

data="$TRAINING_DIR/data-$HOMES-$TASKS"
if [[ ! -d $data ]]; then
  rm -rf "$data.part"
  "$PYTHON" $here/scenes.py src/tasks/src/data/home.json "$data.part/scenes" --count "$HOMES"
  cp src/tasks/src/data/home.json "$data.part/scenes/"
  for scene in "$data.part"/scenes/*.json; do
    home=$(basename "$scene" .json)
    "$REEL" tasks generate --scene "$scene" --count "$TASKS" --seed 7 --out "$data.part/tasks/$home"
    "$REEL" run --scene "$scene" --tasks "$data.part/tasks/$home" --policy oracle --no-images --out "$data.part/traces/$home"
  done
  "$REEL" ingest "$data.part/traces" --store "$data.part/store"
  "$REEL" export sft --store "$data.part/store" --format trl --words rules --images none --out "$data.part/set"
  mv "$data.part" "$data"
fi

# prove.py splits by scene itself: all files of the set, whatever part the export put them into.
find "$data/set" -name '*.jsonl' -print0 | sort -z | xargs -0 \
  "$PYTHON" $here/prove.py --held-out home --json "$TRAINING_DIR/result.json"
