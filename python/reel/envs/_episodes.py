"""Opening episodes: from the start of a task, and from any call of a recorded episode."""

from __future__ import annotations

import os
import re
import threading
import time
import uuid
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from .. import _reel
from .._arguments import place_in_group, whole
from .._episode import Episode, Fork, open
from .._play import Tasks
from .._reel import ReelError
from .._types import PathLike
from .._simulation import Simulation

Group = tuple[str, int]
"""Prompt group of a rollout and its index there, as `reel export rl` finds them in traces."""

V = TypeVar("V")


class Cache(Generic[V]):
    """The values used last, each made once, from any number of threads."""

    def __init__(self, size: int) -> None:
        self.size = size
        self._lock = threading.Lock()
        self._values: OrderedDict[Hashable, V] = OrderedDict()

    def get(self, key: Hashable, make: Callable[[], V]) -> V:
        """The value of a key; `make` makes it where it is not there."""
        with self._lock:
            if key in self._values:
                self._values.move_to_end(key)
                return self._values[key]
            value = self._values[key] = make()
            while len(self._values) > self.size:
                self._values.popitem(last=False)
            return value

    def clear(self) -> None:
        """Forgets all values."""
        with self._lock:
            self._values.clear()


_traces: Cache[Episode] = Cache(32)
_forks: Cache[Fork] = Cache(256)
_frames: Cache[NDArray[np.uint8] | None] = Cache(64)
_tasks: Cache[Tasks] = Cache(32)
_counts: dict[tuple[str, str], int] = {}
_counts_lock = threading.Lock()


def _version(path: Path) -> tuple[str, int, int]:
    """What a file is known by: a file written again under its name is another one."""
    try:
        found = path.stat()
    except OSError as error:
        raise ReelError(f"cannot read the trace {path}: {error.strerror}; give the path of a .mcap file") from error
    return str(path.resolve()), found.st_mtime_ns, found.st_size


def trace_at(trace: PathLike | Episode) -> Episode:
    """The episode of a trace; the 32 read last are kept."""
    if isinstance(trace, Episode):
        return trace
    path = Path(trace)
    return _traces.get(_version(path), lambda: open(path))


def fork_at(trace: PathLike | Episode, call: int) -> Fork:
    """The state of a recorded episode before a call (from 0; negative ones count from the end).

    The 256 used last are kept, so that siblings open in milliseconds.

    Raises:
        ReelError: the trace cannot be read, has no such call, or does not replay up to there.
    """
    episode = trace_at(trace)
    at = call + len(episode) if call < 0 else call
    # `Episode.digest` covers all inputs and outputs
    return _forks.get((episode.digest, at), lambda: episode.at(at))


def frame_at(fork: Fork) -> NDArray[np.uint8] | None:
    """The image that the agent had before a call (480 x 640 x 3, uint8, RGB); None if the call before
    gave none. The 64 used last are kept; it is the caller's copy."""
    episode, call = fork.episode, fork.call
    frame = _frames.get((episode.digest, call), lambda: episode.frame(call - 1 if call else None))
    return None if frame is None else frame.copy()


def clear_cache() -> None:
    """Forgets the traces, moments and tasks that are kept for the next `reset`."""
    for cache in (_traces, _forks, _frames, _tasks):
        cache.clear()


def load_tasks(tasks: PathLike | Tasks | None, scene: PathLike | None = None) -> Tasks | None:
    """Tasks of a path, read once in a process; None if there are none."""
    if tasks is None or isinstance(tasks, Tasks):
        return tasks
    path = Path(tasks)
    if not path.exists():
        raise ReelError(f"no tasks at {path}: give a task file or a folder of them (reel task generate makes some)")
    key = (*_version(path), None if scene is None else str(scene))
    return _tasks.get(key, lambda: Tasks.load(path, scene=scene))


def unique_run(prefix: str) -> str:
    """A name for the episodes of this process, told from those of others."""
    return f"{prefix}-{time.strftime('%Y%m%d-%H%M%S')}-{os.getpid()}"


def next_index(run: str, group: str) -> int:
    """The next index in a prompt group of a run: 0, 1, ... in the order of the calls."""
    with _counts_lock:
        index = _counts.get((run, group), 0)
        _counts[run, group] = index + 1
        return index


@dataclass
class Opened:
    """A running episode and where it is recorded."""

    simulation: Simulation
    task_id: str
    seed: int
    path: Path | None
    """The trace; None if the episode is not recorded."""
    group: Group | None
    frame: NDArray[np.uint8] | None = None
    """The image before the first call here, where the simulation does not hold it: a fork's."""


SETTINGS = ("tasks", "scene", "profile", "preset", "skills", "policy", "images", "record_dir", "run")
"""Arguments of `EpisodeSource` that environments with a configuration read from it."""


