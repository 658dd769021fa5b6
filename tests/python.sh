#!/usr/bin/env bash
# python.sh [NAME]: prints the Python of the virtual environment with the packages of tests/python/NAME.txt (default: tests), below
# ~/.cache/reel-python, and makes the environment where it is missing or old. Fails where the packages cannot be installed.
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
name="${1:-tests}"
home="${XDG_CACHE_HOME:-$HOME/.cache}/reel-python/$name"
requirements="$here/python/$name.txt"
current() { cmp -s "$requirements" "$home/requirements.txt"; }
if ! current; then
  mkdir -p "${home%/*}"
  if command -v flock >/dev/null; then
    # Tests that want the same environment at once wait for each other.
    exec 9>"$home.lock"
    flock 9
  fi
  if ! current; then
    if ! python3 -c 'import ensurepip' 2>/dev/null && [[ $(id -u) == 0 ]] && command -v apt-get >/dev/null; then
      { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends python3-venv; } >&2
    fi
    # The first Python that is new enough: of the PATH, else one that pyenv keeps.
    least=$(sed -n 's/^# python: //p' "$requirements")
    for python in python3 python3.1{2,3,4} "${PYENV_ROOT:-$HOME/.pyenv}"/versions/3.*/bin/python3; do
      "$python" -c "import sys; sys.exit(sys.version_info < tuple(map(int, '${least:-3.0}'.split('.'))))" 2>/dev/null && break
      python=
    done
    [[ -n $python ]] || { echo "no Python $least or newer; install one" >&2 && exit 1; }
    "$python" -m venv --clear "$home" >&2
    # A registry that does not answer ends here, and a slow machine with a compiler beside it does not.
    pip=(timeout --verbose 1500 "$home/bin/python" -m pip install -q --disable-pip-version-check --retries 2)
    "${pip[@]}" -r "$requirements" >&2
    alone=$(sed -n 's/^# without dependencies: //p' "$requirements")
    # shellcheck disable=SC2086
    [[ -z $alone ]] || "${pip[@]}" --no-deps --ignore-requires-python $alone >&2
    afterwards=$(sed -n 's/^# afterwards: //p' "$requirements")
    [[ -z $afterwards ]] || "$home/bin/python" "$here/python/$afterwards" >&2
    cp "$requirements" "$home/requirements.txt"
  fi
fi
echo "$home/bin/python"
