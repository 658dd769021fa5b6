#!/usr/bin/env bash
# wheel.sh: builds the wheel of the Python package into python/dist, with the profile `wheel` and without Rerun's viewer.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$HOME/.cache/reel}"
tools="${XDG_CACHE_HOME:-$HOME/.cache}/reel-python/maturin"
if [[ ! -x $tools/bin/maturin ]]; then
  python3 -m venv "$tools"
  "$tools/bin/python" -m pip install -q --disable-pip-version-check 'maturin>=1.9,<2'
fi
"$tools/bin/maturin" build --locked --strip --out dist
ls -l dist
