#!/usr/bin/env bash
# `make viewers`: what other people's viewers say of our files. Ten traces pass `rerun mcap check --full`, and their recordings
# `rerun rrd verify`, both of PyPI's rerun-sdk.
#
# REEL  a binary that is built already (default: cargo builds it)
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$HOME/.cache/reel}"
[[ -n ${REEL:-} ]] || cargo build --locked --workspace --all-targets
reel=${REEL:-$CARGO_TARGET_DIR/debug/reel}
python=${REEL_PYTHON:-$(tests/python.sh)}
rerun=$(dirname "$python")/rerun # rerun-sdk puts its command beside Python
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
