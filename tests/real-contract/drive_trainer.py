"""Drives `reel serve` as REAL's trainer does, with the oracle's decisions: the tool contract at every reset, no refused graph,
every episode done; then compares what the trainer was paid with what Reel pays for the same traces.

    drive_trainer.py [--short] [--workers N]
"""

import argparse
import asyncio
import json
import sys
import tempfile
from pathlib import Path

import live
import oracle
import trainer
import vectors
import yaml
from vectors import Report

VARIANTS = ("real-repo", "real-gspo")
"""The profiles of the two published servers: branch main and branch gspo."""

PRESET = "real-trainer"
WORKERS = 4
CLUMSY_TASKS = 2
"""Tasks of each family that are played clumsily first."""

BENCHMARK_FIELDS = ["benchmark_task_id", "family", "global_index"]
"""Fields that only branch main's server tells, after `task_id`."""

PAYLOAD = [
    "episode_idx",
    "episode_local_idx",
    "episode_range",
    "task_description",
    "scene_id",
    "rooms_and_furniture",
    "initial_world_graph",
    "target_world_graph",
    "target_object",
    "source_furniture",
    "destination_furniture",
    "source_distractors",
    "destination_distractors",
    "object_distractors",
    "distractor_metadata",
    "execution_plan",
]


class Player:
    """A policy that plays a plan on an environment."""

    def __init__(self, environment, plan):
        self.environment, self.plan, self.running = environment, plan, None
        self.refused, self.observations = [], []

    def __call__(self, _reset, steps):
        if steps:
            info = steps[-1]["info"]
            self.observations.append(steps[-1]["observation"])
            if info.get("world_graph_rejected"):
                self.refused.append(f"{info['tool_name']}: {info['world_graph_rejected']}")
        try:
            if self.running is None:
                self.running = self.plan(self.environment.payload)
                tool, arguments = next(self.running)
            else:
                tool, arguments = self.running.send(self.environment.markers)
        except StopIteration:
            return ""
        return oracle.answer(tool, arguments)


def payload_problem(payload, variant, task):
    """What is wrong with a payload for the trainer, or `None`. `task` is the episode of the task's YAML file."""
    keys = ["task_id"] + (BENCHMARK_FIELDS if variant == "real-repo" else []) + PAYLOAD
    if list(payload) != keys:
        return f"the keys are {list(payload)}, not {keys}"
    instruction = (
        task["task_description"] if variant == "real-gspo" else task.get("benchmark_instruction", task["task_description"])
    )
    told = {
        "task_description": instruction,
        "distractor_metadata": task.get("obj_distractor_meta") or {},
        "object_distractors": task.get("obj_distractors") or [],
        "source_furniture": task["src"],
        "destination_furniture": task["dest"],
    }
    for key, value in told.items():
        if found := vectors.difference(value, payload[key], key):
            return f"not what the file says: {found}"
    mapping = trainer.asset_categories(payload)
    graph = payload["initial_world_graph"]
    unknown = [name for name in trainer.names_of(graph) if trainer.category_of(mapping, name) == name]
    if unknown:
        return f"no category for {unknown}"
    listed = [name for room in payload["rooms_and_furniture"].values() for name in room]
    if sorted(listed) != sorted(graph):
        return f"rooms list {sorted(set(listed) ^ set(graph))} otherwise than the graph"
    extra = {key for entry in graph.values() for key in entry} - {"content", "door"}
    return f"graph entries hold {sorted(extra)}" if extra else None


