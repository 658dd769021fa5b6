#!/usr/bin/env bash
# test.sh: the Python package as its users have it. Builds the wheel, installs it into an empty environment, runs every test, those
# that take long and those with PyTorch, TRL, verifiers and ms-swift included, then the type checker.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"
WHEEL_PROFILE="${WHEEL_PROFILE:-fast}" ./wheel.sh
python=$(../tests/python.sh package)
"$python" -m pip install -q --disable-pip-version-check --force-reinstall --no-deps dist/reel-*.whl
bytes=$(stat -c %s dist/reel-*.whl)
echo "the wheel has $bytes bytes"
((bytes <= 60 * 1024 * 1024)) || { echo "the wheel is larger than 60 MiB" >&2; exit 1; }
export PYTHONDONTWRITEBYTECODE=1 REEL_LONG=1
# from another folder, so that the installed package is tested, not this one
cd tests
"$python" -P -m pytest -q -p no:cacheprovider --rootdir . .
cd ..
"$python" -m pyright --pythonpath "$python" reel examples
