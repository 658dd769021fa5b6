#!/usr/bin/env bash
# `make viewers`: what other people's viewers say of our files. Ten traces pass `rerun mcap check --full`, and their recordings
# `rerun rrd verify`, both of PyPI's rerun-sdk.
#
# REEL        a binary that is built already (default: cargo builds it)
# REEL_RERUN  a `rerun` of version 0.36 (default: one in ~/.cache/reel-bench, installed where it may be)
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$HOME/.cache/reel}"
[[ -n ${REEL:-} ]] || cargo build --locked --workspace --all-targets
reel=${REEL:-$CARGO_TARGET_DIR/debug/reel}
rerun=${REEL_RERUN:-}
if [[ -z $rerun ]]; then
  venv="${BENCH_DIR:-$HOME/.cache/reel-bench}/rerun-0.36.3"
  rerun=$venv/bin/rerun
  if [[ ! -x $rerun ]] && ! { python3 -m venv "$venv" && "$venv/bin/python" -m pip install -q rerun-sdk==0.36.3; } >&2; then
    echo "skipped: Rerun's checks, because rerun-sdk 0.36.3 cannot be installed"
    exit 0
  fi
fi
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$reel" task draw --count 4 --seed 7 --out "$work/tasks" >/dev/null
for policy in oracle planner gibberish; do
  "$reel" run --tasks "$work/tasks" --policy "$policy" --out "$work/traces" >/dev/null
done
checked=0
for trace in $(find "$work/traces" -name '*.mcap' | sort | head -10); do
  "$rerun" mcap check --full "$trace" >"$work/said" 2>&1 || { cat "$work/said"; exit 1; }
  "$reel" export rrd "$trace" --out "$work/episode.rrd" >/dev/null
  "$rerun" rrd verify "$work/episode.rrd" >"$work/said" 2>&1 || { cat "$work/said"; exit 1; }
  checked=$((checked + 1))
done
echo "$checked traces pass 'rerun mcap check --full', and their recordings 'rerun rrd verify'"
[[ $checked == 10 ]]
