#!/usr/bin/env bash
# `make web`: builds the simulator as WebAssembly and the player around it into web/dist: the npm package, and player.html, which needs nothing
# else. Does nothing where they are newer than what they are made of.
#
# This machine's Rust builds it where it has the target (`rustup target add wasm32-unknown-unknown`) and there is clang; else, as root on
# Debian, a chroot with Debian's Rust does. Where neither can be it says so, and Reel is built without a player.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

built=web/dist/player.html
sources=(web/src web/*.json web/build.mjs web/build.sh Cargo.lock schemas/reel src/{web,bundle,world,reward,sim,episode,trace,replay,statistics}/{src,Cargo.toml})
if [[ -f $built ]] && [[ -z $(find "${sources[@]}" -newer "$built" -print -quit) ]]; then
  exit 0
fi
skip() { # NEED WHY
  echo "skipped: $1: the player for browsers, because $2" >&2
  exit 0
}
command -v npm >/dev/null || skip npm "there is no npm"

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
# compile COMMAND...: the module, by a cargo that COMMAND runs; the profile is `web` of Cargo.toml.
compile() {
  "$@" cargo rustc --locked --quiet -p reel-web --crate-type cdylib --target wasm32-unknown-unknown --profile web
}
if [[ -d $(rustc --print sysroot)/lib/rustlib/wasm32-unknown-unknown ]] && command -v clang >/dev/null; then
  echo "building the simulator for browsers"
  target="${CARGO_TARGET_DIR:-$HOME/.cache/reel}"
  CARGO_TARGET_DIR="$target" RUSTC_WORKSPACE_WRAPPER='' compile env CC_wasm32_unknown_unknown=clang
  cp "$target/wasm32-unknown-unknown/web/reel_web.wasm" "$work/reel.wasm"
else
  [[ $(id -u) == 0 ]] && command -v apt-get unshare >/dev/null || skip wasm "this Rust has no target wasm32-unknown-unknown (rustup target add it, and install clang), and only root on Debian can make a chroot that has"
  # Mounts in a namespace of its own: they end with this script.
  if [[ -z ${REEL_CROSS_NAMESPACE:-} ]]; then
    REEL_CROSS_NAMESPACE=1 unshare --mount --propagation private "${BASH_SOURCE[0]}" || exit $?
    exit 0
  fi
  command -v mmdebstrap >/dev/null || { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends mmdebstrap; } >/dev/null 2>&1 || skip wasm "mmdebstrap cannot be installed"
  . tests/chroot.sh
  cargo fetch --locked --quiet
  suite=forky
  made web $suite amd64 "ca-certificates cargo rustc libstd-rust-dev-wasm32 lld gcc libc6-dev clang llvm" "deb $mirror $suite main" \
    || skip wasm "the chroot cannot be made ($cross/web.log)"
  echo "building the simulator for browsers (some minutes at first)"
  # In the chroot the checkout is /source.
  compile within web CARGO_NET_OFFLINE=true CARGO_TARGET_WASM32_UNKNOWN_UNKNOWN_LINKER=wasm-ld CC_wasm32_unknown_unknown=clang \
    AR_wasm32_unknown_unknown=llvm-ar env --chdir=/source
  cp "$cross/target/web/wasm32-unknown-unknown/web/reel_web.wasm" "$work/reel.wasm"
fi

cd web
npm ci --no-audit --no-fund --loglevel=error >/dev/null || skip npm "the packages of web/package.json cannot be installed"
node build.mjs "$work/reel.wasm"
