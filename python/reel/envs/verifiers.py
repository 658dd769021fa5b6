"""Household tasks as an environment of verifiers 0.4: taskset, task, harness and environment.

    import verifiers.v1 as vf
    from reel.envs import load_environment

    env = load_environment(tasks="tasks", record_dir="rollouts")
    async with env.serving():
        for task in env.taskset:
            episode = await env.run_episode(task, vf.ModelContext(model=..., client=...))

On the command line and in a trainer's configuration the taskset is `reel-household`:
`vf-eval reel-household --env.taskset.tasks tasks`.

The harness plays in this process: it asks the model through the rollout's endpoint, with the tools as
native functions, and makes the calls in the simulator. Other harnesses get the tools over MCP with
`--env.taskset.task.tool-server true`.
"""

# pyright: reportMissingTypeStubs=false, reportMissingTypeArgument=false, reportUnknownMemberType=false
# pyright: reportUnknownParameterType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import asyncio
import json
import os
import time
from collections.abc import Iterator
from typing import Any, cast

from .._types import PathLike, Record
from .._play import Tasks
from .._reel import ReelError
from ._calls import NO_CALL, Call, ToolSet, as_text, call, parsed
from ._episodes import SETTINGS, Cache, EpisodeSource, unique_run
from ._extras import missing
from ._play import Episode
from ._rollouts import ENDED, SYSTEM, GroupCounter, briefing

try:
    import openai
    import verifiers.v1 as vf
except ImportError as error:
    raise missing("verifiers", error) from error


TASKSET_ID = "reel-household"
"""Id of the taskset in configurations."""


class HouseholdState(vf.State):
    """How a rollout went. Privileged: for scores, never for the model."""

    episode_id: str = ""
    total_reward: float = 0.0
    success: bool = False
    completion: float = 0.0
    length: int = 0
    end_reason: str = ""
    trace: str = ""
    """Path of the trace; empty if it is not recorded."""

    def take(self, episode: Episode) -> None:
        """Takes over what is known of an episode."""
        outcome = episode.outcome() if episode.ended else episode.trace_entry()
        self.episode_id = episode.id
        self.total_reward = episode.total_reward
        self.success = bool(outcome.get("success"))
        self.completion = float(outcome.get("completion") or 0.0)
        self.length = int(outcome.get("length") or episode.observation.step)
        self.end_reason = str(outcome.get("end_reason") or "")
        self.trace = str(outcome.get("trace") or "")


class HouseholdData(vf.TaskData):
    """A task, or a moment of a recorded episode, with the settings to play it."""

    settings: dict[str, Any] = {}
    """Settings of the episodes: `tasks`, `profile`, `preset`, ... (`HouseholdConfig`)."""
    task: str = ""
    seed: int = 0
    trace: str = ""
    """Trace to start from; empty: from the start of the task."""
    call: int = 0
    group_size: int = 8


class HouseholdTaskConfig(vf.TaskConfig):
    """Settings of how tasks are played and scored."""

    reward: str = "total"
    """What a rollout earns: `total`, the sum of its step rewards, or `success`."""
    tool_server: bool = False
    """Whether the tools are served over MCP, for harnesses other than `reel-household`."""


class HouseholdTask(vf.Task[HouseholdData, HouseholdState, HouseholdTaskConfig]):
    """A household task; its score is Reel's reward, or its success."""

    @property
    def key(self) -> str:
        """The task with its seed, or the trace with its call."""
        data = self.data
        return f"{data.trace}@{data.call}" if data.trace else f"{data.task}--{data.seed}"

    @vf.stop
    async def ended(self, trace: vf.Trace) -> bool:
        """Whether the episode has ended: no further model call is made."""
        return bool(cast(HouseholdState, trace.state).end_reason)

    @vf.reward
    async def household(self, trace: vf.Trace) -> float:
        """The sum of the step rewards, or 1 for a success."""
        state = cast(HouseholdState, trace.state)
        return float(state.success) if cast(HouseholdTaskConfig, self.config).reward == "success" else state.total_reward

    @vf.metric
    async def outcome(self, trace: vf.Trace) -> dict[str, float]:
        """Success, completion (0 to 1), calls made, and the sum of the step rewards."""
        state = cast(HouseholdState, trace.state)
        return {
            "success": float(state.success),
            "completion": state.completion,
            "calls": float(state.length),
            "total_reward": state.total_reward,
        }

    async def finalize(self, trace: vf.Trace, runtime: vf.Runtime) -> None:
        """Names the recorded episode in the trace of verifiers."""
        state = cast(HouseholdState, trace.state)
        trace.info["reel"] = {
            "episode_id": state.episode_id,
            "trace": state.trace,
            "end_reason": state.end_reason,
        }

    @classmethod
    def toolsets(cls, config: HouseholdTaskConfig) -> list[vf.Toolset]:
        """The tool server, where another harness plays."""
        if not config.tool_server:
            return []
        from ._tool_server import HouseholdToolset

        # the generics of verifiers are invariant in the state
        return [HouseholdToolset(vf.ToolsetConfig())]  # pyright: ignore[reportReturnType]


