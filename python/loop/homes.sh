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

for seed in $(seq 1 "$HOMES"); do
  traces="$LOOP_DIR/traces/home_$seed"
  [[ -d $traces ]] && continue
  rm -rf "$traces.part"
  "$REEL" run --tasks "$LOOP_DIR/train/home_$seed/tasks" --policy oracle --jobs "$JOBS" --out "$traces.part" >/dev/null
  "$REEL" dataset annotate "$traces.part" >/dev/null
  "$PYTHON" "$here/notes.py" --reel "$REEL" "$traces.part"
  mv "$traces.part" "$traces"
  rm -rf "$LOOP_DIR/store" "$LOOP_DIR/set"
done

if [[ ! -d $LOOP_DIR/set ]]; then
  rm -rf "$LOOP_DIR/set.part" "$LOOP_DIR/store"
  "$REEL" ingest "$LOOP_DIR/traces" --store "$LOOP_DIR/store" >/dev/null
  # The same binary recorded the traces a moment ago. The images keep their size: `reel bench` sends them as they were taken.
  "$REEL" export sft --store "$LOOP_DIR/store" --format ms-swift --style single-turn --annotations notes --image-format png --max-pixels 0 \
    --no-replay --allow-unverified --jobs "$JOBS" --out "$LOOP_DIR/set.part"
  mv "$LOOP_DIR/set.part" "$LOOP_DIR/set"
fi

# The oracle in the homes of evaluation: what `examine.py` compares with. Nothing is trained on it.
if [[ -n ${EXAMINE:-} && ! -d $LOOP_DIR/held-out-set ]]; then
  rm -rf "$LOOP_DIR"/held-out-{traces,store,set.part}
  for seed in $(seq 1001 $((1000 + HELD_OUT_HOMES))); do
    "$REEL" run --tasks "$LOOP_DIR/held-out/home_$seed/tasks" --policy oracle --jobs "$JOBS" --out "$LOOP_DIR/held-out-traces/home_$seed" >/dev/null
  done
  "$REEL" dataset annotate "$LOOP_DIR/held-out-traces" >/dev/null
  "$PYTHON" "$here/notes.py" --reel "$REEL" "$LOOP_DIR/held-out-traces"
  "$REEL" ingest "$LOOP_DIR/held-out-traces" --store "$LOOP_DIR/held-out-store" >/dev/null
  "$REEL" export sft --store "$LOOP_DIR/held-out-store" --format ms-swift --style single-turn --annotations notes --image-format png --max-pixels 0 \
    --no-replay --allow-unverified --jobs "$JOBS" --out "$LOOP_DIR/held-out-set.part"
  mv "$LOOP_DIR/held-out-set.part" "$LOOP_DIR/held-out-set"
fi
