#!/usr/bin/env bash
# Runs every server scenario of the published conformance suite of the Model Context Protocol, warnings included, against
# src/mcp/examples/conformance.rs: the transport and the guard of the real server, around the fixtures that the suite calls.
# Exits 1 unless all pass; without npm, or where nothing can be installed, it says so and exits 0.
#
# REEL_CONFORMANCE_SERVER  the example, built already (default: cargo builds it)
# REEL_NODE                where Node and the suite are installed (default: ~/.cache/reel-node)
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

suite=0.1.16
node_major=22
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
folder=$(installed "conformance-$suite" "@modelcontextprotocol/conformance@$suite") \
  || skip "@modelcontextprotocol/conformance@$suite could not be installed (npm)"
program=$folder/node_modules/@modelcontextprotocol/conformance/dist/index.js

server=("${REEL_CONFORMANCE_SERVER:-}")
if [[ -z ${server[0]} ]]; then
  timeout 3600 cargo build --locked --quiet -p reel-mcp --example conformance
  # Cargo becomes the program it runs: the process to end is the server.
  server=(cargo run --locked --quiet -p reel-mcp --example conformance --)
fi
: >"$work/server"
"${server[@]}" 0 >"$work/server" &
pid=$!
url=
for ((tries = 0; tries < 600; tries++)); do
  url=$(sed -n 's/^listening on //p' "$work/server")
  [[ -z $url ]] && kill -0 "$pid" 2>/dev/null || break
  sleep 0.1
done
if [[ -z $url ]]; then
  echo "the server of the conformance suite did not start: ${server[*]}" >&2
  exit 1
fi

# Nothing is expected to fail; with a list, even an empty one, warnings count as failures.
echo "server: []" >"$work/expected.yml"
code=0
timeout 180 "$node" "$program" server --url "$url" --suite all --expected-failures "$work/expected.yml" >"$work/said" 2>&1 || code=$?

# The suite's own summary has a line for each scenario, and further down the names of those that failed or warned. One that
# checked nothing did not pass either.
count() { sed -nE "$1" "$work/said" | wc -l | tr -d ' '; }
announced=$(sed -n 's/^Running all suite (\([0-9]*\) scenarios).*/\1/p' "$work/said")
failed=$(count '/Unexpected failures \(not in baseline\)/,$ s/^  ✗ //p')
empty=$(count '/^(✓|✗) .*: 0 passed, 0 failed$/p')
passed=$(($(count '/^(✓|✗) .*: [0-9]+ passed, [0-9]+ failed$/p') - failed - empty))
((code == 0 && passed == ${announced:-0} && passed > 0)) || code=1
((code == 0)) || cat "$work/said" >&2
echo "conformance: ${announced:-0} scenarios, $passed passed"
exit "$code"
