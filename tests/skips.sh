#!/usr/bin/env bash
# skips.sh [--forget]: prints what the last `make test` skipped, from the list that tests write into the build folder (src/vectors/src/skip.rs);
# --forget empties the list.
set -euo pipefail
list="${CARGO_TARGET_DIR:-$HOME/.cache/reel}/skips.txt"
if [[ ${1:-} == --forget ]]; then
  rm -f "$list"
  exit
fi
[[ -s $list ]] || { echo "no part of a test was skipped"; exit; }
echo "$(cut -f1,2 "$list" | sort -u | wc -l) parts of tests were skipped (tests/skips.toml says what each needs):"
sort -u "$list" | awk -F'\t' '$1 != need { need = $1; print "  " need } { print "    " $2 ": " $3 }'
