"""The work of `reel export sft --words recorded` in Python: MCAP traces into a training set with PyPI mcap, protobuf, datasets
and Pillow.

The yardstick that the export is measured against, tuned as its users would tune it: traces are read as `ingest_python.py` reads
them, but only the channels that a row needs are decoded and no hash chain is computed; what the decisions of an episode or of a
task have in common is written once; rows become flat Arrow columns, a file of the dataset at a time. `--build generator` is the
way that the documentation of datasets names for more data than memory holds.

A row is what ours is: the decisions of episodes that succeeded, mistakes left out, as system, user and assistant with the words
that were recorded, and the columns of provenance. `export.py` compares them. With `--images` the latest picture before a
decision is decoded from the trace, scaled to the pixel budget and encoded as PNG.

It does what `reel export sft` does beside: whole traces are decoded and their hash chains verified, as rows say where they come
from; every text is looked at for what an agent must not know (`export_checks.py`) and decisions with such a text are left out;
tokens are counted; a manifest tells the digest of each file and how many examples there are of what. `--unchecked` leaves all
that out and decodes only what rows are made of.

It does less nevertheless: it replays nothing, so that its rows say `unverified`; writes no words where none were recorded; does
not hold Histories against the record; names neither the digest of the reward preset nor a version of a store; makes one part
and no card.

  export_python.py TRACES... --out DIR [--reader library] [--build generator] [--images] [--unchecked]

Needs PyPI mcap, protobuf, zstandard, orjson, blake3, google-re2, pyarrow, datasets and pillow.
"""

import argparse
import functools
import gc
import itertools
import json
import math
import os
import re
import resource
from collections import Counter
from io import BytesIO
from itertools import accumulate, chain, islice
from pathlib import Path
from typing import NamedTuple

import datasets
import orjson
import pyarrow as pa
from blake3 import blake3
from datasets import Dataset, Features, Image, List, Value
from PIL import Image as Picture

from export_checks import NO_SECRETS, Secrets, clean, refused, strip
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
TOOL, MESSAGES = NAMES.index("tool"), NAMES.index("messages")
# As `src/dataset/src/tokens.rs` has it.
CONTEXT_TOKENS, TOKENS_PER_TURN, BAR_TOKENS = 8192, 5, 1024
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
    parser.add_argument("--unchecked", action="store_true", help="verify nothing, refuse nothing, count nothing")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    datasets.disable_progress_bars()
    gc.disable()  # little here is cyclic
    cpu = cpu_seconds()
    paths = sorted({os.path.abspath(path) for given in options.traces for path in files_of(given)})
    made = None if options.unchecked else Counts()
    rows = functools.partial(examples, paths, options.reader, options.images, made)
    count = BUILDS[options.build](options.out, rows, options.images)
    if made:
        made.write(options.out)
    report = {
        "examples": count,
        "cpu_s": round(cpu_seconds() - cpu, 3),
        "peak_rss_bytes": 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
    }
    print(json.dumps(report))


# Rows become a dataset.


def by_columns(out, examples, images):
    rows = examples()
    count = 0
    for number in itertools.count():
        some = list(islice(rows, ROWS[images]))
        if not some:
            return count
        table(some).to_parquet(out / f"train-{number:05}.parquet")
        count += len(some)


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


def by_generator(out, examples, images):
    given = {"examples": examples}
    dataset = Dataset.from_generator(dicts, features=FEATURES, gen_kwargs=given, cache_dir=str(out / "cache"), fingerprint="rows")
    dataset.to_parquet(out / "train.parquet")
    return len(dataset)


def dicts(examples):
    for row in examples():
        columns = dict(zip(NAMES, row))
        columns["messages"] = [{"role": role, "content": text} for role, text in zip(ROLES, columns["messages"])]
        columns["images"] = [{"bytes": file, "path": path} for file, path in columns["images"]]
        yield columns


BUILDS = {"columns": by_columns, "generator": by_generator}


