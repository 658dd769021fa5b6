"""How many episodes of the oracle succeeded; every other one with its reason. Fails below 99%.

    python3 oracle.py EPISODES.jsonl
"""

import json
import sys

with open(sys.argv[1], encoding="utf-8") as file:
    episodes = [json.loads(line) for line in file if line.startswith("{")]
failed = [episode for episode in episodes if not episode["success"]]
for episode in failed:
    print(f"  {episode['task_id']}: {episode.get('unreachable') or episode['end_reason']} after {episode['length']} steps")
share = 1 - len(failed) / max(1, len(episodes))
print(f"the oracle does {len(episodes) - len(failed)} of {len(episodes)} tasks ({share:.1%})")
sys.exit(0 if episodes and share >= 0.99 else 1)
