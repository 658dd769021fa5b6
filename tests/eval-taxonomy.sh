#!/usr/bin/env bash
# `make eval-taxonomy`: how often the failure taxonomy is right, on faults that were injected on purpose and labelled by who
# injected them; beside it a naive baseline. Then the paper's hundred episodes. FAILURES (default 2000) of single faults, half
# as many episodes with combinations and repaired faults. REEL: a binary that is built already.
#
# The seeds of the report: tasks 9001, faults from 9000000 on. Rules were tuned on tasks 1001, faults from 1000000 on, and on
# nothing else; SEEDS=tuning takes those.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$HOME/.cache/reel}"
[[ -n ${REEL:-} ]] || cargo build --locked --workspace --all-targets
reel="${REEL:-$CARGO_TARGET_DIR/debug/reel}"
work="${EVAL_DIR:-$(mktemp -d)}"
count="${FAILURES:-2000}"
if [[ ${SEEDS:-report} == tuning ]]; then task_seed=1001 seed=1000000; else task_seed=9001 seed=9000000; fi

"$reel" task draw --count 200 --seed "$task_seed" --out "$work/tasks" >/dev/null

# what out count first-seed further arguments...
evaluate() {
  local what=$1 out=$2 count=$3 seed=$4
  shift 4
  echo "=== $what: tasks of seed $task_seed, faults from seed $seed"
  "$reel" agent faults run --tasks "$work/tasks" --out "$work/$out" --episodes "$count" --seed "$seed" "$@" >/dev/null
  "$reel" ingest "$work/$out" --store "$work/$out-store" >/dev/null
  "$reel" taxonomy --store "$work/$out-store" --sankey "$work/$out.svg" --sankey "$work/$out.png"
  "$reel" store label import "$work/$out" --store "$work/$out-store"
  "$reel" taxonomy agreement --store "$work/$out-store" --reference injected --baseline --examples "${SHOW:-10}"
  echo "--- the decisive steps measured by reel blame"
  "$reel" blame --store "$work/$out-store" --no-alternatives >/dev/null
  "$reel" taxonomy --store "$work/$out-store" >/dev/null
  "$reel" taxonomy agreement --store "$work/$out-store" --reference injected --examples 0 | grep -i "step"
}

evaluate "single faults" single "$count" "$seed"
evaluate "combinations and repaired faults" combined $((count / 2)) $((seed + 500000)) --double-share 0.7 --repaired-share 0.35 --detour-share 0.5
evaluate "the paper's hundred episodes" paper 100 $((seed + 800000)) --paper
echo "images and stores: $work"
