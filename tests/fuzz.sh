#!/usr/bin/env bash
# `make fuzz`: feeds each parser of outside bytes (fuzz/parsers) with mutated inputs, or those that are named: fuzz.sh [NAME...].
#   FUZZ_S        seconds for each parser (default 60)
#   FUZZ_TOTAL_S  seconds for all of them, in equal shares, in place of FUZZ_S
#   FUZZ_TABLES   `no` leaves out the parsers of fuzz/parsers/tables.rs, which take DataFusion to build
# Inputs that reach new code are kept in ~/.cache/reel-fuzz. What crashes, hangs or takes too much memory lies in fuzz/artifacts, is
# named at the end and makes the exit status 1; it goes into fuzz/corpus with the mend.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$HOME/.cache/reel}/fuzz"
kept="${XDG_CACHE_HOME:-$HOME/.cache}/reel-fuzz"

# The names in a list of parsers.
names_in() { sed -n 's/^    ("\([a-z_]*\)", [a-z_:]*),$/\1/p' "$1"; }
mapfile -t light < <(names_in fuzz/parsers/mod.rs)
mapfile -t heavy < <(names_in fuzz/parsers/tables.rs)
names=("$@")
if ((!${#names[@]})); then
  names=("${light[@]}")
  [[ ${FUZZ_TABLES:-} == no ]] || names+=("${heavy[@]}")
fi
# The program that feeds a parser.
program_of() { [[ " ${heavy[*]} " == *" $1 "* ]] && echo tables || echo parser; }
for name in "${names[@]}"; do
  [[ " ${light[*]} ${heavy[*]} " == *" $name "* ]] || { echo "no parser is called $name; there are ${light[*]} ${heavy[*]}" >&2; exit 2; }
done

rustc +nightly --version >/dev/null 2>&1 || rustup toolchain install nightly --profile minimal
cargo +nightly fuzz --version >/dev/null 2>&1 || cargo install --locked cargo-fuzz
# The versions that Reel is built and tested with.
cp Cargo.lock fuzz/Cargo.lock
fuzz() { local verb=$1 program=$2; shift 2; cargo +nightly fuzz "$verb" --features "${program/parser/}" "$program" "$@"; }
for program in $(printf '%s\n' "${names[@]}" | while read -r name; do program_of "$name"; done | sort -u); do
  fuzz build "$program"
done

seconds=${FUZZ_S:-60}
[[ -z ${FUZZ_TOTAL_S:-} ]] || seconds=$((FUZZ_TOTAL_S / ${#names[@]}))
((seconds > 0)) || { echo "less than a second for each of ${#names[@]} parsers" >&2; exit 2; }
# Parsers of files write them there; a disk would be most of the time.
memory=/dev/shm
[[ -w $memory ]] || memory=${TMPDIR:-/tmp}
TMPDIR=$(mktemp -d "$memory/reel-fuzz-XXXXXX")
export TMPDIR
trap 'rm -rf "$TMPDIR"' EXIT

table=$(printf '%-16s %12s %12s %10s %8s' parser executions 'a second' 'new inputs' crashes)
total=0 crashed=()
for name in "${names[@]}"; do
  mkdir -p "$kept/$name" "fuzz/artifacts/$name"
  log="$kept/$name.log"
  started="$TMPDIR/started"
  touch "$started"
  echo "$name: $seconds s"
  REEL_PARSER=$name fuzz run "$(program_of "$name")" "$kept/$name" "fuzz/corpus/$name" -- -artifact_prefix="fuzz/artifacts/$name/" \
    -max_total_time="$seconds" -timeout=20 -rss_limit_mb=4096 -detect_leaks=0 -print_final_stats=1 >"$log" 2>&1 && ended=0 || ended=$?
  figure() { sed -n "s/^stat::$1: *//p" "$log" | tail -1; }
  mapfile -t found < <(find "fuzz/artifacts/$name" -type f -newer "$started" ! -name 'slow-unit-*')
  executions=$(figure number_of_executed_units)
  total=$((total + ${executions:-0}))
  table+=$(printf '\n%-16s %12s %12s %10s %8s' "$name" "${executions:--}" "$(figure average_exec_per_sec)" "$(figure new_units_added)" "${#found[@]}")
  for input in "${found[@]}"; do crashed+=("$name $input"); done
  ((ended == 0 || ${#found[@]})) || crashed+=("$name $log")
  rm -rf "${TMPDIR:?}"/*
done

printf '\n%s\n%-16s %12s\n' "$table" all "$total"
((${#crashed[@]})) || exit 0
for crash in "${crashed[@]}"; do
  read -r name input <<<"$crash"
  program=$(program_of "$name")
  printf '\n%s: see %s; again with\n' "$input" "$kept/$name.log"
  echo "  REEL_PARSER=$name CARGO_TARGET_DIR=$CARGO_TARGET_DIR cargo +nightly fuzz run --features '${program/parser/}' $program $input"
done
exit 1
