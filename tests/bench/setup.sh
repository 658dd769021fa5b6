# What the benchmarks share: the optimised binary, a folder, a Python with the packages they compare with.
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$HOME/.cache/reel}"
EPISODES="${EPISODES:-1000000}"
BENCH_DIR="${BENCH_DIR:-$HOME/.cache/reel-bench}"
mkdir -p "$BENCH_DIR"
cargo build --locked --profile fast -p reel-cli --no-default-features --features analytics
REEL="$CARGO_TARGET_DIR/fast/reel"
PYTHON="${REEL_PYTHON:-$BENCH_DIR/venv/bin/python}"
if ! "$PYTHON" -c 'import blake3, datasets, duckdb, deltalake, mcap, google.protobuf, PIL, pyarrow, re2, orjson, zstandard' 2>/dev/null; then
  python3 -m venv "$BENCH_DIR/venv"
  PYTHON="$BENCH_DIR/venv/bin/python"
  "$PYTHON" -m pip install -q blake3 datasets duckdb deltalake google-re2 mcap pillow protobuf pyarrow orjson zstandard
fi
