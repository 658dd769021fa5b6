"""What a store holds, and how well policies do."""
import re

from .rows import (
    ENDED, EPISODES, FAMILIES, HANDLING, QUARANTINE, SCENES, all_of, answers, distinct, first, group, letters, lost,
    mean, ok, ordered, questions, share, steps, success, wilson, with_totals, won,
)


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
