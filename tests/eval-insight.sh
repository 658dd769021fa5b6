#!/usr/bin/env bash
# `make eval-insight`: how often taxonomy and blame are right on competent play that random operators perturb. The truth comes from
# counterfactual play (src/counterfactual/src/truth) and is fixed before Reel answers. SPLIT=development may be looked at
# (SHOW wrong answers are listed); the report half shares no operator, task or seed with it and shows figures only.
# Beside it stand 60 failures of a learned policy (tests/training/labelled, played by `make eval-learned`) that two labellers labelled
# without Reel's answer: how far they agree with each other, and Reel with each of them.
#
# EPISODES (default 1000), SEED (default 1). REEL: a binary that is built already.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$HOME/.cache/reel}"
[[ -n ${REEL:-} ]] || cargo build --locked --workspace --all-targets
reel="${REEL:-$CARGO_TARGET_DIR/debug/reel}"
work="${EVAL_DIR:-$(mktemp -d)}"
split="${SPLIT:-report}"
show=()
[[ $split == development ]] && show=(--examples "${SHOW:-20}")
"$reel" dev eval-insight --split "$split" --episodes "${EPISODES:-1000}" --seed "${SEED:-1}" --out "$work" "${show[@]}"
echo "traces, store and truth.json: $work"

labelled=tests/training/labelled
mkdir -p "$work/labelled"
python3 -m tarfile -e "$labelled/episodes.tar.xz" "$work/labelled"
"$reel" ingest "$work/labelled" --store "$work/labelled-store" >/dev/null
"$reel" blame --store "$work/labelled-store" >/dev/null
"$reel" taxonomy --store "$work/labelled-store" >/dev/null
python3 tests/training/agree.py --reel "$reel" --store "$work/labelled-store" --index "$labelled/index.json" \
  "$labelled/first.json" "$labelled/second.json"
