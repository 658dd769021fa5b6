"""Recorded episodes."""

from __future__ import annotations

import itertools
import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import NDArray

from . import _reel
from ._arguments import ArgumentError, call_index, threads, whole
from ._counterfactual import Comparison, Explanation, Fork
from ._reel import ReelError
from ._simulation import Action, Call, as_call
from ._types import Image, Layer, PathLike, Record

if TYPE_CHECKING:
    from ._play import Policy

_scratch: tempfile.TemporaryDirectory[str] | None = None
_numbers = itertools.count()


def scratch_path(name: str) -> Path:
    """A path in a folder that goes with the process."""
    global _scratch
    if _scratch is None:
        _scratch = tempfile.TemporaryDirectory(prefix="reel-")
    return Path(_scratch.name) / f"{next(_numbers):04}-{name}"


def snapshot_cache() -> Path:
    """The folder of snapshots that seeking uses, shared with the command line; it may be deleted."""
    cache = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    return Path(cache) / "reel-snapshots"


@dataclass(frozen=True)
class Verdict:
    """What a replay found. True if every digest, image and text is identical."""

    name: str
    """`exact`, `diverged`, `other_simulator`, `not_replayable` or `refused`."""
    text: str
    """The verdict as the command line prints it: with the first difference, if there is one."""
    details: Record
    """Counts if exact; if diverged the call, physics step, body, field and both values."""

    @property
    def exact(self) -> bool:
        """Whether every digest, image and text is identical."""
        return self.name == "exact"

    def __bool__(self) -> bool:
        return self.exact

    def __str__(self) -> str:
        return self.text

    @classmethod
    def _of(cls, record: Record) -> Verdict:
        details = {key: value for key, value in record.items() if key not in ("verdict", "text")}
        return cls(record["verdict"], record["text"], details)

    def _repr_html_(self) -> str:
        from ._display import verdict_html

        return verdict_html(self)


@dataclass(frozen=True)
class RenderedFrame:
    """What a camera sees."""

    rgb: Image
    """480 x 640 x 3, uint8."""
    depth_mm: Layer
    """480 x 640, uint16: depth along the optical axis in millimetres; 0 is nothing."""
    instance_ids: Layer
    """480 x 640, uint16: what each pixel belongs to (`Episode.instances`); 0 is nothing."""

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.asarray(self.rgb, dtype=dtype)


def calls_of(calls: Iterable[Action]) -> list[Call]:
    """The calls of a list. One call alone is refused: its letters or keys would be taken for calls."""
    match calls:
        case str() | Mapping():
            alone = True
        case (str(), dict() as arguments):
            alone = not {"name", "tool_name"} & set(arguments)
        case _:
            alone = False
    if alone:
        raise ReelError(f"calls is one call alone, not a list of calls; put it in a list: [{calls!r:.200}]")
    return [as_call(action) for action in calls]


class Step:
    """One decision of an episode and what came of it."""

    def __init__(self, episode: Episode, index: int) -> None:
        self.episode = episode
        self.index = index

    @cached_property
    def record(self) -> Record:
        """The whole record, as a dictionary."""
        return self.episode._trace.step(self.index)

    @property
    def tool(self) -> str:
        """Name of the tool, as it was called."""
        return self.record["input"]["call"]["name"]

    @property
    def arguments(self) -> Record:
        """The arguments of the call."""
        return self.record["input"]["call"]["arguments"]

    @property
    def call(self) -> str:
        """The call as people write it, e.g. `pick(2)`."""
        return self.episode._trace.call_text(self.index)

    @property
    def text(self) -> str:
        """What the agent was answered."""
        return self.record["outcome"]["text"]

    @property
    def error(self) -> str | None:
        """Code of the error; None if the call did what it should."""
        return self.record["outcome"].get("error")

    @property
    def reward(self) -> float:
        """Sum of the reward terms."""
        return float(sum(term["value"] for term in self.record["reward"]))

    @property
    def reward_terms(self) -> dict[str, float]:
        """Value of each reward term that is not zero (`task`, `prog`, `phys`, `ask`, `time`, `safe`)."""
        terms: dict[str, float] = {}
        for term in self.record["reward"]:
            terms[term["component"]] = terms.get(term["component"], 0.0) + term["value"]
        return terms

    @property
    def reasoning(self) -> str:
        """The reasoning that came with the call; empty if there is none."""
        said: Record = self.record["input"].get("policy") or {}
        return said.get("reasoning", "")

    @property
    def changes(self) -> list[Record]:
        """How the physical world graph changed."""
        return self.record["changes"]["physics"]

    @property
    def frame(self) -> Image | None:
        """The image that the agent got (480 x 640 x 3, uint8); None if the call gives none."""
        return self.episode.frame(self.index)

    def __repr__(self) -> str:
        error = f" {self.error}:" if self.error else ""
        first_line = self.text.partition("\n")[0]
        return f"<Step {self.index}: {self.call} ->{error} {first_line}>"