async def play(url, task_id, plan, reports, family, variant):
    """One rollout, as the scheduler starts it: a connection of its own, over whatever ran. Returns its record, or `None`."""
    name = task_id.rsplit("/", 1)[-1]
    label = f"{variant} {family}/{name}"
    file = live.real_bench() / "tasks" / family / f"{name}.yaml"
    task = yaml.safe_load(file.read_text(encoding="utf-8"))["episodes"][0]
    async with live.Session(url) as session:
        environment = trainer.Environment(session)
        player = Player(environment, plan)
        try:
            reset, steps, played = await trainer.rollout(environment, task_id, player)
        except oracle.Lost as lost:
            reports["done"].check(label, False, str(lost))
            return None
        if not reports["resets"].check(label, not reset["error"] and not reset["done"], reset.get("observation")):
            return None
        reports["payloads"].check(label, (problem := payload_problem(environment.payload, variant, task)) is None, problem)
        reports["diffs"].check(label, reset["target_diffs"] > 0, "the goal equals the start")
        if steps and steps[-1]["info"].get("world_graph_rejected"):
            player.refused.append(steps[-1]["info"]["world_graph_rejected"])
        reports["graphs"].check(label, not player.refused, f"refused graphs: {player.refused}")
        for name, _, result in session.results:
            if name != "finish_with_id":
                problem = live.form_problem(result)
                reports["forms"].check(f"{label} {name}", problem is None, problem)
        done = bool(played and played["done"] and played["success"])
        said = [step["observation"][:160] for step in steps[-3:]]
        reports["done"].check(label, done, f"{played and played['total_reward']} after {len(steps)} steps; last: {said}")
        return {"task_id": task_id, "rewards": played["step_rewards"], "total": played["total_reward"]} if done else None


async def drive_family(server, family, count, workers, reports, variant):
    """Plays all tasks of a family's server over several URLs at once. Returns the records."""
    urls = [f"{server.url}/sse"] + [f"{server.url}/w/port-{number}/sse" for number in range(1, workers)]
    lists = []
    for url in urls:
        await live.probe(url)
        async with live.Session(url) as session:
            answer = await session.call("list_tasks", {})
            lists.append(tuple(trainer.task_ids(json.loads(answer["content"][0]["text"]))))
    label = f"{variant} {family}"
    ids = lists[0]
    reports["lists"].check(label, len(set(lists)) == 1 and len(set(ids)) == len(ids) == count, f"{count} tasks, lists {lists}")
    _, groups = trainer.allocate([list(lists)], ["task_0"])
    reports["lists"].check(f"{label} pool", groups["group_0"]["ports"] == list(range(workers)), groups)
    waiting = list(enumerate(ids))
    records = []

    async def worker(url):
        while waiting:
            at, task_id = waiting.pop(0)
            plan = oracle.clumsy_then_right if at < CLUMSY_TASKS else oracle.plan
            try:
                record = await play(url, task_id, plan, reports, family, variant)
            except Exception as error:
                reports["done"].check(f"{label} {task_id}", False, f"{type(error).__name__}: {error}")
                continue
            if record:
                records.append(record)

    async with asyncio.TaskGroup() as group:
        for url in urls:
            group.create_task(worker(url))
    return records


def tasks_of(bench, family, short, folder):
    """The folder of a family's tasks; in the short form a folder with the first ones."""
    files = sorted((bench / "tasks" / family).glob("*.yaml"))
    if not short:
        return bench / "tasks" / family, len(files)
    chosen = folder / "tasks"
    chosen.mkdir(parents=True)
    for file in files[: live.SHORT_TASKS]:
        (chosen / file.name).symlink_to(file)
    return chosen, live.SHORT_TASKS


