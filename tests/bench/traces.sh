# 500 traces with pictures and the same episodes without, recorded once; delete the folders after a change of the simulator.
for kind in full lean; do
  traces="$BENCH_DIR/traces-$kind"
  [[ -d $traces ]] && continue
  "$REEL" tasks draw --count 100 --out "$BENCH_DIR/tasks"
  for policy in oracle planner wrong-object no-ask oscillating; do
    "$REEL" run --tasks "$BENCH_DIR/tasks" --policy "$policy" --out "$traces.part" $([[ $kind == lean ]] && echo --no-images)
  done
  mv "$traces.part" "$traces"
done
