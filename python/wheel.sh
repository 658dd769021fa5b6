#!/usr/bin/env bash
# wheel.sh: builds the wheel of the Python package into python/dist, with the release profile and without Rerun's viewer.
# WHEEL_PROFILE=fast leaves link-time optimisation out, which takes most of the time.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$HOME/.cache/reel}"
tools="${XDG_CACHE_HOME:-$HOME/.cache}/reel-python/maturin"
if [[ ! -x $tools/bin/maturin ]]; then
  python3 -m venv "$tools"
  "$tools/bin/python" -m pip install -q --disable-pip-version-check 'maturin>=1.9,<2'
fi
"$tools/bin/maturin" build --locked --profile "${WHEEL_PROFILE:-release}" --strip --out dist
ls -l dist
