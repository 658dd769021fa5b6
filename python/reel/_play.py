"""Tasks, and playing them with policies."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast, overload

from . import _reel
from ._arguments import place_in_group, threads, whole
from ._command import command
from ._episode import Episode, open
from ._progress import bar
from ._reel import Observation, ReelError
from ._simulation import Action, Simulation, as_call, recording
from ._types import PathLike, Record

Policy = Callable[[Observation], Action] | type
"""Who decides: a function of an `Observation` that returns a call, or a class of such objects, of
which each episode gets its own. A dictionary may also hold what a model said: `raw`, `reasoning`,
`history`, `plan`, `tokens`, `latency_ns`."""

SEPARATORS = r"[/\\]"
OUTPUT_KEYS = ("raw", "reasoning", "history", "plan", "tokens", "latency_ns", "logprobs")


def as_function(policy: Policy) -> Callable[[Observation], tuple[str, Mapping[str, Any], Record | None]]:
    """A policy for one episode, as the native part calls it."""
    act: Callable[[Observation], Action] = policy() if isinstance(policy, type) else policy

    def decide(observation: Observation) -> tuple[str, Mapping[str, Any], Record | None]:
        action = act(observation)
        said: Record | None = None
        if isinstance(action, Mapping):
            said = {key: action[key] for key in OUTPUT_KEYS if action.get(key) is not None} or None
        elif isinstance(action, str):
            said = {"raw": action}
        return *as_call(action), said

    return decide


class Tasks(Sequence[Record]):
    """Tasks of files, each with the scene it plays in.

    Pickle keeps the tasks and scenes themselves, not the paths of their files; meshes are read again
    from their folder, and other ones than before are refused.
    """

    def __init__(self, native: _reel.TaskSet) -> None:
        self._native = native

    @classmethod
    def load(
        cls,
        path: PathLike,
        *,
        scene: PathLike | None = None,
        scene_dirs: Iterable[PathLike] = (),
        assets: PathLike | None = None,
    ) -> Tasks:
        """Reads task files (YAML in the form of REAL-Bench).

        Args:
            path: a file, or a folder of them.
            scene: the scene for all of them: a file, or the name of one that comes with Reel (`S1` to
                `S7`, `home`). None: the one that each task names.
            scene_dirs: folders to find scenes in by their ids.
            assets: folder of meshes (glTF, OBJ, USD) for the objects.
        """
        return cls(_reel.TaskSet.load(path, scene, list(scene_dirs), assets))

    @classmethod
    def generate(cls, count: int, out: PathLike, *, seed: int = 0, **options: Any) -> Tasks:
        """Makes so many tasks that can be done, writes their files into a folder, and loads them.

        Options are those of `reel task generate`, e.g. `scene=["S1", "S2"]`.
        """
        command("task", "generate", count=whole("count", count, 1), out=out, seed=whole("seed", seed), **options)
        return cls.load(out)

    @property
    def ids(self) -> list[str]:
        """Ids of the tasks, in the order of their files."""
        return self._native.ids()

    @property
    def warnings(self) -> list[str]:
        """What is odd about files that were read, and why files were not: file, line, field."""
        return [*self._native.warnings, *self._native.broken]

    def index(self, value: Any, start: int = 0, stop: int | None = None) -> int:
        """The index of a task, by its id or by the part of it after the family."""
        return self._native.find(value) if isinstance(value, str) else super().index(value, start, stop or len(self))

    def scene(self, index: int) -> Record:
        """The scene of a task: rooms, furniture, receptacles, in metres."""
        return self._native.scene(self._at(index))

    def start(
        self,
        task: int | str,
        *,
        seed: int = 0,
        profile: str = "paper",
        preset: str = "paper",
        skills: str = "perfect",
        policy: str = "python",
        images: bool = True,
        record: PathLike | None = None,
        group: tuple[str, int] | None = None,
    ) -> Simulation:
        """Starts an episode of a task.

        Args:
            task: its index or id.
            seed: seed of everything random in the simulator.
            profile: `paper`, `real-repo` or `real-gspo`: which server the agent meets.
            preset: reward preset of the steps.
            skills: `perfect`, or `real-v1`: picks, places and doors fail as on the paper's robot.
            policy: name of who decides, for the trace.
            images: whether images are rendered (and recorded). Without them it takes a third of the
                time; everything else is the same.
            record: the trace to write; None: it is not recorded.
            group: prompt group and index in it, for the trace.

        Raises:
            ArgumentError: `seed` or the index in the group is out of range.
            ReelError: there is no such task, profile, preset or skills, or the trace cannot be written.
        """
        index = self._at(self.index(task) if isinstance(task, str) else task)
        to = None if record is None else recording(record, images)
        started = _reel.Simulation.start(
            self._native, index, whole("seed", seed), profile, preset, skills, policy, None, place_in_group(group), images, to
        )
        return Simulation(started, record)

    def _at(self, index: int) -> int:
        """An index that a task has."""
        if not -len(self) <= index < len(self):
            raise ReelError(f"no task {index}: there are {len(self)}, from 0")
        return index

    def __len__(self) -> int:
        return len(self._native)

    @overload
    def __getitem__(self, index: int) -> Record: ...
    @overload
    def __getitem__(self, index: slice) -> Tasks: ...
    def __getitem__(self, index: int | slice) -> Record | Tasks:
        if isinstance(index, slice):
            return Tasks(self._native.select(range(*index.indices(len(self)))))
        if not -len(self) <= index < len(self):
            raise IndexError(f"no task {index}: there are {len(self)}, from 0")
        return self._native.task(index)

    def __repr__(self) -> str:
        return f"<{len(self)} tasks>"


def run(
    tasks: PathLike | Tasks,
    policy: str | Policy = "oracle",
    *,
    out: PathLike | None = "traces-out",
    name: str | None = None,
    seed: int = 0,
    profile: str = "paper",
    preset: str = "paper",
    skills: str = "perfect",
    images: bool = True,
    replace: bool = True,
    jobs: int | None = None,
    progress: bool | None = None,
) -> Episodes:
    """Plays tasks with a policy and records every episode.

    Args:
        tasks: a task file, a folder, or `Tasks`.
        policy: a built-in policy by name (`oracle`, `planner`, ...; see `reel run --help`), or a
            function that gets an `Observation`, which holds what an agent sees, and returns a call.
        out: folder for the traces; None: nothing is recorded.
        name: name of the policy in the traces; None: the function's.
        seed: seed of everything random.
        profile: `paper`, `real-repo` or `real-gspo`: which server the agent meets.
        preset: reward preset of the steps.
        skills: `perfect`, or `real-v1`: picks, places and doors fail as on the paper's robot.
        images: whether the traces hold images; replay renders them again.
        replace: whether traces of the same policy name, task and seed in `out` are replaced, as `reel
            run` does. False: nothing is played if there is one.
        jobs: episodes at a time; None: one for each core. Python policies share one interpreter.
        progress: whether a bar is shown; None: in terminals and notebooks.

    Returns:
        The episodes with their reports, in the order of the tasks. What a killed run left of them
        (`<trace>.part`) is removed, and they are played anew.

    Raises:
        ReelError: no episode could be played (where some could not, a warning says so), or there are
            traces already and `replace` is False.
        ArgumentError: `seed` or `jobs` is out of range.
        PolicyError: a policy raised an exception, its `__cause__`; the text names the task and the
            step. It ends its episode as aborted, and is raised when the others are done.
        KeyboardInterrupt: Ctrl-C; a Python policy is not asked again.
    """
    workers, seed = threads(jobs), whole("seed", seed)
    loaded = tasks if isinstance(tasks, Tasks) else Tasks.load(tasks)
    called = policy if isinstance(policy, str) else name or getattr(policy, "__name__", type(policy).__name__)
    factory = None
    if not isinstance(policy, str):
        if not callable(policy):
            raise ReelError(f"a policy is a name or a function, not {type(policy).__name__}")
        factory = lambda: as_function(policy)  # noqa: E731
    native = loaded._native
    recordings: list[_reel.Recording | None] = [None] * len(loaded)
    if out is not None:
        folder = Path(out)
        # the name of the policy as the name of a file
        file_name = re.sub(r"[^\w.-]", "_", called)
        paths = [folder / f"{re.sub(SEPARATORS, '_', id)}--{file_name}--{seed}.mcap" for id in loaded.ids]
        there = [] if replace else [path for path in paths if path.exists()]
        if there:
            raise ReelError(
                f"{len(there)} of {len(paths)} traces are there already, and replace=False keeps them; give another "
                f"out, name or seed, or replace=True: {there[0]}"
            )
        folder.mkdir(parents=True, exist_ok=True)
        recordings = [recording(path, images) for path in paths]
    with bar(len(loaded), called, progress) as tell:
        reports = _reel.run(native, called, factory, recordings, seed, profile, preset, skills, workers, tell)
    played = Episodes(reports)
    if played.errors and len(played.errors) == len(played):
        raise ReelError(f"no episode was played: {played.errors[0]}")
    if played.errors:
        warnings.warn(
            f"{len(played.errors)} of {len(played)} episodes were not played: {played.errors[0]}", stacklevel=2
        )
    return played


class Episodes(Sequence[Episode]):
    """Episodes that were played, with a report of each."""

    def __init__(self, reports: Sequence[Record]) -> None:
        self.reports = list(reports)
        """For each episode `success`, `total_reward`, `completion`, `spl`, `length`, `trace`, ...; for
        one that broke down `error`."""

    @property
    def success_rate(self) -> float:
        """Share of the episodes in which the goal held at the end."""
        return sum(bool(report.get("success")) for report in self.reports) / max(len(self.reports), 1)

    @property
    def errors(self) -> list[str]:
        """Why episodes broke down."""
        return [report["error"] for report in self.reports if "error" in report]

    def __len__(self) -> int:
        return len(self.reports)

    @overload
    def __getitem__(self, index: int) -> Episode: ...
    @overload
    def __getitem__(self, index: slice) -> Episodes: ...
    def __getitem__(self, index: int | slice) -> Episode | Episodes:
        if isinstance(index, slice):
            return Episodes(self.reports[index])
        report = self.reports[index]
        if report.get("trace") is None:
            raise ReelError(report.get("error") or "the episode was not recorded: give run(..., out=FOLDER)")
        return open(cast(str, report["trace"]))

    def __repr__(self) -> str:
        broken = f", {len(self.errors)} not played" if self.errors else ""
        return f"<{len(self)} episodes, {self.success_rate:.1%} succeeded{broken}>"


def tools(profile: str = "paper") -> list[Record]:
    """The tools that a policy has in a profile: `name`, `description`, and `parameters` as JSON
    Schema, as chat templates take them."""
    return _reel.tools(profile)


__all__ = ["Episodes", "Policy", "Tasks", "as_function", "run", "tools"]