class Steps(Sequence[Step]):
    """The steps of an episode, each read when it is looked at."""

    def __init__(self, episode: Episode, indices: range) -> None:
        self._episode = episode
        self._indices = indices

    def __len__(self) -> int:
        return len(self._indices)

    @overload
    def __getitem__(self, index: int) -> Step: ...
    @overload
    def __getitem__(self, index: slice) -> Steps: ...
    def __getitem__(self, index: int | slice) -> Step | Steps:
        if isinstance(index, slice):
            return Steps(self._episode, self._indices[index])
        return Step(self._episode, self._indices[index])

    def __repr__(self) -> str:
        return "\n".join(map(repr, self)) or "<no steps>"


class Episode:
    """A recorded episode: one trace file, read and verified (checksums, order, hash chain).

    `reel.open` reads one.
    """

    def __init__(self, trace: _reel.Trace) -> None:
        self._trace = trace

    # --- what happened

    @property
    def path(self) -> Path:
        """Where the trace lies."""
        return Path(self._trace.path)

    @property
    def digest(self) -> str:
        """The last link of the hash chain, which covers all inputs and outputs."""
        return self._trace.chain

    @cached_property
    def header(self) -> Record:
        """What was known before the first call: ids, seed, profile, policy, parent of a branch."""
        return self._trace.header()

    @property
    def id(self) -> str:
        """Id of the episode: equal inputs give equal ids."""
        return self.header["episode_id"]

    @cached_property
    def task(self) -> Record:
        """The task: instruction, objects, goal. Privileged."""
        return self._trace.task()

    @cached_property
    def scene(self) -> Record:
        """The scene: rooms, furniture, receptacles, in metres."""
        return self._trace.scene()

    @property
    def instruction(self) -> str:
        """The task's instruction to the agent."""
        return self.task["instruction"]

    @property
    def steps(self) -> Steps:
        """The decisions, in order."""
        return Steps(self, range(len(self._trace)))

    @cached_property
    def end(self) -> Record | None:
        """How it ended: reason, graphs, metrics; None if the recording broke off."""
        return self._trace.end()

    @property
    def success(self) -> bool | None:
        """Whether the goal held at the end; None if the recording broke off."""
        return self.end["metrics"]["success"] if self.end else None

    @property
    def rewards(self) -> NDArray[np.float64]:
        """The reward of each step, float64."""
        return np.array([step.reward for step in self.steps], dtype=np.float64)

    @property
    def total_reward(self) -> float:
        """Undiscounted sum of the rewards, as the trace has it."""
        return float(self.end["metrics"]["total_reward"]) if self.end else float(self.rewards.sum())

    @property
    def events(self) -> list[Record]:
        """Every change of the physical world graph, each with its `step`."""
        return [{"step": step.index, **change} for step in self.steps for change in step.changes]

    def graphs(self, call: int | None = None) -> Record:
        """Where the objects are after a call (None: before the first), by both authorities:
        `physics` and `registry`."""
        return self._trace.graphs(self._call(call))

    # --- images

    def frame(self, call: int | None = None) -> Image | None:
        """The image that the agent got after a call (None: before the first): 480 x 640 x 3, uint8,
        RGB, Set-of-Mark overlay included. None if that call returns no image. Read from the trace,
        or rendered again if the trace holds no images."""
        call = self._call(call)
        if self._trace.image_count:
            return self._trace.image(call)
        if call is not None and not self._trace.step(call)["digests"].get("frame"):
            return None
        return self.render(call=call).rgb

    @property
    def frames(self) -> Iterator[tuple[int | None, Image]]:
        """The images that the agent got, each with its call (None: before the first)."""
        for call in itertools.chain([None], range(len(self._trace))):
            image = self.frame(call)
            if image is not None:
                yield call, image

    def depth(self, call: int | None = None) -> Layer | None:
        """The recorded depth in millimetres (480 x 640, uint16); None if the trace holds none:
        `render` draws it."""
        return self._trace.depth(self._call(call))

    def instance_ids(self, call: int | None = None) -> Layer | None:
        """The recorded instance ids (480 x 640, uint16); None if the trace holds none: `render`
        draws them."""
        return self._trace.instance_ids(self._call(call))

    @cached_property
    def instances(self) -> list[Record]:
        """What the instance ids of images stand for, by index."""
        return self._trace.instances()

    def render(
        self,
        camera: str = "head",
        call: int | None = None,
        *,
        eye: Sequence[float] | None = None,
        look_at: Sequence[float] | None = None,
    ) -> RenderedFrame:
        """Renders the moment after a call (None: before the first) again, from any camera.

        Args:
            camera: `head` (what the agent saw), `top-down`, `follow:OBJECT` (an instance, asset or
                category of the task, or `target`), or `free`.
            call: index of the call, from 0; negative ones count from the end.
            eye: with `free`, where the camera is: x, y, z in metres in the scene's frame.
            look_at: with `free`, what it looks at, in the same frame.
        """

        def as_text(point: Sequence[float] | None) -> str | None:
            return None if point is None else ",".join(map(str, point))

        drawn = self._trace.draw(self._call(call), camera, as_text(eye), as_text(look_at), snapshot_cache())
        return RenderedFrame(*drawn)

    # --- replay and other futures

    def replay(self) -> Verdict:
        """Executes the episode again from its inputs and compares every digest, image and text."""
        return Verdict._of(self._trace.replay())

    def at(self, call: int) -> Fork:
        """The state before a call (from 0; negative ones count from the end): any number of other
        futures start there.

        Raises:
            ArgumentError: the episode has no such call.
            DivergenceError: the episode does not replay up to there.
        """
        return Fork(self, self._trace.fork(call_index(call, len(self)), snapshot_cache()))

    def branch(
        self,
        call: int,
        calls: Iterable[Action] = (),
        *,
        policy: str | Policy | None = None,
        then: str | None = None,
        seed: int | None = None,
        out: PathLike | None = None,
        images: bool | None = None,
    ) -> Episode:
        """Plays another future: this episode's calls up to `call`, then `calls`, then a policy.

        Args:
            call: the first call that is replaced (from 0; negative ones count from the end).
            calls: what is called instead, a list also of one call: `[("pick", {"marker_id": 2})]`.
                A call is a tuple, a dictionary with `name` and `arguments`, or JSON text.
            policy: who goes on after them: a built-in policy by name, or a function (`reel.run`).
            then: instead of a policy `"parent"` (this episode's calls after those that were
                replaced) or `"parent:J"` (from its call J on).
            seed: seed of a built-in policy; None: that of the episode.
            out: the trace to write. None: a file that goes with the process.
            images: whether the trace holds images; None: as this one.

        Returns:
            The branch, a trace like any other; its header names the parent.

        Raises:
            ArgumentError: the episode has no such call, or `seed` is out of range.
            PolicyError: the function raised an exception. The branch up to there is recorded, with
                the end `aborted`.
        """
        at = call_index(call, len(self))
        seed = None if seed is None else whole("seed", seed)
        made = calls_of(calls)
        path = Path(out) if out is not None else scratch_path(f"{self.path.stem}--at-{at}.mcap")
        if callable(policy):
            fork = self.at(at)
            held = images if images is not None else self._trace.image_count > 0
            with fork.play(policy=getattr(policy, "__name__", "python"), record=path, images=held) as simulation:
                for name, arguments in made:
                    if simulation.ended is None:
                        simulation.step((name, arguments))
                simulation.follow(policy)
            return open(path)
        if policy is None and then is None and not made:
            raise ReelError(f"say what happens at call {at}: calls, policy or then")
        self._trace.branch(at, made, policy or then, seed, path, images, snapshot_cache())
        return open(path)

    def blame(self, *, alternatives: bool = True, branches: PathLike | None = None) -> Explanation:
        """Which call decided that the episode failed, measured by other futures that are played.

        Args:
            alternatives: whether the better future is played, too.
            branches: folder for the trace of that future.
        """
        folder = Path(branches) if branches is not None else None
        if alternatives and folder is None:
            folder = scratch_path(self.path.stem)
            folder.mkdir()
        return Explanation(self, self._trace.blame(alternatives, folder))

    def diff(self, other: Episode) -> Comparison:
        """Both episodes side by side, call by call."""
        return Comparison(self, other, self._trace.diff(other._trace))

    def transcript(self) -> str:
        """The episode as readable text."""
        return self._trace.transcript()

    def save_rerun(self, path: PathLike, layers: str = "") -> Path:
        """Writes a recording for the Rerun viewer (`pip install 'reel[rerun]'`, then `rerun PATH`).

        Args:
            path: the `.rrd` file to write.
            layers: `depth`, `masks`, or `depth,masks` besides the images.
        """
        to = Path(path)
        to.write_bytes(self._trace.rerun_recording(layers))
        return to

    # --- as an object

    def _call(self, call: int | None) -> int | None:
        """An index from 0 for one that may be negative."""
        count = len(self._trace)
        if call is None:
            return None
        at = call_index(call, count)
        if at == count:
            raise ArgumentError(f"unknown call {call}: the episode has {count} calls, from 0")
        return at

    def __len__(self) -> int:
        return len(self._trace)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Episode) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)

    def __reduce__(self) -> tuple[type[Episode], tuple[_reel.Trace]]:
        return Episode, (self._trace,)

    def __repr__(self) -> str:
        header = self.header
        return (
            f"<Episode {header['task_id']}, policy {header['policy']['name']}, seed {header['seed']}: "
            f"{self._trace.ending()}>"
        )

    def _repr_html_(self) -> str:
        from ._display import episode_html

        return episode_html(self)


