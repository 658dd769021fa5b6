"""Compares the clients of this folder with the vectors of REAL's published code, one line a file and part."""

import asyncio
import contextlib
import dataclasses
import json
import math
import re
import sys
import tempfile
from pathlib import Path

import agent
import answers
import reward as rewards
import trainer
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
            ends.append(
                {"task_progress": memory.task_progress, "last_action": memory.last_action, "observation": memory.observation}
            )
        report.compare(case["id"], case["agent"], ends)
    report.finish()


def count_ask(memory, answer):
    """Every ask that a server answered counts; the vectors' server answers each."""
    with contextlib.suppress(answers.Unreadable):
        memory.ask_count += answers.parse_trainer(answer)["tool_name"] == "ask"


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


def check_contract():
    document = vectors.load("trainer_contract.json")
    tools = {case["id"]: case["tools"] for case in document["tool_lists"]}

    def part(name, case_id, expected, got):
        report = Report("trainer_contract.json", f"{name} (python)")
        for at, case in enumerate(document[name]):
            report.compare(f"{at} {case_id(case)}", expected(case), got(case))
        report.finish()

    def named(case):
        name, arguments = trainer.server_call(tools[case["list"]], case["name"], case["arguments"])
        canonical = trainer.answers.canonical(case["name"].strip())
        return {"server_name": name, "server_arguments": arguments, "canonical": canonical}

    def error_text(case):
        penalty, kind, pattern = trainer.tool_error(case["text"])
        return {"penalty": penalty, **({"error_type": kind, "error_pattern": pattern} if kind else {})}

    def hand(case):
        violation = trainer.hand_violation(case["tool"], case["occupied"])
        return {"penalty": trainer.HAND if violation else 0.0, "violation": violation}

    def refused(case):
        reason = trainer.refusal(case["old"], case["new"], case["tool"])
        return {"accepted": not reason, "reason": reason}

    def ambiguity(case):
        visible = trainer.is_ambiguous(case["tool"], case["markers"], case["target_object"])
        return {"distractor_visible": visible, "asked_since": not visible}

    def not_found(case):
        return trainer.is_task_not_found(case["observation"], case["instruction"])

    def keys(*names):
        return lambda case: {name: case[name] for name in names if name in case}

    part("tool_lists", lambda case: case["id"], lambda case: case["errors"], lambda case: trainer.contract_errors(case["tools"]))
    part("names", lambda case: f"{case['list']} {case['name']}", keys("server_name", "server_arguments", "canonical"), named)
    part("task_lists", lambda case: case["raw"], lambda case: case["ids"], lambda case: trainer.task_ids(case["raw"]))
    part("mapping", str, lambda case: case["mapping"], lambda case: trainer.asset_categories(case["payload"]))
    part("convert", str, lambda case: case["converted"], lambda case: trainer.category_graph(case["mapping"], case["graph"]))
    part("validate", str, keys("accepted", "reason"), refused)
    part("error_text", lambda case: case["text"], keys("penalty", "error_type", "error_pattern"), error_text)
    part("hand", str, keys("penalty", "violation"), hand)
    part("ambiguity", str, keys("distractor_visible", "asked_since"), ambiguity)
    part("ask_marker", str, lambda case: case["marker"], lambda case: trainer.answered_marker(case["answer"], case["markers"]))
    part("not_found", str, lambda case: case["task_not_found"], not_found)
    part("allocation", lambda case: case["id"], lambda case: case["expect"], allocated)


def allocated(case):
    try:
        ids, groups = trainer.allocate(case["pools"], case["messages"], case["dead"])
    except trainer.NoServer:
        return {"error": True}
    described, tasks = {}, {}
    for name, group in groups.items():
        described[name] = {"pool": group["pool"], "ports": group["ports"], "tasks": group["tasks"]}
        described[name]["task_in_list"] = group["task"] in group["tasks"]
        tasks.setdefault(group["pool"], set()).add(group["task"])
    free = {str(group["pool"]): len(group["ports"]) for group in groups.values()}
    same = all(len(chosen) == 1 for chosen in tasks.values())
    return {"prompt_ids": ids, "groups": described, "free_ports": free, "same_task_when_reused": same}


