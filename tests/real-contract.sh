#!/usr/bin/env bash
# `make real-contract`: holds Reel against what REAL's published code computes and expects, and prints for each vector file how
# many cases are equal. First the vector tests of every crate, then clients of their own in Python (tests/real-contract) that
# drive `reel serve` as the published trainer and agents do. Fails if a case differs or a file is compared by nobody.
#
# REEL_REAL_CONTRACT  folder of the vector files (default: ../shared/real-contract/vectors beside the checkout)
# REEL_REAL_BENCH     REAL-Bench: a folder with tasks (default: ../shared/real-bench)
# REEL                a `reel` binary that is built already
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$HOME/.cache/reel}"
export REEL_REAL_CONTRACT="${REEL_REAL_CONTRACT:-$PWD/../shared/real-contract/vectors}"
export REEL_REAL_BENCH="${REEL_REAL_BENCH:-$PWD/../shared/real-bench}"
if [[ ! -d $REEL_REAL_CONTRACT ]]; then
  echo "no vector files at $REEL_REAL_CONTRACT: set REEL_REAL_CONTRACT" >&2
  exit 2
fi

log=$(mktemp)
trap 'rm -f "$log"' EXIT
failed=0
echo "== vector tests of the crates ==" >&2
cargo test --locked --workspace --tests --no-fail-fast -- real_contract --skip the_published_clients --show-output >"$log" 2>&1 || failed=1
((failed == 0)) || grep -E '^(error|warning: unused|---- |test .* FAILED)|cases differ' "$log" >&2 || true
echo "== clients in Python ==" >&2
[[ -n ${REEL:-} ]] || cargo build --locked --quiet --workspace --bin reel
export REEL="${REEL:-$CARGO_TARGET_DIR/debug/reel}"
tests/real-contract/run.sh 2>&1 | tee -a "$log" || failed=1

# real-contract <tab> file <tab> part <tab> cases <tab> equal <tab> different <tab> different for a stated cause
echo
awk -F'\t' '
  $1 == "real-contract" { cases[$2] += $4; equal[$2] += $5; different[$2] += $6; deviating[$2] += $7; parts[$2] = parts[$2] (parts[$2] ? ", " : "") $3 }
  function line(file) {
    printf "%-24s %8d %8d %10d %14d  %s\n", file, cases[file], equal[file], different[file], deviating[file], parts[file]
    if (!cases[file] || different[file]) bad = 1
    delete cases[file]
  }
  END {
    printf "%-24s %8s %8s %10s %14s  %s\n", "file", "cases", "equal", "different", "stated cause", "parts"
    while (("ls " ENVIRON["REEL_REAL_CONTRACT"]) | getline file) if (file ~ /\.json$/) line(file)
    for (file in cases) line(file) # what the clients played
    exit bad
  }' "$log" || failed=1
grep -h '^real-contract-cause' "$log" | cut -f2- | sed 's/^/stated cause: /' || true
grep -h 'skipped: ' "$log" | sort -u || true
exit "$failed"
