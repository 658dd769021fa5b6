#!/usr/bin/env bash
# REAL's published clients, written anew from their contract, against the vectors and against `reel`. Prints a tab-separated
# line for each part:
#   real-contract FILE PART CASES EQUAL DIFFERENT DEVIATING
# and exits with 1 on any difference. What cannot be done here says `skipped:` and how to get what it needs.
#
#   run.sh [--short]      --short: two tasks of each family instead of all
#
# REEL: the binary, otherwise the dev build in CARGO_TARGET_DIR. REEL_REAL_BENCH: the benchmark's folder. REEL_REAL_CONTRACT: the vectors.
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
short=("$@")
export REEL="${REEL:-${CARGO_TARGET_DIR:-$HOME/.cache/reel}/debug/reel}" PYTHONDONTWRITEBYTECODE=1
bench="${REEL_REAL_BENCH:-$here/../../../shared/real-bench}"
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
status=0

skipped() { # NEED WHY
  echo "skipped: $1: $2"
}

# python_for NAME: the Python of an environment of tests/python.sh, in `python`; fails if pip cannot install it.
python_for() {
  python="$("$here/../python.sh" "$1" 2>"$work/pip.log")"
}

if python3 -c "import sys; sys.path.insert(0, '$here'); import vectors; sys.exit(vectors.folder() is None)"; then
  python3 "$here/check_vectors.py" || status=1
else
  skipped real-contract "the Python clients against the vectors: no folder of vectors; set REEL_REAL_CONTRACT"
fi

if [[ ! -x $REEL ]]; then
  echo "no binary at $REEL: run 'cargo build -p reel-cli' or set REEL" >&2
  exit 2
fi
if [[ ! -d $bench/tasks ]]; then
  skipped real-bench "the drives: no REAL-Bench at $bench; clone https://github.com/InternRobotics/REAL and set REEL_REAL_BENCH"
  exit "$status"
fi
export REEL_REAL_BENCH="$bench"

if python_for mcp-1.21.2; then
  "$python" "$here/drive_trainer.py" "${short[@]}" || status=1
  for family in FDP FODP FDO SUL; do
    for task in $(cd "$bench/tasks/$family" && ls | head -n 2); do
      mkdir -p "$work/tasks/$family"
      cp "$bench/tasks/$family/$task" "$work/tasks/$family/"
    done
  done
  "$REEL" run --tasks "$work/tasks" --scene "$bench/s7_scene.json" --profile real-repo --out "$work/traces" >"$work/run.log" 2>&1 &&
    "$REEL" ingest "$work/traces" --store "$work/store" >"$work/ingest.log" 2>&1 || status=1
  for format in qwen-vl ms-swift llama-factory trl openai parquet; do
    if "$REEL" export sft --store "$work/store" --out "$work/sft-$format" --format "$format" >"$work/export.log" 2>&1; then
      "$python" "$here/check_answers.py" "$work/sft-$format" || status=1
    else
      echo "reel export sft --format $format failed: $(tail -n 3 "$work/export.log")" >&2
      status=1
    fi
  done
else
  skipped python "the trainer's drive and the answers of exports: pip cannot install mcp-1.21.2.txt: $(tail -n 1 "$work/pip.log")"
fi

if python_for mcp-1.9.4; then
  "$python" "$here/drive_agent.py" "${short[@]}" || status=1
else
  skipped python "the agents' drive: pip cannot install mcp-1.9.4.txt: $(tail -n 1 "$work/pip.log")"
fi
exit "$status"
