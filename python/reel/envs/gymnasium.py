"""Household tasks as a Gymnasium environment.

    import gymnasium
    import reel.envs

    env = gymnasium.make("reel/Household-v0", tasks="tasks")
    observation, info = env.reset(seed=1)
    observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
"""

from __future__ import annotations

from typing import Any, ClassVar, NoReturn

import numpy as np
from numpy.typing import NDArray

from .._types import PathLike
from .._play import Tasks
from .._reel import ReelError
from ._calls import ToolSet
from ._episodes import EpisodeSource
from ._extras import missing
from ._play import IMAGE_SHAPE, Episode, Record, open_episode, step_episode

try:
    import gymnasium
    from gymnasium import spaces

    from ._spaces import TEXT_MAX, ToolCallSpace, UnicodeText
except ImportError as error:
    raise missing("gymnasium", error) from error


STEP_MAX = 1000
"""Most calls of an episode: 30 in profile `paper`, 1,000 in the published ones."""


def observation_space(images: bool) -> spaces.Dict:
    """What an agent sees.

    | key | value |
    |---|---|
    | `instruction` | the task in words |
    | `receptacles` | the receptacles of the home, a line each: `id (category, room)` |
    | `text` | what the last call answered; empty before the first |
    | `error` | code of the last call's error; empty if it did what it should |
    | `held` | category of what the gripper holds; empty if nothing |
    | `step` | calls made so far |
    | `image` | with images: 480 x 640 x 3, uint8, RGB; black if the last call gave none |
    | `has_image` | with images: 1 if the last call gave an image, else 0 |
    """
    texts = ("instruction", "receptacles", "text", "error", "held")
    entries: dict[str, spaces.Space[Any]] = {name: UnicodeText() for name in texts}
    entries["step"] = spaces.Discrete(STEP_MAX + 1)
    if images:
        entries["image"] = spaces.Box(0, 255, IMAGE_SHAPE, np.uint8)
        entries["has_image"] = spaces.Discrete(2)
    return spaces.Dict(entries)


def observe(episode: Episode, images: bool) -> Record:
    """The observation of an episode, a member of `observation_space(images)`."""
    seen = episode.observation
    observation: Record = {
        "instruction": seen.instruction[:TEXT_MAX],
        "receptacles": episode.scene[:TEXT_MAX],
        "text": seen.text[:TEXT_MAX],
        "error": seen.error or "",
        "held": seen.held or "",
        "step": seen.step,
    }
    if images:
        image = episode.image
        observation["has_image"] = int(image is not None)
        # black rather than an earlier image, which would pass for the current view
        observation["image"] = np.zeros(IMAGE_SHAPE, np.uint8) if image is None else image
    return observation


def start_info(episode: Episode) -> Record:
    """What `reset` tells beside the observation: ids, seed, receptacles, group and trace."""
    opened = episode.opened
    info: Record = {
        "task_id": opened.task_id,
        "episode_id": episode.id,
        "seed": opened.seed,
        "receptacles": list(episode.receptacles),
    }
    if opened.group is not None:
        info["group_id"], info["rollout_index"] = opened.group
    return info | episode.trace_entry()


def step_info(episode: Episode) -> Record:
    """What `step` tells beside the observation: the reward by component; at the end `success`,
    `end_reason`, `total_reward`, `completion`, `length` and the trace."""
    return episode.outcome() if episode.ended else {}


def no_pickle(name: str) -> TypeError:
    """Why an environment cannot be pickled: a simulation runs in this process, and a copy would give its
    episodes the ids of the original's."""
    return TypeError(
        f"a {name} cannot be pickled or copied, because its simulation runs in this process: make it in the worker "
        f"process, e.g. from functools.partial({name}, tasks='tasks')"
    )


