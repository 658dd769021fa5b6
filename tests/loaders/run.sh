#!/usr/bin/env bash
# Loads datasets with the loaders of their formats: run.sh DATASET_DIR (one dataset, or a folder of them).
# Prints one line a loader and dataset: ok, FAILED, or skipped with the reason. Exits 1 if one failed.
# Without the environments of install.sh, $REEL_PYTHON serves for what it has.
set -u
here="$(cd "$(dirname "$0")" && pwd)"
root="${REEL_LOADERS:-$HOME/.cache/reel/loaders}"
failed=0

load() { # loader, dataset
    local python="$root/$1/bin/python" said code
    if [ ! -x "$python" ] && [ "$1" = datasets5 ] && "${REEL_PYTHON:-python3}" -c 'import datasets, PIL' 2>/dev/null; then
        python="${REEL_PYTHON:-python3}"
    fi
    if [ ! -x "$(command -v "$python")" ]; then
        echo "$1 $(basename "$2"): skipped: not installed (tests/loaders/install.sh)"
        return
    fi
    said="$(cd "$2" && HF_HUB_OFFLINE=1 HF_DATASETS_CACHE="$cache" MODELSCOPE_CACHE="$cache" "$python" "$here/load_$3.py" 2>"$cache/stderr")"
    code=$?
    case $code in
        0) echo "$1 $(basename "$2"): ok: $said" ;;
        77) echo "$1 $(basename "$2"): skipped: $said" ;;
        *)
            echo "$1 $(basename "$2"): FAILED: $(tail -n 3 "$cache/stderr" | tr '\n' ' ')"
            failed=1
            ;;
    esac
}

cache="$(mktemp -d)"
trap 'rm -rf "$cache"' EXIT
for manifest in "${1:?usage: run.sh DATASET_DIR}"/manifest.json "$1"/*/manifest.json; do
    [ -f "$manifest" ] || continue
    dataset="$(dirname "$manifest")"
    case "$(sed -n 's/^  "format": "\(.*\)",$/\1/p' "$manifest")" in
        qwen-vl | parquet)
            load datasets5 "$dataset" datasets
            load datasets3 "$dataset" datasets
            ;;
        ms-swift)
            load datasets5 "$dataset" datasets
            load datasets3 "$dataset" datasets
            load swift "$dataset" swift
            ;;
        llama-factory)
            load datasets3 "$dataset" datasets
            load llamafactory "$dataset" llamafactory
            ;;
        trl)
            load datasets5 "$dataset" datasets
            load datasets3 "$dataset" datasets
            load trl "$dataset" trl
            ;;
        openai) load openai "$dataset" openai ;;
    esac
done
exit $failed
