"""What the environments for language models share: texts, prompt groups of trainers, rewards."""

from __future__ import annotations

import os
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

from .._reel import ReelError
from ._calls import ToolSet
from ._episodes import EpisodeSource, Group, next_index
from ._play import Episode, open_episode, step_episode

REWARDS = ("total", "success")
"""What a rollout earns: the sum of its step rewards, or 1 if the goal held at the end, else 0."""


def text_of(name: str) -> str:
    """A text that comes with the package."""
    return (files("reel.envs") / "texts" / name).read_text(encoding="utf-8")


SYSTEM = text_of("conversation.txt").rstrip()
"""System message of a conversation with native tool calls."""

ENDED = "The episode has ended."
"""The answer to a call after the end."""


def briefing(episode: Episode) -> str:
    """The first user message: the task and the receptacles of the home."""
    lines = "\n".join(f"- {name} ({category}, {room})" for name, category, room in episode.receptacles)
    return f"Task: {episode.observation.instruction}\n\nReceptacles:\n{lines}\n"


def reward_of(episode: Episode | None, reward: str) -> float:
    """What a rollout earned so far, by one of `REWARDS`. A success is only seen when it has ended."""
    if episode is None:
        return 0.0
    report = episode.report or {}
    return float(bool(report.get("success"))) if reward == "success" else episode.total_reward


def checked_reward(reward: str) -> str:
    """The name of a reward, checked."""
    if reward not in REWARDS:
        raise ReelError(f"reward {reward!r} is unknown; give one of {', '.join(REWARDS)}")
    return reward


class GroupCounter:
    """Gives each rollout its prompt group and index there.

    Trainers reset the rollouts of a group one after the other, with the same task and seed, or the
    same call of a trace. Every `size` of them are a group.

    Args:
        source: opens the episodes.
        size: rollouts of a group (`num_generations`).
        part: rollouts of a group that this process plays, where a group is spread over processes in
            the order of their `RANK`; None: whole groups.
    """

    def __init__(self, source: EpisodeSource, size: int, part: int | None = None) -> None:
        self.source = source
        self.size = size
        self.part = part or size
        if size < 1 or self.part < 1 or size % self.part:
            raise ReelError(f"a group of {size} cannot be played in parts of {self.part}; give a divisor of {size}")
        self.rank = int(os.environ.get("RANK", "0")) % (size // self.part)

    def next(self, name: str) -> Group:
        """Group and index of the next rollout that starts like the others of this name."""
        count = next_index(self.source.run, name)
        number, index = divmod(count, self.part)
        return f"{name}--{number}", self.rank * self.part + index

    def start(self, options: Mapping[str, Any], task: int | str, seed: int) -> Episode:
        """Opens an episode in its prompt group.

        Args:
            options: `trace` with `call`, or nothing: then the task is played.
            task: index or id of the task.
            seed: seed of the simulator.
        """
        trace = options.get("trace")
        if trace:
            call = int(options.get("call") or 0)
            group = self.next(self.source.group_of_fork(trace, call))
            return open_episode(self.source, {"trace": trace, "call": call, "group": group}, 0, seed)
        group = self.next(self.source.group_of_task(task, seed))
        return open_episode(self.source, {"task": task, "group": group}, 0, seed)


def play(episode: Episode, tools: ToolSet, action: Any) -> float:
    """Makes a call in any form; returns its reward. After the end nothing happens."""
    if episode.ended:
        return 0.0
    result = step_episode(episode, tools, action)
    episode.advance(result)
    return float(result.reward)


__all__ = ["ENDED", "REWARDS", "SYSTEM", "GroupCounter", "briefing", "checked_reward", "play", "reward_of", "text_of"]
