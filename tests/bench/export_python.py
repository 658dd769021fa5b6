"""The work of `reel export sft --words recorded` in Python: MCAP traces into a training set with PyPI mcap, protobuf, datasets
and Pillow.

The yardstick that the export is measured against, tuned as its users would tune it: traces are read as `ingest_python.py` reads
them, but only the channels that a row needs are decoded and no hash chain is computed; what the decisions of an episode or of a
task have in common is written once; rows become flat Arrow columns, a file of the dataset at a time. `--build generator` is the
way that the documentation of datasets names for more data than memory holds.

A row is what ours is: the decisions of episodes that succeeded, mistakes left out, as system, user and assistant with the words
that were recorded, and the columns of provenance. `export.py` compares them. With `--images` the latest picture before a
decision is decoded from the trace, scaled to the pixel budget and encoded as PNG.

It does less than `reel export sft`: it replays nothing, so that its rows say `unverified`; writes no words where none were
recorded; does not hold Histories against the record; of what is privileged it strips `Debug Info` only and refuses nothing;
names neither the digest of the reward preset nor a version of a store; counts no tokens, makes no split, no manifest and no card.

  export_python.py TRACES... --out DIR [--reader library] [--build generator] [--images]

Needs PyPI mcap, protobuf, zstandard, orjson, blake3, pyarrow, datasets and pillow.
"""

import argparse
import functools
import json
import math
import os
import re
import resource
from io import BytesIO
from itertools import accumulate, chain, islice
from pathlib import Path

import datasets
import orjson
import pyarrow as pa
from blake3 import blake3
from datasets import Dataset, Features, Image, List, Value
from PIL import Image as Picture

from ingest_python import READERS, TAKERS, Trace, cpu_seconds, files_of
from ingest_rows import arguments_of

SOURCES = Path(__file__).parents[2] / "src"
# Rows of a file, without pictures and with them.
ROWS = {False: 5000, True: 500}
PIXELS_MAX = 100_352
# Encoded pictures that are kept: episodes of a task begin with the same one.
PICTURES_KEPT = 64
# Tasks whose part of the prompt is kept.
TASKS_KEPT = 1024
OUTCOME_LENGTH_MAX = 120

TEXTS = (
    "example", "episode_id", "task_id", "family", "scene_id", "policy", "tool", "trace_uri", "trace_digest", "verdict",
    "verdict_sim_version", "preset", "preset_digest", "rules_version", "annotator", "tools",
)  # fmt: skip
NUMBERS = ("call", "table_version")
NAMES = (*TEXTS, *NUMBERS, "prompt_digest", "messages", "images")
ROLES = ("system", "user", "assistant")
FEATURES = Features(
    {name: Value("string") for name in TEXTS}
    | {name: Value("int64") for name in NUMBERS}
    | {"prompt_digest": Value("string"), "messages": List({"role": Value("string"), "content": Value("string")})}
    | {"images": List(Image())}
)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("traces", nargs="+", type=Path, help="trace files, or folders of them")
    parser.add_argument("--out", required=True, type=Path, help="folder of the dataset; should be empty")
    parser.add_argument("--reader", choices=READERS, default="fast", help="who goes through the records")
    parser.add_argument("--build", choices=BUILDS, default="columns", help="how rows become a dataset")
    parser.add_argument("--images", action="store_true")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    datasets.disable_progress_bars()
    cpu = cpu_seconds()
    paths = sorted({os.path.abspath(path) for given in options.traces for path in files_of(given)})
    count = BUILDS[options.build](options.out, paths, options.reader, options.images)
    report = {
        "examples": count,
        "cpu_s": round(cpu_seconds() - cpu, 3),
        "peak_rss_bytes": 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
    }
    print(json.dumps(report))


# Rows become a dataset.


def by_columns(out, paths, reader, images):
    rows = examples(paths, reader, images)
    count = 0
    for number in range(len(paths)):
        some = list(islice(rows, ROWS[images]))
        if not some:
            break
        table(some).to_parquet(out / f"train-{number:05}.parquet")
        count += len(some)
    return count


