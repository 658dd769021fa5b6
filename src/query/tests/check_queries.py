"""Answers every named query again, in plain Python over the rows of the Delta tables, and compares with Reel's answers.

check_queries.py STORE OUT: STORE is a folder of tables, OUT holds <name>.json for each named query: a list of objects.
Prints a line a query; ends with 1 at any difference, and names query, row, column and both values. Needs `deltalake`,
`pyarrow` and `numpy`. Shares nothing with the SQL: step patterns are regular expressions over one letter a step, graph and
statistics are written out.
"""
import json
import math
import os
import re
import sys
from collections import Counter, defaultdict

import numpy
import pyarrow.parquet
from deltalake import DeltaTable

STORE, OUT = sys.argv[1:3]
ANSWERS = {}
FAMILIES = ["FDP", "FODP", "FDO", "SUL"]
LOOKING = ["walk_around", "show_object_by_category", "show_receptacles", "gaze_at"]
HANDLING = ["pick", "place", "open", "close"]


# ---------------------------------------------------------------------------------------------------------------- rows


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


# --------------------------------------------------------------------------------------------------------------- steps


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


# ------------------------------------------------------------------------------------------------- what the store holds


@answers
def overview():
    keys = ["policy", "checkpoint", "backend", "profile", "preset", "sim_version", "build"]
    rows = [
        {
            **dict(zip(keys, values)), "episodes": len(mine),
            "broken_off": sum(e["end_reason"] is None for e in mine),
            "tasks": distinct(mine, "task_digest"), "scenes": distinct(mine, "scene_digest"),
            "seeds": distinct(mine, "seed"), "runs": distinct(mine, "run_id"),
            "decisions": sum(len(e["steps"]) for e in mine), "megabytes": sum(e["trace_bytes"] for e in mine) / 1e6,
        }
        for values, mine in group(EPISODES, *keys)
    ]
    return ordered(rows, "-episodes", *keys)


@answers
def quarantined():
    rows = [
        {"reason": reason, "files": len(mine), "example": min(file["trace"] for file in mine)}
        for (reason,), mine in group(QUARANTINE, "reason")
    ]
    return ordered(rows, "-files", "reason")


@answers
def ends():
    rows = [
        {
            "policy": policy, "reason": reason or "broken off", "episodes": len(mine), "share": share(mine, all_of(policy)),
            "success": success(mine), "done": mean(e["completion"] for e in mine), "length": mean(e["length"] for e in mine),
        }
        for (policy, reason), mine in group(EPISODES, "policy", "end_reason")
    ]
    return ordered(rows, "policy", "-episodes", "reason")


def all_of(policy, episodes=EPISODES):
    return [episode for episode in episodes if episode["policy"] == policy]


# ------------------------------------------------------------------------------------------------------------- results


@answers
def benchmark():
    return [
        {
            "policy": policy, "family": family, "episodes": len(mine), "success": success(mine),
            "done": mean(e["completion"] for e in mine), "reward": mean(e["total_reward"] for e in mine),
            "length": mean(e["length"] for e in mine), "asks": mean(e["asks"] for e in mine), "spl": mean(e["spl"] for e in mine),
        }
        for policy, family, mine in with_totals(ENDED, "family")
    ]


@answers
def main_results():
    rows = []
    for (policy,), mine in group(ENDED, "policy"):
        row = {"policy": policy}
        for family in FAMILIES:
            played = [e for e in mine if e["family"] == family]
            row[family.lower()] = f"{len(won(played))}/{len(played)}" if played else "-"
        counts = {"all": f"{len(won(mine))}/{len(mine)}", "success": share(won(mine), mine)}
        rows.append({**row, **counts, **wilson(len(won(mine)), len(mine))})
    return ordered(rows, "-success", "policy")


@answers
def success_intervals():
    return [
        {
            "policy": policy, "family": family, "episodes": len(mine), "tasks": distinct(mine, "task_digest"),
            "won": len(won(mine)), "success": success(mine), **wilson(len(won(mine)), len(mine)),
        }
        for policy, family, mine in with_totals(ENDED, "family")
    ]


