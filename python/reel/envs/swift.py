"""Household tasks for the GYM training of ms-swift.

    swift rlhf --rlhf_type grpo --external_plugins "$(python -m reel.envs.swift)" \\
      --multi_turn_scheduler gym_scheduler --gym_env reel_household --use_gym_env true ...

`python -m reel.envs.swift` prints the path of the plug-in, which registers `HouseholdGym` under
`reel_household`; docs/training.md has the whole command. A row of the data set is

    {"messages": [{"role": "user", "content": "task_0"}], "env_config": {"tasks": "tasks"}}

as the published trainer has it: rows with equal messages are one prompt group.
"""

from __future__ import annotations

import asyncio
import base64
import importlib
import io
import json
import re
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from .._types import Record
from .._reel import ReelError
from ._calls import ToolSet
from ._episodes import SETTINGS, Cache, EpisodeSource
from ._extras import missing
from ._play import Episode
from ._published import ANSWER_FORM, Answer, Prompt, read_answer, result_text, scene_lines
from ._rollouts import ENDED, SYSTEM, GroupCounter, briefing, checked_reward

Content = str | list[Record]
"""A message's content: text, or blocks of images and text."""

NAME = "reel_household"
"""Name of the environment in ms-swift's registry."""

CONFIG = {
    "tasks": None,
    "scene": None,
    "task": None,
    "seed": None,
    "trace": None,
    "call": None,
    "profile": "real-gspo",
    "preset": "real-trainer",
    "skills": "perfect",
    "policy": "ms-swift",
    "images": True,
    "record_dir": None,
    "run": None,
    "group_size": 8,
    "max_turns": 50,
    "style": "conversation",
    "prompt": None,
    "reward": "total",
}
"""Keys of `env_config` and their defaults.

- `tasks`, `scene`, `profile`, `preset`, `skills`, `policy`, `images`, `record_dir`, `run`: as in
  `HouseholdEnv`;
- `task` (index or id), `seed`, or `trace` with `call`: where to start. Without any, the messages of the
  row name the task: `task_3` is the fourth, another text one that is drawn by its checksum;
- `group_size`: rollouts of a prompt group (`--num_generations`);
- `max_turns`: calls of a rollout (`--max_turns`);
- `style`: `conversation` (each user message is the result of the last call) or `single-turn` (each holds
  the task, the scene and the model's memory, as REAL's trainer puts it);
- `prompt`: with `single-turn` the template file; None: the one that comes with Reel;
- `reward`: `total`, or `success`: nothing before the end, then 1 for a success.
"""

_sources: Cache[EpisodeSource] = Cache(64)


def _source(config: Mapping[str, Any]) -> EpisodeSource:
    """The settings of a row, which all rows that are alike share."""
    chosen = {name: config[name] for name in SETTINGS}
    return _sources.get(json.dumps(chosen, sort_keys=True, default=str), lambda: EpisodeSource(**chosen))


