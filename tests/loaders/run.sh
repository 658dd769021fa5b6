#!/usr/bin/env bash
# Loads datasets with the loaders of their formats: run.sh DATASET_DIR (one dataset, or a folder of them).
# Prints one line a loader and dataset: ok, FAILED, or skipped where tests/setup.sh has not installed the loader. Exits 1 if one failed.
set -u
here="$(cd "$(dirname "$0")" && pwd)"
failed=0

load() { # dataset, environment of tests/python.sh, script, name of the loader
    local home="${XDG_CACHE_HOME:-$HOME/.cache}/reel-python/$2" python said name
    name="$4 $(basename "$1")"
    python="$home/bin/python"
    [ "$2" = tests ] && [ -n "${REEL_PYTHON:-}" ] && python="$REEL_PYTHON"
    if [ "$python" = "$home/bin/python" ] && [ ! -f "$home/requirements.txt" ]; then
        echo "skipped: python: $name: not installed (tests/setup.sh)"
    elif said="$(cd "$1" && HF_HUB_OFFLINE=1 HF_DATASETS_CACHE="$cache" MODELSCOPE_CACHE="$cache" "$python" "$here/load_$3.py" 2>"$cache/stderr")"; then
        echo "$name: ok: $said"
    else
        echo "$name: FAILED: $(tail -n 3 "$cache/stderr" | tr '\n' ' ')"
        failed=1
    fi
}

cache="$(mktemp -d)"
trap 'rm -rf "$cache"' EXIT
for manifest in "${1:?usage: run.sh DATASET_DIR}"/manifest.json "$1"/*/manifest.json; do
    [ -f "$manifest" ] || continue
    dataset="$(dirname "$manifest")"
    format="$(sed -n 's/^  "format": "\(.*\)",$/\1/p' "$manifest")"
    case "$format" in
        qwen-vl | parquet | ms-swift | trl) load "$dataset" tests datasets datasets-5 ;;
    esac
    case "$format" in
        qwen-vl | parquet | ms-swift | trl | llama-factory) load "$dataset" datasets-3 datasets datasets-3 ;;
    esac
    case "$format" in
        ms-swift) load "$dataset" trainers swift ms-swift ;;
        llama-factory) load "$dataset" llama-factory llamafactory llama-factory ;;
        trl) load "$dataset" trainers trl trl ;;
        openai) load "$dataset" tests openai openai ;;
    esac
done
exit $failed
