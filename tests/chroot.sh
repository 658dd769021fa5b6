# Sourced: Debian chroots with other compilers than this machine's. Needs root and mmdebstrap; the sourcing script runs in a mount namespace of
# its own (`unshare --mount`), so that mounts end with it and no `rm` can reach through them.
#
# REEL_CROSS   folder of the chroots and of what is built in them, kept for the next run (default: /var/tmp/reel-cross)
# REEL_MIRROR  Debian mirror (default: the one in the machine's APT sources)
cross=${REEL_CROSS:-/var/tmp/reel-cross}
registry=${CARGO_HOME:-$HOME/.cargo}/registry
mirror=${REEL_MIRROR:-$(apt-get indextargets --format '$(REPO_URI)' 'Created-By: Packages' 'Origin: Debian' | grep -v security | head -1)}
security=$(apt-get indextargets --format '$(REPO_URI)' 'Created-By: Packages' 'Label: Debian-Security' | head -1)
mkdir -p "$cross"

# made NAME SUITE ARCHITECTURES PACKAGES SOURCE...: the chroot of that name, made once; fails with its log beside it.
made() {
  local name=$1 suite=$2 architectures=$3 packages=$4
  shift 4
  if [[ ! -d $cross/$name ]]; then
    echo "== making the chroot $name" >&2
    rm -rf "$cross/$name.new"
    mmdebstrap --variant=apt --architectures="$architectures" --include="$packages" \
      --aptopt='APT::Install-Recommends "false"' --aptopt='Acquire::Check-Valid-Until "false"' \
      "$suite" "$cross/$name.new" "$@" >"$cross/$name.log" 2>&1 || return 1
    mkdir -p "$cross/$name.new"/{source,target,cargo/registry}
    mv "$cross/$name.new" "$cross/$name"
  fi
  mkdir -p "$cross/target/$name"
  mount --bind -o ro "$PWD" "$cross/$name/source"
  mount --bind -o ro "$registry" "$cross/$name/cargo/registry"
  mount --bind "$cross/target/$name" "$cross/$name/target"
}

# within NAME [NAME=VALUE...] COMMAND...: runs a command in a chroot, whose /source is this checkout and /target what it builds.
within() {
  local name=$1
  shift
  chroot "$cross/$name" /usr/bin/env -i PATH=/usr/bin:/bin HOME=/root CARGO_HOME=/cargo CARGO_TARGET_DIR=/target "$@"
}