def table(rows):
    columns = dict(zip(NAMES, zip(*rows)))
    messages, images = columns.pop("messages"), columns.pop("images")
    turns = [pa.array(ROLES * len(rows)), pa.array(list(chain.from_iterable(messages)))]
    offsets = pa.array(range(0, 3 * len(rows) + 1, 3), pa.int32())
    columns["messages"] = pa.ListArray.from_arrays(offsets, pa.StructArray.from_arrays(turns, ("role", "content")))
    shown = list(chain.from_iterable(images))
    files = [pa.array([file for file, _ in shown], pa.binary()), pa.array([path for _, path in shown], pa.string())]
    offsets = pa.array(list(accumulate(map(len, images), initial=0)), pa.int32())
    columns["images"] = pa.ListArray.from_arrays(offsets, pa.StructArray.from_arrays(files, ("bytes", "path")))
    return Dataset(pa.table(columns).cast(FEATURES.arrow_schema))


def by_generator(out, paths, reader, images):
    given = {"paths": paths, "reader": reader, "images": images}
    dataset = Dataset.from_generator(dicts, features=FEATURES, gen_kwargs=given, cache_dir=str(out / "cache"), fingerprint="rows")
    dataset.to_parquet(out / "train.parquet")
    return len(dataset)


def dicts(paths, reader, images):
    for row in examples(paths, reader, images):
        columns = dict(zip(NAMES, row))
        columns["messages"] = [{"role": role, "content": text} for role, text in zip(ROLES, columns["messages"])]
        columns["images"] = [{"bytes": file, "path": path} for file, path in columns["images"]]
        yield columns


BUILDS = {"columns": by_columns, "generator": by_generator}


# Traces become rows.


def examples(paths, reader, images):
    reader = reader_of(reader, images)
    for path in paths:
        with open(path, "rb") as file:
            data = file.read()
        trace = Trace(path, len(data), 0)
        trace.pictures = {}
        attachments = reader.walk(data, trace)
        if trace.end and trace.end.metrics.success:
            task = reader.task_of(attachments["task.json"], trace.start.task_digest)
            yield from decisions(trace, task, attachments["scene.json"])


def reader_of(name, images):
    topics = ["/episode", "/tool/call", "/tool/result", "/policy/output"]
    takers = {topic: TAKERS[topic] for topic in topics}
    if images:
        takers["/camera/head"] = taking_pictures

    class Chosen(READERS[name]):
        """Decodes only what rows are made of."""

        def taker(self, channel, schemas, trace):
            make = takers.get(channel.topic)
            return make and make(self.decoder(schemas[channel.schema_id]), trace)

    return Chosen(check_chain=False)


def taking_pictures(decode, trace):
    """By the number of calls before it; decoded only where a row shows it."""

    def take(data, offset):
        trace.pictures[len(trace.calls)] = lambda: decode(data).data

    return take


def decisions(trace, task, scene):
    """The rows of an episode."""
    start, (system, prompt_digest) = trace.start, prompts()
    text = setting(task, scene, start.profile)
    episode = start.episode_id, start.task_id, start.family, start.scene_id, start.policy.name
    source = trace.path, trace.end.chain.hex(), "unverified", "", start.reward_preset, "", "", start.policy.name, ""
    situation = f"\nProgress:\n{NOTHING}\nLast action: none\nLast outcome: The episode begins.\n"
    log, view = "", None
    for step, (call, result) in enumerate(zip(trace.calls, trace.results)):
        tool = result.tool or call.name
        said = trace.policies.get(step)
        reasoning, state = words(said) if said else ("", NO_STATE)
        args = arguments_of(call.name, call.arguments_json)[0]
        action = f'{{"tool_name":{quoted(call.name)},"args":{"{}" if args == "null" else args}}}'
        view = trace.pictures.get(step, view)
        if tool in tools() and not is_mistake(tool, result, task):
            example = f"{start.episode_id}/{step}"
            seen = "\nCurrent view: <image>" if view else ""
            thought = f"<think>{reasoning}</think>\n" if reasoning else ""
            answer = f'{thought}{orjson.dumps(state)[:-1].decode()},"next_action":{action}}}'
            images = [(picture(view()), f"{example}.png")] if view else []
            messages = system, f"{text}{situation}{seen}", answer
            yield (example, *episode, tool, *source, step, 0, prompt_digest, messages, images)
        outcome = public(result.text)
        told = state["History"] or state.get("New Schedule")
        progress = "".join(f"{title}: {part}\n" for title, part in state.items() if part) if told else log or NOTHING
        situation = f"\nProgress:\n{progress}\nLast action: {action}\nLast outcome: {outcome}\n"
        log += f"{step + 1}. {action}: {' '.join(outcome.split())[:OUTCOME_LENGTH_MAX]}\n"


