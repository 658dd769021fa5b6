#!/usr/bin/env bash
# `make fuzz`: feeds each parser of outside bytes (fuzz/parsers.rs) with mutated inputs, FUZZ_S seconds each (default 60), or those that
# are named: fuzz.sh [NAME...]. Inputs that reach new code are kept in ~/.cache/reel-fuzz; what crashes lies in fuzz/artifacts, and goes
# into fuzz/corpus with the mend.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$HOME/.cache/reel}/fuzz"
cargo +nightly fuzz --version >/dev/null 2>&1 || cargo install --locked cargo-fuzz
# The versions that Reel is built and tested with.
cp Cargo.lock fuzz/Cargo.lock
names=("$@")
((${#names[@]})) || mapfile -t names < <(cargo +nightly fuzz list)
for name in "${names[@]}"; do
  found="${XDG_CACHE_HOME:-$HOME/.cache}/reel-fuzz/$name"
  mkdir -p "$found"
  cargo +nightly fuzz run "$name" "$found" "fuzz/corpus/$name" -- -max_total_time="${FUZZ_S:-60}" -timeout=10 -rss_limit_mb=4096
done
