"""Compares the clients of this folder with the vectors of REAL's published code, one line a file and part."""

import json
import math
import sys

import answers
import reward as rewards
import vectors
from vectors import Report


def plain(value):
    """A value as the vectors write it: NaN and infinities are texts."""
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [plain(item) for item in value]
    return value


def parsed(parse, text):
    try:
        return plain(parse(text))
    except answers.Unreadable as error:
        return {"error": str(error)}


def gym(text):
    memory = answers.GymMemory("⟦unchanged⟧", "⟦unchanged⟧")
    raises = {}
    try:
        memory.read(text)
    except Exception as error:
        raises = {"raises": type(error).__name__}
    return {"task_progress": plain(memory.task_progress), "last_action": plain(memory.last_action), **raises}


def scheduler(text):
    if not text.strip():
        return {"ended": "empty_completion"}
    try:
        if answers.parse_trainer(text)["tool_name"] == "finish":
            return {"ended": True}
    except answers.Unreadable:
        pass
    memory = answers.SchedulerMemory()
    memory.read(text)
    return {"task_progress": memory.task_progress, "last_action": plain(memory.last_action)}


def check_answers():
    document = vectors.load("answers.json")
    for column, read in (
        ("agent", lambda text: parsed(answers.parse_agent, text)),
        ("trainer", lambda text: parsed(answers.parse_trainer, text)),
        ("gym", gym),
        ("scheduler", scheduler),
    ):
        report = Report("answers.json", f"{column} (python)")
        for case in document["cases"]:
            report.compare(case["id"], case[column], read(case["text"]))
        report.finish()


def check_memory():
    cases = vectors.load("memory.json")["cases"]
    report = Report("memory.json", "scheduler (python)")
    for case in cases:
        memory, ends = answers.SchedulerMemory(), []
        for answer in case["answers"]:
            memory.read(answer)
            count_ask(memory, answer)
            ends.append({"task_progress": memory.task_progress, "last_action": memory.last_action, "ask_count": memory.ask_count})
        published = [{key: slot[key] for key in ("task_progress", "last_action", "ask_count")} for slot in case["scheduler"]]
        report.compare(case["id"], published, ends)
    report.finish()

    report = Report("memory.json", "gym (python)")
    for case in cases:
        memory, ends = answers.GymMemory(), []
        for answer in case["answers"]:
            memory.read(answer)
            count_ask(memory, answer)
            ends.append({"task_progress": memory.task_progress, "last_action": memory.last_action, "ask_count": memory.ask_count})
        report.compare(case["id"], case["gym"], ends)
    report.finish()

    report = Report("memory.json", "agent (python)")
    for case in cases:
        memory, ends = answers.AgentMemory(), []
        for answer in case["answers"]:
            try:
                memory.decide(answer)
            except answers.Unreadable:
                ends.append({"ends": "inference_error"})
                break
            memory.observe("text", "seen", 0)
            ends.append({"task_progress": memory.task_progress, "last_action": memory.last_action, "observation": memory.observation})
        report.compare(case["id"], case["agent"], ends)
    report.finish()


def count_ask(memory, answer):
    """Every ask that a server answered counts; the vectors' server answers each."""
    try:
        memory.ask_count += answers.parse_trainer(answer)["tool_name"] == "ask"
    except answers.Unreadable:
        pass


REWARD_PARTS = ("matched_diffs", "wrong_diffs", "neutral_diffs", "perfect_match", "progress_reward")
CREDIT_PARTS = ("partial_reward", "replan_reward", "anti_exploit_reward")


def reward_row(scorer, step):
    row = {}
    if "track" in step and isinstance(scorer, rewards.AntiExploitReward):
        row["track"] = scorer.track(*step["track"], step.get("markers"))
    reward, info = scorer.compute(step["graph"], step.get("inv"), step.get("markers"))
    row |= {"reward": reward, "completion": info["completion_rate"], "done": not scorer.remaining}
    row["remaining"] = [list(diff) for diff in sorted(scorer.remaining)]
    row |= {key: info[key] for key in REWARD_PARTS + CREDIT_PARTS if info.get(key)}
    if "tool" in step and isinstance(scorer, rewards.PartialCreditReward):
        tool, arguments, _, state = step["tool"]
        row["tool_reward"], row["tool_info"] = scorer.tool(tool, arguments, state)
    return row


def check_reward():
    document = vectors.load("reward.json")
    weights = document["README"]["weights"]
    names = {"plain": ("reward_weights",), "partial": ("reward_weights", "partial_credit_weights"), "anti": tuple(weights)}
    classes = {"plain": rewards.DiffReward, "partial": rewards.PartialCreditReward, "anti": rewards.AntiExploitReward}
    report = Report("reward.json", "cases (python)")
    for case in document["cases"]:
        for variant, expected in case["expect"].items():
            name, chosen = variant.split("/")
            scorer = classes[name](**({key: weights[key] for key in names[name]} if chosen == "weights" else {}))
            scorer.reset(case["initial"], case["goal"])
            if not report.compare(f"{case['id']} targets", case["targets"], [list(diff) for diff in scorer.targets]):
                continue
            for at, (step, row) in enumerate(zip(case["steps"], expected)):
                report.compare(f"{case['id']} {variant} step {at}", row, reward_row(scorer, step))
    report.finish()

    report = Report("reward.json", "metric (python)")
    for case in document["metric"]:
        metric = rewards.Metric(**case["config"])
        ended = []
        for episode in case["episodes"]:
            metric.start(episode["targets"])
            for reward, info in episode["steps"]:
                metric.step(reward, info)
            ended.append(metric.end(**episode["end"]))
        expected = case["expect"]
        got = {"metrics": metric.metrics(), "recent": metric.recent(), "recent_2": metric.recent(2)}
        keys = list(expected["episodes"][0]) if expected.get("episodes") else []
        got["episodes"] = [{key: episode[key] for key in keys} for episode in ended]
        report.compare(case["id"], expected, {key: got[key] for key in expected})
    report.finish()


CHECKS = {"reward": check_reward, "answers": check_answers, "memory": check_memory}


def main(names):
    for name in names or CHECKS:
        CHECKS[name]()
    return vectors.exit_status()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
