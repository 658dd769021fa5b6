#!/usr/bin/env bash
# `make pages`: builds the web pages into dashboards/dist, from where `reel` embeds them. Does nothing where they are newer than what
# they are made of. Without Node it says so, and Reel is built without pages.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"

built=dist/index.html
if [[ -f $built ]] && [[ -z $(find src public index.html ./*.json ./*.ts ./*.js ./*.mjs ../schemas/openapi.json -newer "$built" -print -quit 2>/dev/null) ]]; then
  exit 0
fi
# A fresh Debian has no Node; where it may be installed, it is.
if ! command -v npm >/dev/null && [[ $(id -u) == 0 ]] && command -v apt-get >/dev/null; then
  (apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends nodejs npm) >/dev/null 2>&1 || true
fi
if ! command -v npm >/dev/null; then
  echo "skipped: the web pages, because there is no npm; install Node 20.19 or newer and run 'make pages'" >&2
  exit 0
fi
node=$(node --version | tr -dc '0-9.\n' | awk -F. '{ print $1 * 1000 + $2 }')
vite=()
if ((node < 20019)); then
  # npm has newer ones.
  vite=(npx --yes --package=node@22 --)
fi
if ! npm ci --no-audit --no-fund --loglevel=error; then
  echo "skipped: the web pages, because their packages cannot be installed" >&2
  exit 0
fi
# The types of what the service answers. A change of src/lib/generated.ts is to be committed.
[[ ! -f ../schemas/openapi.json ]] || node generate.mjs
"${vite[@]}" npx vite build --logLevel warn
