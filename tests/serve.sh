# Sourced. serve NAME COMMAND...: starts a server that says where it listens, with its output in $work/NAME.out and $work/NAME.log, and waits
# for that; sets pid and url.
serve() {
  local name=$1 tries
  shift
  : >"$work/$name.out"
  "$@" >"$work/$name.out" 2>"$work/$name.log" &
  pid=$! url=
  for ((tries = 0; tries < 600; tries++)); do
    url=$(sed -n 's|^listening on \(http://[0-9.:]*[0-9]\).*|\1|p' "$work/$name.out")
    [[ -z $url ]] && kill -0 "$pid" 2>/dev/null || break
    sleep 0.1
  done
  if [[ -z $url ]]; then
    echo "$name did not start:" >&2
    cat "$work/$name.log" >&2
    exit 1
  fi
}
