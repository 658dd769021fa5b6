#!/usr/bin/env bash
# `make eval-attribution`: whether the 95 % intervals of `reel attribute` hold the true difference in at least 95 of 100 runs,
# for each capability. The truth is known: faults are injected, each kind maps to one capability, and the same agent is played
# without the faults of that capability. Runs are drawn from the played episodes by task, with replacement.
#
# EPISODES (default 600). SEEDS=developing takes the tasks and faults that the rules were developed on. REEL: a binary that is
# built already.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$HOME/.cache/reel}"
[[ -n ${REEL:-} ]] || cargo build --locked --workspace --all-targets
reel="${REEL:-$CARGO_TARGET_DIR/debug/reel}"
work="${EVAL_DIR:-$(mktemp -d)}"
kinds=wrong_attribute,similar_furniture,missing_ask,oscillation,repeated_failure,missing_pick,premature_finish
if [[ ${SEEDS:-report} == developing ]]; then task_seed=5 seed=1000; else task_seed=9201 seed=9700000; fi

"$reel" task draw --count 200 --seed "$task_seed" --out "$work/tasks" >/dev/null
"$reel" agent faults run --tasks "$work/tasks" --out "$work/faulty" --episodes "${EPISODES:-600}" --seed "$seed" \
  --double-share 0.3 --repaired-share 0.2 --detour-share 0.3 --kinds "$kinds" >/dev/null
echo "=== tasks of seed $task_seed, faults from seed $seed"
"$reel" attribute "$work/faulty" --labels --runs 100 --run-tasks 60
