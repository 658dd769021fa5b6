#!/usr/bin/env bash
# `make web`: builds the simulator as WebAssembly and the player around it into web/dist: the npm package, and player.html, which needs nothing
# else. There are two modules: one with vector instructions (SIMD), and one for browsers without them. Does nothing where they are newer than
# what they are made of.
#
#   build.sh [--quick]    --quick: only the module with vectors, larger and sooner, for tests
#
# This machine's Rust builds it where it has the target (`rustup target add wasm32-unknown-unknown`) and there is clang; else, as root on
# Debian, a chroot with Debian's Rust does. Where neither can be it says so, and Reel is built without a player.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

quick=${1:-}
modules=(reel-simd)
[[ $quick == --quick ]] || modules+=(reel)
built=web/dist/player.html
sources=(web/src web/*.json web/build.mjs web/build.sh Cargo.lock schemas/reel src/{web,bundle,world,reward,sim,episode,trace,replay,statistics}/{src,Cargo.toml})
if [[ -f $built && -f web/dist/${modules[-1]}.wasm ]] && [[ -z $(find "${sources[@]}" -newer "$built" -print -quit) ]]; then
  exit 0
fi
skip() { # NEED WHY
  echo "skipped: $1: the player for browsers, because $2" >&2
  exit 0
}
command -v npm >/dev/null || skip npm "there is no npm"

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
# compile MODULE TARGET COMMAND...: a module, in a target folder of its own, by a cargo that COMMAND runs.
compile() {
  local module=$1 target=$2 flags=()
  shift 2
  [[ $module != reel-simd ]] || flags+=(RUSTFLAGS='-C target-feature=+simd128')
  [[ $quick != --quick ]] || flags+=(CARGO_PROFILE_WEB_LTO=off CARGO_PROFILE_WEB_CODEGEN_UNITS=16)
  "$@" "${flags[@]}" CC_wasm32_unknown_unknown=clang cargo rustc --locked --quiet -p reel-web --crate-type cdylib \
    --target wasm32-unknown-unknown --profile web --target-dir "$target"
}
if [[ -d $(rustc --print sysroot)/lib/rustlib/wasm32-unknown-unknown ]] && command -v clang >/dev/null; then
  echo "building the simulator for browsers"
  for module in "${modules[@]}"; do
    target="${CARGO_TARGET_DIR:-$HOME/.cache/reel}/$module"
    compile "$module" "$target" env -u RUSTC_WORKSPACE_WRAPPER
    cp "$target/wasm32-unknown-unknown/web/reel_web.wasm" "$work/$module.wasm"
  done
else
  [[ $(id -u) == 0 ]] && command -v apt-get unshare >/dev/null \
    || skip wasm "this Rust has no target wasm32-unknown-unknown (rustup target add it, and install clang), and only root on Debian can make a chroot that has"
  # Mounts in a namespace of its own: they end with this script.
  if [[ -z ${REEL_WEB_NAMESPACE:-} ]]; then
    REEL_WEB_NAMESPACE=1 unshare --mount --propagation private "${BASH_SOURCE[0]}" "$@" || exit $?
    exit 0
  fi
  command -v mmdebstrap >/dev/null || { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends mmdebstrap; } >/dev/null 2>&1 \
    || skip wasm "mmdebstrap cannot be installed"
  . tests/chroot.sh
  cargo fetch --locked --quiet
  suite=forky
  made web $suite amd64 "ca-certificates cargo rustc libstd-rust-dev-wasm32 lld gcc libc6-dev clang llvm" "deb $mirror $suite main" \
    || skip wasm "the chroot cannot be made ($cross/web.log)"
  echo "building the simulator for browsers (some minutes at first)"
  for module in "${modules[@]}"; do
    # In the chroot the checkout is /source.
    compile "$module" "/target/$module" within web CARGO_NET_OFFLINE=true CARGO_TARGET_WASM32_UNKNOWN_UNKNOWN_LINKER=wasm-ld \
      AR_wasm32_unknown_unknown=llvm-ar env --chdir=/source
    cp "$cross/target/web/$module/wasm32-unknown-unknown/web/reel_web.wasm" "$work/$module.wasm"
  done
fi

cd web
npm ci --no-audit --no-fund --loglevel=error >/dev/null || skip npm "the packages of web/package.json cannot be installed"
node build.mjs "${modules[@]/#/$work/}"
