#!/usr/bin/env bash
# `make proxy` and `make bench-proxy`: runs a script of this folder against `reel`.
# REEL: a binary that is built already; without tables in it (feature `service` alone), REEL_TABLES names one that has them.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$HOME/.cache/reel}"
[[ -n ${REEL:-} ]] || cargo build --locked --workspace --all-targets
export REEL="${REEL:-$CARGO_TARGET_DIR/debug/reel}" PYTHONDONTWRITEBYTECODE=1
script=$1
shift
exec python3 "tests/proxy/$script" "$@"
