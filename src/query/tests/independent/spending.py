"""Rewards, changes of the graphs, prompt groups, and what decisions and time are spent on."""
import math
import re
from collections import Counter

import numpy

from .rows import (
    ENDED, EPISODES, HANDLING, LOOKING, all_of, answers, distinct, first, group, letters, mean, of, ok, ordered,
    steps, success, table, without, won,
)


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
            **dict(zip(["tool", "worked", "event", "floor"], key)),
            **{name: authorities[name] for name in ["physics", "registry"]},
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