@answers
def real_world():
    def latency_s(episode):
        known = [step["latency_ns"] for step in episode["steps"] if step["latency_ns"] is not None]
        return sum(known) / 1e9 if known else None

    return [
        {
            "policy": policy, "family": family, "episodes": len(mine), "success": success(mine),
            "steps": mean(e["length"] for e in mine), "spl": mean(e["spl"] for e in mine),
            "asks": mean(e["asks"] for e in mine), "latency_s": mean(map(latency_s, mine)),
        }
        for policy, family, mine in with_totals(ENDED, "family")
    ]


@answers
def primitives():
    calls = []
    for episode, step in steps():
        if step["tool"] not in HANDLING:
            continue
        markers = {str(marker["marker"]): marker["id"] for marker in step["marker_map"]}
        aim = step["receptacle"] or markers.get(step["argument"])
        kinds = {r["receptacle"]: r["category"] for r in SCENES[episode["scene_digest"]]["receptacles"]}
        skill = f"place {kinds.get(aim, '?')}" if step["tool"] == "place" else step["tool"]
        calls.append({"policy": episode["policy"], "skill": skill, "worked": step["error_code"] is None})
    rows = []
    for policy, skill, mine in with_totals(calls, "skill"):
        worked = sum(call["worked"] for call in mine)
        row = {"policy": policy, "skill": skill, "calls": len(mine), "worked": worked, "success": worked / len(mine)}
        rows.append({**row, **wilson(worked, len(mine))})
    return rows


@answers
def rollouts():
    tools = ["nav_to", "show_object_by_category", "gaze_at", "pick", "nav_to", "show_receptacles", "place"]
    code = {"nav_to": "n", "show_object_by_category": "f", "gaze_at": "g", "pick": "p", "show_receptacles": "r", "place": "l"}
    word = "".join(code[tool] for tool in tools)

    def spelled(episode):
        return letters(episode, *((letter, lambda step, tool=tool: ok(step, tool)) for tool, letter in code.items()))

    def last_place_wrong(episode):
        places = [step for step in episode["steps"] if ok(step, "place")]
        picks = [step["step"] for step in episode["steps"] if ok(step, "pick")]
        return bool(places) and places[-1]["goal_object"] is False and any(pick < places[-1]["step"] for pick in picks)

    rows = []
    for (policy,), mine in sorted(group(ENDED, "policy")):
        asked = [e for e in mine if any(questions(e))]
        failed = lost(mine)
        rows.append({
            "policy": policy, "episodes": len(mine), "success": success(mine),
            "canonical": share([e for e in mine if word in spelled(e)], mine),
            "in_order": share([e for e in mine if re.search(".*".join(word), spelled(e))], mine),
            "asked": share(asked, mine),
            "asked_well": share([e for e in asked if any(q["useful"] for q in questions(e))], asked),
            "failed": len(failed),
            "procedure_right": share([e for e in failed if re.search("p.*l", spelled(e))], failed),
            "wrong_object": share([e for e in failed if last_place_wrong(e)], failed),
        })
    return rows


@answers
def funnel():
    names = ["told", "went to the source", "saw the target", "picked the right object", "went to the destination",
             "placed the object right", "success"]

    def stages(episode):
        done = [step for step in episode["steps"] if step["error_code"] is None]
        seen = {item["object"] for item in episode["start_objects"]}.union(*(s["new_objects"] for s in episode["steps"]))
        picked = first(step["step"] for step in done if step["tool"] == "pick" and step["goal_object"])
        there = [step["step"] for step in done if step["tool"] == "nav_to" and step["receptacle"] == episode["dest"]]
        return [
            True,
            any(step["tool"] == "nav_to" and step["receptacle"] == episode["src"] for step in done),
            episode["target"] in seen,
            picked is not None,
            picked is not None and any(step > picked for step in there),
            any(step["tool"] == "place" and step["goal_object"] and step["goal_receptacle"] for step in done),
            episode["success"],
        ]

    rows = []
    for (policy,), mine in sorted(group(ENDED, "policy")):
        reached = [stages(episode) for episode in mine]
        before = None
        for number, name in enumerate(names):
            passed = sum(all(stage[: number + 1]) for stage in reached)
            rows.append({
                "policy": policy, "stage": f"{number + 1} {name}", "reached": sum(stage[number] for stage in reached),
                "passed": passed, "share": passed / len(mine), "kept": passed / before if before else None,
            })
            before = passed
    return rows


