# Sourced by prove-sft.sh and learned.sh: homes, what the oracle does in them, and the training set of it, below the folder $data. Needs
# $here and $TRAINING_DIR; sets $REEL and $PYTHON where they are not given. What was made once is used again.

mkdir -p "$TRAINING_DIR"
if [[ -z ${REEL:-} ]]; then
  export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$HOME/.cache/reel}"
  cargo build --quiet --locked --profile fast -p reel-cli --no-default-features --features analytics
  REEL="$CARGO_TARGET_DIR/fast/reel"
fi
PYTHON="${REEL_PYTHON:-$(tests/python.sh)}"

# play SEED TASKS: the traces of one home.
play() {
  local traces="$data/traces/home_$1" scene="$data/scenes/home_$1.json" tasks="$data/tasks/home_$1"
  [[ -d $traces ]] && return
  draw_tasks "$1" "$2"
  rm -rf "$traces.part"
  "$REEL" run --scene "$scene" --tasks "$tasks" --policy oracle --no-images --out "$traces.part" >/dev/null
  mv "$traces.part" "$traces"
  rm -rf "$data/store" "$data/set" "$data/training.pickle" "$data/played"
}

# draw_tasks SEED TASKS [FOLDER]: one home, and tasks in it.
draw_tasks() {
  local out="${3:-$data/tasks}/home_$1"
  rm -rf "$out"
  "$PYTHON" "$here/scenes.py" src/tasks/src/data/home.json "$data/scenes" "$1"
  "$REEL" task draw --scene "$data/scenes/home_$1.json" --count "$2" --seed "$1" --out "$out" >/dev/null
}

# export_set SEED...: the episodes of these homes as whole conversations, in $data/set.
export_set() {
  [[ -d $data/set ]] && return
  rm -rf "$data/set.part" "$data/store"
  local homes=() seed
  for seed in "$@"; do homes+=("$data/traces/home_$seed"); done
  "$REEL" ingest "${homes[@]}" --store "$data/store" >/dev/null
  # They were recorded a moment ago by this binary; that traces replay is proved elsewhere (`make determinism`).
  "$REEL" export sft --store "$data/store" --format trl --style multi-turn --annotations rules --image-format none \
    --no-replay --allow-unverified --out "$data/set.part" >/dev/null
  mv "$data/set.part" "$data/set"
}
