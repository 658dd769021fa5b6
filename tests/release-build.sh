# Sourced by release.sh, reproducible.sh and supply-chain.sh: how the released binary is built, so that its bytes depend on the commit
# and the tools alone, and what it is made of. FULL=0 is the lean binary, FULL=1 the whole one.

variant=()
[[ $FULL == 1 ]] || variant=(--no-default-features)
version=$(sed -n '/^\[workspace.package\]/,/^\[/s/^version = "\(.*\)"/\1/p' Cargo.toml)
host=$(rustc -vV | sed -n 's/^host: //p')
# What embeds a time takes this one: rust-embed for the web pages, cargo-cyclonedx.
SOURCE_DATE_EPOCH=$(git log -1 --format=%ct)
export SOURCE_DATE_EPOCH

# needs_pinned_toolchain: fails unless the compiler is the one that rust-toolchain.toml names, by whatever name it is installed.
needs_pinned_toolchain() {
  local pinned found
  pinned=$(sed -n 's/^channel = "\(.*\)"/\1/p' rust-toolchain.toml)
  found=$(rustc -vV | sed -n 's/^release: //p')
  [[ $found == "$pinned" ]] && return
  echo "rustc is $found, and releases are built with $pinned: rustup toolchain install $pinned" >&2
  exit 2
}

# build FOLDER: clones the commit HEAD to FOLDER/checkout and builds its binary: FOLDER/target/release/reel.
build() {
  local checkout=$1/checkout target=$1/target from to rust=() c=() maps
  git clone --quiet --shared . "$checkout"
  (
    cd "$checkout"
    if [[ $FULL == 1 ]]; then
      dashboards/build.sh
      [[ -f dashboards/dist/index.html ]] || { echo "no web pages, which a release has: install Node 20.19 or newer" >&2; exit 2; }
    fi
    cargo fetch --quiet --locked --target "$host"
    # Compilers write the names of source files into panics and assertions. Of profiles, `trim-paths` would do it; it is not stable.
    from=$(rustc --print sysroot)/lib/rustlib/src/rust
    maps=("$checkout=/reel" "$target=/target" "$from=/rustc/$(rustc -vV | sed -n 's/^commit-hash: //p')")
    for from in "${CARGO_HOME:-$HOME/.cargo}"/registry/src/*; do maps+=("$from=/crates"); done
    for to in "${maps[@]}"; do
      rust+=("--remap-path-prefix=$to")
      c+=("-ffile-prefix-map=$to")
    done
    # What whoever builds has set for other builds stays out (src/sim/src/math.rs reads the last).
    unset RUSTC_WRAPPER RUSTC_WORKSPACE_WRAPPER CARGO_BUILD_TARGET "${!CARGO_PROFILE_@}" REEL_OFF_BY_ONE_ULP
    CARGO_TARGET_DIR=$target CARGO_ENCODED_RUSTFLAGS=$(IFS=$'\x1f' && echo "${rust[*]}") CFLAGS="${c[*]}" CXXFLAGS="${c[*]}" \
      cargo build --quiet --locked --release -p reel-cli "${variant[@]}"
  )
}

# sbom FILE: what the binary for this machine is made of, as CycloneDX. cargo-cyclonedx, of CycloneDX's makers, knows features, targets and
# SOURCE_DATE_EPOCH, unlike cargo-sbom. It writes beside manifests: into a copy of them.
sbom() {
  local copy
  cargo cyclonedx --version 2>/dev/null | grep -q ' 0\.5\.9$' || env -u CARGO_TARGET_DIR cargo install --locked cargo-cyclonedx@0.5.9
  copy=$(mktemp -d)
  git ls-files -z Cargo.toml Cargo.lock rust-toolchain.toml src | tar -c --null -T - | tar -x -C "$copy"
  cargo cyclonedx --quiet --manifest-path "$copy/src/cli/Cargo.toml" --format json --spec-version 1.5 --describe binaries \
    --target "$host" "${variant[@]}"
  # Its ids of our own crates are paths.
  sed "s#$copy#/reel#g" "$copy/src/cli/reel_bin.cdx.json" >"$1"
  rm -rf "$copy"
}
