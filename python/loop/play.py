"""Plays tasks: serves a model while `reel bench` asks it, and tells where the time went."""

import dataclasses
import json
import pathlib
import resource
import subprocess
import time

import server

NAME = "small"  # of the model, in requests and traces


@dataclasses.dataclass(frozen=True)
class Play:
    """What `reel bench` is to play, and how."""

    reel: str
    tasks: pathlib.Path
    out: pathlib.Path
    temperature: float = 0.0
    seed: int = 0
    repeat: int = 1
    max_tokens: int = 200
    jobs: int = 16
    logprobs: bool = False
    further: tuple[str, ...] = ()  # options of `reel bench`


@dataclasses.dataclass(frozen=True)
class Spent:
    """Seconds of a play: by the clock, of CPU in the model's process, and of CPU in Reel (simulator, frames, recording)."""

    wall: float
    model: float
    reel: float


def bench(served: server.Server, play: Play, quiet: bool = False) -> Spent:
    """Plays what is not yet played. The server must have begun. Fails if an episode broke off, which is no failure of the policy; to call again goes on."""
    command = [
        play.reel, "bench", "--tasks", str(play.tasks), "--agent", "real-agent", "--model", NAME, "--endpoint", served.endpoint,
        "--max-tokens", str(play.max_tokens), "--temperature", str(play.temperature), "--seed", str(play.seed), "--repeat", str(play.repeat),
        "--jobs", str(play.jobs), "--out", str(play.out), *play.further,
    ]
    if play.logprobs:
        command += ["--logprobs", "--extra-body", json.dumps({"return_tokens_as_token_ids": True})]
    children = lambda: sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])
    began, model, reel = time.monotonic(), time.process_time(), children()
    status = subprocess.run(command, stdout=subprocess.DEVNULL if quiet else None).returncode
    if status:
        raise SystemExit(f"`{' '.join(command)}` ended with {status}")
    return Spent(time.monotonic() - began, time.process_time() - model, children() - reel)
