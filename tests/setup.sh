#!/usr/bin/env bash
# setup.sh: installs the Python packages that `make test` compares Reel with, from PyPI, into the environments of tests/python.sh. Takes
# some minutes once and no time afterwards. Where a package cannot be installed it says so, and the tests that want it skip.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"
if [[ -n ${REEL_PYTHON:-} ]]; then
  echo "tests use REEL_PYTHON: $REEL_PYTHON"
fi
missing=()
for name in tests trainers llama-factory datasets-3 mcp-1.9.4 mcp-1.21.2 mcp-1.30.0 mcp-2.3.0 openenv formats lerobot; do
  cmp -s "python/$name.txt" "${XDG_CACHE_HOME:-$HOME/.cache}/reel-python/$name/requirements.txt" || missing+=("$name")
done
((${#missing[@]})) || exit 0
if ! command -v python3 >/dev/null; then
  echo "no python3: what tests compare with Python is skipped (tests/skips.toml)"
  exit 0
fi
echo "installing the Python packages that tests compare Reel with (${missing[*]}); this takes some minutes, once"
start=$SECONDS
said=$(mktemp)
trap 'rm -f "$said"' EXIT
if printf '%s\n' "${missing[@]}" | xargs -P 3 -n 1 ./python.sh >/dev/null 2>"$said"; then
  echo "installed in $((SECONDS - start)) s"
else
  tail -n 5 "$said"
  echo "not all could be installed: what needs them is skipped (tests/skips.toml)"
fi
