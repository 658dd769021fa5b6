"""Episodes that are played from Python, call by call."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from . import _reel
from ._reel import Observation, ReelError, StepResult
from ._types import PathLike, Record

if TYPE_CHECKING:
    from ._episode import Episode, RenderedFrame
    from ._play import Policy

DEPTH_MAX = 64
"""Deepest nesting of the arguments of a call."""

Call = tuple[str, Mapping[str, Any]]
Action = str | Mapping[str, Any] | tuple[str, Any]
"""A tool call: `("nav_to", {"receptacle_name": "table_1"})`, a dictionary with `name` and
`arguments` (or `tool_name`, as REAL's agents write it), or either as JSON text."""


def as_call(action: Action) -> Call:
    """The name and arguments of a call, however it is written. Text that is no call stays one whose
    name no tool has: the simulator answers it as it answers a model that says gibberish."""
    if isinstance(action, str):
        try:
            parsed: Any = json.loads(action)
        except json.JSONDecodeError:
            return action, {}
        return as_call(cast(Record, parsed)) if isinstance(parsed, dict) else (action, {})
    if isinstance(action, Mapping):
        name: Any = action.get("name", action.get("tool_name"))
        arguments: Any = action.get("arguments", action.get("parameters")) or {}
        if not isinstance(name, str):
            raise ReelError(f"a call needs a name: {{'name': 'pick', 'arguments': {{'marker_id': 1}}}}, not {action}")
        return name, plain(arguments)
    match cast(Any, action):
        case [str() as name, arguments]:
            return name, plain(arguments or {})
        case _:  # a policy may return anything
            raise ReelError(f"no call: {action!r:.200}; give ('pick', {{'marker_id': 1}}), a dictionary, or JSON text")


def plain(value: Any, depth: int = 0) -> Any:
    """Numbers and arrays of NumPy as Python's own."""
    if isinstance(value, (np.generic, np.ndarray)):
        return cast(Any, value).tolist()
    if depth > DEPTH_MAX:  # the native part refuses it
        return value
    if isinstance(value, dict):
        return {name: plain(item, depth + 1) for name, item in cast(Record, value).items()}
    if isinstance(value, (list, tuple)):
        return [plain(item, depth + 1) for item in cast(list[Any], value)]
    return value


def recording(path: PathLike, images: bool, fsync: bool = False) -> _reel.Recording:
    """How the native part is told to record an episode."""
    return {"path": path, "images": images, "fsync": fsync}


class Simulation:
    """A running episode.

    `Tasks.start` starts one from a task, `Episode.at(call).play()` from a call of a recorded
    episode. As a context manager it is closed at the end of the block, also where an exception leaves
    it: the trace then ends as `aborted`. A recorded simulation that is never closed leaves
    `<trace>.part`, from which `reel trace recover` makes a trace.
    """

    def __init__(self, native: _reel.Simulation, record: PathLike | None = None) -> None:
        self._native = native
        self._record = None if record is None else Path(record)
        self.report: Record | None = None
        """How the episode went: success, reward, metrics; None until it is closed."""

    def step(self, action: Action, output: Mapping[str, Any] | None = None) -> StepResult:
        """Makes a call. Where the episode is recorded, the call is on disk when this returns.

        Args:
            action: the call.
            output: what a model said with it, for the trace: `raw`, `reasoning`, `history`, `plan`,
                `tokens` (read and written), `latency_ns`.

        Returns:
            `observation`, `reward`, `terminated`, `truncated` and `end_reason`.

        Raises:
            ReelError: the episode has ended.
        """
        return self._native.step(*as_call(action), output)

    def follow(self, policy: Policy, calls_max: int | None = None) -> None:
        """Lets a policy decide until the episode ends, or for so many calls.

        Raises:
            PolicyError: the policy raised an exception, its `__cause__`. The episode still runs: another
                policy may go on, and leaving the `with` block ends it as aborted.
        """
        from ._play import as_function

        try:
            decide = as_function(policy)
        except Exception as error:
            raise self._policy_error(error) from error
        left = calls_max
        while self.ended is None and (left is None or left > 0):
            observation = self.observe()
            try:
                name, arguments, output = decide(observation)
            except Exception as error:
                raise self._policy_error(error) from error
            self._native.step(name, arguments, output)
            left = None if left is None else left - 1

    def _policy_error(self, raised: Exception) -> BaseException:
        return _reel.policy_error(self.header["task_id"], self.calls, raised)

    def observe(self) -> Observation:
        """What the agent knows now: nothing privileged."""
        return self._native.observe()

    def render(self) -> RenderedFrame:
        """What the robot's head sees now, also if the simulation renders no images by itself."""
        from ._episode import RenderedFrame

        return RenderedFrame(*self._native.render())

    @property
    def calls(self) -> int:
        """How many calls were made, those before a fork included."""
        return self._native.calls

    @property
    def ended(self) -> str | None:
        """Why the episode ended: `finished`, `horizon` or `fault`; None while it runs."""
        return self._native.ended

    @property
    def header(self) -> Record:
        """Ids, seed, profile, policy, group, parent."""
        return self._native.header()

    @property
    def task(self) -> Record:
        """The task: instruction, objects, goal. Privileged."""
        return self._native.task()

    def record(self, call: int) -> Record:
        """The whole record of a call. Privileged."""
        return self._native.record(call)

    @property
    def state_digest(self) -> str:
        """Digest of the simulator's state: equal for bit-identical states."""
        return self._native.state_digest()

    def close(self) -> Episode | None:
        """Ends the episode, as aborted if it still runs. Returns the recorded episode; None if it is
        not recorded."""
        from ._episode import open

        report = self._native.close()
        if report is not None:
            self.report = report
        return open(self._record) if self._record is not None else None

    def __enter__(self) -> Simulation:
        return self

    def __exit__(self, *_: object) -> None:
        report = self._native.close()
        if report is not None:
            self.report = report

    def __repr__(self) -> str:
        if self.report is not None:
            return f"<Simulation of {self.report['task_id']}: closed>"
        return f"<Simulation of {self.header['task_id']}: {self.calls} calls, ended: {self.ended}>"


__all__ = ["Action", "Call", "Simulation", "as_call"]
