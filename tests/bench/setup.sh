# What the benchmarks share: the optimised binary, a folder, a Python with the packages they compare with.
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$HOME/.cache/reel}"
EPISODES="${EPISODES:-1000000}"
BENCH_DIR="${BENCH_DIR:-$HOME/.cache/reel-bench}"
mkdir -p "$BENCH_DIR"
cargo build --locked --profile fast -p reel-cli --no-default-features --features analytics
REEL="$CARGO_TARGET_DIR/fast/reel"
PYTHON="${REEL_PYTHON:-$(tests/python.sh)}"
