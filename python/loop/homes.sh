#!/usr/bin/env bash
# homes.sh: homes and tasks for training and for evaluation, the oracle's episodes with images, and the training set, below LOOP_DIR.
# The homes are split by seed before anything is played: those of training have seeds from 1, those of evaluation from 1001. What was made
# once is used again.
#
# REEL (the binary), PYTHON (with PyTorch), LOOP_DIR; HOMES and TASKS (of training: homes, and tasks in each), HELD_OUT_HOMES, HELD_OUT_TASKS,
# TYPES (of tasks), JOBS.
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
REEL="${REEL:-reel}" PYTHON="${PYTHON:-python3}" LOOP_DIR="${LOOP_DIR:-loop-data}" JOBS="${JOBS:-1}"
export REEL PYTHON JOBS
HOMES="${HOMES:-8}" TASKS="${TASKS:-18}" HELD_OUT_HOMES="${HELD_OUT_HOMES:-4}" HELD_OUT_TASKS="${HELD_OUT_TASKS:-15}"
TYPES="${TYPES:-basic,distractor}"

# home PART SEED TASKS: one home with tasks in it, and its scene beside them.
home() {
  local out="$LOOP_DIR/$1/home_$2"
  [[ -d $out ]] && return
  rm -rf "$out.part" && mkdir -p "$out.part"
  "$REEL" scene generate --seed "$2" --rooms $((5 + $2 % 4)) --name "home_$2" --out "$out.part/scene.json" >/dev/null
  "$REEL" task generate --scene "$out.part/scene.json" --types "$TYPES" --count "$3" --seed "$2" --jobs "$JOBS" --out "$out.part/tasks" >/dev/null
  mv "$out.part" "$out"
}

mkdir -p "$LOOP_DIR"
for seed in $(seq 1 "$HOMES"); do home train "$seed" "$TASKS"; done
for seed in $(seq 1001 $((1000 + HELD_OUT_HOMES))); do home held-out "$seed" "$HELD_OUT_TASKS"; done

# play PART SEED: the oracle's episodes of a home, with images.
play() {
  local traces="$LOOP_DIR/$1-traces/home_$2"
  [[ -d $traces ]] && return
  rm -rf "$traces.part" "$LOOP_DIR/$1-set"
  "$REEL" run --tasks "$LOOP_DIR/$1/home_$2/tasks" --policy oracle --jobs "$JOBS" --out "$traces.part" >/dev/null
  mv "$traces.part" "$traces"
}

for seed in $(seq 1 "$HOMES"); do play train "$seed"; done
"$here/set.sh" "$LOOP_DIR/train-traces" "$LOOP_DIR/train-set"

# The oracle in the homes of evaluation: what `examine.py` compares with. Nothing is trained on it.
if [[ -n ${EXAMINE:-} ]]; then
  for seed in $(seq 1001 $((1000 + HELD_OUT_HOMES))); do play held-out "$seed"; done
  "$here/set.sh" "$LOOP_DIR/held-out-traces" "$LOOP_DIR/held-out-set"
fi
