#!/usr/bin/env bash
# Executes recorded episodes, and scenes made to fail, with other C libraries, other compilers and on other processors:
# Debian chroots, aarch64 under qemu, wasm32-wasip1 under Node. Prints one table and fails unless each digest is the
# recorded one. Needs root, a Debian machine with mmdebstrap, 4 GB and, at first, half an hour.
#
# REEL_TRACES  folder of traces (default: traces/golden)
# REEL_CROSS, REEL_MIRROR: see chroot.sh
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
for tool in mmdebstrap unshare chroot; do
  command -v "$tool" >/dev/null || { echo "no $tool: apt-get install mmdebstrap util-linux" >&2; exit 2; }
done
((EUID == 0)) || { echo "the chroots need root" >&2; exit 2; }
# Mounts in a namespace of its own: they end with this script, however it ends, and no `rm` can reach through them.
if [[ -z ${REEL_CROSS_NAMESPACE:-} ]]; then
  REEL_CROSS_NAMESPACE=1 exec unshare --mount --propagation private "${BASH_SOURCE[0]}"
fi
. tests/determinism-table.sh

traces=${REEL_TRACES:-traces/golden}
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$HOME/.cache/reel}"
unset REEL_OFF_BY_ONE_ULP
. tests/chroot.sh

# build SUITE TARGET: the light program, optimised, from the sources that the machine has fetched.
build() {
  local suite=$1 target=$2
  echo "== building for $target in $suite" >&2
  within "$suite" CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-gcc CC_aarch64_unknown_linux_gnu=aarch64-linux-gnu-gcc \
    CARGO_TARGET_WASM32_WASIP1_LINKER=wasm-ld cargo build --locked --offline --quiet --manifest-path /source/Cargo.toml -p reel-episode --example digests \
    --target "$target" --profile opt2 --config 'profile.opt2.inherits="release"' --config profile.opt2.opt-level=2 \
    --config 'profile.opt2.lto="off"' >"$cross/$suite-$target.log" 2>&1
}
reason() { grep -m 1 -i '^e[:r]' "$1" || tail -n 1 "$1"; }
glibc() { within "$1" ldd --version | sed -n '1s/.* //p'; }
rust() { within "$1" rustc --version | cut -d ' ' -f 2; }

echo "== building reel" >&2
cargo fetch --locked --quiet
cargo build --locked --quiet -p reel-cli --no-default-features
cargo build --locked --quiet -p reel-episode --example digests
cp "$CARGO_TARGET_DIR/debug/examples/digests" "$work/digests"
read_traces "$CARGO_TARGET_DIR/debug/reel" "$work/digests" "$traces"
here="rustc $(rustc --version | cut -d ' ' -f 2)"
column "x86-64, glibc $(ldd --version | sed -n '1s/.* //p'), $here: this machine" "$work/digests"

# Debian's Rust for browsers is newer than the suite's own, which is too old for the engine, and comes for arm64 too.
old=bookworm
arm="aarch64 under qemu"
if made $old $old amd64,arm64 "ca-certificates rustc-web cargo-web libstd-rust-web-dev:arm64 gcc libc6-dev gcc-aarch64-linux-gnu libc6-dev-arm64-cross qemu-user-static" \
  "deb $mirror $old main" "deb ${security:-$mirror-security} $old-security main"; then
  if build $old aarch64-unknown-linux-gnu; then
    column "$arm, glibc $(glibc $old), rustc $(rust $old)" \
      within $old qemu-aarch64-static -L /usr/aarch64-linux-gnu /target/aarch64-unknown-linux-gnu/opt2/examples/digests
  else
    skip "$arm" "$(reason "$cross/$old-aarch64-unknown-linux-gnu.log")"
  fi
else
  skip "$arm" "$(reason "$cross/$old.log")"
fi

new=forky
if made $new $new amd64 "ca-certificates cargo rustc libstd-rust-dev-wasm32 lld wasi-libc gcc libc6-dev" "deb $mirror $new main"; then
  cp "$work/digests" "$cross/$new/tmp/digests"
  column "x86-64, glibc $(glibc $new), the program of this machine" within $new /tmp/digests
  if build $new x86_64-unknown-linux-gnu; then
    column "x86-64, glibc $(glibc $new), rustc $(rust $new)" within $new /target/x86_64-unknown-linux-gnu/opt2/examples/digests
  else
    skip "x86-64, another compiler" "$(reason "$cross/$new-x86_64-unknown-linux-gnu.log")"
  fi
  if ! command -v node >/dev/null; then
    skip "wasm32-wasip1" "no node on the path"
  elif build $new wasm32-wasip1; then
    column "wasm32-wasip1 under Node $(node --version), rustc $(rust $new)" \
      node --no-warnings tests/node/wasi.mjs "$cross/target/$new/wasm32-wasip1/opt2/examples/digests.wasm"
  else
    skip "wasm32-wasip1" "$(reason "$cross/$new-wasm32-wasip1.log")"
  fi
else
  skip "another glibc, another compiler, wasm32-wasip1" "$(reason "$cross/$new.log")"
fi

musl="x86-64, musl, $here"
if ! [[ -d $(rustc --print sysroot)/lib/rustlib/x86_64-unknown-linux-musl ]]; then
  skip "$musl" "rustup target add x86_64-unknown-linux-musl"
elif ! command -v musl-gcc >/dev/null; then
  skip "$musl" "apt-get install musl-tools"
elif cargo build --locked --quiet -p reel-episode --example digests --target x86_64-unknown-linux-musl 2>"$work/musl.log"; then
  column "$musl" "$CARGO_TARGET_DIR/x86_64-unknown-linux-musl/debug/examples/digests"
else
  skip "$musl" "$(reason "$work/musl.log")"
fi
print_table
