#!/usr/bin/env bash
# Runs every server scenario of the published conformance suite of the Model Context Protocol, warnings included:
#   conformance.sh fixtures   against src/mcp/examples/conformance.rs: the transport and the guard of the real server, around the
#                             fixtures that the suite calls; all pass
#   conformance.sh serve      against `reel serve` itself, the suite of today at /mcp and the newest one at /w/NAME/mcp;
#                             tests/conformance.txt names what does not apply and why, and every other scenario passes
# Without an argument both. Exits 1 unless that holds; without npm, or where nothing can be installed, it says so and exits 0.
#
# REEL_CONFORMANCE_SERVER  the example, built already (default: cargo builds it)
# REEL                     the command, built already (default: cargo builds it)
# REEL_NODE                where Node and the suites are installed (default: ~/.cache/reel-node)
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

suite=0.1.16
newest=0.2.0-alpha.12
node_major=22
which=${1:-both}
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$HOME/.cache/reel}"
cache=${REEL_NODE:-${XDG_CACHE_HOME:-$HOME/.cache}/reel-node}
work=$(mktemp -d)
pid=
cleanup() {
  [[ -z $pid ]] || { kill "$pid" && wait "$pid"; } 2>/dev/null || true
  rm -rf "$work"
}
trap cleanup EXIT
trap 'exit 130' INT
trap 'exit 143' TERM

skip() {
  echo "skipped: npm: MCP conformance, because $1"
  exit 0
}

# installed NAME PACKAGE: a folder of the cache with the package in it. It appears when it is whole, so that what broke off is
# tried again, and two scripts at once do no harm.
installed() {
  local folder=$cache/$1 fresh
  if [[ ! -d $folder ]]; then
    echo "installing $2 into $cache" >&2
    mkdir -p "$cache" && fresh=$(mktemp -d "$cache/.fresh.XXXXXX") || return 1
    if ! timeout 300 npm install --prefix "$fresh" --no-audit --no-fund --loglevel=error --fetch-retries=1 --fetch-timeout=30000 "$2" >&2; then
      rm -rf "$fresh"
      return 1
    fi
    if [[ -d $folder ]]; then rm -rf "$fresh"; else mv "$fresh" "$folder"; fi
  fi
  echo "$folder"
}

# new_enough NODE: whether it is a Node that the suite runs on.
new_enough() { [[ $("$1" -p 'process.versions.node.split(".")[0]' 2>/dev/null || echo 0) -ge $node_major ]]; }

for command in npm timeout; do
  command -v "$command" >/dev/null || skip "$command is not installed"
done
node=node
if ! new_enough "$node"; then
  folder=$(installed "node-$node_major" "node@$node_major") || skip "node@$node_major could not be installed (npm)"
  node=$folder/node_modules/.bin/node
  new_enough "$node" || skip "$node does not run (remove $folder to install it again)"
  # npm warns of a Node too old for what it installs.
  export PATH="$folder/node_modules/.bin:$PATH"
fi
# program SUITE: the suite's program.
program() {
  local folder
  folder=$(installed "conformance-$1" "@modelcontextprotocol/conformance@$1") || return 1
  echo "$folder/node_modules/@modelcontextprotocol/conformance/dist/index.js"
}

# start COMMAND...: starts a server that says `listening on URL`; its address without a path is in $url.
start() {
  : >"$work/server"
  "$@" >"$work/server" &
  pid=$!
  url=
  for ((tries = 0; tries < 600; tries++)); do
    url=$(sed -nE 's#^listening on (http://[^/: ]+:[0-9]+).*#\1#p' "$work/server")
    [[ -z $url ]] && kill -0 "$pid" 2>/dev/null || break
    sleep 0.1
  done
  [[ -n $url ]] && return
  echo "the server of the conformance suite did not start: $*" >&2
  exit 1
}

stop() {
  kill "$pid" && wait "$pid" || true
  pid=
}

# suite PROGRAM URL: what every scenario came to, a line each: NAME PASSED/FAILED. With a list of expected failures, even an empty
# one, warnings count as failures.
suite() {
  echo "server: []" >"$work/expected.yml"
  timeout 300 "$node" "$1" server --url "$2" --suite all --expected-failures "$work/expected.yml" >"$work/said" 2>&1 || true
  sed -nE 's/^(✓|✗) ([^:]+): ([0-9]+) passed, ([0-9]+) failed$/\2 \3\/\4/p' "$work/said" | sort
  sed -nE '/Unexpected failures \(not in baseline\)/,$ s/^  ✗ //p' "$work/said" | sort >"$work/failures"
}

# judge NAME SUITE: compares with tests/conformance.txt. A scenario that is not listed has passed if something was checked and nothing
# failed or warned; one that is listed came to what stands there, no more and no less (-: anything).
judge() {
  local announced wrong
  announced=$(sed -n 's/^Running all suite (\([0-9]*\) scenarios).*/\1/p' "$work/said")
  wrong=$(awk -v suite="$2" -v failures="$work/failures" '
    BEGIN { while ((getline name < failures) > 0) bad[name] = 1 }
    FILENAME != "-" { if ($1 == suite) listed[$2] = $3; next }
    { seen[$1] = 1; split($2, counts, "/")
      if ($1 in listed) { if (listed[$1] != "-" && listed[$1] != $2) print $1 " came to " $2 ", listed is " listed[$1] }
      else if ($1 in bad || counts[2] > 0 || counts[1] == 0) print $1 " did not pass: " $2 }
    END { for (name in listed) if (!(name in seen)) print name " is listed and was not run" }
  ' tests/conformance.txt - <"$work/came")
  local run passed
  run=$(wc -l <"$work/came" | tr -d ' ')
  if [[ $run != "${announced:-0}" || $run == 0 ]]; then wrong+=$'\n'"${announced:-0} scenarios were announced, $run run"; fi
  passed=$(grep -cE ' [1-9][0-9]*/0$' "$work/came" || true)
  echo "conformance: $1: ${announced:-0} scenarios, $passed passed, $((run - passed)) do not apply"
  [[ -z $wrong ]] && return
  cat "$work/said" >&2
  echo "$wrong" >&2
  exit 1
}

if [[ $which != serve ]]; then
  program=$(program "$suite") || skip "@modelcontextprotocol/conformance@$suite could not be installed (npm)"
  server=("${REEL_CONFORMANCE_SERVER:-}")
  if [[ -z ${server[0]} ]]; then
    timeout 3600 cargo build --locked --quiet -p reel-mcp --example conformance
    # Cargo becomes the program it runs: the process to end is the server.
    server=(cargo run --locked --quiet -p reel-mcp --example conformance --)
  fi
  start "${server[@]}" 0
  suite "$program" "$url/mcp" >"$work/came"
  stop
  judge "the suite's fixtures ($suite)" fixtures
fi
if [[ $which != fixtures ]]; then
  program=$(program "$suite") || skip "@modelcontextprotocol/conformance@$suite could not be installed (npm)"
  new=$(program "$newest") || skip "@modelcontextprotocol/conformance@$newest could not be installed (npm)"
  [[ -n ${REEL:-} ]] || cargo build --locked --quiet --workspace --bin reel
  start "${REEL:-$CARGO_TARGET_DIR/debug/reel}" serve --listen 127.0.0.1:0 --data "$work/data"
  suite "$program" "$url/mcp" >"$work/came"
  judge "reel serve, /mcp ($suite)" "$suite"
  suite "$new" "$url/w/suite/mcp" >"$work/came"
  judge "reel serve, /w/NAME/mcp ($newest)" "$newest"
  stop
fi