# Traces become rows.


def examples(paths, reader, images, made):
    """The rows of traces; with `made` everything is checked and counted."""
    reader = reader_of(reader, images, made)
    for path in paths:
        trace = reader.read(path)
        if not (trace.end and trace.end.metrics.success):
            if made:
                made.left_out["episodes that did not succeed"] += 1
            continue
        told = told_of(trace.task, trace.scene, trace.start.profile, bool(made))
        rows = decisions(trace, told, made)
        if made and rows:
            made.add(trace.start, told, rows)
        yield from rows


def reader_of(name, images, made):
    topics = TAKERS if made else ("/episode", "/tool/call", "/tool/result", "/policy/output")
    takers = {topic: TAKERS[topic] for topic in topics}
    if images:
        takers["/camera/head"] = taking_pictures

    class Chosen(READERS[name]):
        """Decodes only what rows are made of, where nothing is verified."""

        def read(self, path):
            return super().read(path) if made else self.rows_only(path)

        def rows_only(self, path):
            with open(path, "rb") as file:
                data = file.read()
            trace = Trace(path, len(data), 0)
            attachments = self.walk(data, trace)
            trace.task = self.task_of(attachments["task.json"], trace.start.task_digest)
            trace.scene = attachments["scene.json"]
            return trace

        def taker(self, channel, schemas, trace):
            make = takers.get(channel.topic)
            return make and make(self.decoder(schemas[channel.schema_id]), trace)

    return Chosen(check_chain=bool(made))


def taking_pictures(decode, trace):
    """By the number of calls before it; decoded only where a row shows it."""
    trace.pictures = {}

    def take(data, offset):
        trace.pictures[len(trace.calls)] = lambda: decode(data).data

    return take


class Step(NamedTuple):
    """A decision, in words."""

    tool: str
    name: str
    args: str
    reasoning: str
    state: dict
    outcome: str
    mistake: bool


def steps_of(trace):
    for step, (call, result) in enumerate(zip(trace.calls, trace.results)):
        tool = result.tool or call.name
        said = trace.policies.get(step)
        reasoning, state = words(said) if said else ("", NO_STATE)
        args = arguments_of(call.name, call.arguments_json)[0]
        args = "{}" if args == "null" else args
        yield Step(tool, call.name, args, reasoning, state, strip(result.text), is_mistake(tool, result, trace.task))


def decisions(trace, told, made):
    """The rows of an episode."""
    start, (system, prompt_digest) = trace.start, prompts()
    episode = start.episode_id, start.task_id, start.family, start.scene_id, start.policy.name
    source = trace.path, trace.end.chain.hex(), "unverified", "", start.reward_preset, "", "", start.policy.name, ""
    steps = [*steps_of(trace)]
    refused = refusals(steps, told) if made else ()
    pictures = getattr(trace, "pictures", {})
    situation = f"\nProgress:\n{NOTHING}\nLast action: none\nLast outcome: The episode begins.\n"
    log, view, rows = "", None, []
    for number, step in enumerate(steps):
        action = f'{{"tool_name":{quoted(step.name)},"args":{step.args}}}'
        view = pictures.get(number, view)
        if step.tool in tools() and not step.mistake and number not in refused:
            example = f"{start.episode_id}/{number}"
            seen = "\nCurrent view: <image>" if view else ""
            thought = f"<think>{step.reasoning}</think>\n" if step.reasoning else ""
            answer = f'{thought}{orjson.dumps(step.state)[:-1].decode()},"next_action":{action}}}'
            images = [(picture(view()), f"{example}.png")] if view else []
            messages = system, f"{told.text}{situation}{seen}", answer
            rows.append((example, *episode, step.tool, *source, number, 0, prompt_digest, messages, images))
        elif made:
            reason = "decisions that were mistakes" if step.mistake else "episodes and decisions refused"
            made.left_out["decisions that call no tool" if step.tool not in tools() else reason] += 1
        noted = step.state["History"] or step.state.get("New Schedule")
        progress = "".join(f"{title}: {part}\n" for title, part in step.state.items() if part) if noted else log or NOTHING
        situation = f"\nProgress:\n{progress}\nLast action: {action}\nLast outcome: {step.outcome}\n"
        log += f"{number + 1}. {action}: {' '.join(step.outcome.split())[:OUTCOME_LENGTH_MAX]}\n"
    return rows


