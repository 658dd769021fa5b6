#!/usr/bin/env bash
# `make supply-chain`: writes what the released binary is made of to out/reel.cdx.json (CycloneDX), and holds every package of Cargo.lock
# against deny.toml: licences, duplicates, sources, advisories. Fails if anything was not checked.
#
# OFFLINE  1: fetch nothing; advisories are those fetched before, 90 days old at most, and are left out where there are none
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
FULL=1
. tests/release-build.sh
cargo deny --version >/dev/null 2>&1 || env -u CARGO_TARGET_DIR cargo install --locked cargo-deny
offline=()
[[ ${OFFLINE:-0} != 1 ]] || offline=(--offline)
# An exception that nothing needs any more is an error, too.
check() { cargo deny --locked "${offline[@]}" check -D unmatched-skip -D unnecessary-skip "$@"; }

mkdir -p out
sbom out/reel.cdx.json
echo "$(grep -c '^      "purl"' out/reel.cdx.json) packages in out/reel.cdx.json"

check licenses bans sources
database="${CARGO_HOME:-$HOME/.cargo}/advisory-dbs"
if [[ ${OFFLINE:-0} != 1 ]] && ! cargo deny fetch db; then
  echo "advisories were not checked: their database could not be fetched (https://github.com/RustSec/advisory-db)." >&2
  echo "OFFLINE=1 checks the rest, and advisories by the copy that was fetched last" >&2
  exit 1
fi
if ! compgen -G "$database/*/" >/dev/null; then
  echo "skipped: advisories: OFFLINE=1 fetches none, and there is no copy in $database"
  exit 0
fi
check advisories