class Replay:
    """A session that answers as the published server did in an episode of the vectors."""

    def __init__(self, tools, episode):
        self.listed, self.payload, self.steps = tools, episode["payload"], episode["steps"]
        self.calls, self.current = [], None

    async def tools(self):
        return self.listed

    async def reconnect(self):
        pass

    async def call(self, name, arguments):
        if name == "finish_with_id":
            items = self.payload if isinstance(self.payload, list) else [{"type": "text", "text": json.dumps(self.payload)}]
            return {"content": items}
        result = self.current["result"]
        if result is None:
            raise TimeoutError
        self.calls.append({"name": name, "arguments": arguments})
        if "raise" in result:
            raise ConnectionError(result["raise"])
        times = len(self.current["calls"])
        failed_before = len(self.calls) < times < trainer.ATTEMPTS
        return {"content": [whole(item) for item in result["content"]], "isError": failed_before or result.get("isError", False)}


def whole(item):
    """An item of the vectors with the text that its shorthand stands for."""
    if "debug" in item:
        return {"type": "text", "text": f"Debug Info:\n{json.dumps(item['debug'])}"}
    if "json" in item:
        return {"type": "text", "text": json.dumps(item["json"])}
    return item


def episode_state(environment):
    graph = {}
    for receptacle, entry in environment.graph.items():
        if isinstance(entry, dict) and (entry.get("content") or entry.get("door")):
            opened = {"content": entry["content"], "door": True}
            graph[receptacle] = opened if entry.get("door") else entry["content"]
    return {
        "inv": environment.inventory,
        "hand_occupied": environment.hand_occupied,
        "remaining": [list(diff) for diff in sorted(environment.scorer.remaining)],
        "graph": graph,
        "distractor_visible": environment.distractor_visible,
        "asked_since": environment.asked_since,
        "last_ask_marker": environment.last_ask_marker,
    }


async def no_sleep(_seconds):
    pass


async def check_episode(episode, tools, reports):
    session = Replay(tools["legacy" if "legacy-server" in episode["id"] else "main"], episode)
    environment = trainer.Environment(session, episode["config"], sleep=no_sleep)
    given = iter(episode["steps"])

    def policy(_reset, steps):
        if steps:
            check_step(steps[-1])
        session.current, session.calls = next(given, None), []
        return session.current["text"] if session.current else ""

    def check_step(step):
        expected = session.current["expect"]
        got = {**step, "images": len(step["images"]), "state": episode_state(environment)}
        at = f"{episode['id']} step {environment.steps - 1}"
        reports["steps"].compare(at, expected, got)
        reports["calls"].compare(at, session.current["calls"], session.calls)

    asked = episode["task"].split("/")[1]
    reset, steps, played = await trainer.rollout(environment, asked, policy, episode["max_turns"])
    if session.current:
        check_step(steps[-1])
    reports["resets"].compare(episode["id"], episode["reset"], {key: reset.get(key) for key in episode["reset"]})
    end = {"rollout": played, "outcome": played and trainer.outcome_of(played), "metric": None}
    if environment.last_episode:
        end["metric"] = {key: environment.last_episode[key] for key in METRIC_KEYS}
    broke = {"trajectory_error": True} if episode.get("trajectory_error") else {}
    expected = {key: episode.get(key) for key in end}
    reports["rollouts"].compare(episode["id"], expected | broke, end | ({"trajectory_error": True} if played is None else {}))


METRIC_KEYS = (
    "total_steps",
    "total_reward",
    "target_diff_count",
    "completed_diff_count",
    "completion_rate",
    "is_success",
    "is_timeout",
)


def check_episodes():
    tools = {case["id"]: case["tools"] for case in vectors.load("trainer_contract.json")["tool_lists"]}
    reports = {name: Report("trainer_episodes.json", f"{name} (python)") for name in ("resets", "steps", "calls", "rollouts")}
    for episode in vectors.load("trainer_episodes.json")["episodes"]:
        asyncio.run(check_episode(episode, tools, reports))
    for report in reports.values():
        report.finish()


class Script:
    """A policy that decides as an evaluation run of the vectors says."""

    def __init__(self, decisions):
        self.decisions, self.observed = decisions, []

    def start(self, _task):
        self.observed.append([])
        self.left = iter(self.decisions[len(self.observed) - 1])

    def decide(self):
        decision = next(self.left)
        if decision == "raise":
            raise RuntimeError("the policy raises")
        tool, arguments, *raw = decision
        return tool, arguments, raw[0] if raw else "raw text"

    def observe(self, kind, data, _debug, images):
        self.observed[-1].append([kind, data, len(images)])