@answers
def distractors():
    def placed(episode):
        return sum(item["role"] == "distractor" for item in episode["objects"].values())

    def wrong(episode):
        return any(ok(step, "pick") and step["goal_object"] is False for step in episode["steps"])

    rows = []
    for (policy, number), mine in sorted(group([{**e, "number": placed(e)} for e in ENDED], "policy", "number")):
        rows.append({
            "policy": policy, "distractors": number, "episodes": len(mine), "tasks": distinct(mine, "task_digest"),
            "success": success(mine), **wilson(len(won(mine)), len(mine)), "wrong_pick": share(list(filter(wrong, mine)), mine),
            "asks": mean(e["asks"] for e in mine), "length": mean(e["length"] for e in mine),
        })
    return rows


@answers
def solved_within():
    rows = []
    for (policy,), mine in sorted(group(ENDED, "policy")):
        for budget in sorted({e["length"] for e in won(mine)}):
            within = [e for e in won(mine) if e["length"] <= budget]
            rows.append({"policy": policy, "decisions": budget, "won": len(within), "success": share(within, mine)})
    return rows


# ------------------------------------------------------------------------------------------------- tasks and comparison


def on_tasks():
    """Mean success by policy and task."""
    results = defaultdict(dict)
    for (policy, task), mine in group(ENDED, "policy", "task_digest"):
        results[policy][task] = mine
    return results


def chacha8(seed, count):
    """`count` numbers of 64 bits of ChaCha with 8 rounds, the key stretched from the seed by PCG32 (crate `rand_core`)."""
    words, mask = [], (1 << 64) - 1
    for _ in range(8):
        seed = (seed * 6364136223846793005 + 11634580027462260723) & mask
        word, turn = ((seed >> 18) ^ seed) >> 27 & 0xFFFFFFFF, seed >> 59
        words.append((word >> turn | word << (32 - turn)) & 0xFFFFFFFF)
    blocks = (count + 7) // 8
    begin = [numpy.full(blocks, word, numpy.uint32) for word in [0x61707865, 0x3320646E, 0x79622D32, 0x6B206574, *words]]
    counter = numpy.arange(blocks, dtype=numpy.uint64)
    begin += [counter.astype(numpy.uint32), (counter >> numpy.uint64(32)).astype(numpy.uint32), *numpy.zeros((2, blocks), numpy.uint32)]
    x = [word.copy() for word in begin]

    def mix(a, b, c, d):
        for to, by, turned, bits in [(a, b, d, 16), (c, d, b, 12), (a, b, d, 8), (c, d, b, 7)]:
            x[to] += x[by]
            x[turned] ^= x[to]
            x[turned] = x[turned] << numpy.uint32(bits) | x[turned] >> numpy.uint32(32 - bits)

    for _ in range(4):
        for column in range(4):
            mix(column, column + 4, column + 8, column + 12)
        for column in range(4):
            mix(column, (column + 1) % 4 + 4, (column + 2) % 4 + 8, (column + 3) % 4 + 12)
    out = numpy.stack([word + start for word, start in zip(x, begin)], axis=1).astype(numpy.uint64)
    return (out[:, 0::2] | out[:, 1::2] << numpy.uint64(32)).reshape(-1)[:count]


def bootstrap(differences, samples, seed):
    """2.5 and 97.5 % percentiles of the means of resampled lists."""
    n = len(differences)
    draws = chacha8(seed, n * samples)
    half = numpy.uint64(32)
    low, high = draws & numpy.uint64(0xFFFFFFFF), draws >> half
    # floor(draw * n / 2^64) without 128 bits
    index = (high * numpy.uint64(n) + (low * numpy.uint64(n) >> half)) >> half
    means = sorted(numpy.array(differences)[index.astype(int)].reshape(samples, n).mean(axis=1))
    return [float(means[int((samples - 1) * part + 0.5)]) for part in (0.025, 0.975)]


@answers
def compared():
    rows, results = [], on_tasks()
    for a in sorted(results):
        for b in sorted(other for other in results if other > a):
            both = sorted(set(results[a]) & set(results[b]))
            if not both:
                continue
            pairs = [(success(results[a][task]), success(results[b][task])) for task in both]
            only_a = sum(one > 0.5 >= other for one, other in pairs)
            only_b = sum(other > 0.5 >= one for one, other in pairs)
            n = only_a + only_b
            tail = sum(math.comb(n, k) for k in range(min(only_a, only_b) + 1)) * 2 / 2**n
            low, high = bootstrap([one - other for one, other in pairs], 2000, 7)
            rows.append({
                "a": a, "b": b, "tasks": len(both), "success_a": mean(one for one, _ in pairs),
                "success_b": mean(other for _, other in pairs), "only_a": only_a, "only_b": only_b, "p": min(1.0, tail),
                "difference": mean(one - other for one, other in pairs), "low": low, "high": high,
            })
    return rows