def image_block(pixels: Any) -> Record:
    """An image as a block of a message: a PNG in a data URL."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG")
    return {"type": "image", "image": "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()}


def answer_text(action: Any) -> str:
    """The model's answer in what a step is given: messages (the last one of the assistant, else the
    last), a message, or a text."""
    if isinstance(action, str):
        return action
    if isinstance(action, Mapping):
        content: Any = cast("Mapping[str, Any]", action).get("content", "")
        if isinstance(content, list):
            blocks: list[Mapping[str, Any]] = [it for it in cast("list[Any]", content) if isinstance(it, Mapping)]
            return "".join(str(block.get("text", "")) for block in blocks)
        return str(content or "")
    if isinstance(action, Sequence) and action:
        messages = [cast("Mapping[str, Any]", it) for it in cast("Sequence[Any]", action) if isinstance(it, Mapping)]
        answers = [message for message in messages if message.get("role") == "assistant"]
        return answer_text(answers[-1]) if answers else answer_text(messages[-1]) if messages else ""
    return str(cast("Any", action))


class HouseholdGym:
    """An episode as ms-swift's `Env`: `reset`, `step` and `close` are coroutines.

    Args:
        env_config: keys of `CONFIG`; `name` is ms-swift's own.
    """

    def __init__(self, env_config: Mapping[str, Any] | None) -> None:
        given = {key: value for key, value in (env_config or {}).items() if key != "name"}
        if unknown := sorted(set(given) - set(CONFIG)):
            raise ReelError(f"env_config: unknown key {unknown[0]!r}; the keys are {', '.join(CONFIG)}")
        self.env_config = dict(env_config or {})
        self.config: Record = {**CONFIG, **{key: value for key, value in given.items() if value is not None}}
        if self.config["style"] not in ("conversation", "single-turn"):
            raise ReelError(f"env_config: style {self.config['style']!r} is unknown; give conversation or single-turn")
        checked_reward(self.config["reward"])
        self.tools = ToolSet(self.config["profile"])
        self._episode: Episode | None = None
        self._prompt: Prompt | None = None
        self._turns = 0
        self._paid_by_trainer = False

    async def reset(self, config: Any) -> tuple[Content, Record, str]:
        """Starts the episode of a request.

        Args:
            config: ms-swift's `RolloutInferRequest`. Its messages name the prompt group.

        Returns:
            The first user message, `task_id`, `episode_id`, `seed`, `group_id`, `rollout_index` and
            `trace`, and the system message.
        """
        return await asyncio.to_thread(self._reset, config)

    async def step(self, action: Any) -> tuple[Content, float, bool, Record]:
        """Makes the call of the model's last answer.

        Args:
            action: the conversation so far, the answer last. One without a call is told so.

        Returns:
            The next user message, the reward, whether the episode is over, and `reward_terms`; at the
            end also `success`, `end_reason`, `total_reward`, `completion`, `length` and `trace`.
        """
        return await asyncio.to_thread(self._step, action)

    async def close(self) -> None:
        """Ends the episode, as aborted if it still runs; its trace is complete then."""
        if self._episode is not None:
            await asyncio.to_thread(self._episode.close)

    def _reset(self, request: Any) -> tuple[Content, Record, str]:
        if self._episode is not None:
            self._episode.close()
        config = self.config
        source = _source(config)
        groups = GroupCounter(source, int(config["group_size"]))
        name = answer_text([message for message in request.messages if message.get("role") == "user"])
        task, seed = self._start(source, name)
        episode = self._episode = groups.start(config, task, seed)
        self._turns = 0
        self._paid_by_trainer = episode.opened.simulation.header["reward_preset"] == "real-trainer"
        if config["style"] == "single-turn":
            self._prompt = Prompt.load(config["prompt"], int(config["max_turns"]))
        opened = episode.opened
        info: Record = {
            "task_id": opened.task_id,
            "episode_id": episode.id,
            "seed": opened.seed,
            **episode.trace_entry(),
        }
        if opened.group is not None:
            info["group_id"], info["rollout_index"] = opened.group
        return self._message(None), info, "" if self._prompt is not None else self._system()

    def _start(self, source: EpisodeSource, name: str) -> tuple[int | str, int]:
        """Task and seed of a row."""
        config = self.config
        number = re.fullmatch(r"task_(\d+)", name.strip())
        drawn = int(number[1]) if number else zlib.crc32(name.encode("utf-8", "replace"))
        task = config["task"] if config["task"] is not None else drawn % max(len(source.task_ids), 1)
        return task, int(config["seed"] if config["seed"] is not None else drawn)

    def _system(self) -> str:
        tools = "\n".join(json.dumps(spec) for spec in self.tools.specs if self._offers(spec["name"]))
        return f"{SYSTEM}\n\nTools:\n{tools}\n\n{ANSWER_FORM}"

    def _offers(self, tool: str) -> bool:
        # the server of branch gspo has no user
        return not (self.config["profile"] == "real-gspo" and tool == "ask")

    def _step(self, action: Any) -> tuple[Content, float, bool, Record]:
        episode = self._episode
        if episode is None:
            raise ReelError("no episode runs: call reset() first")
        if episode.ended:
            return ENDED, 0.0, True, episode.outcome()
        text = answer_text(action)
        answer = read_answer(text)
        output = {"raw": text or " "}
        if answer.reasoning:
            output["reasoning"] = answer.reasoning
        name, arguments = answer.call
        native = episode.opened.simulation._native
        result = native.step(name, arguments, output)
        terms = result.reward_terms
        episode.advance(result)
        self._turns += 1
        # the published trainer is done when no target remains: nothing after it is paid
        done = self._paid_by_trainer and "perfect_match" in terms
        if done or self._turns >= int(self.config["max_turns"]):
            episode.close()
        if self._prompt is not None:
            self._prompt.update(answer, episode.observation.text)
        info: Record = {"reward_terms": terms} | (episode.outcome() if episode.ended else {})
        reward = float(result.reward) + 0.0
        if self.config["reward"] == "success":
            reward = float(episode.ended and info["success"])
        return self._message(answer), reward, episode.ended, info

    def _message(self, answer: Answer | None) -> Content:
        """The next user message: what the last call gave, with its image."""
        episode = self._episode
        assert episode is not None
        seen = episode.observation
        image = episode.image if self.config["images"] else None
        result = ""
        if answer is not None or seen.text:
            result = result_text(answer.call[0] if answer is not None else "The last call", seen.text)
        if self._prompt is None:
            text = briefing(episode) if answer is None else ""
            text += f"Result: {result}" if result else ""
            return [image_block(image), {"type": "text", "text": text}] if image is not None else text
        shown = f"Result: {result}" if result else ""
        if image is not None:
            shown = f"View: <image>\n{shown}".rstrip()
        task, scene = seen.instruction, scene_lines(episode.receptacles)
        text = self._prompt.render(task, scene, shown, seen.held)
        if image is None:
            return text
        before, _, after = text.rpartition("<image>")
        return [{"type": "text", "text": before}, image_block(image), {"type": "text", "text": after}]


def register() -> type[Any]:
    """Registers the environment with ms-swift under `reel_household`; the plug-in calls it.

    Returns:
        The class that ms-swift makes environments of.

    Raises:
        MissingPackageError: ms-swift is not installed.
    """
    try:
        # by name: the types are the same whether or not ms-swift is installed where they are checked
        gym_env: Any = importlib.import_module("swift.rollout.gym_env")
    except ImportError as error:
        raise missing("swift", error) from error
    registry: dict[str, type[Any]] = gym_env.envs
    if NAME not in registry:
        registry[NAME] = type("HouseholdGym", (HouseholdGym, gym_env.Env), {"__doc__": HouseholdGym.__doc__})
    return registry[NAME]


def plugin_path() -> Path:
    """The file for `--external_plugins`."""
    # in a folder of its own: ms-swift puts it on the module path, where `swift.py` would hide ms-swift
    return Path(__file__).parent / "plugin" / "reel_household_plugin.py"


if __name__ == "__main__":
    print(plugin_path())

__all__ = ["CONFIG", "NAME", "HouseholdGym", "plugin_path", "register"]
