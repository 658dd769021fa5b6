#!/usr/bin/env bash
# The simulator in a browser: every golden trace is verified by the module under Node and in Chromium and Firefox with the verdicts of the native build,
# changed bytes are named in the native words, a shared page and the examples of a report work from disk without a network, a row of a leaderboard
# is executed again, and how long it takes beside the native build.
# Needs Node, Chromium and Firefox (installed where they may be) and a module (web/build.sh); what is missing is said, and the rest is skipped.
#
#   run.sh [--short]    some traces and changed bytes instead of all and 500
#
# REEL        a binary that is built already (default: cargo builds it)
# REEL_NODE   where packages are installed (default: ~/.cache/reel-node)
# TRACES      a folder of traces (default: traces/golden)
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$HOME/.cache/reel}"
if [[ -z ${REEL:-} ]]; then
  cargo build --locked --workspace --bin reel
fi
export REEL=${REEL:-$CARGO_TARGET_DIR/debug/reel} TRACES=${TRACES:-traces/golden} FORM=${1:-}

skip() { # NEED WHY
  echo "skipped: $1: the simulator in a browser, because $2"
  exit 0
}
quick=()
[[ -z $FORM ]] || quick=(--quick)
web/build.sh "${quick[@]}" 2>&1 | sed 's/^skipped: [a-z]*: the player.*because /building: /'
[[ -f web/dist/player.html ]] || skip wasm "web/build.sh could not build it"
WORK=$(mktemp -d)
export WORK
trap 'rm -rf "$WORK"' EXIT
node tests/web/guide.mjs
node tests/web/native.mjs

. tests/browser.sh
with_chromium
node tests/web/page.mjs
node tests/web/documents.mjs
with_firefox
node tests/web/firefox.mjs