@answers
def regressions():
    rows, results = [], on_tasks()
    for a in results:
        for b in results:
            for task in set(results[a]) & set(results[b]):
                one, other = results[a][task], results[b][task]
                if success(one) > 0.5 >= success(other):
                    rows.append({
                        "a": a, "b": b, **of(one[0], "family", "task_id"),
                        "success_a": success(one), "success_b": success(other),
                        "episodes_a": len(one), "episodes_b": len(other),
                        "trace_a": first(e["trace"] for e in won(one)), "trace_b": first(e["trace"] for e in lost(other)),
                        "task": task,
                    })
    return without(ordered(rows, "a", "b", "family", "task_id", "task"), "task")


def without(rows, *keys):
    return [{key: value for key, value in row.items() if key not in keys} for row in rows]


@answers
def hardest_tasks():
    classes = {e["episode_id"]: judged(e)["class"] for e in lost(EPISODES)}
    rows = []
    for (task,), mine in group(ENDED, "task_digest"):
        failures = Counter(classes[e["episode_id"]] for e in mine if e["episode_id"] in classes)
        rows.append({
            **of(mine[0], "family", "task_id"), "policies": distinct(mine, "policy"), "solved_by": distinct(won(mine), "policy"),
            "episodes": len(mine), "success": success(mine), "done": mean(e["completion"] for e in mine),
            "length": mean(e["length"] for e in mine),
            "failure": min(failures, key=lambda name: (-failures[name], name), default=None),
            "instruction": min(e["instruction"] for e in mine),
            "task": task, "rounded": round(mean(e["completion"] for e in mine), 6),
        })
    return without(ordered(rows, "success", "rounded", "family", "task_id", "task"), "task", "rounded")


@answers
def unsteady_tasks():
    rows = []
    for (policy, task), mine in group(ENDED, "policy", "task_digest"):
        if won(mine) and lost(mine):
            rows.append({
                "policy": policy, **of(mine[0], "family", "task_id"), "episodes": len(mine), "seeds": distinct(mine, "seed"),
                "won": len(won(mine)), "success": success(mine), "trace_won": min(e["trace"] for e in won(mine)),
                "trace_lost": min(e["trace"] for e in lost(mine)), "task": task,
            })
    return without(ordered(rows, "policy", "family", "task_id", "task"), "task")


# ------------------------------------------------------------------------------------------------------------ failures


@answers
def oscillations():
    rows = []
    for episode in EPISODES:
        if swing := swings(episode):
            row = dict(zip(["length", "first_step", "one", "other"], swing))
            rows.append({**row, **of(episode, "policy", "family", "task_id", "success", "episode_id", "trace")})
    return ordered(rows, "-length", "policy", "task_id", "episode_id")