def refusals(steps, told):
    """The decisions that may not go out, for a text of theirs or of the one before."""
    everything = range(len(steps))
    if told.refused:
        return everything
    texts = ((step.reasoning, *step.state.values(), step.name, step.args, step.outcome) for step in steps)
    if clean(chain.from_iterable(texts), told.secrets):
        return ()

    def bad(*texts):
        return any(refused(text, told.secrets) for text in texts)

    said = [bad(step.reasoning) for step in steps]
    noted = [bad(*step.state.values(), step.name, step.args) for step in steps]
    answered = [bad(step.outcome) for step in steps]
    return {at for at in everything if said[at] or noted[at] or at and (noted[at - 1] or answered[at - 1])}


class Counts:
    """What the manifest tells."""

    def __init__(self):
        self.by = {kind: Counter() for kind in ("families", "tools", "policies")}
        self.left_out, self.histogram = Counter(), Counter()
        self.examples = self.tokens = self.longest = self.over = 0

    def add(self, start, told, rows):
        self.examples += len(rows)
        self.by["families"][start.family] += len(rows)
        self.by["policies"][start.policy.name] += len(rows)
        shared = tokens(prompts()[0]) + told.tokens
        for row in rows:
            self.by["tools"][row[TOOL]] += 1
            _, user, answer = row[MESSAGES]
            situation = user[len(told.text) :].removesuffix("<image>")
            count = shared + tokens(situation) + tokens(answer) + len(ROLES) * TOKENS_PER_TURN
            self.tokens += count
            self.longest = max(self.longest, count)
            self.over += count > CONTEXT_TOKENS
            self.histogram[-(-count // BAR_TOKENS) * BAR_TOKENS] += 1

    def write(self, out):
        def entry(path):
            data = path.read_bytes()
            return {"path": path.name, "bytes": len(data), "blake3": blake3(data).hexdigest()}

        lengths = {"examples": self.examples, "text": self.tokens, "longest": self.longest, "over": self.over}
        manifest = {
            "counts": {"examples": self.examples, **self.by},
            "tokens": {**lengths, "histogram": self.histogram},
            "left_out": self.left_out,
            "files": [entry(path) for path in sorted(out.glob("*.parquet"))],
        }
        (out / "manifest.json").write_text(json.dumps(manifest, indent=2))


def tokens(text):
    """By the rule of thumb: four bytes each."""
    return -(-(len(text) if text.isascii() else len(text.encode())) // 4)


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


class Told(NamedTuple):
    """What the episodes of a task have in common."""

    text: str
    tokens: int
    secrets: Secrets
    refused: bool


@functools.lru_cache(TASKS_KEPT)
def told_of(task, scene, profile, checked):
    """What the user's turn has in all decisions of a task."""
    instruction, receptacles = task.fields["instruction"], orjson.loads(scene)["receptacles"]
    listed = [f"{it['id']} ({it['category']}, {it['room']})" for it in receptacles]
    lines = "".join(f"- {it}\n" for it in listed)
    text = f"Task: {instruction}\n\nTools:\n{tool_list(profile)}\n\nReceptacles:\n{lines}"
    if not checked:
        return Told(text, 0, NO_SECRETS, False)
    secrets = Secrets.of_task(task.fields)
    bad = not clean([instruction, *listed], secrets) and any(refused(it, secrets) for it in (instruction, *listed))
    return Told(text, tokens(text), secrets, bad)


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
