"""Household tasks for TRL's `GRPOTrainer(environment_factory=...)`.

    from trl import GRPOConfig, GRPOTrainer
    from reel.envs import household_dataset, household_factory

    factory = household_factory("tasks", group_size=8, record_dir="rollouts")
    trainer = GRPOTrainer(
        model="Qwen/Qwen3-4B-Instruct-2507",
        args=GRPOConfig(num_generations=8, max_completion_length=4096),
        train_dataset=household_dataset("tasks", seeds=range(4)),
        environment_factory=factory,
    )

The model calls the tools natively; the chat template gets them from the methods below.
"""

# pyright: reportMissingTypeStubs=false, reportMissingTypeArgument=false, reportUnknownMemberType=false
# pyright: reportUnknownParameterType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any

from .._types import PathLike
from .._play import Tasks
from .._reel import ReelError
from ._calls import ToolSet
from ._episodes import EpisodeSource, load_tasks
from ._extras import missing
from ._play import Episode
from ._rollouts import ENDED, SYSTEM, GroupCounter, briefing, checked_reward, play, reward_of

if TYPE_CHECKING:
    from datasets import Dataset

Content = str | list[dict[str, Any]]
"""What a model reads: text, or blocks of text and images."""


class _Environment:
    """An episode behind methods that are tools. TRL takes every public method of a subclass for a
    tool, but `reset` and `get_reward`."""

    def __init__(self, groups: GroupCounter, tools: ToolSet, reward: str) -> None:
        self._groups = groups
        self._tools = tools
        self._reward = reward
        self._episode: Episode | None = None

    def reset(self, **row: Any) -> Content:
        """Starts the episode of a row.

        Args:
            row: `task` (index or id) and `seed`, or `trace` and `call`; other columns are ignored.

        Returns:
            What is appended to the last user message: task, receptacles and, with images, the view.
        """
        if self._episode is not None:
            self._episode.close()
        task, seed = row.get("task"), row.get("seed")
        options = {"trace": row.get("trace"), "call": row.get("call")}
        self._episode = self._groups.start(options, 0 if task is None else task, int(seed or 0))
        text = briefing(self._episode)
        # an episode that starts at a call goes on from what that call's agent was last told
        last = self._episode.observation.text
        return self._content(f"{text}\nLast result: {last}\n" if last else text)

    def get_reward(self) -> float:
        """What the rollout earned. Ends the episode, so that its trace is complete.

        Returns:
            The sum of its step rewards, or 1.0 for a success, as the factory was told.
        """
        if self._episode is not None:
            self._episode.close()
        return reward_of(self._episode, self._reward)

    @property
    def success(self) -> bool:
        """Whether the goal held when the episode ended; False while it runs."""
        return self._episode is not None and bool((self._episode.report or {}).get("success"))

    @property
    def trace(self) -> os.PathLike[str] | None:
        """The trace of the episode; None if it is not recorded."""
        return None if self._episode is None else self._episode.opened.path

    def _call(self, name: str, **arguments: Any) -> Content:
        episode = self._episode
        if episode is None:
            raise ReelError("no episode runs: call reset() first")
        if episode.ended:
            return ENDED
        play(episode, self._tools, (name, arguments))
        return self._content(f"{episode.observation.text}\n{ENDED}" if episode.ended else episode.observation.text)

    def _content(self, text: str) -> Content:
        image = self._episode.image if self._groups.source.images and self._episode is not None else None
        if image is None:
            return text
        from PIL import Image

        return [{"type": "text", "text": text}, {"type": "image", "image": Image.fromarray(image)}]


ARGUMENTS = {
    "receptacle_name": "Id of the receptacle.",
    "target_category": "Category of the objects.",
    "marker_id": "Number in the latest marker map.",
    "question": "The question.",
}
"""What the model reads about each argument of the tools."""


def tool_method(tools: ToolSet, index: int) -> Callable[..., Content]:
    """A method that calls a tool. TRL makes the tool's schema from its signature and docstring."""
    name, spec = tools.names[index], tools.specs[index]
    parameters = tools.parameters(index)
    self_parameter = inspect.Parameter("self", inspect.Parameter.POSITIONAL_ONLY)
    signature = inspect.Signature([self_parameter, *parameters], return_annotation=Content)

    def method(*given: Any, **named: Any) -> Content:
        arguments = signature.bind(*given, **named).arguments
        environment: _Environment = arguments.pop("self")
        return environment._call(name, **arguments)

    described = "\n".join(f"    {each.name}: {ARGUMENTS[each.name]}" for each in parameters)
    method.__name__ = name
    method.__signature__ = signature  # pyright: ignore[reportFunctionMemberAccess]
    method.__annotations__ = {each.name: each.annotation for each in parameters} | {"return": Content}
    sections = [spec["description"], f"Args:\n{described}" if described else "", "Returns:\n    What the robot is told."]
    method.__doc__ = "\n\n".join(filter(None, sections))
    return method