def judged(episode):
    """The first rule that holds, with its evidence; the rules are in the header of `failed_episodes`."""
    done = [step for step in episode["steps"] if step["error_code"] is None]
    pick = next((step for step in reversed(done) if step["tool"] == "pick"), None)
    place = next((step for step in reversed(done) if step["tool"] == "place" and step["goal_object"]), None)
    opened = {step["receptacle"] for step in done if step["tool"] == "open"}
    door = first(step["step"] for step in episode["steps"] if step["error_code"] == "door_closed")
    candidates = max((step["candidates"] for step in episode["steps"]), default=0)
    swing, task = swings(episode), TASKS[episode["task_digest"]]
    src, dest, target, length = (episode[key] for key in ["src", "dest", "target", "length"])
    right = bool(pick and pick["goal_object"])
    wrong_object = bool(pick and pick["goal_object"] is False)
    wrong_place = right and bool(place and place["goal_receptacle"] is False)
    unasked = episode["fuzzy"] and episode["asks"] == 0
    shut = task["src_door"] == "closed" and src not in opened or task["dest_door"] == "closed" and right and dest not in opened
    never = "picked" if pick is None else "placed"
    finished_early = episode["end_reason"] == "finished" and not (pick and any(step["tool"] == "place" for step in done))
    picked, at = (pick["object"] or "", pick["step"]) if pick else ("", None)
    put, put_at = (place["receptacle"] or "", place["step"]) if place else ("", None)
    missing, confusion, memory = "Key Action Missing", "Object Confusion", "Lost Memory"
    rules = [
        (unasked and wrong_object, missing, "no question", f"no ask, {candidates} candidates seen; step {at} picked {picked}"),
        (unasked and wrong_place, missing, "no question", f"no ask; step {put_at} placed on {put}, not {dest}"),
        (wrong_object, confusion, "wrong object", f"step {at} picked {picked}, not {target}"),
        (wrong_place, confusion, "similar furniture", f"step {put_at} placed on {put}, not {dest}"),
        (door is not None and not opened, missing, "closed door", f"step {door} met a closed door, none was opened"),
        (swing and swing[0] >= 4, memory, "oscillation",
         swing and f"{swing[0]} nav_to between {swing[2]} and {swing[3]} from step {swing[1]}"),
        (shut, missing, "closed door", f"door of {src} or {dest} never opened"),
        (unasked and not pick and candidates > 1, missing, "no question", f"no ask, {candidates} candidates seen, none picked"),
        (finished_early, missing, f"never {never}", f"finish after {length} decisions"),
        (episode["end_reason"] == "horizon", memory, "no progress", f"{length} decisions"),
        (True, "Other", "other", f"last pick {picked}, last place {put}"),
    ]
    rule = next(index for index, (holds, *_) in enumerate(rules) if holds)
    return {
        **dict(zip(["class", "cause", "evidence"], rules[rule][1:])), "done": episode["completion"],
        **of(episode, "length", "end_reason", "policy", "family", "task_id", "episode_id", "trace"), "rule": max(rule, 1),
    }


@answers
def failed_episodes():
    return without(ordered([judged(e) for e in lost(EPISODES)], "rule", "policy", "task_id", "episode_id"), "rule")


@answers
def failures():
    judgements = [judged(e) for e in lost(EPISODES)]
    rows = [
        {
            "policy": policy, "class": name, "cause": cause, "episodes": len(mine),
            "share": len(mine) / sum(j["policy"] == policy for j in judgements), "example": min(j["trace"] for j in mine),
        }
        for (policy, name, cause), mine in group(judgements, "policy", "class", "cause")
    ]
    return ordered(rows, "policy", "-episodes", "class", "cause")


@answers
def errors():
    calls = [{"policy": e["policy"], **of(s, "tool", "error_code", "error_class")} for e, s in steps()]
    of_tool = Counter((call["policy"], call["tool"]) for call in calls)
    rows = [
        {"policy": key[0], "tool": key[1], "error": key[2], "class": key[3], "calls": len(mine),
         "share": len(mine) / of_tool[key[:2]]}
        for key, mine in group(calls, "policy", "tool", "error_code", "error_class") if key[2] is not None
    ]
    return ordered(rows, "-calls", "policy", "tool", "error")


@answers
def error_classes():
    calls = [{"policy": e["policy"], **of(s, "tool", "error_class")} for e, s in steps()]
    rows = []
    for policy, tool, mine in with_totals(calls, "tool"):
        classes = Counter(call["error_class"] for call in mine)
        rows.append({
            "policy": policy, "tool": tool, "calls": len(mine), "an_episode": len(mine) / len(all_of(policy)),
            "worked": classes[None], "moderate": classes["moderate"], "severe": classes["severe"],
            "failed": (classes["moderate"] + classes["severe"]) / len(mine),
        })
    return rows


@answers
def object_confusions():
    picks = []
    for episode, step in steps():
        if ok(step, "pick") and step["goal_object"] is False:
            taken = episode["objects"].get(step["object"], {"category": None, "caption": None})
            picks.append({
                **of(episode, "policy", "episode_id", "trace", "success"), "wanted": episode["target_category"],
                "wanted_caption": episode["target_caption"], "picked": taken["category"], "picked_caption": taken["caption"],
            })
    keys = ["policy", "wanted", "wanted_caption", "picked", "picked_caption"]
    rows = [
        {**dict(zip(keys, values)), "alike": values[3] == values[1] if values[3] is not None else None,
         "picks": len(mine), **involved(mine)}
        for values, mine in group(picks, *keys)
    ]
    return ordered(rows, "-picks", *keys)


