#!/usr/bin/env bash
# `make bench-export`: the same training set by `reel export sft` and by PyPI mcap + datasets, without images and with them
# (Pillow); then the memory of the export from 1,000 to 50,000 traces. TRACES_MAX (default 50000).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
source tests/bench/setup.sh
cargo build --locked --profile fast -p reel-trace --example trace_copies
source tests/bench/traces.sh
record full 100
record many 400 --no-images
"$PYTHON" tests/bench/export.py --full "$BENCH_DIR/traces-full" --lean "$BENCH_DIR/traces-many" --reel "$REEL" \
  --copies "$CARGO_TARGET_DIR/fast/examples/trace_copies" --work "$BENCH_DIR" --traces-max "${TRACES_MAX:-50000}"
