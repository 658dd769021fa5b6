#!/usr/bin/env bash
# `make bench-sql`: fills a store with synthetic episodes and asks the same questions of reel and of DuckDB.
# EPISODES (default 1000000), BENCH_DIR (default ~/.cache/reel-bench).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
source tests/bench/setup.sh
store="$BENCH_DIR/synthetic-$EPISODES"
[[ -d $store/episodes ]] || "$REEL" store synthesize --episodes "$EPISODES" --store "$store"
"$PYTHON" tests/bench/sql.py "$store" --work "$BENCH_DIR/duckdb-$EPISODES" --reel "$REEL"
echo
echo "rewards of all episodes again, from the tables, twice a preset:"
for preset in paper real-repo real-trainer; do
  seconds=$( { TIMEFORMAT='%U %S'; time "$REEL" store reward --store "$store" --diff "$preset" "$preset" >/dev/null 2>&1; } 2>&1 )
  awk -v preset="$preset" -v episodes="$EPISODES" '{ printf "%-14s %9.0f episodes a CPU second\n", preset, 2 * episodes / ($1 + $2) }' <<<"$seconds"
done