def is_mistake(tool, result, task):
    """A call that failed, a pick of what the goal leaves where it is, a place where the goal does not want it."""
    if result.error:
        return True
    moved = result.object in task.goal_objects
    if tool == "pick":
        return bool(result.object) and not moved
    return tool == "place" and moved and bool(result.receptacle) and (result.object, result.receptacle) not in task.goal_places


NOTHING = "Nothing done yet.\n"
NO_STATE = {"History": "", "Current subtask": ""}


def words(said):
    """The reasoning, and the state as it stands in the answer."""
    schedule, _, subtask = said.plan.partition("Current subtask:")
    schedule, subtask = (part.strip().removeprefix("New Schedule:").strip() for part in (schedule, subtask))
    plan = {"New Schedule": schedule} if schedule else {}
    return said.reasoning, {"History": said.history, **plan, "Current subtask": subtask}


DEBUG_INFO = re.compile(r"\bdebug[ _-]?info", re.IGNORECASE)


def public(text):
    """Without what the published server tells for debugging: the last part of an outcome."""
    found = DEBUG_INFO.search(text)
    return text[: found.start()].strip() if found else text


@functools.lru_cache(4096)
def quoted(text):
    return orjson.dumps(text).decode()


# What many rows share; the wording is read from where it stands.


@functools.cache
def prompts():
    """The system message, and the digest of the wording."""
    texts = [(SOURCES / f"prompt/texts/agent-{style}.txt").read_text() for style in ("single-turn", "multi-turn")]
    return texts[0].rstrip(), blake3("".join(texts).encode()).hexdigest()


@functools.cache
def tools():
    """The tools' names in the published code, arguments and descriptions by their names in the paper."""
    code = (SOURCES / "world/src/tool.rs").read_text()
    argument = re.compile(r'const (\w+): Option<Argument> = Some\(Argument \{ name: "(\w+)", json_type: "(\w+)" \}\)')
    arguments = {constant: (name, kind) for constant, name, kind in argument.findall(code)}
    specs = re.findall(r'\bspec\("(\w+)", "(\w+)", (\w+), "(.+?)"\)', code)
    return {paper: (repo, arguments.get(constant), description) for paper, repo, constant, description in specs}


@functools.cache
def tool_list(profile):
    functions = []
    for paper, (repo, argument, description) in tools().items():
        properties = {argument[0]: {"type": argument[1]}} if argument else {}
        parameters = {"type": "object", "properties": properties, "required": list(properties)}
        name = repo if profile == "real-repo" else paper
        functions.append({"name": name, "description": description, "parameters": parameters})
    return orjson.dumps(functions).decode()


@functools.lru_cache(TASKS_KEPT)
def setting(task, scene, profile):
    """What the user's turn has in all decisions of a task."""
    receptacles = "".join(f"- {it['id']} ({it['category']}, {it['room']})\n" for it in orjson.loads(scene)["receptacles"])
    return f"Task: {task.fields['instruction']}\n\nTools:\n{tool_list(profile)}\n\nReceptacles:\n{receptacles}"


@functools.lru_cache(PICTURES_KEPT)
def picture(file):
    """A picture as PNG within the pixel budget."""
    image = Picture.open(BytesIO(file)).convert("RGB")
    scale = math.sqrt(PIXELS_MAX / (image.width * image.height))
    if scale < 1:
        image = image.resize((int(image.width * scale), int(image.height * scale)), Picture.Resampling.LANCZOS)
    out = BytesIO()
    image.save(out, "PNG", compress_level=1)
    return out.getvalue()


if __name__ == "__main__":
    main()
