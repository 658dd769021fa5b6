#!/usr/bin/env bash
# `make bench-pages`: the optimised binary with pages over 100,000 synthetic episodes, in a browser. Fails where a page is slower than
# docs/figures.md (Web pages) promises, or where pages keep memory.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$HOME/.cache/reel}"
if [[ -z ${REEL:-} ]]; then
  dashboards/build.sh
  cargo build --locked --profile fast -p reel-cli --no-default-features --features analytics
fi
REEL="${REEL:-$CARGO_TARGET_DIR/fast/reel}" tests/pages/run.sh --large
