#!/usr/bin/env bash
# prove.sh: the whole loop with a policy that learns, from nothing to a report. Homes and the oracle's episodes; a student whose mistakes the
# oracle takes over; a policy that sees and a twin that does not; play in homes never seen, GSPO on rollouts, play again, paired comparisons,
# failures before and after. Each stage is done once: the same command goes on where it was broken off. The report is LOOP_DIR/report.html, its
# numbers LOOP_DIR/report.json.
#
# REEL (the binary), PYTHON (with PyTorch; one is set up otherwise), LOOP_DIR. SHORT=1: some minutes, that show the plumbing whole and prove
# nothing of learning. What is made and learned: see the defaults below.
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
export REEL="${REEL:-reel}" LOOP_DIR="${LOOP_DIR:-loop-data}" JOBS="${JOBS:-2}" EXAMINE=1
PYTHON="${PYTHON:-$("$here/../../tests/python.sh" lerobot)}"
export PYTHON
if [[ -n ${SHORT:-} ]]; then
  export HOMES="${HOMES:-3}" TASKS="${TASKS:-6}" HELD_OUT_HOMES="${HELD_OUT_HOMES:-1}" HELD_OUT_TASKS="${HELD_OUT_TASKS:-4}"
  PRACTICE_HOMES="${PRACTICE_HOMES:-1}" STUDENT_UPDATES="${STUDENT_UPDATES:-40}"
  ENCODER_HOMES="${ENCODER_HOMES:-2}" ENCODER_UPDATES="${ENCODER_UPDATES:-20}" COMPARISONS="${COMPARISONS:-0.33}" UPDATES="${UPDATES:-60}" STEPS="${STEPS:-2}" OTHER_STEPS="${OTHER_STEPS:-2}" REPEATS="${REPEATS:-1}" GSPO="${GSPO:---groups 2 --size 4 --updates 2 --max-tokens 100}"
else
  export HOMES="${HOMES:-110}" TASKS="${TASKS:-16}" HELD_OUT_HOMES="${HELD_OUT_HOMES:-20}" HELD_OUT_TASKS="${HELD_OUT_TASKS:-15}"
  PRACTICE_HOMES="${PRACTICE_HOMES:-16}" STUDENT_UPDATES="${STUDENT_UPDATES:-400}"
  ENCODER_HOMES="${ENCODER_HOMES:-24}" ENCODER_UPDATES="${ENCODER_UPDATES:-900}" COMPARISONS="${COMPARISONS:-0.33}" UPDATES="${UPDATES:-700}" STEPS="${STEPS:-16}" OTHER_STEPS="${OTHER_STEPS:-6}" REPEATS="${REPEATS:-1}" GSPO="${GSPO:-}"
fi
data="$LOOP_DIR" OTHER_PRESET="${OTHER_PRESET:-real-trainer}"
mkdir -p "$data/played"

# stage NAME COMMAND...: runs it unless it was done, and notes how long it took.
stage() {
  local name="$1" start=$SECONDS
  shift
  [[ ! -e $data/done.$name ]] || return 0
  echo "== $name ($(date +%H:%M:%S))"
  "$@"
  echo $((SECONDS - start)) >"$data/done.$name"
}

look() { # the image encoder, on frames with masks of the first homes
  local homes=() number
  for number in $(seq 1 "$ENCODER_HOMES"); do homes+=("$data/train-traces/home_$number"); done
  rm -rf "$data/coco"
  "$REEL" export coco "${homes[@]}" --marks --out "$data/coco"
  "$PYTHON" "$here/pretrain.py" --coco "$data/coco" --traces "${homes[@]}" --reel "$REEL" --updates "$ENCODER_UPDATES" --out "$data/encoder.pt"
  rm -rf "$data/coco"
}

