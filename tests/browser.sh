# Sourced: finds Chromium and playwright-core, and installs them where it may; sets CHROMIUM and PACKAGES. Uses `skip NEED WHY` of the
# sourcing script.
command -v npm >/dev/null || skip npm "there is no npm"
if ! command -v chromium >/dev/null && [[ $(id -u) == 0 ]] && command -v apt-get >/dev/null; then
  (apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends chromium) >/dev/null 2>&1 || true
fi
CHROMIUM=$(command -v chromium || command -v chromium-browser || command -v google-chrome) || skip chromium "there is no Chromium"
packages=(playwright-core@1.65.1 axe-core@4.14.1)
cache=${REEL_NODE:-${XDG_CACHE_HOME:-$HOME/.cache}/reel-node}
PACKAGES="$cache/pages-1.65.1-4.14.1"
if [[ ! -d $PACKAGES ]]; then
  mkdir -p "$cache" && fresh=$(mktemp -d "$cache/.fresh.XXXXXX")
  if ! timeout 300 npm install --prefix "$fresh" --no-audit --no-fund --loglevel=error --fetch-retries=1 "${packages[@]}" >&2; then
    rm -rf "$fresh"
    skip npm "${packages[*]} cannot be installed"
  fi
  # Somebody else may have been faster.
  mv -T "$fresh" "$PACKAGES" 2>/dev/null || rm -rf "$fresh"
fi
export CHROMIUM PACKAGES
