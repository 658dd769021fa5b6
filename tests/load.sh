#!/usr/bin/env bash
# `make load`: many sessions open in one `reel serve`, all of them acting at once with the thinking time of the paper's policy
# (5.9 s a step, from half of it to one and a half), on the loopback; the same clients beside it against a server of the same SDK
# that does nothing (src/mcp/examples). They repeat what the oracle does, and every answer is compared with what it was told.
# Prints how long each tool took, what a parked session costs, and how long the server takes to stop; then replays every trace.
#
# Exits 1 when an answer is another one, a trace does not replay, or the server breaks. Goals that are missed are printed.
#
#   load.sh [--short]   --short: 60 sessions, 20 acting for 10 s, thinking 1 s
#
# SESSIONS, ACTING, SECONDS_ACTING, THINK, TASKS  how much
# LEVELS         numbers of agents that act before that, for 30 s each (default "200,400,600,800,1000"; "none"): how much the server bears, beside
#                what `reel run` does on the same cores with nobody to talk to
# PARK_AFTER     seconds until an idle session is parked (default: what the server does by itself)
# REEL           a binary that is built already
# LOAD_EXAMPLES  folder with the examples `load` and `idle_server`, built already
# LOAD_DIR       where everything is kept (default: a temporary folder, removed at the end)
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

short=
if [[ ${1:-} == --short ]]; then short=1; fi
sessions=${SESSIONS:-${short:+60}} acting=${ACTING:-${short:+20}} seconds=${SECONDS_ACTING:-${short:+10}}
think=${THINK:-${short:+1}} tasks=${TASKS:-${short:+20}} levels=${LEVELS:-${short:+10}}
sessions=${sessions:-1000}
acting=${acting:-$sessions} levels=${levels:-200,400,600,800,1000}
seconds=${seconds:-120} think=${think:-5.9} tasks=${tasks:-100}
if [[ $levels == none ]]; then levels=; fi

level_seconds=${LEVEL_SECONDS:-${short:+5}}
level_seconds=${level_seconds:-30}

export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$HOME/.cache/reel}"
[[ -n ${REEL:-} ]] || cargo build --locked --profile fast -p reel-cli --no-default-features --features service
reel="${REEL:-$CARGO_TARGET_DIR/fast/reel}"
[[ -n ${LOAD_EXAMPLES:-} ]] || cargo build --locked --profile fast -p reel-mcp --example load --example idle_server
examples="${LOAD_EXAMPLES:-$CARGO_TARGET_DIR/fast/examples}"

work=${LOAD_DIR:-$(mktemp -d)}
mkdir -p "$work"
pid=
cleanup() {
  [[ -z $pid ]] || { kill "$pid" && wait "$pid"; } 2>/dev/null || true
  [[ -n ${LOAD_DIR:-} ]] || rm -rf "$work"
}
trap cleanup EXIT
trap 'exit 130' INT
trap 'exit 143' TERM
# A session has its trace open, and two sockets.
ulimit -n "$(ulimit -Hn)"

source tests/serve.sh
# stop NAME: ends the server; sets stopped_s.
stop() {
  local begin=$EPOCHREALTIME code=0
  kill "$pid" 2>/dev/null || true
  wait "$pid" || code=$?
  pid=
  stopped_s=$(awk -v a="$begin" -v b="$EPOCHREALTIME" 'BEGIN { printf "%.1f", b - a }')
  # A program that does not wait for the signal ends by it.
  if ((code != 0 && code != 143)); then
    echo "$1 ended with code $code:" >&2
    tail -20 "$work/$1.log" >&2
    exit 1
  fi
}
# drive NAME ARGUMENT...: the clients; what they measured is in $work/NAME.figures.
drive() {
  local name=$1
  shift
  if ! timeout $((seconds + 1200)) "$examples/load" --url "$url" --pid "$pid" --calls "$work/calls" --sessions "$sessions" \
    --acting "$acting" --think "$think" --seconds "$seconds" "$@" >"$work/$name.figures"; then
    tail -5 "$work/$name.log" >&2
    exit 1
  fi
}
figure() { sed -n "s/^$2 //p" "$work/$1.figures"; }

echo "== recording what the oracle does in $tasks tasks" >&2
"$reel" task draw --count "$tasks" --seed 7 --out "$work/tasks" >/dev/null
"$reel" run --tasks "$work/tasks" --policy oracle --no-images --out "$work/calls" >/dev/null
echo "== the same with images on all cores, without a server" >&2
begin=$EPOCHREALTIME
"$reel" run --tasks "$work/tasks" --policy oracle --out "$work/bare" --json >"$work/bare.json"
bare=$(awk -v a="$begin" -v b="$EPOCHREALTIME" '{ sub(/.*"length":/, ""); calls += $0 } END { printf "%.1f", calls / (b - a) }' "$work/bare.json")

