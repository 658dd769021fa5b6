#!/usr/bin/env bash
# Executes recorded episodes, and scenes made to fail, in every build and under every condition that this machine can
# make; prints one table and fails unless each digest is the recorded one. docs/determinism.md says what that proves.
#
# REEL_TRACES  folder of traces (default: traces/golden)
# REEL_BIN     another build of reel that has to find the same, e.g. the full one (default: none)
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
. tests/determinism-table.sh

traces=${REEL_TRACES:-traces/golden}
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$HOME/.cache/reel}"
unset REEL_OFF_BY_ONE_ULP

# build NAME ARGUMENT...: the light program, alone with the crates that compute, kept as $work/NAME.
build() {
  local name=$1 program
  shift
  echo "== building $name" >&2
  if ! cargo build --locked --quiet -p reel-episode --example digests --message-format=json-render-diagnostics "$@" \
    >"$work/$name.json" 2>"$work/$name.log"; then
    return 1
  fi
  program=$(sed -n 's|.*"executable":"\([^"]*/digests\)".*|\1|p' "$work/$name.json")
  cp "$program" "$work/$name"
}
# at_level N: the options of a profile with that level and nothing else.
at_level() {
  local profile="profile.opt$1"
  printf '%s\n' --profile "opt$1" --config "$profile.inherits=\"release\"" --config "$profile.opt-level=$1" --config "$profile.lto=\"off\""
}
# built TITLE NAME ARGUMENT...: builds and runs it, or says why it cannot be built.
built() {
  local title=$1 name=$2
  shift 2
  if build "$name" "$@"; then
    column "$title" "$work/$name"
  else
    skip "$title" "$(grep -m 1 '^error' "$work/$name.log" || echo "it does not build")"
  fi
}
# replayed REEL: digests by the verdicts of `reel replay`, which compares every digest of every call.
replayed() {
  xargs -d '\n' "$1" replay --json <"$work/traces" >"$work/verdicts" || true
  awk '
    FILENAME ~ /traces$/ { path[FNR] = $0; next }
    FILENAME ~ /recorded$/ { id[path[FNR]] = $1; digest[$1] = $2; next }
    {
      verdict = $0; sub(/.*"verdict":"/, "", verdict); sub(/".*/, "", verdict)
      trace = $0; sub(/.*"trace":"/, "", trace); sub(/".*/, "", trace)
      print id[trace], verdict == "exact" ? digest[id[trace]] : verdict
    }
  ' "$work/traces" "$work/recorded" "$work/verdicts"
}

echo "== building reel" >&2
cargo build --locked --quiet -p reel-cli --no-default-features
reel=$CARGO_TARGET_DIR/debug/reel
build dev
read_traces "$reel" "$work/dev" "$traces"

column "profile dev" "$work/dev"
column "2 workers, each of them all episodes" "$work/dev" --workers 2
column "8 workers, each of them all episodes" "$work/dev" --workers 8
column "last episode first" "$work/dev" --reversed
column "restored from bytes before each call" "$work/dev" --restored
built "profile release: opt-level 3, thin LTO" release --release
mapfile -t level2 < <(at_level 2)
built "opt-level 2" opt2 "${level2[@]}"
mapfile -t level1 < <(at_level 1)
built "opt-level 1" opt1 "${level1[@]}"
built "profile unopt: opt-level 0, overflow checks" unopt --profile unopt
# other flags for every crate: a folder of its own, or the rest would be built again and again
native_folder=$CARGO_TARGET_DIR/native
native() { CARGO_TARGET_DIR=$native_folder RUSTFLAGS="-C target-cpu=native" built "$@"; }
native "release with -C target-cpu=native" native --release
if build parallel --features parallel; then
  for threads in 1 2 8; do
    column "the engine's feature parallel, $threads threads" env RAYON_NUM_THREADS="$threads" "$work/parallel"
  done
else
  skip "the engine's feature parallel" "$(grep -m 1 '^error' "$work/parallel.log" || echo "it does not build")"
fi
column "reel replay, lean build" replayed "$reel"
if [[ -n ${REEL_BIN:-} ]]; then
  column "reel replay, REEL_BIN" replayed "$REEL_BIN"
else
  skip "reel replay, REEL_BIN" "REEL_BIN names no other build"
fi
for function in sincosf acosf cosf; do
  REEL_OFF_BY_ONE_ULP=$function build "control-$function" "${level1[@]}"
  negative_control "negative control: $function is off by one ulp" "$work/control-$function"
done
print_table
