# record NAME TASKS [OPTION...]: traces of five policies at so many tasks, into $BENCH_DIR/traces-NAME, unless they are there
# already; delete the folders after a change of the simulator.
record() {
  local traces="$BENCH_DIR/traces-$1" tasks="$BENCH_DIR/tasks-$2"
  [[ -d $traces ]] && return
  "$REEL" task draw --count "$2" --out "$tasks"
  for policy in oracle planner wrong-object no-ask oscillating; do
    "$REEL" run --tasks "$tasks" --policy "$policy" --out "$traces.part" "${@:3}"
  done
  mv "$traces.part" "$traces"
}
