# Sourced: finds browsers and what drives them, and installs them where it may. Uses `skip NEED WHY` of the sourcing script; what is skipped
# there ends it.
command -v npm >/dev/null || skip npm "there is no npm"

# browser DEBIAN-PACKAGE NAME...: path of the first program that is there, after an installation where it may.
browser() {
  local package=$1
  shift
  if ! command -v "$1" >/dev/null && [[ $(id -u) == 0 ]] && command -v apt-get >/dev/null; then
    (apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$package") >/dev/null 2>&1 || true
  fi
  { command -v "$@" || true; } | head -1
}

# packages FOLDER PACKAGE...: path of a folder with these packages of npm; nothing where they cannot be installed.
packages() {
  local cache=${REEL_NODE:-${XDG_CACHE_HOME:-$HOME/.cache}/reel-node} fresh
  local folder="$cache/$1"
  shift
  if [[ ! -d $folder ]]; then
    mkdir -p "$cache" && fresh=$(mktemp -d "$cache/.fresh.XXXXXX")
    if ! timeout 300 npm install --prefix "$fresh" --no-audit --no-fund --loglevel=error --fetch-retries=1 "$@" >&2; then
      rm -rf "$fresh"
      return
    fi
    # Somebody else may have been faster.
    mv -T "$fresh" "$folder" 2>/dev/null || rm -rf "$fresh"
  fi
  echo "$folder"
}

# Chromium and playwright-core: sets CHROMIUM and PACKAGES.
with_chromium() {
  CHROMIUM=$(browser chromium chromium chromium-browser google-chrome)
  [[ -n $CHROMIUM ]] || skip chromium "there is no Chromium"
  PACKAGES=$(packages pages-1.65.1-4.14.1 playwright-core@1.65.1 axe-core@4.14.1)
  [[ -n $PACKAGES ]] || skip npm "playwright-core cannot be installed"
  export CHROMIUM PACKAGES
}

# Firefox and puppeteer-core, which drives any build of it: sets FIREFOX and PUPPETEER.
with_firefox() {
  FIREFOX=$(browser firefox-esr firefox-esr firefox)
  [[ -n $FIREFOX ]] || skip firefox "there is no Firefox"
  PUPPETEER=$(packages puppeteer-24.43.1 puppeteer-core@24.43.1)
  [[ -n $PUPPETEER ]] || skip npm "puppeteer-core cannot be installed"
  export FIREFOX PUPPETEER
}
