"""Runs the evaluation agents' loop over `reel serve --profile real-repo` with the oracle's decisions: every task ends in success
on the client's side, and what the agent wrote is what `reel import real-eval` reads.

    drive_agent.py [--short]
"""

import argparse
import asyncio
import json
import sys
import tempfile
from pathlib import Path

import agent
import answers
import live
import oracle
import vectors
from vectors import Report

MODEL = "org/Oracle-1.v2"
PRESETS = ("real-repo", "real-trainer")


class Policy:
    """The oracle behind the agent's answer parser and memory."""

    def __init__(self):
        self.memory, self.empty_memories, self.steps = None, 0, 0

    def start(self, task):
        self.memory, self.markers = answers.AgentMemory(), None
        self.running, self.plan = None, oracle.plan(task, close_doors=True)

    def decide(self):
        try:
            if self.running is None:
                self.running = self.plan
                call = next(self.running)
            else:
                call = self.running.send(self.markers)
        except StopIteration:
            call = "finish", {}
        text = oracle.answer(*call)
        decision = self.memory.decide(text)
        self.steps += 1
        self.empty_memories += not self.memory.task_progress
        return decision["tool_name"], decision["arguments"], text

    def observe(self, kind, data, debug, images):
        self.memory.observe(kind, data, len(images))
        self.markers = debug.get("CURRENT_MARKER_MAP")


async def evaluate(server, output, reports):
    """The run of the agent. Returns its results and the sessions' calls an episode."""
    async with live.Session(f"{server.url}/sse") as session:
        settings = agent.Settings(
            model=MODEL, max_steps=30, prefix="qwen_agent", output=str(output), metadata={"lora_enabled": False}
        )
        policy = Policy()
        results = await agent.evaluate(session, settings, policy)
    reports["memory"].check("all steps", policy.steps > 0 and policy.empty_memories == 0, f"{policy.empty_memories} are empty")
    for at, (name, _, result) in enumerate(session.results):
        if name != "finish":
            problem = live.form_problem(result)
            reports["forms"].check(f"call {at} {name}", problem is None, problem)
    return results


def episodes_of(store):
    """Calls, success and totals of each episode of a store, by family and task."""
    found = {}
    sql = "SELECT e.episode_id AS episode, e.family AS family, e.task_id AS task, e.success AS success FROM episodes e"
    rows = {row["episode"]: row for row in live.query(store, sql)}
    calls = {}
    for row in live.query(
        store, "SELECT episode_id AS episode, call_name AS name, arguments FROM steps ORDER BY episode_id, step"
    ):
        calls.setdefault(row["episode"], []).append([row["name"], json.loads(row["arguments"])])
    paid = {}
    for preset in PRESETS:
        sql = f"SELECT episode_id AS episode, sum(value) AS total FROM rewards WHERE preset = '{preset}' GROUP BY 1"
        for row in live.query(store, sql):
            paid.setdefault(row["episode"], {})[preset] = row["total"]
    for episode, row in rows.items():
        key = f"{row['family']}/{row['task'].rsplit('/', 1)[-1]}"
        found[key] = {"calls": calls.get(episode, []), "success": row["success"], "rewards": paid.get(episode, {})}
    return found


def written(folder):
    """Calls and success of each episode that the agent wrote, by family and task."""
    found = {}
    for path in Path(folder).rglob("episode_summary.json"):
        summary = json.loads(path.read_text())
        calls = [json.loads((step / "tool_call.json").read_text()) for step in sorted(path.parent.glob("step_*"))]
        key = summary["benchmark_task_id"] or f"{summary['family']}/{summary['task_id']}"
        found[key] = {"calls": [[call["tool_name"], call["args"]] for call in calls], "success": summary["success"]}
    return found


def store_of(traces, folder, report):
    live.reel("ingest", traces, "--store", folder)
    for preset in PRESETS:
        try:
            live.reel("store", "reward", "--store", folder, "--preset", preset)
        except RuntimeError as error:
            report.check(f"{folder.name} under {preset}", False, str(error))
    return episodes_of(folder)


def compare_import(folder, bench, reports):
    """Compares what was written, what is imported of it, and what the server recorded."""
    live.reel("import", "real-eval", folder / "eval_output", "--out", folder / "imported", "--tasks", bench / "tasks")
    wrote = written(folder / "eval_output")
    imported = store_of(folder / "imported", folder / "imported-store", reports["import rewards"])
    recorded = store_of(folder / "data" / "traces", folder / "recorded-store", reports["import rewards"])
    for key, episode in sorted(wrote.items()):
        got = imported.get(key)
        if not reports["import"].check(f"{key} imported", got is not None, "not among the imported traces"):
            continue
        reports["import"].compare(key, episode, {name: got[name] for name in episode})
        served = recorded.get(key)
        if reports["import rewards"].check(f"{key} recorded", served is not None, "not among the server's traces"):
            reports["import rewards"].compare(key, served["rewards"], got["rewards"])


def tasks_of(bench, short, folder):
    """The folder of the tasks, and how many they are; in the short form the first ones of each family."""
    families = {family: sorted((bench / "tasks" / family).glob("*.yaml")) for family in live.FAMILIES}
    if not short:
        return bench / "tasks", sum(map(len, families.values()))
    for family, files in families.items():
        (folder / "tasks" / family).mkdir(parents=True)
        for file in files[: live.SHORT_TASKS]:
            (folder / "tasks" / family / file.name).symlink_to(file)
    return folder / "tasks", live.SHORT_TASKS * len(families)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--short", action="store_true", help=f"{live.SHORT_TASKS} tasks of each family")
    arguments = parser.parse_args()
    bench = live.require_bench()
    names = ("success", "memory", "forms", "import", "import rewards")
    reports = {name: Report("drive_agent.py", name) for name in names}
    with tempfile.TemporaryDirectory(prefix="reel-agent-") as name:
        folder = Path(name)
        tasks, count = tasks_of(bench, arguments.short, folder)
        options = ("--tasks", tasks, "--scene", bench / "s7_scene.json", "--profile", "real-repo", "--preset", "real-repo")
        try:
            with live.Server(folder / "data", *options) as server:
                results = asyncio.run(evaluate(server, folder / "eval_output", reports))
            for episode in results["episodes"]:
                label = episode["benchmark_task_id"] or episode["task_id"]
                reports["success"].check(label, episode.get("success") is True, f"ends as {episode}")
            reports["success"].check("count", results["total"] == count, f"{results['total']} of {count} tasks were handed out")
            print(f"agent over SSE: {results['successes']} of {count} succeed on the client")
            compare_import(folder, bench, reports)
        except Exception as error:
            reports["import"].check("run", False, f"{type(error).__name__}: {error}")
        for report in reports.values():
            report.finish()
    return vectors.exit_status()


if __name__ == "__main__":
    sys.exit(main())