def involved(calls):
    return {"episodes": distinct(calls, "episode_id"), "won": distinct(won(calls), "episode_id"),
            "example": min(call["trace"] for call in calls)}


@answers
def receptacle_confusions():
    places = []
    for episode, step in steps():
        if ok(step, "place") and step["goal_object"] and step["goal_receptacle"] is False:
            likes = TASKS[episode["task_digest"]]["dest_distractors"]
            places.append({
                **of(episode, "policy", "scene_id", "episode_id", "trace", "success"), "wanted": episode["dest"],
                "placed_on": step["receptacle"], "alike": step["receptacle"] in likes,
                "source": step["receptacle"] == episode["src"],
            })
    keys = ["policy", "scene_id", "wanted", "placed_on", "alike", "source"]
    rows = [{**dict(zip(keys, values)), "places": len(mine), **involved(mine)} for values, mine in group(places, *keys)]
    return ordered(rows, "-places", *keys)


# ----------------------------------------------------------------------------------------------------------- questions


@answers
def asks():
    rows = [question for episode in EPISODES for question in questions(episode)]
    return ordered(rows, "policy", "family", "task_id", "episode_id", "step")


@answers
def asking():
    rows = []
    for (policy, fuzzy), mine in sorted(group(ENDED, "policy", "fuzzy")):
        asked = [episode for episode in mine if any(questions(episode))]
        put = [question for episode in mine for question in questions(episode)]
        picked = [question for question in put if question["then_picked"]]
        rows.append({
            "policy": policy, "fuzzy": fuzzy, "episodes": len(mine), "asks": share(put, mine), "asked": share(asked, mine),
            "useful": share([q for q in put if q["useful"]], put),
            "answered": share([q for q in put if q["reply"] is not None], put),
            "picked_right": share([q for q in picked if q["then_picked"] == "right"], picked),
            "success_asked": success(asked), "success_unasked": success(e for e in mine if e not in asked),
        })
    return rows


@answers
def user_fidelity():
    played = {episode["episode_id"]: episode for episode in EPISODES}
    answered = [question for question in asks() if question["reply"] is not None]
    rows = []
    for (policy, source), mine in sorted(group(answered, "policy", "source")):
        episodes = [played[name] for name in {question["episode_id"] for question in mine}]
        ended = [episode for episode in episodes if episode["end_reason"] is not None]
        led = Counter(question["then_picked"] for question in mine)
        rows.append({
            "policy": policy, "source": source, "answers": len(mine), "words": mean(question["words"] for question in mine),
            "led_right": led["right"], "led_wrong": led["wrong"], "led_nowhere": led[None], "episodes": len(ended),
            "tasks": distinct(ended, "task_digest"), "won": len(won(ended)), "success": success(ended),
            **wilson(len(won(ended)), len(ended)),
        })
    return rows


# --------------------------------------------------------------------------------------- rewards, graphs, groups, effort


@answers
def reward_components():
    terms = [
        {**of(episode, "policy", "preset"), **of(term, "component", "value")}
        for episode in ENDED for step in episode["steps"] for term in step["terms"]
    ]
    rows = []
    for (policy, preset, component), mine in sorted(group(terms, "policy", "preset", "component")):
        values = [term["value"] for term in mine]
        played = [episode for episode in all_of(policy, ENDED) if episode["preset"] == preset]
        rows.append({
            "policy": policy, "preset": preset, "component": component, "mean": math.fsum(values) / len(played),
            "low": min(values), "high": max(values), "terms": len(values),
        })
    return rows


@answers
def rescored_rewards():
    scores = []
    for score in table("rescored"):
        for episode in ENDED:
            if (episode["episode_id"], episode["trace_digest"]) == (score["episode_id"], score["trace_digest"]):
                scores.append({
                    "policy": episode["policy"], "recorded": episode["preset"], **of(score, "preset", "version"),
                    "before": episode["total_reward"], "after": score["total_reward"],
                })
    keys = ["policy", "recorded", "preset", "version"]
    rows = []
    for values, mine in sorted(group(scores, *keys)):
        gains = [score["after"] - score["before"] for score in mine]
        rows.append({
            **dict(zip(keys, values)), "episodes": len(mine), "reward_recorded": mean(score["before"] for score in mine),
            "reward": mean(score["after"] for score in mine), "difference": mean(gains),
            "higher": sum(gain > 0 for gain in gains), "lower": sum(gain < 0 for gain in gains),
            "least": min(gains), "most": max(gains),
        })
    return rows


