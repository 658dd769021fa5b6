"""The rows of a store, and words to talk about episodes and steps."""
import math
import os
import sys
from collections import defaultdict

import pyarrow.parquet
from deltalake import DeltaTable

STORE = sys.argv[1]
ANSWERS = {}
FAMILIES = ["FDP", "FODP", "FDO", "SUL"]
LOOKING = ["walk_around", "show_object_by_category", "show_receptacles", "gaze_at"]
HANDLING = ["pick", "place", "open", "close"]


def table(name):
    rows = []
    for uri in DeltaTable(os.path.join(STORE, name)).file_uris():
        rows += pyarrow.parquet.ParquetFile(uri.removeprefix("file://")).read().to_pylist()
    return rows


EPISODES = sorted(table("episodes"), key=lambda e: e["episode_id"])
TASKS = {task["task_digest"]: task for task in table("tasks")}
SCENES = {scene["scene_digest"]: scene for scene in table("scenes")}
QUARANTINE = table("quarantine")
ENDED = [episode for episode in EPISODES if episode["end_reason"] is not None]
for one in EPISODES:
    one["objects"] = {item["instance"]: item for item in TASKS[one["task_digest"]]["objects"]}


def answers(query):
    """Says that a function answers the named query of its name."""
    ANSWERS[query.__name__] = query
    return query


def group(rows, *keys):
    """Rows by the values of their keys."""
    groups = defaultdict(list)
    for row in rows:
        groups[tuple(row[key] for key in keys)].append(row)
    return groups.items()


def ordered(rows, *keys):
    """Sorted as SQL does: nulls last; with a minus before the key downwards, nulls first."""
    for key in reversed(keys):
        name = key.lstrip("-")
        rows.sort(key=lambda row: (row[name] is None, 0 if row[name] is None else row[name]), reverse=key.startswith("-"))
    return rows


def with_totals(rows, key):
    """(policy, value of the key, rows), after each policy's values one `all`; families in their own order."""
    for (policy,), mine in sorted(group(rows, "policy")):
        values = {row[key] for row in mine}
        for value in sorted(values, key=FAMILIES.index if key == "family" else None):
            yield policy, value, [row for row in mine if row[key] == value]
        yield policy, "all", mine


def mean(values):
    known = [value for value in values if value is not None]
    return math.fsum(known) / len(known) if known else None


def share(part, whole):
    return len(part) / len(whole) if whole else None


def won(episodes):
    return [episode for episode in episodes if episode["success"]]


def lost(episodes):
    return [episode for episode in episodes if episode["success"] is False]


def success(episodes):
    return mean(float(episode["success"]) for episode in episodes if episode["success"] is not None)


def distinct(rows, key):
    return len({row[key] for row in rows if row[key] is not None})


def first(values):
    return min(values, default=None)


def wilson(part, whole):
    """Roots of (p - share)^2 = z^2 p (1 - p) / n, by the quadratic formula."""
    if not whole:
        return {"low": None, "high": None}
    z2 = 1.959963984540054**2
    a, b, c = 1 + z2 / whole, -2 * part / whole - z2 / whole, (part / whole) ** 2
    root = math.sqrt(max(b * b - 4 * a * c, 0))
    return {"low": max(0.0, (-b - root) / (2 * a)), "high": min(1.0, (-b + root) / (2 * a))}


def of(episode, *keys):
    return {key: episode[key] for key in keys}


def without(rows, *keys):
    return [{key: value for key, value in row.items() if key not in keys} for row in rows]


def ok(step, tool):
    return step["tool"] == tool and step["error_code"] is None


def letters(episode, *rules):
    """A letter a step: that of the first rule (letter, condition) it fulfils, else a dot."""
    return "".join(next((letter for letter, rule in rules if rule(step)), ".") for step in episode["steps"])


def steps():
    return ((episode, step) for episode in EPISODES for step in episode["steps"])


def swings(episode):
    """The longest back and forth, the first of equals: (length, first step, the two places)."""
    places = [step["argument"] if step["tool"] == "nav_to" else None for step in episode["steps"]]
    best = None
    for begin in range(len(places)):
        end = begin
        while end < len(places) and places[end] is not None:
            if end - begin == 1 and places[end] == places[begin] or end - begin > 1 and places[end] != places[end - 2]:
                break
            end += 1
        if end - begin >= 3 and (best is None or end - begin > best[0]):
            best = (end - begin, begin, *sorted(places[begin : begin + 2]))
    return best


def questions(episode):
    for step in episode["steps"]:
        if not ok(step, "ask"):
            continue
        later = [pick for pick in episode["steps"] if pick["step"] > step["step"] and ok(pick, "pick")]
        earned = episode["preset"] == "paper" and any(t["component"] == "ask" and t["value"] > 0 for t in step["terms"])
        reply = step["reply"]
        yield {
            **of(episode, "policy", "family", "task_id", "success"), **of(step, "step", "candidates"),
            "useful": step["candidates"] > 1 or earned,
            "question": step["question"], "reply": reply, "source": step["reply_source"],
            "words": None if reply is None else len(reply.split()),
            "then_picked": {True: "right", False: "wrong", None: None}[later[0]["goal_object"] if later else None],
            **of(episode, "episode_id", "trace"),
        }


def all_of(policy, episodes=EPISODES):
    return [episode for episode in episodes if episode["policy"] == policy]
