#!/usr/bin/env bash
# `make eval-preferences`: whether preference pairs teach what they should, on PAIRS (default 500) pairs of episodes with faults of
# every kind. Counted from the files and from the traces of the chosen futures, ingested anew: equal pairs, chosen calls that fail,
# futures that do not succeed or do not replay, missing questions. All have to be 0. REEL: a binary that is built already.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$HOME/.cache/reel}"
[[ -n ${REEL:-} ]] || cargo build --locked --workspace --bin reel
reel="${REEL:-$CARGO_TARGET_DIR/debug/reel}"
work="${EVAL_DIR:-$(mktemp -d)}"
pairs="${PAIRS:-500}"

"$reel" task draw --count 200 --seed 9201 --out "$work/tasks" >/dev/null
# about seven of ten faulty episodes fail and have a better call that needs no knowledge of the truth
"$reel" agent faults run --tasks "$work/tasks" --out "$work/faulty" --episodes $((pairs * 16 / 10)) --seed 9700000 \
  --double-share 0.3 --repaired-share 0.2 --detour-share 0.5 >/dev/null
"$reel" ingest "$work/faulty" --store "$work/store" >/dev/null
"$reel" export preferences --store "$work/store" --out "$work/pairs" --no-images --json >"$work/report.json"
"$reel" replay "$work/pairs/traces" >"$work/replayed.txt" || true
"$reel" ingest "$work/pairs/traces" --store "$work/chosen" >/dev/null
"$reel" query --store "$work/chosen" --format json \
  "SELECT e.episode_id, e.success, s.step, s.tool, s.error_code FROM episodes e JOIN steps s USING (episode_id)" >"$work/steps.json"
python3 - "$work" "$pairs" <<'PYTHON'
import collections, json, sys
work, wanted = sys.argv[1], int(sys.argv[2])
report = json.load(open(f"{work}/report.json"))
text = open(f"{work}/steps.json").read()
rows = json.loads(text) if text.lstrip().startswith("[") else [json.loads(line) for line in text.splitlines()]
steps = {(row["episode_id"], row["step"]): row for row in rows}
pairs = [json.loads(line) for line in open(f"{work}/pairs/preferences.jsonl")]
bad, causes = collections.Counter(), collections.Counter()
for pair in pairs:
    origin = pair["provenance"]
    episode, step = origin["chosen"]["example"].rsplit("/", 1)
    chosen = steps[episode, int(step)]
    causes[origin["cause"]] += 1
    bad["equal"] += pair["chosen"] == pair["rejected"] or origin["chosen_call"] == origin["rejected_call"]
    bad["chosen call fails"] += chosen["error_code"] is not None
    bad["future does not succeed"] += not chosen["success"]
    bad["question missing"] += origin["cause"] == "communication" and chosen["tool"] != "ask"
replayed = [line for line in open(f"{work}/replayed.txt") if line.rstrip().endswith(".mcap") is False]
bad["future does not replay"] += sum("exact" not in line for line in replayed if ".mcap:" in line)
print(f"{len(pairs)} pairs of {report['failed']} failed episodes; causes: {dict(causes)}")
for what in ["equal", "chosen call fails", "future does not succeed", "future does not replay", "question missing"]:
    print(f"  {what}: {bad[what]}")
reasons = collections.Counter(row["reason"].split(":")[0].split("(")[0][:60] for row in report["refused"])
for reason, count in reasons.most_common(6):
    print(f"  no pair, {count} times: {reason}")
sys.exit(any(bad.values()) or len(pairs) < wanted)
PYTHON
