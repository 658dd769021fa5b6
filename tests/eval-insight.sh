#!/usr/bin/env bash
# `make eval-insight`: how often taxonomy and blame are right on competent play that random operators perturb. The truth comes from
# counterfactual play (src/counterfactual/src/truth) and is fixed before Reel answers. SPLIT=development may be looked at
# (SHOW wrong answers are listed); the report half shares no operator, task or seed with it and shows figures only.
# Beside it stand failures of learned policies (tests/training/labelled: 60 of a language model, of `make eval-learned`, and 60 of a policy
# that sees, of `make prove-loop`) that two labellers labelled without Reel's answer: how far they agree with each other, and Reel with each.
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

for sample in tests/training/labelled/*/; do
  name=$(basename "$sample")
  printf '\n== failures of a learned policy: %s\n' "$name"
  mkdir -p "$work/labelled/$name"
  python3 -m tarfile -e "$sample/episodes.tar.xz" "$work/labelled/$name"
  "$reel" ingest "$work/labelled/$name" --store "$work/labelled-$name" >/dev/null
  "$reel" blame --store "$work/labelled-$name" >/dev/null
  "$reel" taxonomy --store "$work/labelled-$name" >/dev/null
  python3 tests/training/agree.py --reel "$reel" --store "$work/labelled-$name" --index "$sample/index.json" "$sample/first.json" "$sample/second.json"
done
