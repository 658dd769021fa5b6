"""Rollouts of a training step as Reel keeps them: tasks drawn, traces exported as rows, log-probabilities written back."""

import collections.abc
import dataclasses
import json
import os
import pathlib
import random
import shutil
import subprocess
import tempfile
import typing

import data
from model import Config
from tokenizer import Tokenizer

PREFIX = "token_id:"


class Wanted(typing.Protocol):
    """What an export is told of a training."""

    size: int
    advantage: str
    returns: str
    preset: str


@dataclasses.dataclass(frozen=True)
class Decision:
    """One decision of a rollout: what was read and drawn, and what it was worth."""

    episode: str
    call: int
    group: str
    row: data.Row
    tokens: list[str]  # as the trace names them
    old: list[float]  # log-probabilities of the policy that drew them
    advantage: float  # of the episode
    returned: float  # of the episode
    success: bool


def run(command: list[str]) -> str:
    """What a command prints. Fails with what it complained of."""
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"`{' '.join(command)}` ended with {done.returncode}:\n{done.stderr}")
    return done.stdout


def all_tasks(folder: pathlib.Path) -> list[pathlib.Path]:
    """The task files below a folder of homes."""
    found = sorted(folder.glob("*/tasks/**/*.yaml"))
    if not found:
        raise SystemExit(f"{folder} holds no tasks; make some with homes.sh")
    return found


def tasks_of_step(tasks: list[pathlib.Path], step: int, count: int, seed: int) -> list[pathlib.Path]:
    """The tasks of a step, from 1: all tasks in random order, then all in another one."""
    rng, queue = random.Random(f"{seed}/tasks"), list[pathlib.Path]()
    while len(queue) < step * count:
        queue += rng.sample(tasks, len(tasks))
    return queue[(step - 1) * count : step * count]


def gather(tasks: list[pathlib.Path], folder: pathlib.Path) -> pathlib.Path:
    """A folder with these tasks, each in a folder of its own beside the scene of its home."""
    for index, task in enumerate(tasks):
        home = next(parent for parent in task.parents if (parent / "scene.json").exists())
        place = folder / f"{index}"
        place.mkdir(parents=True, exist_ok=True)
        for file, name in ((task, task.name), (home / "scene.json", f"{home.name}.json")):
            if not (place / name).exists():
                (place / name).symlink_to(os.path.relpath(file, place))
    return folder


def export(reel: str, here: pathlib.Path, wanted: Wanted) -> str:
    """Rows of a step's traces in `rows`, from a new store. Every episode is replayed; one that is not exact stops it."""
    for name in ("store", "rows"):
        shutil.rmtree(here / name, ignore_errors=True)
    run([reel, "ingest", str(here / "traces"), "--store", str(here / "store")])
    command = [
        reel, "export", "rl", "--store", str(here / "store"), "--format", "ms-swift", "--style", "single-turn", "--group-size", str(wanted.size),
        "--advantage", wanted.advantage, "--returns", wanted.returns, "--image-format", "png", "--max-pixels", "0", "--out", str(here / "rows"),
    ]
    return run([*command, *(["--preset", wanted.preset] if wanted.preset else [])]).strip().splitlines()[-1]


def rows(folder: pathlib.Path) -> collections.abc.Iterator[dict[str, typing.Any]]:
    """The rows of `reel export rl` that hold tokens."""
    for path in sorted((folder / "train").glob("*.jsonl")):
        with path.open(encoding="utf-8") as lines:
            for line in lines:
                if (row := json.loads(line)).get("tokens"):
                    yield row


def token_ids(tokens: list[str]) -> list[int]:
    """The ids that a trace names. Fails if it names texts instead."""
    if not all(token.startswith(PREFIX) for token in tokens):
        raise SystemExit("the trace names tokens by their text; record with --extra-body '{\"return_tokens_as_token_ids\": true}'")
    return [int(token.removeprefix(PREFIX)) for token in tokens]


def read(folder: pathlib.Path, tokenizer: Tokenizer, config: Config) -> list[Decision]:
    """The decisions of an exported folder, by episode and call."""
    found = []
    for one in rows(folder):
        shown, about = one.get("images") or [], one["provenance"]
        prompt = next(message["content"] for message in one["messages"] if message["role"] == "user")
        row = data.Row(data.prompt_tokens(tokenizer, config, prompt), token_ids(one["tokens"]), folder / shown[0] if shown else None)
        known = one["logprobs"]["old"]
        found.append(Decision(
            about["episode"], about["call"], one["group"], row, one["tokens"], known, one["advantage"], one["return"], one["success"]
        ))
    if not found:
        raise SystemExit(f"{folder} holds no rows with tokens")
    return sorted(found, key=lambda one: (one.episode, one.call))


def add_logprobs(reel: str, here: pathlib.Path, decisions: list[Decision], scores: dict[str, list[list[float]]]) -> None:
    """Writes what other policies give to the drawn tokens into the traces, and reads the traces anew."""
    with tempfile.NamedTemporaryFile("w", suffix=".jsonl", encoding="utf-8") as file:
        for policy, scored in scores.items():
            for one, values in zip(decisions, scored):
                file.write(json.dumps({"episode_id": one.episode, "step": one.call, "policy": policy, "tokens": one.tokens, "logprobs": values}) + "\n")
        file.flush()
        run([reel, "trace", "logprobs", "add", str(here / "traces"), "--from", file.name])
    run([reel, "ingest", str(here / "traces"), "--store", str(here / "store")])


def gspo(reel: str, store: pathlib.Path, objective: dict[str, typing.Any]) -> dict[str, typing.Any]:
    """What `reel dataset gspo` reports of a store; the objective is that of `training.json`."""
    command = [reel, "dataset", "gspo", "--store", str(store), "--json"]
    for name, value in objective.items():
        if value is not None:
            command += ["--" + {"reference": "ref"}.get(name, name).replace("_", "-"), str(value)]
    return json.loads(run(command))["report"]


def figures(report: dict[str, typing.Any]) -> dict[str, float]:
    """The figures of a report that an update logs."""
    return {"loss": report["loss"], "ratio": report["ratio"][1], "low": report["clipped"]["low"], "high": report["clipped"]["high"], "kl": report["kl"]}