def compare_rewards(traces, folder, records, report, label):
    """Compares what our client was paid with what Reel pays under its preset, step by step."""
    store = folder / "store"
    live.reel("ingest", traces, "--store", store)
    live.reel("store", "reward", "--store", store, "--preset", PRESET)
    sql = (
        "SELECT e.episode_id AS episode, e.task_id AS task, r.step AS step, sum(r.value) AS reward FROM episodes e "
        f"JOIN rewards r ON r.episode_id = e.episode_id AND r.preset = '{PRESET}' GROUP BY 1, 2, 3 ORDER BY 1, 3"
    )
    steps = live.query(store, "SELECT episode_id AS episode, task_id AS task, count(*) AS steps FROM steps GROUP BY 1, 2")
    paid = {}
    for row in live.query(store, sql):
        paid.setdefault(row["episode"], {})[row["step"]] = row["reward"]
    episodes = {row["task"].rsplit("/", 1)[-1]: row for row in steps}
    for record in records:
        row = episodes.get(record["task_id"].rsplit("/", 1)[-1])
        if not report.check(f"{label} {record['task_id']} recorded", row is not None, "no trace of it"):
            continue
        ours = paid.get(row["episode"], {})
        got = [float(ours.get(step, 0.0)) for step in range(row["steps"])]
        report.compare(f"{label} {record['task_id']}", [float(value) for value in record["rewards"]], got)


async def check_ids(server, count, report, label):
    """Checks that a server of all families lists every task under an id of its own, and answers that id with itself."""
    async with live.Session(f"{server.url}/sse") as session:
        answer = await session.call("list_tasks", {})
        ids = trainer.task_ids(json.loads(answer["content"][0]["text"]))
        report.check(f"{label} all families", len(set(ids)) == count, f"{count} tasks, {len(set(ids))} different ids")
        for task_id in ids:
            text = (await session.call("finish_with_id", {"task_id": task_id}))["content"][0]["text"]
            told = json.loads(text).get("task_id") if text.startswith("{") else text[:200]
            report.check(f"{label} {task_id}", told == task_id, f"the answer is of {told}")


def drive(variant, arguments, reports):
    bench = live.require_bench()
    total, paid, tasks = 0, 0.0, 0
    for family in live.FAMILIES:
        with tempfile.TemporaryDirectory(prefix="reel-trainer-") as name:
            folder = Path(name)
            path, count = tasks_of(bench, family, arguments.short, folder)
            tasks += count
            try:
                with serve(folder / "data", path, variant) as server:
                    records = asyncio.run(drive_family(server, family, count, arguments.workers, reports, variant))
            except Exception as error:
                reports["done"].check(f"{variant} {family}", False, f"{type(error).__name__}: {error}")
                continue
            total += len(records)
            paid += sum(record["total"] for record in records)
            try:
                compare_rewards(folder / "data" / "traces", folder, records, reports["rewards"], f"{variant} {family}")
            except RuntimeError as error:
                reports["rewards"].check(f"{variant} {family}", False, str(error))
    reports["done"].check(f"{variant} count", total == tasks, f"{total} of {tasks} tasks were rolled out")
    if not arguments.short:
        with tempfile.TemporaryDirectory(prefix="reel-trainer-") as folder, serve(folder, bench / "tasks", variant) as server:
            asyncio.run(check_ids(server, tasks, reports["ids"], variant))
    print(f"trainer over SSE, {variant}: {total} of {tasks} episodes done, sum of rewards {paid:.2f}")


def serve(data, tasks, variant):
    scene = live.real_bench() / "s7_scene.json"
    return live.Server(data, "--tasks", tasks, "--scene", scene, "--profile", variant, "--preset", "real-repo")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--short", action="store_true", help=f"{live.SHORT_TASKS} tasks of each family")
    parser.add_argument("--workers", type=int, default=WORKERS, help="URLs that are used at once")
    parser.add_argument("--variant", choices=VARIANTS, action="append", help="the profile; both if not given")
    arguments = parser.parse_args()
    for variant in arguments.variant or VARIANTS:
        names = ["lists", "resets", "payloads", "diffs", "forms", "graphs", "done", "rewards"]
        names += [] if arguments.short else ["ids"]
        reports = {name: Report("drive_trainer.py", f"{variant} {name}") for name in names}
        try:
            drive(variant, arguments, reports)
        finally:
            for report in reports.values():
                report.finish()
    return vectors.exit_status()


if __name__ == "__main__":
    sys.exit(main())
