# What the benchmarks share: the optimised binary (REEL: one that is built already), a folder, a Python with the packages they compare with.
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$HOME/.cache/reel}"
EPISODES="${EPISODES:-1000000}"
BENCH_DIR="${BENCH_DIR:-$HOME/.cache/reel-bench}"
mkdir -p "$BENCH_DIR"
if [[ -z ${REEL:-} ]]; then
  cargo build --locked --profile fast -p reel-cli --no-default-features --features analytics
  REEL="$CARGO_TARGET_DIR/fast/reel"
fi
PYTHON="${REEL_PYTHON:-$(tests/python.sh)}"
