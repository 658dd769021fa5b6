#!/usr/bin/env bash
# `make cluster`: a scheduler and executors on machines of their own (network namespaces, where root may make them), with traces
# and tables in an S3-compatible store; whether they answer as one machine does, what they do when machines die, how they grow.
# TRACES (default 1000), CLUSTER_DIR (default: a temporary folder, removed at the end); arguments: parts to run.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$HOME/.cache/reel}"
cargo build --locked --workspace --all-targets
PYTHON="${REEL_PYTHON:-$(tests/python.sh)}"
work="${CLUSTER_DIR:-$(mktemp -d)}"
[[ -n ${CLUSTER_DIR:-} ]] || trap 'rm -rf "$work"' EXIT
"$PYTHON" tests/cluster/cluster.py --reel "$CARGO_TARGET_DIR/debug/reel" --work "$work" --traces "${TRACES:-1000}" "$@"
