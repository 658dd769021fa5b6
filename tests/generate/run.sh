#!/usr/bin/env bash
# `make eval-tasks`: makes tasks of every kind, checks them from outside, lets the oracle do them, and prints figures.
# REEL: a binary that is built already. SCENES: names or files of scenes; without them the seven that come along. COUNT: how many tasks.
# REAL_BENCH: the published tasks; without them that part says that it is skipped.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$HOME/.cache/reel}" PYTHONDONTWRITEBYTECODE=1
if [[ -z ${REEL:-} ]]; then
  cargo build --locked --profile fast -p reel-cli --no-default-features
  REEL="$CARGO_TARGET_DIR/fast/reel"
fi
python="${REEL_PYTHON:-$(tests/python.sh)}"
bench="${REAL_BENCH:-../shared/real-bench}"
count="${COUNT:-2000}" seed="${SEED:-1}"
read -ra scenes <<<"${SCENES:-S1 S2 S3 S4 S5 S6 S7}"
scenes=("${scenes[@]/#/--scene=}")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

echo "== $count tasks"
time "$REEL" task generate "${scenes[@]}" --count "$count" --seed "$seed" --out "$work/made"

echo "== in the published schema"
"$REEL" task generate "${scenes[@]}" --count "$((count / 10))" --seed "$seed" --format real --out "$work/real"
if [[ -d $bench/tasks ]]; then
  "$python" tests/generate/real_schema.py "$bench/s7_scene.json" "$bench/tasks"
else
  echo "skipped: real-bench: nothing at $bench, so the validator is not tried on it"
fi

for set in real made; do
  for scene in "$work/$set"/*.json; do
    folder="${scene%.json}"
    echo "== $set, $(basename "$folder")"
    if [[ $set == real ]]; then
      "$python" tests/generate/real_schema.py "$scene" "$folder"
    else
      "$python" tests/generate/check_words.py src/tasks/src/data/objects.json "$scene" "$folder"
    fi
    "$REEL" run --tasks "$folder" --scene "$scene" --no-images --out "$work/traces/$set" --json >>"$work/$set.jsonl" || true
  done
  "$python" tests/generate/oracle.py "$work/$set.jsonl"
done

echo "== with questions"
"$REEL" task generate "${scenes[@]}" --count "${SOCIAL_COUNT:-270}" --seed "$seed" --out "$work/told"
"$REEL" task annotate "$work/told" --seed "$seed" --out "$work/social"
for scene in "$work/social"/*.json; do
  folder="${scene%.json}" traces="$work/traces/social/$(basename "${scene%.json}")"
  "$REEL" run --tasks "$folder" --scene "$scene" --no-images --out "$traces" --json >>"$work/social.jsonl" || true
  "$REEL" replay "$traces"
  "$python" tests/generate/check_questions.py "$REEL" src/tasks/src/data/objects.json "$scene" "$folder" "$traces"
done
"$python" tests/generate/oracle.py "$work/social.jsonl"

echo "== beside REAL-Bench"
if [[ -d $bench/tasks ]]; then
  "$REEL" task report "$work/made" --compare "$bench/tasks"
else
  "$REEL" task report "$work/made"
fi
