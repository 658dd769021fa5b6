"""The work of `reel export sft --annotations recorded` in Python: MCAP traces into a training set with PyPI mcap, protobuf, datasets
and Pillow.

The yardstick that the export is measured against, tuned as its users would tune it: traces are read as `ingest_python.py` reads
them, but only the channels that a row needs are decoded and no hash chain is computed; what the decisions of an episode or of a
task have in common is written once; rows become flat Arrow columns, a file of the dataset at a time. `--build generator` is the
way that the documentation of datasets names for more data than memory holds.

A row is what ours is: the decisions of episodes that succeeded, mistakes left out, as prompt and answer in the form of REAL's
trainer (`export_prompt.py`) with the words that were recorded, and the columns of provenance. `export.py` compares them. With
`--images` the frame of the result before a decision, the first one excepted, is decoded from the trace, scaled to the pixel budget
and encoded as PNG.

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
from PIL import Image as PilImage

from export_checks import NO_SECRETS, Secrets, clean, refused, strip
from export_prompt import Decisions, prompts, tools, values_of
from ingest_python import READERS, TAKERS, Trace, cpu_seconds, files_of
from ingest_rows import arguments_of

# Rows of a file, without images and with them.
ROWS = {False: 5000, True: 500}
PIXELS_MAX = 100_352
# Encoded images that are kept: episodes of a task begin with the same one.
FRAMES_KEPT = 64
# Tasks whose part of the prompt is kept.
TASKS_KEPT = 1024

TEXTS = (
    "example", "episode_id", "task_id", "family", "scene_id", "policy", "tool", "trace_uri", "trace_digest", "verdict",
    "verdict_sim_version", "preset", "preset_digest", "rules_version", "annotator", "tools",
)  # fmt: skip
NUMBERS = ("call", "table_version")
NAMES = (*TEXTS, *NUMBERS, "prompt_digest", "messages", "images")
ROLES = ("user", "assistant")
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
    offsets = pa.array(range(0, len(ROLES) * len(rows) + 1, len(ROLES)), pa.int32())
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
        told = told_of(trace.task, trace.scene, bool(made))
        rows = decisions(trace, told, made)
        if made and rows:
            made.add(trace.start, told, rows)
        yield from rows


def reader_of(name, images, made):
    topics = TAKERS if made else ("/episode", "/tool/call", "/tool/result", "/policy/output", "/chain")
    takers = {topic: TAKERS[topic] for topic in topics}
    if images:
        takers["/camera/head"] = taking_frames

    class Chosen(READERS[name]):
        """Decodes only what rows are made of, where nothing is verified."""

        def read(self, path):
            return super().read(path) if made else self.rows_only(path)

        def rows_only(self, path):
            with open(path, "rb") as file:
                data = file.read()
            trace = Trace(path, len(data), 0, False)
            attachments = self.walk(data, trace)
            trace.task = self.task_of(attachments["task.json"], trace.start.task_digest)
            trace.scene = attachments["scene.json"]
            return trace

        def taker(self, channel, schemas, trace):
            make = takers.get(channel.topic)
            return make and trace.chain.covering(channel.topic, make(self.decoder(schemas[channel.schema_id]), trace))

    return Chosen(check_chain=bool(made))


def taking_frames(decode, trace):
    """By the number of calls before it; decoded only where a row shows it."""
    trace.frames = {}

    def take(data, offset):
        trace.frames[len(trace.calls)] = lambda: decode(data).data

    return take


class Step(NamedTuple):
    """A decision, in words."""

    tool: str
    name: str
    args: str
    reasoning: str
    history: str
    schedule: str
    subtask: str
    outcome: str
    held: str
    mistake: bool


def steps_of(trace):
    for step, (call, result) in enumerate(zip(trace.calls, trace.results)):
        tool = result.tool or call.name
        said = trace.policies.get(step)
        args = arguments_of(call.name, call.arguments_json)[0]
        args = "{}" if args == "null" else args
        told = words(said) if said else ("", "", "", "")
        yield Step(tool, call.name, args, *told, strip(result.text), result.held, is_mistake(tool, result, trace.task))


def decisions(trace, told, made):
    """The rows of an episode."""
    start, task = trace.start, trace.task
    episode = start.episode_id, start.task_id, start.family, start.scene_id, start.policy.name
    source = trace.path, trace.chain.links[-1].hex(), "unverified", "", start.reward_preset, "", "", start.policy.name, ""
    steps = [*steps_of(trace)]
    refused = refusals(steps, told) if made else ()
    frames = getattr(trace, "frames", {})
    turn, rows = Decisions(told.values), []
    for number, step in enumerate(steps):
        if step.tool in tools() and not step.mistake and number not in refused:
            example = f"{start.episode_id}/{number}"
            # REAL's first prompt holds no observation yet, and so no image
            shown = frames.get(number) if number else None
            user = told.text + turn.prompt(bool(shown))
            answer = turn.answer(step)
            images = [(frame(shown()), f"{example}.png")] if shown else []
            rows.append((example, *episode, step.tool, *source, number, 0, prompts().digest, (user, answer), images))
        else:
            turn.answer(step)
            if made:
                reason = "decisions that were mistakes" if step.mistake else "episodes and decisions refused"
                made.left_out["decisions that call no tool" if step.tool not in tools() else reason] += 1
        turn.observe(step, task.objects[step.held]["category"] if step.held in task.objects else None)
    return rows


def refusals(steps, told):
    """The decisions that may not go out, for a text of theirs, a History up to theirs or the call before."""
    everything = range(len(steps))
    if told.refused:
        return everything
    texts = (
        (step.reasoning, step.history, step.schedule, step.subtask, step.name, step.args, step.outcome) for step in steps
    )
    if clean(chain.from_iterable(texts), told.secrets):
        return ()

    def bad(*texts):
        return any(refused(text, told.secrets) for text in texts)

    said = [bad(step.reasoning, step.schedule, step.subtask) for step in steps]
    remembered = [*accumulate((bad(step.history) for step in steps), lambda before, now: before or now)]
    called = [bad(step.name, step.args) for step in steps]
    untold = {at for at, step in enumerate(steps) if called[at] or bad(step.outcome)}
    return {at for at in everything if said[at] or remembered[at] or called[at] or at - 1 in untold}


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
        for row in rows:
            self.by["tools"][row[TOOL]] += 1
            user, answer = row[MESSAGES]
            count = told.tokens + tokens(user[len(told.text) :]) + tokens(answer) + len(ROLES) * TOKENS_PER_TURN
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
            "excluded": self.left_out,
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


def words(said):
    """The reasoning, the History, the schedule and the subtask."""
    schedule, _, subtask = said.plan.partition("Current subtask:")
    schedule, subtask = (part.strip().removeprefix("New Schedule:").strip() for part in (schedule, subtask))
    return said.reasoning, said.history, schedule, subtask


# What many rows share.


class Told(NamedTuple):
    """What the episodes of a task have in common: the beginning of their prompts, and values for the rest."""

    text: str
    values: dict
    tokens: int
    secrets: Secrets
    refused: bool


@functools.lru_cache(TASKS_KEPT)
def told_of(task, scene, checked):
    """What the prompts have in all decisions of a task."""
    instruction, receptacles = task.fields["instruction"], orjson.loads(scene)["receptacles"]
    values = values_of(instruction, receptacles)
    text = prompts().shared.format(**values)
    if not checked:
        return Told(text, values, 0, NO_SECRETS, False)
    secrets = Secrets.of_task(task.fields)
    listed = [f"{it['id']} ({it['category']}, {it['room']})" for it in receptacles]
    bad = not clean([instruction, *listed], secrets) and any(refused(it, secrets) for it in (instruction, *listed))
    return Told(text, values, tokens(text), secrets, bad)


@functools.lru_cache(FRAMES_KEPT)
def frame(file):
    """An image as PNG within the pixel budget."""
    image = PilImage.open(BytesIO(file)).convert("RGB")
    scale = math.sqrt(PIXELS_MAX / (image.width * image.height))
    if scale < 1:
        image = image.resize((int(image.width * scale), int(image.height * scale)), PilImage.Resampling.LANCZOS)
    out = BytesIO()
    image.save(out, "PNG", compress_level=1)
    return out.getvalue()


if __name__ == "__main__":
    main()
