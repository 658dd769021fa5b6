#!/usr/bin/env bash
# Drives Chromium through every web page of a real `reel serve` over episodes that are recorded here: no mock. Needs Node, Chromium
# (installed where it may be) and pages in the binary; what is missing is said, and the rest is skipped.
#
#   run.sh [NAME...]           only the tests whose names begin so
#   run.sh --short             every page once, and the shortest test of each thing that people do on them
#   run.sh --screenshots DIR   every page, light and dark, 1440, 1024 and 390 wide
#   run.sh --large             how long pages take over 100,000 synthetic episodes, and whether they keep memory
#
# REEL        a binary that is built already (default: cargo builds it)
# REEL_NODE   where packages are installed (default: ~/.cache/reel-node)
# ODD         a folder of traces that are not as they should be (src/cli/tests/cli/pages.rs makes it)
# PATIENCE_MS how long anything may take, in milliseconds (default: two minutes)
# PAGES_DATA  a data folder to be used again: made where it is not there (default: a temporary one)
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$HOME/.cache/reel}"
if [[ -z ${REEL:-} ]]; then
  dashboards/build.sh
  cargo build --locked --workspace --all-targets
fi
reel=${REEL:-$CARGO_TARGET_DIR/debug/reel}

skip() { # NEED WHY
  echo "skipped: $1: the web pages in a browser, because $2"
  exit 0
}
. tests/browser.sh
with_chromium

work=$(mktemp -d)
data=${PAGES_DATA:-$work/data}
pids=()
cleanup() {
  for pid in "${pids[@]}"; do { kill "$pid" && wait "$pid"; } 2>/dev/null || true; done
  rm -rf "$work"
}
trap cleanup EXIT
trap 'exit 130' INT
trap 'exit 143' TERM

if [[ ! -d $data/store ]]; then
  echo "recording episodes" >&2
  mkdir -p "$data"
  "$reel" task draw --count 8 --seed 7 --out "$work/tasks" >/dev/null
  for policy in oracle planner; do
    "$reel" run --tasks "$work/tasks" --policy "$policy" --out "$data/traces" >/dev/null
  done
  "$reel" agent faults run --tasks "$work/tasks" --out "$work/faulty" --episodes 12 --seed 4200 >/dev/null
  find "$work/faulty" -name '*.mcap' -exec mv {} "$data/traces/" \;
  # Everything lies flat in the archive.
  find "$data/traces" -mindepth 2 -name '*.mcap' -exec mv {} "$data/traces/" \;
  "$reel" ingest "$data/traces" --store "$data/store" >/dev/null
  "$reel" taxonomy --store "$data/store" >/dev/null
  "$reel" blame --store "$data/store" >/dev/null
  "$reel" export sft --store "$data/store" --format trl --out "$data/exports/first" >/dev/null
fi

[[ -z ${ODD:-} ]] || cp "$ODD"/* "$data/traces/"

source tests/serve.sh
# over NAME DATA ARGUMENT...: a server over a data folder, until the end.
over() {
  serve "$1" "$reel" serve --listen 127.0.0.1:0 --data "$2" --ask rest "${@:3}"
  pids+=("$pid")
}
if [[ ${1:-} == --large ]]; then
  store="${BENCH_DIR:-${XDG_CACHE_HOME:-$HOME/.cache}/reel-bench}/synthetic-100000"
  if [[ ! -d $store/classes ]]; then
    "$reel" store synthesize --episodes 100000 --store "$store" >/dev/null
    "$reel" taxonomy --store "$store" >/dev/null
  fi
  over large "$data" --store "$store"
  URL=$url REEL=$reel node tests/pages/large.mjs
  exit
fi
over empty "$work/empty"
export EMPTY_URL=$url
"$reel" import atif tests/formats/foreign/trajectory.json --out "$work/foreign/traces" >/dev/null
"$reel" import inspect tests/formats/foreign/log.json --out "$work/foreign/traces" >/dev/null
"$reel" ingest "$work/foreign/traces" --store "$work/foreign/store" >/dev/null
"$reel" taxonomy --store "$work/foreign/store" >/dev/null
over foreign "$work/foreign"
export FOREIGN_URL=$url
over full "$data"
export URL=$url
node tests/pages/main.mjs "$@" || { tail -5 "$work/full.log" >&2; exit 1; }