class HouseholdEnv(gymnasium.Env[Record, Any]):
    """One robot in a simulated home, which carries out a task by calling tools.

    Args:
        tasks: a task file, a folder of them, or `Tasks`; None: episodes start from traces only.
        images: whether observations hold images. Without them nothing is drawn, which takes a third
            of the time, unless the episode is recorded: traces hold a digest of each image.
        scene: the scene for all tasks; None: the one that each task names.
        profile: `paper`, `real-repo` or `real-gspo`: which server the agent meets.
        preset: reward preset of the steps.
        skills: `perfect`, or `real-v1`: picks, places and doors fail as on the paper's robot.
        policy: name of who decides, for the traces.
        record_dir: folder for the traces; None: episodes are not recorded. Each call is on disk when
            `step` returns.
        run: name that the traces give the run; None: a new one for this process.
        render_mode: `rgb_array`, or None. With one images are rendered even if observations hold none.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 4}  # pyright: ignore

    def __init__(
        self,
        tasks: PathLike | Tasks | None = None,
        *,
        images: bool = True,
        scene: PathLike | None = None,
        profile: str = "paper",
        preset: str = "paper",
        skills: str = "perfect",
        policy: str = "python",
        record_dir: PathLike | None = None,
        run: str | None = None,
        render_mode: str | None = None,
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise ReelError(f"render_mode {render_mode!r} is unknown; give 'rgb_array' or None")
        self.source = EpisodeSource(
            tasks, scene=scene, profile=profile, preset=preset, skills=skills, policy=policy, images=images,
            draw=render_mode is not None, record_dir=record_dir, run=run,
        )  # fmt: skip
        self.images = images
        self.render_mode = render_mode
        self.tools = ToolSet(profile)
        self.observation_space = observation_space(images)
        self.action_space = self._tool_calls = ToolCallSpace(self.tools)
        self._episode: Episode | None = None

    def reset(self, *, seed: int | None = None, options: Record | None = None) -> tuple[Record, Record]:
        """Starts an episode.

        Args:
            seed: seed of the simulator and of the draws after it; None: both are drawn.
            options: where to start. `task`: index or id; without it one is drawn. `trace` and `call`:
                before that call of a recorded episode. `group`: name of its prompt group, or name and
                index; episodes from one call of a trace form one by themselves. `record`: path of the
                trace to write.

        Returns:
            The observation (`observation_space`), and `task_id`, `episode_id`, `seed`, `receptacles`
            (id, category, room of each), `group_id` and `rollout_index` in a group, `trace` if
            recorded.

        Raises:
            ReelError: an option is unknown or of another form, or what it names is missing.
        """
        super().reset(seed=seed)
        self._close_episode()
        task = int(self.np_random.integers(max(len(self.source.task_ids), 1)))
        simulator_seed = int(self.np_random.integers(2**31)) if seed is None else seed
        self._episode = open_episode(self.source, options or {}, task, simulator_seed)
        names = [name for name, _, _ in self._episode.receptacles]
        self._tool_calls.set_vocabulary(names, self._episode.observation.instruction)
        return observe(self._episode, self.images), start_info(self._episode)

    def step(self, action: Any) -> tuple[Record, float, bool, bool, Record]:
        """Makes a tool call.

        Args:
            action: a member of `action_space`, or a call in any form that `reel.Simulation.step`
                takes. What is no call is answered with an error text; it never raises.

        Returns:
            Observation, reward, terminated (the agent finished, or a fault), truncated (the horizon),
            and `reward_terms`; at the end also `success`, `end_reason`, `total_reward`, `completion`,
            `length`, and `trace` if recorded.
        """
        episode = self._running()
        result = step_episode(episode, self.tools, action)
        terms = result.reward_terms
        episode.advance(result, keep_image=self.render_mode is not None)
        info = {"reward_terms": terms} | step_info(episode)
        return observe(episode, self.images), float(result.reward) + 0.0, result.terminated, result.truncated, info

    def render(self) -> NDArray[np.uint8] | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """What the robot's head sees: 480 x 640 x 3, uint8, RGB, without markers; None without a
        render mode."""
        if self.render_mode is None or self._episode is None:
            return None
        return self._episode.render()

    def close(self) -> None:
        """Ends the episode, as aborted if it still runs."""
        self._close_episode()

    @property
    def simulation(self) -> Any:
        """The running `reel.Simulation`. Its records are privileged: no agent may see them."""
        return self._running().opened.simulation

    def __reduce__(self) -> NoReturn:
        raise no_pickle("HouseholdEnv")

    def _running(self) -> Episode:
        if self._episode is None:
            raise ReelError("no episode runs: call reset() first")
        if self._episode.ended:
            raise ReelError("the episode has ended: call reset()")
        return self._episode

    def _close_episode(self) -> None:
        if self._episode is not None:
            self._episode.close()


__all__ = ["HouseholdEnv", "observation_space"]