practise() { # a student plays homes of training, and the oracle takes over where it goes wrong (DAgger); the student sees nothing and is done early
  "$PYTHON" "$here/sft.py" --set "$data/train-set" --out "$data/student" --updates "$STUDENT_UPDATES" --blind >"$data/student.txt"
  local number
  mkdir -p "$data/practice"
  for number in $(seq 1 "$PRACTICE_HOMES"); do cp -r "$data/train/home_$number" "$data/practice"; done
  "$PYTHON" "$here/evaluate.py" play "$data/student" --reel "$REEL" --tasks "$data/practice" --out "$data/played/student"
  "$PYTHON" "$here/takeover.py" "$data/played/student" --reel "$REEL" --out "$data/takeovers"
  "$here/set.sh" "$data/takeovers" "$data/takeover-set"
}

prepare() { # the encoder and the student, at once
  look &
  local encoder=$!
  practise
  wait "$encoder"
}

learn() { # the policy that sees and its twin, at once; what is rare counts three times
  local sets=("$data/train-set" "$data/takeover-set" "$data/takeover-set" "$data/takeover-set") twin
  "$PYTHON" "$here/sft.py" --set "${sets[@]}" --out "$data/untrained" --updates 0 >/dev/null
  "$PYTHON" "$here/sft.py" --set "${sets[@]}" --out "$data/blind" --comparisons "$COMPARISONS" --updates "$UPDATES" --blind >"$data/blind.txt" &
  twin=$!
  "$PYTHON" "$here/sft.py" --set "${sets[@]}" --out "$data/seeing" --encoder "$data/encoder.pt" --comparisons "$COMPARISONS" --updates "$UPDATES" | tee "$data/seeing.txt"
  wait "$twin"
}

play() { # play CHECKPOINT NAME OPTIONS...
  local checkpoint="$1" name="$2"
  shift 2
  "$PYTHON" "$here/evaluate.py" play "$checkpoint" --reel "$REEL" --tasks "$data/held-out" --out "$data/played/$name" --repeat "$REPEATS" --threads 2 "$@"
}

stage homes "$here/homes.sh"
stage prepare prepare
stage learn learn
stage examine "$PYTHON" "$here/examine.py" "$data/seeing" --set "$data/held-out-set" --threads 2 --out "$data/examined.json"
# What an untrained policy says cannot be read, however long it is.
stage play-untrained play "$data/untrained" untrained --max-tokens 10
for name in blind seeing; do
  stage "play-$name" play "$data/$name" "$name"
done
# shellcheck disable=SC2086
stage reinforce "$PYTHON" "$here/gspo.py" "$data/seeing" --tasks "$data/train" --out "$data/gspo" --steps "$STEPS" --reel "$REEL" $GSPO
last="$data/gspo/step_$(printf %03d "$STEPS")"
# A step in the middle once more, from its weights and its traces: the same weights, bit for bit.
stage repeat-step "$PYTHON" "$here/gspo.py" --replay-step $(((STEPS + 1) / 2)) --out "$data/gspo" --reel "$REEL"
stage play-learned play "$last" learned
# As it was trained: with draws. The same seeds give the same draws.
stage play-seeing-sampled play "$data/seeing" seeing-sampled --temperature 1
stage play-learned-sampled play "$last" learned-sampled --temperature 1
# A training under another reward, as long as the other reward needs to show; then whether the first one's traces forecast it.
# shellcheck disable=SC2086
stage reinforce-other "$PYTHON" "$here/gspo.py" "$data/seeing" --tasks "$data/train" --out "$data/gspo-other" --steps "$OTHER_STEPS" --preset "$OTHER_PRESET" --reel "$REEL" $GSPO
stage ablate "$PYTHON" "$here/ablate.py" "$data/gspo" --preset "$OTHER_PRESET" --trained "$data/gspo-other" --reel "$REEL" --out "$data/ablated.json"
stage report "$PYTHON" "$here/report.py" "$data" --reel "$REEL"
echo "the report: $data/report.html"
