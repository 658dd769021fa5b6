"""Why episodes and calls fail."""
from collections import Counter

from .rows import (
    EPISODES, TASKS, all_of, answers, distinct, first, group, lost, of, ok, ordered, steps, swings, with_totals,
    without, won,
)


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
