"""Several household episodes that are stepped together, on all cores, in one process.

    from reel.envs import HouseholdVectorEnv

    envs = HouseholdVectorEnv(8, tasks="tasks", images=False)
    observations, infos = envs.reset(seed=1)
    observations, rewards, terminated, truncated, infos = envs.step(envs.action_space.sample())
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from .. import _reel
from .._types import PathLike
from .._play import Tasks
from .._reel import ReelError, StepResult
from ._extras import missing
from ._play import IMAGE_SHAPE, Episode, Record, open_episode

try:
    from gymnasium.utils.seeding import np_random
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space, iterate

    from .gymnasium import HouseholdEnv, no_pickle, observation_space, observe, start_info, step_info
except ImportError as error:
    raise missing("gymnasium", error) from error


Results = tuple[Record, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], Record]


class HouseholdVectorEnv(VectorEnv[Record, Any, Any]):
    """Several `HouseholdEnv`s in one: `step` makes the calls of all episodes at the same time, on
    all cores and without the interpreter's lock.

    Args:
        num_envs: number of episodes.
        tasks: a task file, a folder of them, or `Tasks`; None: episodes start from traces only.
        autoreset_mode: `NEXT_STEP` (the step after an end resets), `SAME_STEP` (the step of an end
            resets, and `final_obs` and `final_info` hold the end), or `DISABLED` (`reset` with
            options `reset_mask`).
        options: further arguments are those of `HouseholdEnv`.
    """

    def __init__(
        self,
        num_envs: int = 1,
        tasks: PathLike | Tasks | None = None,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        **options: Any,
    ) -> None:
        if num_envs < 1:
            raise ReelError(f"num_envs is {num_envs}; give at least 1")
        # what all episodes share
        single = HouseholdEnv(tasks, **options)
        self.num_envs = num_envs
        self.source = single.source
        self.images = single.images
        self.render_mode = single.render_mode
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**single.metadata, "autoreset_mode": self.autoreset_mode}
        self.tools = single.tools
        self.single_observation_space = observation_space(single.images)
        self.single_action_space = self._tool_calls = single._tool_calls
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._episodes: list[Episode | None] = [None] * num_envs
        self._ended = np.zeros(num_envs, np.bool_)
        self._draws: list[np.random.Generator | None] = [None] * num_envs

    def reset(self, *, seed: int | Sequence[int | None] | None = None, options: Any = None) -> tuple[Record, Record]:
        """Starts all episodes, or those of a mask.

        Args:
            seed: seed of the simulators: one for each, or a number that the first one has, the second
                one more, and so on; None: they are drawn.
            options: those of `HouseholdEnv.reset`, for all episodes or a list of one for each. Where
                they name a task and a `group`, all episodes have the same seed: siblings of one prompt
                group. `reset_mask` (bool array of `num_envs`): only these episodes.

        Returns:
            Batched observations and infos.
        """
        super().reset(seed=seed if isinstance(seed, int) else None)
        each, mask = self._options(options)
        seeds = self._seeds(seed, each)
        infos: Record = {}
        for index in map(int, np.flatnonzero(mask)):
            self._start(index, each[index], seeds[index], infos)
        if any(episode is None for episode in self._episodes):
            raise ReelError("reset: reset_mask leaves out episodes that never began; reset all of them first")
        return self._observe(), infos

    def step(self, actions: Any) -> Results:
        """Makes a call in each episode.

        Args:
            actions: a member of `action_space`, or a sequence of one action for each episode in any
                form that `HouseholdEnv.step` takes.

        Returns:
            Batched observations, rewards (float64), terminated and truncated (bool), and infos.
        """
        calls = [self.tools.answer(action) for action in self._each(actions)]
        if self.autoreset_mode is AutoresetMode.DISABLED and self._ended.any():
            raise ReelError(f"episode {int(np.argmax(self._ended))} has ended: reset it with options reset_mask")
        resetting = self._ended.copy()
        stepping = [index for index in range(self.num_envs) if not resetting[index]]
        running = [self._running(index) for index in stepping]
        results = self._step(running, [calls[index] for index in stepping])
        rewards = np.zeros(self.num_envs, np.float64)
        terminated, truncated = np.zeros(self.num_envs, np.bool_), np.zeros(self.num_envs, np.bool_)
        infos: Record = {}
        finals: list[int] = []
        for index, episode, result in zip(stepping, running, results, strict=True):
            rewards[index] = result.reward
            terminated[index], truncated[index] = result.terminated, result.truncated
            terms = result.reward_terms
            episode.advance(result, keep_image=self.render_mode is not None)
            info = {"reward_terms": terms} | step_info(episode)
            if episode.ended and self.autoreset_mode is AutoresetMode.SAME_STEP:
                finals.append(index)
                info = {"final_obs": observe(episode, self.images), "final_info": info}
            infos = self._add_info(infos, info, index)
        for index in [*np.flatnonzero(resetting), *finals]:
            self._start_next(int(index), infos)
        self._ended = terminated | truncated
        if finals:
            self._ended[finals] = False
        return self._observe(), rewards, terminated, truncated, infos

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """What the heads of all robots see: 480 x 640 x 3, uint8, RGB each; None without a render
        mode."""
        if self.render_mode is None:
            return None
        return tuple(episode.render() for episode in self._episodes if episode is not None)

    def close_extras(self, **kwargs: Any) -> None:
        """Ends the episodes, as aborted where they still run."""
        for episode in self._episodes:
            if episode is not None:
                episode.close()

    def _step(self, episodes: list[Episode], calls: list[tuple[str, Any, Record | None]]) -> list[StepResult]:
        """Makes a call in each of these episodes, in one native call."""
        return _reel.step_all([episode.opened.simulation._native for episode in episodes], calls)

    def _running(self, index: int) -> Episode:
        episode = self._episodes[index]
        if episode is None:
            raise ReelError("no episodes run: call reset() first")
        return episode

    def _each(self, actions: Any) -> list[Any]:
        """One action for each episode."""
        if isinstance(actions, Mapping):
            each = list(iterate(self.action_space, actions))  # pyright: ignore
        elif isinstance(actions, Iterable) and not isinstance(actions, (str, bytes)):
            each = list(actions)  # pyright: ignore[reportUnknownArgumentType, reportUnknownVariableType]
        else:
            raise ReelError(f"actions of {self.num_envs} episodes are a batch or a sequence, not {actions!r}")
        if len(each) != self.num_envs:  # pyright: ignore[reportUnknownArgumentType]
            raise ReelError(f"{len(each)} actions for {self.num_envs} episodes")  # pyright: ignore
        return each  # pyright: ignore[reportUnknownVariableType]

    def _options(self, options: Any) -> tuple[list[Record], NDArray[np.bool_]]:
        """The options of each episode, and which are reset."""
        mask = np.ones(self.num_envs, np.bool_)
        if options is None:
            return [{} for _ in range(self.num_envs)], mask
        if isinstance(options, Mapping):
            shared: Record = dict(options)  # pyright: ignore[reportUnknownArgumentType]
            if (given := shared.pop("reset_mask", None)) is not None:
                mask = np.asarray(given)
                if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
                    raise ReelError(f"reset_mask is a bool array of shape ({self.num_envs},) with a True in it")
            if "record" in shared:
                raise ReelError("reset: 'record' names one trace; give record_dir, or options for each episode")
            return [shared] * self.num_envs, mask
        each = [dict(option or {}) for option in options]
        if len(each) != self.num_envs:
            raise ReelError(f"reset: {len(each)} options for {self.num_envs} episodes")
        return each, mask

    def __reduce__(self) -> NoReturn:
        raise no_pickle("HouseholdVectorEnv")

    def _seeds(self, seed: int | Sequence[int | None] | None, options: list[Record]) -> Sequence[int | None]:
        """The seed of each episode; None where its own draws go on."""
        if isinstance(seed, Sequence):
            if len(seed) != self.num_envs:
                raise ReelError(f"reset: {len(seed)} seeds for {self.num_envs} episodes")
            return seed
        siblings = all("group" in option and "task" in option for option in options)
        if seed is None:
            return [int(self.np_random.integers(2**31))] * self.num_envs if siblings else [None] * self.num_envs
        return [seed] * self.num_envs if siblings else [seed + index for index in range(self.num_envs)]

    def _start_next(self, index: int, infos: Record) -> None:
        """Resets one episode by itself: another task, another seed."""
        if self.source.tasks is None:
            raise ReelError("no tasks to go on with: give tasks=PATH, or autoreset_mode DISABLED")
        self._start(index, {}, None, infos)

    def _start(self, index: int, options: Mapping[str, Any], seed: int | None, infos: Record) -> None:
        # drawn as a HouseholdEnv draws: equal seeds give equal episodes
        draws = self._draws[index]
        if seed is not None:
            draws, _ = np_random(int(seed))
        elif draws is None:
            draws = np.random.default_rng(int(self.np_random.integers(2**63)))
        self._draws[index] = draws
        task = int(draws.integers(max(len(self.source.task_ids), 1)))
        seed = int(draws.integers(2**31)) if seed is None else int(seed)
        if (former := self._episodes[index]) is not None:
            former.close()
        episode = self._episodes[index] = open_episode(self.source, options, task, seed)
        self._ended[index] = False
        if index == 0:
            names = [name for name, _, _ in episode.receptacles]
            self._tool_calls.set_vocabulary(names, episode.observation.instruction)
        self._add_info(infos, start_info(episode), index)

    def _observe(self) -> Record:
        """The observations of all episodes, a member of `observation_space`."""
        each = [observe(episode, self.images) for episode in self._episodes if episode is not None]
        batch: Record = {
            name: tuple(observation[name] for observation in each)
            for name in ("instruction", "receptacles", "text", "error", "held")
        }
        batch["step"] = np.array([observation["step"] for observation in each], np.int64)
        if self.images:
            batch["has_image"] = np.array([observation["has_image"] for observation in each], np.int64)
            images = np.empty((self.num_envs, *IMAGE_SHAPE), np.uint8)
            for index, observation in enumerate(each):
                images[index] = observation["image"]
            batch["image"] = images
        return batch


__all__ = ["AutoresetMode", "HouseholdVectorEnv"]