def open(path: PathLike, *, assets: PathLike | None = None) -> Episode:
    """Reads a trace, verifies it, and returns its episode.

    Args:
        path: a `.mcap` file of this machine, a URL of a bucket (`s3://...`), or an episode of a
            packed file (`FILE#EPISODE`, see `reel pack`), which is executed.
        assets: folder of the meshes that it was recorded with.

    Raises:
        ReelError: the file is torn, damaged or no trace; the text says where and what to do.
    """
    if os.path.isdir(path):
        raise ReelError(
            f"{os.fspath(path)} is a folder, and open reads one trace: open a .mcap file in it "
            "(reel.trace_paths finds them), or read all of them as tables with reel.scan_traces or "
            "reel.Store.ingest"
        )
    return Episode(_reel.Trace.read(path, assets))


def replay(
    paths: PathLike | Iterable[PathLike],
    *,
    jobs: int | None = None,
    assets: PathLike | None = None,
    progress: bool | None = None,
) -> list[Verdict]:
    """Replays traces, or all below folders, on several threads.

    Args:
        paths: files and folders, in which `.mcap` files are searched.
        jobs: threads; None: one for each core.
        assets: folder of the meshes that they were recorded with.
        progress: whether a bar is shown; None: in terminals and notebooks.

    Returns:
        The verdicts, in the order of `trace_paths(paths)`.

    Raises:
        ReelError: there is no trace among the paths.
        ArgumentError: `jobs` is less than 1.
    """
    from ._progress import bar

    workers = threads(jobs)
    found = trace_paths(paths)
    with bar(len(found), "replay", progress) as tell:
        verdicts = _reel.replay_all(found, workers, assets, tell)
    return [Verdict._of(verdict) for verdict in verdicts]


def trace_paths(paths: PathLike | Iterable[PathLike]) -> list[Path]:
    """The trace files among paths: files as given, and all below folders and by glob patterns,
    sorted.

    Raises:
        ReelError: there are none.
    """
    import glob

    given = [paths] if isinstance(paths, (str, os.PathLike)) else list(paths)
    if not given:
        raise ReelError("no paths are given: the list is empty; name .mcap files, folders of them, or a pattern")
    named: list[PathLike] = []
    for path in given:
        text = os.fspath(path)
        matches = glob.glob(text, recursive=True) if glob.has_magic(text) and not os.path.exists(text) else []
        named += matches or [path]
    return [Path(path) for path in _reel.trace_paths(named)]


__all__ = [
    "Comparison", "Episode", "Explanation", "Fork", "RenderedFrame", "Step", "Steps", "Verdict",
    "open", "replay", "trace_paths",
]  # fmt: skip
