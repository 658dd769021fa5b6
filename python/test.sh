#!/usr/bin/env bash
# test.sh: the Python package as its users have it. Builds the wheel, installs it into an environment of its own, and runs every test,
# those that take long and those with PyTorch, TRL, verifiers and ms-swift included, then the type checker over package and examples.
# REEL_PYTHON: the Python of an environment with the packages of tests/python/package.txt. REEL_WHEEL: a wheel that is there already.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"
if [[ -z ${REEL_WHEEL:-} ]]; then
  rm -rf dist
  ./wheel.sh
  REEL_WHEEL=$(ls dist/reel-*.whl)
fi
bytes=$(stat -c %s "$REEL_WHEEL")
echo "the wheel has $bytes bytes"
((bytes <= 60 * 1024 * 1024)) || { echo "the wheel is larger than 60 MiB" >&2; exit 1; }
python=${REEL_PYTHON:-$(../tests/python.sh package)}
"$python" -m pip install -q --disable-pip-version-check --force-reinstall --no-deps "$REEL_WHEEL"
# the installed package is tested, not this folder; processes that tests start see it, too
export PYTHONDONTWRITEBYTECODE=1 REEL_LONG=1 PYTHONSAFEPATH=1
"$python" -m pytest -q -p no:cacheprovider tests
"$python" -m pyright --pythonpath "$python" reel examples
