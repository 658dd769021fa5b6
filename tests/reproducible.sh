#!/usr/bin/env bash
# `make reproducible`: builds the release binary of the commit HEAD twice, in different folders, and compares the bytes.
#
# FULL  1: the whole binary, which takes hours on two cores; 0 (default): the lean one
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
FULL=${FULL:-0}
. tests/release-build.sh
needs_pinned_toolchain
work=$(cd "$(mktemp -d)" && pwd -P)
trap 'rm -rf "$work"' EXIT

for folder in "$work/one" "$work/the/other"; do
  echo "== building in $folder" >&2
  mkdir -p "$folder"
  build "$folder"
  cp "$folder/target/release/reel" "$work/${folder##*/}.reel"
  rm -rf "$folder"
done
cd "$work"
sha256sum one.reel other.reel
if ! cmp one.reel other.reel; then
  echo "$(cmp -l one.reel other.reel | wc -l) bytes differ; the first of them (offset, octal values):" >&2
  cmp -l one.reel other.reel | head >&2 || true
  exit 1
fi
echo "both builds of $version for $host are the same $(stat -c %s one.reel) bytes"
