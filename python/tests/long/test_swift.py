"""ms-swift's plug-in loader and its gym scheduler play household tasks, with answers that are scripted."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

gym_env = pytest.importorskip("swift.rollout.gym_env", reason="ms-swift is not installed: pip install 'reel[swift]'")

sys.path.insert(0, str(Path(__file__).parents[1]))

import reel  # noqa: E402
from env_fixtures import calls, tasks, traces  # noqa: E402
from reel.envs._published import Prompt, read_answer  # noqa: E402
from reel.envs._rollouts import text_of  # noqa: E402
from reel.envs.swift import NAME, HouseholdGym, plugin_path  # noqa: E402
from swift.infer_engine import RequestConfig  # noqa: E402
from swift.infer_engine.protocol import (  # noqa: E402
    ChatCompletionResponse,
    ChatCompletionResponseChoice,
    ChatMessage,
    RolloutInferRequest,
    RolloutOutput,
    UsageInfo,
)
from swift.rollout.agent_loop import run_multi_turn  # noqa: E402
from swift.rollout.multi_turn import GYMScheduler  # noqa: E402
from swift.template.template_inputs import StdTemplateInputs  # noqa: E402
from swift.utils import import_external_file  # noqa: E402

REPOSITORY = Path(__file__).parents[3]


def answer(name: str, arguments: dict[str, Any]) -> str:
    """A call in the published form."""
    said = {"summary": {"History": f"1) {name}"}, "next action": {"tool_name": name, "args": arguments}}
    return f"<think>as planned</think>{json.dumps(said)}"


def output(text: str) -> RolloutOutput:
    message = ChatMessage(role="assistant", content=text)
    choice = ChatCompletionResponseChoice(index=0, message=message, finish_reason="stop")
    usage = UsageInfo(prompt_tokens=1, completion_tokens=1, total_tokens=2)
    return RolloutOutput(response=ChatCompletionResponse(model="scripted", choices=[choice], usage=usage))


def request(content: str, uuid: str, **config: Any) -> RolloutInferRequest:
    row = {"env_config": {"name": NAME, "tasks": str(tasks()), **config}}
    return RolloutInferRequest(messages=[{"role": "user", "content": content}], data_dict=row, uuid=uuid)


@pytest.fixture(autouse=True, scope="module")
def plugin() -> None:
    path = subprocess.run([sys.executable, "-m", "reel.envs.swift"], capture_output=True, text=True, check=True)
    assert path.stdout.strip() == str(plugin_path())
    import_external_file(path.stdout.strip())


def test_the_loader_registers_the_environment() -> None:
    assert issubclass(gym_env.envs[NAME], gym_env.Env) and issubclass(gym_env.envs[NAME], HouseholdGym)


@pytest.mark.parametrize("style", ["conversation", "single-turn"])
def test_the_scheduler_plays_a_prompt_group(tmp_path: Path, style: str) -> None:
    trace = traces()[0]
    config: dict[str, Any] = {
        "trace": str(trace), "call": 0, "group_size": 2, "record_dir": str(tmp_path), "style": style,
    }  # fmt: skip
    requests = [request("task_0", f"u{index}", **config) for index in range(2)]
    scheduler = GYMScheduler(max_turns=50)
    asyncio.run(scheduler.on_trajectory_start(requests))
    first = requests[0].messages
    assert [message["role"] for message in first] == (["system", "user"] if style == "conversation" else ["user"])
    script = [answer(name, arguments) for name, arguments in calls(trace)]
    turns = iter(script[1:])

    def rollout(pending: list[RolloutInferRequest], _: RequestConfig) -> list[RolloutOutput]:
        text = next(turns) if pending else ""
        for waiting in pending:
            assert waiting.messages[-1]["role"] == "user"
        return [output(text) for _ in pending]

    outputs = run_multi_turn(requests, [output(script[0])] * 2, scheduler, rollout, RequestConfig(), 50)
    paid = [step.reward for step in reel.open(trace).steps]
    for played in outputs:
        infos = played.rollout_infos
        assert infos["num_turns"] == len(script) and infos["gym_done"]
        assert infos["step_rewards"] == pytest.approx(paid)
        inputs = StdTemplateInputs.from_dict({"messages": played.messages})
        assert inputs.images, "images reach the template"
        assert sum(str(message["content"]).count("<image>") for message in inputs.messages) == len(inputs.images)
    episodes = [reel.open(path) for path in reel.trace_paths(tmp_path)]
    assert all(episode.success for episode in episodes) and len({e.header["group_id"] for e in episodes}) == 1
    assert sorted(episode.header["rollout_index"] for episode in episodes) == [0, 1]
    assert episodes[0].steps[0].reasoning == "as planned"
    assert all(reel.replay(tmp_path, progress=False))


def test_rows_without_a_task_are_drawn_by_their_messages() -> None:
    async def start(content: str) -> tuple[Any, ...]:
        env = HouseholdGym(request(content, "u", images=False).data_dict["env_config"])
        first, info, system = await env.reset(request(content, "u"))
        await env.close()
        return first, info["task_id"], info["seed"], info["group_id"], info["rollout_index"]

    ids = reel.Tasks.load(tasks()).ids
    seventh, again = asyncio.run(start("task_7")), asyncio.run(start("task_7"))
    assert seventh[1:3] == (ids[7 % 4], 7) and seventh[0] == again[0]
    assert seventh[3] == again[3] and (seventh[4], again[4]) == (0, 1)
    assert asyncio.run(start("any words"))[1] in ids


def test_an_answer_without_a_call_costs_and_goes_on() -> None:
    async def play() -> Any:
        env = HouseholdGym({"tasks": str(tasks()), "images": False, "max_turns": 2})
        await env.reset(request("task_1", "u"))
        first = await env.step([{"role": "assistant", "content": "I do not know"}])
        second = await env.step("<think>{</think>```json\n" + answer("navigate_to", {"receptacle_name": "nowhere"}))
        after = await env.step(answer("pick", {"marker_id": "1"}))
        await env.close()
        return first, second, after

    first, second, after = asyncio.run(play())
    assert first[2] is False and first[1] == pytest.approx(-0.5) and "no call" in first[0]
    assert second[2] is True and second[3]["end_reason"] == "aborted" and second[3]["success"] is False
    assert after[2] is True and after[1] == 0.0


def test_an_episode_stops_where_the_published_trainer_stops(tmp_path: Path) -> None:
    reel.run(tasks(), "oracle", out=tmp_path, profile="real-gspo", preset="real-trainer", images=False, progress=False)
    # the oracle closes the door after the placement, which the trainer does not wait for
    parent = next(it for it in map(reel.open, reel.trace_paths(tmp_path)) if it.header["family"] == "FDO")

    async def play() -> tuple[int, dict[str, Any]]:
        env = HouseholdGym({"tasks": str(tasks()), "task": parent.header["task_id"], "seed": 0, "images": False})
        await env.reset(request("task_0", "u"))
        for number, step in enumerate(parent.steps, 1):
            _, _, done, info = await env.step(answer(step.tool, step.arguments))
            if done:
                return number, info
        raise AssertionError("it went on")

    number, info = asyncio.run(play())
    assert number == len(parent) - 2 and info["success"] and "perfect_match" in info["reward_terms"]
    assert info["total_reward"] == pytest.approx(parent.total_reward)


def test_wrong_configurations_are_named() -> None:
    with pytest.raises(reel.ReelError, match="unknown key 'task_path'"):
        HouseholdGym({"task_path": "x"})
    with pytest.raises(reel.ReelError, match="style"):
        HouseholdGym({"style": "x"})


def test_answers_are_read_as_the_published_trainer_reads_them() -> None:
    """The cases of docs/real-agents.md: nested objects, old names, shorthand, prose around."""
    pick = ("pick", {"marker_id": "3"})
    for text in (
        '{"next action": {"tool_name": "pick", "args": {"marker_id": "3"}}}',
        '<think>{"next action": "finish"}</think> so {"next_action": {"tool": "pick", "args": {"marker_id": "3"}}} ok',
        '```json\n{"tool_name": "pick", "arguments": {"marker_id": "3"}}\n```',
        '{"broken": {"name": "pick", "args": {"marker_id": "3"}}',
        """{"next action": "pick('3')"}""",
    ):
        assert read_answer(text).call == pick, text
    assert read_answer('{"next action": {"tool_name": "walk_around", "args": null}}').call == ("explore_receptacle", {})
    assert read_answer('{"next action": {"tool_name": "pick", "args": [1]}}').problem
    assert read_answer('{"Summary": [1], "next action": "finish"}').summary == [1]
    assert read_answer("{" * 5000).call == ("", {})


def test_the_texts_are_those_of_the_repository() -> None:
    for name in ("prompt.txt", "conversation.txt"):
        assert text_of(name) == (REPOSITORY / "src/prompt/texts" / name).read_text(encoding="utf-8")
    prompt = Prompt.load(None, 50)
    prompt.update(read_answer(answer("pick", {"marker_id": "1"})), "Picked up the object with marker 1.")
    text = prompt.render("the task", "the scene\n", "Result: x", "cup")
    assert "Hand: holding: cup" in text and "Questions asked: 0 of 8" in text and '"pick"' in text
