#!/usr/bin/env bash
# Rebuilds REAL-Bench's scene from the published layout, plays every task with the oracle and with each faulty policy, replays all of it with one and with two
# threads, lets an unoptimised build replay what an optimised one recorded, and prints figures. Fails on any divergence.
#
# REEL_REAL_BENCH  the published data (default: ../shared/real-bench beside the checkout)
# REEL_OUT         where traces go (default: a temporary folder, removed at the end)
# REEL_SAMPLE      tasks of each family that the builds exchange (default: 3; the unoptimised build is slow)
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

data=${REEL_REAL_BENCH:-../shared/real-bench}
sample=${REEL_SAMPLE:-3}
seed=7
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$HOME/.cache/reel}"
if [[ ! -d $data/tasks ]]; then
  echo "no REAL-Bench data at $data: set REEL_REAL_BENCH" >&2
  exit 2
fi
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
out=${REEL_OUT:-$work/traces}
mkdir -p "$out"

figures=()
# timed NAME COMMAND...: runs it, keeps the seconds; stops the script when it fails.
timed() {
  local name=$1 begin=$EPOCHREALTIME
  shift
  echo "== $name" >&2
  "$@"
  figures+=("$(awk -v n="$name" -v a="$begin" -v b="$EPOCHREALTIME" 'BEGIN { printf "%-44s %9.1f s", n, b - a }')")
}
count() { find "$1" -name '*.mcap' | wc -l; }
bytes() { find "$1" -name '*.mcap' -printf '%s\n' | awk '{ sum += $1 } END { printf "%d", sum }'; }

timed "build, daily" cargo build --locked --quiet --workspace --all-targets
timed "build, lean release" cargo build --locked --quiet --release -p reel-cli --no-default-features
timed "build, lean unoptimised" cargo build --locked --quiet --profile unopt -p reel-cli --no-default-features
daily=$CARGO_TARGET_DIR/debug/reel
release=$CARGO_TARGET_DIR/release/reel
unopt=$CARGO_TARGET_DIR/unopt/reel
jobs=$(nproc)

# As an outsider plays it: from the task files alone. Exit code 3 says that the bundle is not complete, which it is not here.
mkdir -p "$work/REAL/benchmark"
cp -r "$data/tasks" "$work/REAL/benchmark/tasks"
bench=$work/real-bench
rebuild() {
  local code=0
  "$daily" task real-bench "$work/REAL" --out "$bench" || code=$?
  ((code == 0 || code == 3))
}
timed "tasks real-bench" rebuild
timed "task check" "$daily" task check "$bench/tasks"
mkdir "$work/vocabulary"
timed "open vocabulary" python3 tests/vocabulary/argmax.py "$daily" "$bench/tasks" "$work/vocabulary"

record() {
  "$daily" run --tasks "$bench/tasks" --policy "$1" --seed "$seed" --out "$out/$1" --jobs "$jobs" | tee "$work/$1.txt"
}
tasks=$(find "$data/tasks" -name '*.yaml' | wc -l)
for policy in oracle wrong-object wrong-receptacle no-ask oscillating forgets-door gibberish; do
  timed "record $policy" record "$policy"
  recorded=$(count "$out/$policy")
  if ((recorded == 0)); then
    echo "$policy recorded nothing in $out/$policy" >&2
    exit 1
  fi
  if [[ $policy == oracle ]] && ! grep -Eq "^  all +$tasks +100\.0%" "$work/oracle.txt"; then
    echo "the oracle does not reach the goal of all $tasks tasks" >&2
    exit 1
  fi
  timed "replay $policy, 1 thread" "$daily" replay "$out/$policy" --jobs 1
  timed "replay $policy, 2 threads" "$daily" replay "$out/$policy" --jobs 2
  # From snapshots in the middle, too: the oracle and three that make mistakes.
  case $policy in
    oracle | wrong-object | forgets-door | gibberish) timed "restored at 5 calls, $policy" "$daily" replay "$out/$policy" --restored 5 --jobs "$jobs" ;;
  esac
  figures+=("$(printf '%-44s %9d of %d task files, %d bytes each' "traces of $policy" "$recorded" "$tasks" "$(($(bytes "$out/$policy") / recorded))")")
done

# Images dropped and drawn again, over more than 200 episodes: the same bytes.
for policy in oracle no-ask; do
  timed "compact, $policy" "$daily" trace compact "$out/$policy" --out "$work/lean/$policy" --jobs "$jobs"
  timed "expand, $policy" "$daily" trace expand "$work/lean/$policy" --out "$work/expanded/$policy" --jobs "$jobs"
  diff -r "$out/$policy" "$work/expanded/$policy"
done

# The long forms of tests that `make test` runs in short.
timed "10,000 flips, 200 kills, a cut at every byte" env REEL_FLIPS=10000 REEL_KILLS=200 REEL_CUT_STRIDE=1 cargo test --locked --quiet --workspace --test trace
timed "1,000 forgeries" env REEL_FORGERIES=1000 cargo test --locked --quiet --workspace --test replay -- forgeries
timed "1,000 branches" env REEL_BRANCHES=1000 cargo test --locked --quiet --workspace --test branch -- random
timed "202 episodes to ATIF, Inspect, OpenTelemetry and back" env REEL_ATIF_TASKS=67 cargo test --locked --quiet --workspace --test cli -- a_trace_comes_back
timed "200 recordings answer over 3 transports" env REEL_REPLAY_TRACES=201 cargo test --locked --quiet --workspace --test cli -- on_tape_every_transport
timed "500 mutations, deviations named" env REEL_REPLAY_MUTATIONS=500 cargo test --locked --quiet --workspace --test cli -- first_deviation_of_mutated
timed "blame of every task" env REEL_EVERY_TASK=1 REEL_REAL_BENCH="$data" cargo test --locked --quiet --workspace --test blame -- real_bench

# A few tasks of each family, from one build to the other.
for family in "$bench"/tasks/*/; do
  mkdir -p "$bench/sample/$(basename "$family")"
  find "$family" -name '*.yaml' | sort | awk -v n="$sample" 'NR <= n' | xargs -I{} cp {} "$bench/sample/$(basename "$family")/"
done
timed "record a sample, release" "$release" run --tasks "$bench/sample" --policy oracle --seed "$seed" --out "$work/release" --jobs "$jobs"
timed "replay it, release" "$release" replay "$work/release" --jobs "$jobs"
timed "replay it, daily" "$daily" replay "$work/release" --jobs "$jobs"
timed "replay it, unoptimised" "$unopt" replay "$work/release" --jobs "$jobs"

echo
echo "== figures ($(count "$out") traces, $(bytes "$out") bytes, $jobs cores) =="
printf '%s\n' "${figures[@]}"
echo "no replay diverged"
