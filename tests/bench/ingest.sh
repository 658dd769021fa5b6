#!/usr/bin/env bash
# `make bench-ingest`: the same traces through `reel ingest`, through PyPI mcap + protobuf + pyarrow, and through a loop that
# only decodes; then memory from 1,000 to 50,000 traces. TRACES_MAX (default 50000).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
source tests/bench/setup.sh
cargo build --locked --profile fast -p reel-trace --example trace_decode --example trace_copies
source tests/bench/traces.sh
record full 100
record lean 100 --no-images
"$PYTHON" tests/bench/ingest.py --full "$BENCH_DIR/traces-full" --lean "$BENCH_DIR/traces-lean" --reel "$REEL" \
  --decode "$CARGO_TARGET_DIR/fast/examples/trace_decode" --copies "$CARGO_TARGET_DIR/fast/examples/trace_copies" \
  --work "$BENCH_DIR" --traces-max "${TRACES_MAX:-50000}"
