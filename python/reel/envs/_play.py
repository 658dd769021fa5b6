"""One episode as the environments of this package step it: observation, reward, end."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from .._types import Record
from .._reel import Observation, ReelError, StepResult
from ._calls import ToolSet
from ._episodes import EpisodeSource, Group, Opened


IMAGE_SHAPE = (480, 640, 3)
"""Height, width and channels (RGB) of an image."""

RESET_OPTIONS = ("task", "trace", "call", "group", "record")


def scene_text(receptacles: list[tuple[str, str, str]]) -> str:
    """The receptacles of a home as text: a line each, `id (category, room)`."""
    return "\n".join(f"{name} ({category}, {room})" for name, category, room in receptacles)


class Episode:
    """An episode that runs, with what its agent was last told."""

    def __init__(self, opened: Opened) -> None:
        self.opened = opened
        self.id: str = opened.simulation.header["episode_id"]
        """Id of the episode: equal inputs give equal ids."""
        self.observation: Observation = opened.simulation.observe()
        self.image: NDArray[np.uint8] | None = self.observation.image if opened.frame is None else opened.frame
        """The image that the last call gave (480 x 640 x 3, uint8, RGB); None if it gave none. Black
        where images are not rendered."""
        self.receptacles = self.observation.receptacles
        self.scene = scene_text(self.receptacles)
        self.report: Record | None = None
        """How it went; None while it runs."""
        self.total_reward = 0.0
        """Sum of the rewards of the calls made here."""
        self._rendered: NDArray[np.uint8] | None = None

    @property
    def ended(self) -> bool:
        """Whether no call can be made any more."""
        return self.report is not None

    def advance(self, result: StepResult, keep_image: bool = False) -> None:
        """Takes in what came of a call; closes the episode where that ended it.

        Args:
            result: what the call gave.
            keep_image: whether the last view is kept for `render`.
        """
        self.observation = result.observation
        self.image = self.observation.image
        self.total_reward += float(result.reward)
        self._rendered = None
        if result.terminated or result.truncated:
            if keep_image:
                self.render()
            self.close()

    def render(self) -> NDArray[np.uint8]:
        """What the robot's head sees: 480 x 640 x 3, uint8, RGB. After the end what it saw last."""
        if self._rendered is None:
            if self.ended:
                raise ReelError("the episode has ended and kept no image; call reset()")
            self._rendered = self.opened.simulation.render().rgb
        return self._rendered

    def close(self) -> None:
        """Ends the episode, as aborted if it still runs; its trace is complete then."""
        if self.report is None:
            simulation = self.opened.simulation
            with simulation:
                pass
            self.report = simulation.report or {}

    def outcome(self) -> Record:
        """What an agent may know after the end: `success`, `end_reason`, `total_reward`,
        `completion` and `length`; the trace where the episode is recorded."""
        report = self.report or {}
        known: Record = {"success": bool(report.get("success", False))}
        for key in ("end_reason", "total_reward", "completion", "length"):
            if report.get(key) is not None:
                known[key] = report[key]
        return known | self.trace_entry()

    def trace_entry(self) -> Record:
        """The path of the trace under `trace`; nothing if the episode is not recorded."""
        return {} if self.opened.path is None else {"trace": os.fspath(self.opened.path)}


def open_episode(
    source: EpisodeSource, options: Mapping[str, Any], task: int, seed: int, siblings: bool = False
) -> Episode:
    """Opens the episode that the options of a `reset` name.

    Args:
        source: the settings of the environment.
        options: `trace` with `call`, or `task` (index or id); `group` (a name, or a name and an
            index); `record` (path of the trace to write).
        task: index of the task where the options name none.
        seed: seed of the simulator; a trace has its own.
        siblings: whether the episode belongs to a prompt group although the options name none.
    """
    if unknown := sorted(set(options) - set(RESET_OPTIONS)):
        raise ReelError(f"reset: unknown option {unknown[0]!r}; the options are {', '.join(RESET_OPTIONS)}")
    record = options.get("record")
    trace, call = options.get("trace"), options.get("call")
    if trace is None and call is not None:
        raise ReelError("reset: 'call' is a call of a trace: give options={'trace': PATH, 'call': n}")
    wanted: str | Group | None = options.get("group")
    if trace is not None:
        at = 0 if call is None else int(call)
        group = resolve_group(source, wanted if wanted is not None else source.group_of_fork(trace, at))
        return Episode(source.fork(trace, at, group=group, record=record))
    chosen: int | str = options.get("task", task)
    if isinstance(chosen, (int, np.integer)):
        chosen = int(chosen)
    group = None
    if wanted is not None:
        group = resolve_group(source, wanted)
    elif siblings or record is not None or source.record_dir is not None:
        # also keeps the ids of recorded episodes apart: equal inputs give equal ids
        group = resolve_group(source, source.group_of_task(chosen, seed))
    return Episode(source.start(chosen, seed, group=group, record=record))


def resolve_group(source: EpisodeSource, group: str | Group) -> Group:
    """The place in a prompt group: as given, or the next one of that name."""
    match cast(Any, group):
        case str() as name:
            return source.sibling(name)
        case (str() as name, int() | np.integer() as index):
            return name, int(index)
        case _:  # options come from anybody
            raise ReelError(
                f"reset: group={group!r} is no prompt group; give its name, 'NAME', or the name and the index of the "
                "rollout in it, ('NAME', 0)"
            )


def step_episode(episode: Episode, tools: ToolSet, action: Any) -> StepResult:
    """Makes the call of an action in any form (`ToolSet.answer`)."""
    name, arguments, output = tools.answer(action)
    native = episode.opened.simulation._native
    return native.step(name, arguments, output)


__all__ = ["IMAGE_SHAPE", "Episode", "open_episode", "scene_text", "step_episode"]