class HouseholdConfig(vf.TasksetConfig):
    """Which tasks, and how they are played."""

    tasks: str | None = None
    """A task file, or a folder of them."""
    scene: str | None = None
    """The scene for all tasks; None: the one that each task names."""
    seeds: list[int] = [0]
    """Seeds to play each task with."""
    starts: list[tuple[str, int]] = []
    """Traces with a call of each, to start from the moment before it."""
    profile: str = "paper"
    """`paper`, `real-repo` or `real-gspo`: which server the agent meets."""
    preset: str = "paper"
    """Reward preset of the steps."""
    skills: str = "perfect"
    """`perfect`, or `real-v1`: picks, places and doors fail as on the paper's robot."""
    policy: str = "verifiers"
    """Name of who decides, for the traces."""
    images: bool = True
    """Whether tools return images."""
    record_dir: str | None = None
    """Folder for the traces; None: rollouts are not recorded."""
    run: str | None = None
    """Name that the traces give the run; None: a new one for each process."""
    group_size: int = 8
    """Rollouts of a prompt group."""
    task: HouseholdTaskConfig = HouseholdTaskConfig()  # pyright: ignore[reportIncompatibleVariableOverride]

    def settings(self) -> Record:
        """The settings of the episodes."""
        return {name: getattr(self, name) for name in SETTINGS}


class HouseholdTaskset(vf.Taskset[HouseholdTask, HouseholdConfig]):  # pyright: ignore[reportInvalidTypeArguments]
    """A task for each task file and seed, and for each start."""

    def load(self) -> Iterator[HouseholdTask]:
        """The tasks, each with its first message."""
        config = self.config
        settings = config.settings()
        source = source_of(settings)
        if not source.task_ids and not config.starts:
            raise ReelError("no tasks: give tasks=PATH, or starts=[[TRACE, CALL]]")
        # text of a first message, which neither seed nor image changes
        text_source = EpisodeSource(
            source.tasks, profile=config.profile, preset=config.preset, policy=config.policy, images=False, run="load"
        )
        prompts: dict[str, str] = {}
        shared: Record = {"settings": settings, "system_prompt": SYSTEM, "group_size": config.group_size}
        for seed in config.seeds:
            for task in source.task_ids:
                if task not in prompts:
                    prompts[task] = first_text(Episode(text_source.start(task, seed)))
                data = HouseholdData(name=f"{task}--{seed}", prompt=prompts[task], task=task, seed=seed, **shared)
                yield HouseholdTask(data, config.task)
        for trace, at in config.starts:
            prompt = first_text(Episode(text_source.fork(trace, at)))
            data = HouseholdData(name=f"{trace}@{at}", prompt=prompt, trace=trace, call=at, **shared)
            yield HouseholdTask(data, config.task)


class HouseholdHarnessConfig(vf.HarnessConfig):
    """The harness has no settings of its own."""

    id: str = TASKSET_ID


class HouseholdHarness(vf.Harness[HouseholdHarnessConfig]):
    """Plays an episode in this process: a model call, its tool calls, their results, and so on.

    An answer without a tool call is a step, too: the simulator says that it held none.
    """

    APPENDS_SYSTEM_PROMPT = True
    EXECUTES_CODE = False
    NEEDS_CONTAINER = False

    async def launch(
        self,
        ctx: vf.ModelContext,
        trace: vf.Trace,
        runtime: vf.Runtime,
        endpoint: str,
        secret: str,
        mcp_urls: dict[str, str],
        data: vf.TaskData,
    ) -> vf.ProgramResult:
        """Plays until the episode ends, or the rollout's limits stop it."""
        if mcp_urls:
            raise ReelError("harness reel-household makes the calls itself; leave tool_server false")
        household = cast(HouseholdData, data)
        tools = ToolSet(household.settings["profile"])
        state = cast(HouseholdState, trace.state)
        episode = await asyncio.to_thread(open_rollout, household)
        system, prompt = self.resolve_text_prompt(data)
        messages: list[Record] = [{"role": "system", "content": system}] if system else []
        messages.append({"role": "user", "content": content(prompt or "", episode, household)})
        client = openai.AsyncOpenAI(base_url=endpoint, api_key=secret, max_retries=0, timeout=None)
        try:
            while not episode.ended:
                started = time.monotonic_ns()
                try:
                    reply = await client.chat.completions.create(
                        model=ctx.model, messages=cast(Any, messages), tools=cast(Any, tools.functions())
                    )
                except openai.APIStatusError:
                    if trace.stop_condition is not None:
                        break  # a limit of the rollout
                    raise
                message = reply.choices[0].message.model_dump(exclude_none=True)
                messages.append({"role": "assistant", "content": "", **message})
                output = policy_output(message, reply.usage, time.monotonic_ns() - started)
                for answer, id in calls_of(message):
                    await asyncio.to_thread(make_call, episode, answer, output)
                    shown = content(episode.observation.text, episode, household)
                    messages.append(
                        {"role": "user", "content": shown}
                        if id is None
                        else {"role": "tool", "tool_call_id": id, "content": shown}
                    )
        finally:
            await client.close()
            await asyncio.to_thread(episode.close)
            state.take(episode)
        return vf.ProgramResult(exit_code=0, stdout="", stderr="")