@answers
def graph_events():
    changes = []
    for episode in EPISODES:
        made = [("(start)", True, None, change) for change in episode["start_changes"]]
        made += [(s["tool"], s["error_code"] is None, s["object"], change) for s in episode["steps"] for change in s["changes"]]
        changes += [
            {
                "tool": tool, "worked": worked, "event": change["event"], "floor": change["receptacle"] == "floor",
                "authority": change["authority"], "bystander": change["object"] not in (None, acted_on),
                **of(episode, "episode_id", "trace"),
            }
            for tool, worked, acted_on, change in made
        ]
    rows = []
    for key, mine in sorted(group(changes, "tool", "worked", "event", "floor")):
        authorities = Counter(change["authority"] for change in mine)
        rows.append({
            **dict(zip(["tool", "worked", "event", "floor"], key)), **{name: authorities[name] for name in ["physics", "registry"]},
            "bystanders": sum(change["bystander"] for change in mine), "episodes": distinct(mine, "episode_id"),
            "example": min(change["trace"] for change in mine),
        })
    return rows


def prompt_groups():
    return sorted(group([episode for episode in ENDED if episode["group_id"] is not None], "group_id"))


@answers
def groups():
    rows = []
    for (name,), mine in prompt_groups():
        returns = [episode["discounted_return"] for episode in mine]
        rows.append({
            "group_id": name, "policy": first(e["policy"] for e in mine), "task_id": first(e["task_id"] for e in mine),
            "rollouts": len(mine), "won": len(won(mine)), "tasks": distinct(mine, "task_digest"), "mean": mean(returns),
            "std": float(numpy.std(returns)), "worst": min(returns), "best": max(returns), "signal": len(set(returns)) > 1,
        })
    return rows


@answers
def group_advantages():
    rows = []
    for (name,), mine in prompt_groups():
        returns = numpy.array([episode["discounted_return"] for episode in mine])
        for episode, advantage in zip(mine, (returns - returns.mean()) / (returns.std() + 1e-6)):
            rows.append({
                "group_id": name,
                **of(episode, "rollout_index", "policy", "task_id", "success", "total_reward", "discounted_return"),
                "advantage": float(advantage), **of(episode, "episode_id", "trace"),
            })
    return ordered(rows, "group_id", "rollout_index", "episode_id")