class Server:
    """A session that answers as an evaluation run of the vectors says."""

    IMAGE = "iVBORw0KGgoAAAANSUhEUgAAAAIAAAACCAIAAAD91JpzAAAAC0lEQVR4nGNgQAYAAA4AAamRc7EAAAAASUVORK5CYII="

    def __init__(self, run):
        self.finish, self.results, self.calls = iter(run["finish"]), iter(run["results"]), []
        self.listed = [] if run["id"] == "no-finish-tool" else [{"name": "finish"}]

    async def tools(self):
        return self.listed

    async def call(self, name, arguments):
        self.calls.append([name, arguments])
        items = next(self.finish if name == "finish" else self.results)
        if isinstance(items, str):
            raise ConnectionError(items)
        return {"content": [self.whole(item) for item in items]}

    @classmethod
    def whole(cls, item):
        """An item of the vectors with what its shorthand stands for."""
        if item.get("type") == "image":
            return {"data": cls.IMAGE, **item}
        if "debug" in item:
            debug = item["debug"] if isinstance(item["debug"], str) else json.dumps(item["debug"])
            return {"type": "text", "text": f"Debug Info:\n{debug}"}
        return item if "type" in item else {"type": "text", "text": json.dumps(item)}


TOKENS = ("inference_time", "total_inference_time", "run_tag")


def written(folder):
    """The files below a folder as the vectors give them."""
    files = {}
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        name = path.relative_to(folder).as_posix()
        if path.suffix == ".png":
            files[name] = "⟦png⟧"
        elif path.name.endswith("_error.txt"):
            files[name] = "⟦traceback⟧" if path.read_text().startswith("Traceback") else path.read_text()
        elif path.suffix == ".json":
            content = json.loads(path.read_text())
            tag = content.get("run_tag", "")
            files[name.replace(tag, "⟦time⟧") if re.fullmatch(r"\d{8}_\d{6}_\d{6}", tag) else name] = tokens(content)
        else:
            files[name] = path.read_text()
    return files


def tokens(value):
    if isinstance(value, dict):
        return {key: f"⟦{key}⟧" if key in TOKENS else tokens(item) for key, item in value.items()}
    return [tokens(item) for item in value] if isinstance(value, list) else value


def evaluation(run):
    with tempfile.TemporaryDirectory() as folder:
        config = {"max_steps": 5, **run["config"]}
        names = {"start_idx": "start", "end_idx": "end"}
        config = {names.get(key, key): value for key, value in config.items()}
        settings = agent.Settings(model="org/My-Model.v1", prefix="agent", output=folder, **config)
        if run["existing"]:
            (Path(folder) / run["existing"]).mkdir(parents=True)
            (Path(folder) / run["existing"] / "x").write_text("x")
        server, policy, raises = Server(run), Script(run["decisions"]), None
        try:
            asyncio.run(agent.evaluate(server, settings, policy))
        except agent.RunFailed:
            raises = "RuntimeError"
        return {"calls": server.calls, "raises": raises, "observed": policy.observed, "files": written(Path(folder))}


def agent_settings(case):
    read = {"vlm": agent.vlm_settings, "qwen": agent.qwen_settings}[case["agent"]]
    try:
        settings = dataclasses.asdict(read(case["env"]))
    except ValueError:
        return {"error": True}
    if case["agent"] == "qwen":
        del settings["base_url"], settings["api_key"]
        settings |= {"max_new_tokens": settings.pop("max_tokens"), "lora": settings["metadata"]["lora_enabled"]}
    return settings


def parsed_result(case):
    kind, data, debug, images = agent.parse_result([Server.whole(item) for item in case["content"]])
    data = "⟦image 0⟧" if data == Server.IMAGE else data
    return {"result_type": kind, "data": data, "debug": debug, "images": len(images)}


def check_agent():
    document = vectors.load("eval_client.json")

    def part(name, expected, got):
        report = Report("eval_client.json", f"{name} (python)")
        for at, case in enumerate(document[name]):
            report.compare(case.get("id", at), expected(case), got(case))
        report.finish()

    def keys(*names):
        return lambda case: {name: case[name] for name in names}

    part("runs", keys("calls", "raises", "observed", "files"), evaluation)
    part("evaluate", lambda case: case["success"], lambda case: agent.succeeds(case["actual"], case["target"]))
    part("parse", keys("result_type", "data", "debug", "images"), parsed_result)
    part("graph", lambda case: case["graph"], lambda case: agent.graph_of(case["debug"]))
    part("path", lambda case: case["path"], lambda case: agent.safe_path(case["value"]))
    part("slug", lambda case: case["slug"], lambda case: agent.slug(case["model"]))
    part("settings", lambda case: case["settings"], agent_settings)


CHECKS = {
    "agent": check_agent,
    "contract": check_contract,
    "episodes": check_episodes,
    "reward": check_reward,
    "answers": check_answers,
    "memory": check_memory,
}


def main(names):
    for name in names or CHECKS:
        CHECKS[name]()
    return vectors.exit_status()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