class HouseholdEnvConfig(vf.EnvConfig):
    """Configuration of the environment: one agent, in this process."""

    taskset: HouseholdConfig = HouseholdConfig(id=TASKSET_ID)  # pyright: ignore[reportIncompatibleVariableOverride]
    agent: vf.AgentConfig = vf.AgentConfig(runtime=vf.SubprocessConfig())


class HouseholdVerifiersEnv(vf.Env[HouseholdEnvConfig]):
    """One agent that plays one episode."""

    async def run(self, task: vf.Task[Any, Any, Any], agents: vf.Agents) -> None:
        """Plays the episode."""
        await agents.agent.run(task)


_sources: Cache[EpisodeSource] = Cache(64)
_run = unique_run("verifiers")


def source_of(settings: Record) -> EpisodeSource:
    """The settings as an opener of episodes, the same for equal ones."""
    key = json.dumps(settings, sort_keys=True, default=str)
    named: Record = {**settings, "run": settings.get("run") or _run}
    return _sources.get(key, lambda: EpisodeSource(**named))


def open_rollout(data: HouseholdData) -> Episode:
    """Opens the episode of a task, as the next one of its prompt group."""
    groups = GroupCounter(source_of(data.settings), data.group_size)
    return groups.start({"trace": data.trace, "call": data.call}, data.task, data.seed)


def first_text(episode: Episode) -> str:
    """The first message of an episode, which is closed."""
    last = episode.observation.text
    episode.close()
    return briefing(episode) + (f"\nLast result: {last}\n" if last else "")


def policy_output(message: Record, usage: Any, latency_ns: int) -> Record:
    """What the model wrote with its calls, for the trace."""
    output: Record = {"raw": as_text(json.dumps(message)), "latency_ns": latency_ns}
    if reasoning := message.get("reasoning_content") or message.get("reasoning"):
        output["reasoning"] = str(reasoning)
    if usage is not None:
        output["tokens"] = [usage.prompt_tokens, usage.completion_tokens]
    return output


def calls_of(message: Record) -> list[tuple[Call, str | None]]:
    """The tool calls of an answer with their ids; one that is no call if it has none."""
    calls: list[tuple[Call, str | None]] = []
    for tool_call in message.get("tool_calls") or []:
        function = tool_call.get("function") or {}
        arguments = parsed(function.get("arguments") or "{}")
        calls.append((call(str(function.get("name", "")), arguments), tool_call.get("id")))
    return calls or [(NO_CALL, None)]


def make_call(episode: Episode, answer: Call, output: Record) -> None:
    """Makes a call; after the end nothing happens."""
    if not episode.ended:
        native = episode.opened.simulation._native
        episode.advance(native.step(*answer, output))


def content(text: str, episode: Episode, data: HouseholdData) -> str | list[Record]:
    """A message's content: the text and, with images, the view."""
    if episode.ended:
        text = f"{text}\n{ENDED}"
    image = episode.image if data.settings["images"] else None
    if image is None:
        return text
    from .swift import image_block

    return [
        {"type": "text", "text": text},
        {"type": "image_url", "image_url": {"url": image_block(image)["image"]}},
    ]


def load_environment(
    tasks: PathLike | None = None, *, reward: str = "total", **settings: Any
) -> HouseholdVerifiersEnv:
    """The environment, ready to serve.

    Args:
        tasks: a task file, or a folder of them.
        reward: what a rollout earns: `total`, the sum of its step rewards, or `success`.
        settings: further fields of `HouseholdConfig`: `seeds`, `starts`, `profile`, `preset`, `images`,
            `record_dir`, `group_size`, ...
    """
    if isinstance(tasks, Tasks):
        raise ReelError("verifiers passes tasks between processes: give their path")
    paths = {key: os.fspath(value) if isinstance(value, os.PathLike) else value for key, value in settings.items()}
    config = HouseholdConfig(
        id=TASKSET_ID,
        tasks=None if tasks is None else os.fspath(tasks),
        task=HouseholdTaskConfig(reward=reward),
        **paths,
    )
    # pydantic fills in the rest
    return HouseholdVerifiersEnv(HouseholdEnvConfig(taskset=config))  # pyright: ignore[reportCallIssue]


__all__ = [
    "HouseholdHarness",
    "HouseholdTaskset",
    "HouseholdVerifiersEnv",
    "load_environment",
]