@answers
def latency():
    rows = []
    timed = [{"policy": e["policy"], "episode": e["episode_id"], **s} for e, s in steps() if s["latency_ns"] is not None]
    for (policy,), mine in sorted(group(timed, "policy")):
        seconds = [step["latency_ns"] / 1e9 for step in mine]
        seconds.sort()
        percentiles = {f"p{part}_s": seconds[-(-part * len(seconds) // 100) - 1] for part in (50, 90, 99)}
        rows.append({
            "policy": policy, "decisions": len(mine), "mean_s": mean(seconds), **percentiles, "max_s": max(seconds),
            "episode_s": math.fsum(seconds) / distinct(mine, "episode"),
            **{name: mean(step[name] for step in mine) for name in ["tokens_read", "tokens_written"]},
        })
    return rows


@answers
def longest_episodes():
    rows = []
    for episode in EPISODES:
        mine = episode["steps"]
        known = [step["latency_ns"] for step in mine if step["latency_ns"] is not None]
        if mine:
            rows.append({
                **of(episode, "policy", "family", "task_id", "success", "end_reason"), "decisions": len(mine),
                "failed": sum(step["error_code"] is not None for step in mine), "latency_s": sum(known) / 1e9 if known else None,
                "simulated_s": max(step["sim_step"] for step in mine) / 240, "driven_m": episode["path_length_m"],
                **of(episode, "episode_id", "trace"), "thought": -sum(known) if known else None,
            })
    ordered(rows, "policy", "-decisions", "thought", "family", "task_id", "episode_id")
    return without([row for _, mine in group(rows, "policy") for row in mine[:5]], "thought")


@answers
def effort():
    rows = []
    for (policy, outcome), mine in group(EPISODES, "policy", "success"):
        total = sum(len(episode["steps"]) for episode in mine)
        counts = Counter()
        for episode in mine:
            before = None
            for step in episode["steps"]:
                kinds = {"nav_to": "moving", "ask": "asking", **dict.fromkeys(LOOKING, "looking")}
                counts[{**kinds, **dict.fromkeys(HANDLING, "handling")}.get(step["tool"])] += 1
                counts["failed"] += step["error_code"] is not None
                counts["repeated"] += before == (step["tool"], step["arguments"])
                before = (step["tool"], step["arguments"])
        names = ["moving", "looking", "handling", "asking", "failed", "repeated"]
        shares = {name: counts[name] / total if total else None for name in names}
        rows.append({"policy": policy, "success": outcome, "episodes": len(mine), "decisions": total, **shares})
    return ordered(rows, "policy", "success")


@answers
def tool_transitions():
    counts = Counter()
    for episode in EPISODES:
        tools = ["(start)", *(step["tool"] for step in episode["steps"]), "(end)"]
        counts.update((episode["policy"], *pair) for pair in zip(tools, tools[1:]))
    of_tool = Counter()
    for (policy, tool, _), calls in counts.items():
        of_tool[policy, tool] += calls
    rows = [
        {"policy": policy, "tool": tool, "next": after, "calls": calls, "share": calls / of_tool[policy, tool]}
        for (policy, tool, after), calls in counts.items()
    ]
    return ordered(rows, "policy", "tool", "-calls", "next")


@answers
def episodes_matching():
    rows = []
    for episode in EPISODES:
        picks = letters(episode, ("k", lambda step: ok(step, "pick")), ("f", lambda step: step["tool"] == "pick"))
        found = list(re.finditer("f.*k", picks))
        if found:
            rows.append({
                **of(episode, "policy", "family", "task_id", "success"), "first": found[0].start(), "last": found[0].end() - 1,
                "times": len(found), **of(episode, "episode_id", "trace"),
            })
    return ordered(rows, "policy", "family", "task_id", "episode_id")


@answers
def pattern_success():
    tools = {"f": "show_object_by_category", "g": "gaze_at", "p": "pick"}
    rules = [(letter, lambda step, tool=tool: ok(step, tool)) for letter, tool in tools.items()]
    rows = []
    for (policy, family), mine in sorted(group(ENDED, "policy", "family")):
        matching = [episode for episode in mine if "fgp" in letters(episode, *rules)]
        others = [episode for episode in mine if "fgp" not in letters(episode, *rules)]
        rows.append({
            "policy": policy, "family": family, "episodes": len(mine), "matching": len(matching),
            "success_with": success(matching), "success_without": success(others),
        })
    return rows


# ---------------------------------------------------------------------------------------------------------- comparison


def equal(one, other):
    if isinstance(one, bool) or isinstance(other, bool) or one is None or other is None:
        return one is other
    if isinstance(one, (int, float)) and isinstance(other, (int, float)):
        return math.isclose(one, other, rel_tol=1e-9, abs_tol=1e-12)
    return one == other


def difference(found, expected):
    """What is different first, or nothing."""
    for number, (row, wanted) in enumerate(zip(found, expected)):
        if list(row) != list(wanted):
            return f"row {number}: columns {list(row)}, expected {list(wanted)}"
        for column in wanted:
            if not equal(row[column], wanted[column]):
                return f"row {number}, column {column}: {row[column]!r}, expected {wanted[column]!r}"
    if len(found) != len(expected):
        return f"{len(found)} rows, expected {len(expected)}"
    return None


def main():
    asked = {name.removesuffix(".json") for name in os.listdir(OUT) if name.endswith(".json")}
    wrong = sorted(f"{name}: no independent answer" for name in asked - set(ANSWERS))
    wrong += sorted(f"{name}: no {name}.json" for name in set(ANSWERS) - asked)
    for name in sorted(asked & set(ANSWERS)):
        with open(os.path.join(OUT, f"{name}.json"), encoding="utf-8") as file:
            found = json.load(file)
        problem = difference(found, ANSWERS[name]())
        print(f"{name}: {problem or f'{len(found)} rows agree'}")
        if problem:
            wrong.append(f"{name}: {problem}")
    for line in wrong:
        print(line, file=sys.stderr)
    sys.exit(1 if wrong else 0)


main()
