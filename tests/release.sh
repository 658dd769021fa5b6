#!/usr/bin/env bash
# `make release`: builds the binary of the commit HEAD and puts what a release consists of into out/release: an archive, what the binary is
# made of (CycloneDX), their checksums and a signature of these. The same commit and tools give the same checksums.
#
# REEL_SIGNING_KEY  the maintainer's SSH key, whose public half allowed_signers lists; with an agent, the public half is enough
# UNSIGNED          1: checksums without a signature, e.g. to compare with a release
# FULL              1 (default): the whole binary; 0: the lean one
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
FULL=${FULL:-1}
. tests/release-build.sh
needs_pinned_toolchain
# sign FILE: writes FILE.sig, and checks it as a user does: a key that the repository does not list is not the maintainers'.
signers=$PWD/allowed_signers
sign() {
  ssh-keygen -q -Y sign -f "$REEL_SIGNING_KEY" -n reel-release "$1"
  ssh-keygen -Y verify -f "$signers" -I maintainers -n reel-release -s "$1.sig" <"$1"
}
if [[ ${UNSIGNED:-0} != 1 && ! -f ${REEL_SIGNING_KEY:-} ]]; then
  echo "no key to sign with: set REEL_SIGNING_KEY to the file of an SSH key, or UNSIGNED=1" >&2
  exit 2
fi
if [[ -n $(git status --porcelain) ]]; then
  echo "the tree has changes, and a release is of a commit: commit or stash them ('git status' lists them)" >&2
  exit 2
fi
out=$PWD/out/release
name=reel-$version-$host
[[ $FULL == 1 ]] || name=reel-lean-$version-$host
work=$(cd "$(mktemp -d)" && pwd -P)
trap 'rm -rf "$work"' EXIT
if [[ ${UNSIGNED:-0} != 1 ]]; then
  # before the build, which takes long
  echo try >"$work/try"
  if ! sign "$work/try"; then
    echo "the key does not sign for this repository: add 'maintainers' and its public half to allowed_signers, and commit that" >&2
    exit 2
  fi
fi
rm -rf "$out"
mkdir -p "$out" "$work/$name"

echo "== building $name" >&2
build "$work"
sbom "$out/$name.cdx.json"
cp "$work/target/release/reel" LICENSE README.md CHANGELOG.md "$work/$name"
# Most licences ask for their text beside a binary. Some packages come without it: the list names their licence.
shopt -s nullglob nocaseglob
while read -r package number _; do
  for text in "${CARGO_HOME:-$HOME/.cargo}"/registry/src/*/"$package-${number#v}"/{licen[cs]e,copying,copyright,notice,unlicense}*; do
    [[ ! -f $text ]] || install -D -m 644 "$text" "$work/$name/licenses/$package-${number#v}/${text##*/}"
  done
done < <(cargo tree --locked -p reel-cli "${variant[@]}" --target "$host" -e normal --prefix none --format '{p}' | sort -u)
chmod -R u=rwX,go=rX "$work/$name"
tar -c --sort=name --format=ustar --mtime="@$SOURCE_DATE_EPOCH" --owner=0 --group=0 --numeric-owner -C "$work" "$name" |
  gzip -9n >"$out/$name.tar.gz"
cd "$out"
sha256sum "$name.cdx.json" "$name.tar.gz" >SHA256SUMS
[[ ${UNSIGNED:-0} == 1 ]] || sign SHA256SUMS
cat SHA256SUMS
