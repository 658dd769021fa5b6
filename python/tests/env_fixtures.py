"""Tasks and traces that the tests of the environments share."""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path

import reel


@functools.cache
def folder() -> Path:
    """A folder for the session."""
    made = tempfile.TemporaryDirectory(prefix="reel-envs-")
    _kept.append(made)
    return Path(made.name)


@functools.cache
def tasks() -> Path:
    """Four generated tasks."""
    reel.Tasks.generate(4, folder() / "tasks", seed=1)
    return folder() / "tasks"


@functools.cache
def traces() -> list[Path]:
    """An episode of the oracle for each task, without images."""
    reel.run(tasks(), "oracle", out=folder() / "traces", images=False, progress=False)
    return reel.trace_paths(folder() / "traces")


def calls(trace: Path) -> list[tuple[str, dict[str, object]]]:
    """The calls of a trace."""
    return [(step.tool, step.arguments) for step in reel.open(trace).steps]


_kept: list[tempfile.TemporaryDirectory[str]] = []