echo "== $sessions sessions, $acting acting for $seconds s, reel" >&2
cat >"$work/reel.toml" <<TOML
listen = "127.0.0.1:0"
data = "$work/data"

[play]
tasks = "$work/tasks"
run = "load"

[limits]
${PARK_AFTER:+suspend_after_s = $PARK_AFTER}
sessions = $sessions
TOML
rm -rf "$work/data"
serve reel "$reel" serve --config "$work/reel.toml"
drive reel --levels "$levels" --level-seconds "$level_seconds"
stop reel
stopped=$stopped_s

echo "== the same, a server that does nothing" >&2
serve idle "$examples/idle_server"
drive idle --idle
stop idle

echo "== replaying" >&2
find "$work/data/traces" -name '*.mcap.part' >"$work/parts"
replayed=0
"$reel" replay "$work/data/traces" --json >"$work/verdicts" || replayed=$?
traces=$(find "$work/data/traces" -name '*.mcap' | wc -l)
exact=$(grep -c '"verdict":"exact"' "$work/verdicts" || true)

printf '\n%s sessions open, %s acting at once for %s s, thinking %s s a step; %s cores; milliseconds at the client\n' \
  "$sessions" "$acting" "$seconds" "$think" "$(nproc)"
printf '%-26s %25s %31s\n' '' 'reel' 'a server that does nothing'
printf '%-26s %7s %7s %7s %7s %7s %7s %7s %7s   %s\n' tool calls p50 p99 max calls p50 p99 max goal
# The goals: what the policy sees and where it goes soon, `place` within a second.
awk '
  $1 == "tool" && FILENAME ~ /idle/ { idle[$2] = sprintf("%7d %7.1f %7.1f %7.1f", $3, $4, $5, $6); next }
  $1 == "tool" {
    goal = $2 ~ /^(nav_to|walk_around|show_object_by_category|show_receptacles|gaze_at)$/ ? 250 : $2 == "place" ? 1000 : 0
    said = goal == 0 ? "" : sprintf("p99 < %d ms: %s", goal, $5 < goal ? "met" : sprintf("missed, %.0f ms", $5))
    printf "%-26s %7d %7.1f %7.1f %7.1f %s   %s\n", $2, $3, $4, $5, $6, idle[$2], said
  }
' "$work/idle.figures" "$work/reel.figures"
# What the server bears: the most calls a second while 99 of 100 took at most 250 ms.
{
  grep '^level ' "$work/reel.figures" || true
  echo "level $acting $(figure reel calls_per_s) $(figure reel p50_ms) $(figure reel p99_ms)" \
    "$(figure reel server_cores) $(figure reel client_cores)"
} >"$work/levels"
printf '\n%-10s %10s %9s %9s %14s %14s\n' acting 'calls/s' 'p50 ms' 'p99 ms' 'server cores' 'client cores'
awk -v bare="$bare" '
  { printf "%-10s %10.1f %9.1f %9.1f %14.2f %14.2f\n", $2, $3, $4, $5, $6, $7 }
  $5 <= 250 && $3 > most { most = $3 }
  { met = $5 <= 250 }
  END {
    printf "calls a second with p99 <= 250 ms: %s%.1f; without a server, on all cores: %.1f; ratio %.2f (goal 0.8)\n",
      (met ? "at least " : ""), most, bare, (bare > 0 ? most / bare : 0)
    if (met) print "more agents, or a shorter THINK, would show how many it bears"
  }
' "$work/levels"
# row TITLE NAME [GOAL]: a figure of both.
row() { printf '%-42s %10s %10s   %s\n' "$1" "$(figure reel "$2")" "$(figure idle "$2")" "${3:-}"; }
session_mb=$(figure reel session_mb)
echo
row 'calls a second' calls_per_s
row 'mean image, kB' image_kb
row 'cores busy, server' server_cores
row 'cores busy, clients' client_cores
row 'cores busy, anything else on the machine' others_cores
row 'seconds to open all' opened_s
row 'resident, nobody there, MB' fresh_mb
row 'resident, all parked, MB' parked_mb
row 'MB per parked session' session_mb \
  "$(awk -v mb="$session_mb" 'BEGIN { print mb <= 4 ? "at most 4 MB: met" : "at most 4 MB: missed, " mb " MB" }')"
row 'resident after acting, MB' acting_mb
row 'resident at most, MB' peak_mb
printf '%-42s %10s\n' 'seconds to stop' "$stopped"
printf '%-42s %10s\n' 'traces, MB' "$(du -sm "$work/data/traces" | cut -f 1)"
if [[ -s $work/parts ]]; then
  echo "$(wc -l <"$work/parts") recordings were not finished, e.g. $(head -1 "$work/parts")"
  exit 1
fi
if ((replayed != 0 || exact != traces || traces == 0)); then
  grep -v '"verdict":"exact"' "$work/verdicts" | head -5
  echo "$traces traces, $exact exact"
  exit 1
fi
echo "$traces traces, all exact; every answer was the recorded one"
