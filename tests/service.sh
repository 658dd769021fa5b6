#!/usr/bin/env bash
# `make service`: `reel serve` from outside, the long form: agents in processes of their own, the published texts, 200 episodes
# searched for what a policy could not know, faults, and five minutes of Schemathesis over the OpenAPI document.
# REEL: a binary that is built already. REEL_REAL_BENCH: the benchmark's folder.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$HOME/.cache/reel}"
[[ -n ${REEL:-} ]] || cargo build --locked --workspace --all-targets
export REEL="${REEL:-$CARGO_TARGET_DIR/debug/reel}"
export REEL_REAL_BENCH="${REEL_REAL_BENCH:-$PWD/../shared/real-bench}" PYTHONDONTWRITEBYTECODE=1
python3 tests/service/players.py
python3 tests/service/real_repo_texts.py
python3 tests/service/leaks.py --episodes 200
python3 tests/service/faults.py
python3 tests/service/openapi.py --seconds 300
