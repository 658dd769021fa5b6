#!/usr/bin/env bash
# `make scale`: stores of synthetic episodes, each ten times the one before: made, compacted, asked the four questions of
# `make bench-sql`, and the benchmark table once more by engines that are not ours.
# Before that a shard of PACKED episodes (default 1000000), and how long one of them takes to be read.
# SIZES (default "100000 1000000 10000000"), BENCH_DIR (default ~/.cache/reel-bench; 20 GB), GIB_MAX (default 8).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
source tests/bench/setup.sh
if ! "$PYTHON" -c 'import pyspark' 2>/dev/null && command -v java >/dev/null; then
  "$PYTHON" -m pip install -q pyspark
fi
cargo run --locked --release -p reel-trace --example shard_access -- "$BENCH_DIR/shard.mcap" "${PACKED:-1000000}" traces/golden/*.mcap
"$PYTHON" tests/bench/scale.py --reel "$REEL" --work "$BENCH_DIR/scale" --gib "${GIB_MAX:-8}" ${SIZES:-100000 1000000 10000000}
