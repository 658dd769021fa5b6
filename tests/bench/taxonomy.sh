#!/usr/bin/env bash
# `make bench-taxonomy`: the rules over synthetic episodes: 10,000, 100,000, and a million (12 million steps). EPISODES_MAX.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
source tests/bench/setup.sh
for episodes in 10000 100000 1000000; do
  ((episodes <= ${EPISODES_MAX:-1000000})) || break
  store="$BENCH_DIR/taxonomy-$episodes"
  [[ -d $store/labels ]] || "$REEL" store synthesize --episodes "$episodes" --store "$store"
  echo "== $episodes episodes"
  TIMEFORMAT='%U s user, %S s system, %R s wall'
  time "$REEL" taxonomy --store "$store" | tail -1
done