class EpisodeSource:
    """Opens episodes of tasks and of moments of recorded episodes, all under the same settings.

    Args:
        tasks: tasks to start from: a task file, a folder, or `Tasks`; None where episodes only start
            from traces.
        scene: the scene for all tasks; None: the one that each task names.
        profile: `paper`, `real-repo` or `real-gspo`: which server the agent meets.
        preset: reward preset of the steps.
        skills: `perfect`, or `real-v1`: picks, places and doors fail as on the paper's robot.
        policy: name of who decides, for the traces.
        images: whether images are rendered, and recorded where the episode is.
        draw: whether images are rendered although nobody records them, for `render`.
        record_dir: folder for the traces; None: nothing is recorded.
        run: name that the traces give the run; None: a new one for this process.

    Episodes from a trace have its seed, profile, preset and skills.
    """

    def __init__(
        self,
        tasks: PathLike | Tasks | None = None,
        *,
        scene: PathLike | None = None,
        profile: str = "paper",
        preset: str = "paper",
        skills: str = "perfect",
        policy: str = "python",
        images: bool = True,
        draw: bool = False,
        record_dir: PathLike | None = None,
        run: str | None = None,
    ) -> None:
        self.tasks = load_tasks(tasks, scene)
        self.task_ids: list[str] = self.tasks.ids if self.tasks is not None else []
        """Ids of the tasks; empty without tasks."""
        self.profile = profile
        self.preset = preset
        self.skills = skills
        self.policy = policy
        self.images = images
        self.draw = draw
        self.record_dir = None if record_dir is None else Path(record_dir)
        self.run = run or unique_run(policy)

    def start(self, task: int | str, seed: int, *, group: Group | None = None, record: PathLike | None = None) -> Opened:
        """Opens an episode at the start of a task (its index or id)."""
        tasks = self.tasks
        if tasks is None:
            raise ReelError("no tasks to start from: give tasks=PATH, or options={'trace': ..., 'call': n}")
        index = self.index_of(task)
        task_id = self.task_ids[index]
        path = self._path(record, f"{task_id}--{self.policy}--{seed}", group)
        native = tasks._native
        started = _reel.Simulation.start(
            native, index, whole("seed", seed), self.profile, self.preset, self.skills, self.policy, self.run,
            place_in_group(group), self.images or self.draw, self._recording(path),
        )  # fmt: skip
        return Opened(Simulation(started, path), task_id, seed, path, group)

    def fork(
        self, trace: PathLike | Episode, call: int, *, group: Group | None = None, record: PathLike | None = None
    ) -> Opened:
        """Opens an episode that went as the recorded one up to a call."""
        fork = fork_at(trace, call)
        header = fork.episode.header
        path = self._path(record, f"{header['task_id']}--{self.policy}--at-{fork.call}", group)
        point = fork._point
        opened = point.open(
            policy=self.policy, run_id=self.run, group=place_in_group(group), images=self.images or self.draw,
            record=self._recording(path),
        )  # fmt: skip
        frame = frame_at(fork) if self.images else None
        return Opened(Simulation(opened, path), header["task_id"], int(header["seed"]), path, group, frame)

    def group_of_task(self, task: int | str, seed: int) -> str:
        """Name of the prompt group of the episodes of a task and seed."""
        return f"{self.run}--{self.task_ids[self.index_of(task)]}--{seed}"

    def group_of_fork(self, trace: PathLike | Episode, call: int) -> str:
        """Name of the prompt group of the episodes that start at a call of a trace."""
        fork = fork_at(trace, call)
        return f"{self.run}--{fork.episode.id}--at-{fork.call}"

    def sibling(self, group: str) -> Group:
        """The next place in a prompt group."""
        return group, next_index(self.run, group)

    def index_of(self, task: int | str) -> int:
        """The index of a task, by its id or index."""
        if isinstance(task, str):
            return self.tasks.index(task) if self.tasks is not None else 0
        if not -len(self.task_ids) <= task < len(self.task_ids):
            raise ReelError(f"no task {task}: there are {len(self.task_ids)}, from 0; give an index or an id")
        return int(task) % len(self.task_ids)

    def _path(self, record: PathLike | None, stem: str, group: Group | None) -> Path | None:
        if record is not None:
            path = Path(record)
        elif self.record_dir is not None:
            name = stem if group is None else f"{stem}--{group[1]}"
            # unique: siblings of several processes write into one folder
            path = self.record_dir / f"{re.sub(r'[^A-Za-z0-9._-]+', '_', name)}--{uuid.uuid4().hex[:8]}.mcap"
        else:
            return None
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def _recording(self, path: Path | None) -> _reel.Recording | None:
        return None if path is None else {"path": path, "images": self.images, "fsync": False}


__all__ = ["SETTINGS", "EpisodeSource", "Group", "Opened", "clear_cache", "fork_at", "load_tasks", "trace_at", "unique_run"]
