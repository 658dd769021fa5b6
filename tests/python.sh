#!/usr/bin/env bash
# python.sh [NAME REQUIREMENTS]: prints a Python that has what the tests compare Reel with (requirements.txt), for REEL_PYTHON, or what
# the file REQUIREMENTS lists; makes it the first time. Without one, the tests that want it say that they skip.
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
home="${XDG_CACHE_HOME:-$HOME/.cache}/reel-python/${1:-tests}"
requirements="${2:-$here/requirements.txt}"
if ! cmp -s "$requirements" "$home/requirements.txt"; then
  if ! python3 -c 'import ensurepip' 2>/dev/null && [[ $(id -u) == 0 ]] && command -v apt-get >/dev/null; then
    { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends python3-venv; } >&2
  fi
  python3 -m venv "$home" >&2
  timeout 600 "$home/bin/python" -m pip install -q --disable-pip-version-check -r "$requirements" >&2
  cp "$requirements" "$home/requirements.txt"
fi
echo "$home/bin/python"
