#!/usr/bin/env bash
# Makes one Python environment a loader under ~/.cache/reel/loaders (or $REEL_LOADERS), with pinned versions.
# The trainers' packages come without torch: what is tested here, their reading and converting of rows, computes nothing.
set -u
root="${REEL_LOADERS:-$HOME/.cache/reel/loaders}"
python="${REEL_PYTHON:-python3}"
mkdir -p "$root"

environment() { # name, packages...
    local name="$1"
    shift
    if [ ! -x "$root/$name/bin/python" ]; then
        "$python" -m venv "$root/$name" || { echo "$name: no environment" >&2; return 0; }
    fi
    timeout 600 "$root/$name/bin/python" -m pip install -q "$@" || echo "$name: did not install within 10 minutes" >&2
}

environment datasets5 datasets==5.2.0 pillow
environment datasets3 'datasets==3.6.0' pillow
environment openai openai==3.54.0 pillow
environment trl datasets==5.2.0 transformers pillow jinja2 packaging pandas psutil
environment trl --no-deps trl==1.16.0
environment llamafactory 'datasets<=4.0.0' 'transformers<=5.6.0,>=4.55' numpy omegaconf pillow
environment llamafactory --no-deps llamafactory==0.9.5
environment swift 'datasets<4.8.5,>=4.0' 'transformers<5.20' aiohttp json-repair modelscope numpy pillow
environment swift --no-deps ms-swift==4.6.0
