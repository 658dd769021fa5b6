#!/usr/bin/env bash
# `make eval-learned`: failures that nobody injected. Trains the small model of `make prove-sft` on fewer homes, lets it play tasks of homes
# it never saw (`reel bench` against an endpoint of ours, play.py), has Reel explain the failures, and writes a draw of them down for
# people to label blindly. With LABELS="first.json second.json" (agree.py has the format) it prints how far they and Reel agree. What was
# made once is used again, and what was broken off goes on.
#
# REEL (a binary; else one is built), REEL_PYTHON (a Python with jax; else that of tests/python.sh),
# TRAINING_DIR (default ~/.cache/reel/training), SMOKE=1 (few homes, few updates).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
here=tests/training
TRAINING_DIR="${TRAINING_DIR:-$HOME/.cache/reel/training}"

# Seeds of the homes and of their tasks. Homes 221 to 225 were looked at while the rules were made; those that are played here were not.
train=$(seq 1 40) train_tasks=24 updates=2400
held_out="226 227 228 229" held_out_tasks=40 failures=60
if [[ -n ${SMOKE:-} ]]; then
  train="1 2 3 4" train_tasks=8 updates=200 held_out=221 held_out_tasks=8
fi

. $here/homes.sh
export JAX_COMPILATION_CACHE_DIR="$TRAINING_DIR/compiled"

data="$TRAINING_DIR/learned${SMOKE:+-smoke}"
echo "playing in $(wc -w <<<"$train") homes: $data"
for seed in $train; do play "$seed" "$train_tasks"; done
# shellcheck disable=SC2086
export_set $train
for seed in $held_out; do [[ -d $data/held-out/home_$seed ]] || draw_tasks "$seed" "$held_out_tasks" "$data/held-out"; done

mapfile -d '' sets < <(find "$data/set" -name '*.jsonl' -print0 | sort -z)
"$PYTHON" $here/play.py --updates "$updates" --checkpoint "$data/training.pickle" --sets "${sets[@]}" -- \
  "$REEL" bench --agent function-calling --endpoint '{endpoint}' --model small --temperature 0.7 --max-tokens 64 \
  --tasks "$data/held-out" --scene-dir "$data/scenes" --no-images --out "$data/played"

store="$data/played-store"
"$REEL" ingest "$data/played" --store "$store" >/dev/null
"$REEL" blame --store "$store" >/dev/null
"$REEL" taxonomy --store "$store"
"$PYTHON" $here/transcripts.py --reel "$REEL" --store "$store" --count "$failures" --out "$data/blind"
if [[ -n ${LABELS:-} ]]; then
  # shellcheck disable=SC2086
  "$PYTHON" $here/agree.py --reel "$REEL" --store "$store" --index "$data/blind/index.json" $LABELS
fi