def with_tools(profile: str) -> Callable[[type[_Environment]], type[_Environment]]:
    """Gives a class a method for each tool of a profile (`reel.tools`)."""
    tools = ToolSet(profile)

    def extended(kind: type[_Environment]) -> type[_Environment]:
        for index, name in enumerate(tools.names):
            setattr(kind, name, tool_method(tools, index))
        return kind

    return extended


@with_tools("paper")
class HouseholdTools(_Environment):
    """The tools of profile `paper`."""


@with_tools("real-repo")
class PublishedTools(_Environment):
    """The tools of profiles `real-repo` and `real-gspo`."""


def household_factory(
    tasks: PathLike | Tasks | None = None,
    *,
    group_size: int = 8,
    group_part: int | None = None,
    reward: str = "total",
    images: bool = False,
    scene: PathLike | None = None,
    profile: str = "paper",
    preset: str = "paper",
    skills: str = "perfect",
    policy: str = "trl",
    record_dir: PathLike | None = None,
    run: str | None = None,
) -> Callable[[], _Environment]:
    """An `environment_factory` for `GRPOTrainer`.

    Args:
        tasks: a task file, a folder of them, or `Tasks`; None: the rows name traces.
        group_size: rollouts of a prompt group: `GRPOConfig.num_generations`.
        group_part: rollouts of a group in one process, where groups are spread over processes; None:
            all.
        reward: what a rollout earns: `total`, the sum of its step rewards, or `success`.
        images: whether tools return images, for models that see. Text-only models need False.
        scene: the scene for all tasks; None: the one that each task names.
        profile: `paper`, `real-repo` or `real-gspo`: which server the agent meets.
        preset: reward preset of the steps.
        skills: `perfect`, or `real-v1`: picks, places and doors fail as on the paper's robot.
        policy: name of who decides, for the traces.
        record_dir: folder for the traces; None: rollouts are not recorded.
        run: name that the traces give the run; None: a new one for this process.
    """
    source = EpisodeSource(
        tasks, scene=scene, profile=profile, preset=preset, skills=skills, policy=policy, images=images,
        record_dir=record_dir, run=run,
    )  # fmt: skip
    groups = GroupCounter(source, group_size, group_part)
    tools = ToolSet(profile)
    kind = HouseholdTools if profile == "paper" else PublishedTools
    paid = checked_reward(reward)
    return lambda: kind(groups, tools, paid)


def household_dataset(
    tasks: PathLike | Tasks | None = None,
    *,
    seeds: Iterable[int] = (0,),
    starts: Sequence[tuple[PathLike, int]] = (),
    scene: PathLike | None = None,
) -> Dataset:
    """A data set of prompts for `GRPOTrainer`: a row for each task and seed, and for each start.

    Args:
        tasks: a task file, a folder of them, or `Tasks`.
        seeds: seeds to play each task with.
        starts: traces with a call of each, to start from the moment before it.
        scene: the scene for all tasks; None: the one that each task names.
    """
    try:
        from datasets import Dataset
    except ImportError as error:
        raise missing("trl", error) from error
    loaded = load_tasks(tasks, scene)
    ids = loaded.ids if loaded is not None else []
    prompt = [{"role": "system", "content": SYSTEM}, {"role": "user", "content": ""}]
    empty: dict[str, Any] = {"prompt": prompt, "task": None, "seed": None, "trace": None, "call": None}
    rows = [{**empty, "task": task, "seed": seed} for seed in seeds for task in ids]
    rows += [{**empty, "trace": os.fspath(trace), "call": call} for trace, call in starts]
    if not rows:
        raise ReelError("no prompts: give tasks=PATH, or starts=[(TRACE, CALL)]")
    return Dataset.from_list(rows)  # pyright: ignore[reportUnknownMemberType]


def success_reward(environments: Sequence[_Environment], **_: Any) -> list[float]:
    """A reward function of `GRPOTrainer` beside that of the environment: 1.0 for each rollout whose
    goal held at the end, else 0.0."""
    for environment in environments:
        environment.get_reward()  # ends the episode
    return [float(environment.success) for environment in environments]


__all__ = ["HouseholdTools", "PublishedTools", "household_dataset", "household_factory", "success_reward"]
