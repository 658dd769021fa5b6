"""Plays what its standard input says with the unmodified client of openenv-core 0.3.0, and prints what it was told as JSON.

    openenv_client.py URL EXAMPLE.py
"""

import asyncio
import base64
import io
import json
import runpy
import sys

from openenv.cli._validation import validate_running_environment
from openenv.core import GenericAction, GenericEnvClient, MCPToolClient
from openenv.core.env_server.mcp_types import CallToolAction


def refused(run, code):
    """The message of an error with this code."""
    try:
        run()
    except RuntimeError as error:
        assert f"(code: {code})" in str(error), error
        return str(error)
    raise AssertionError(f"no {code}")


def play_sync(url, episode):
    """Every call of an episode with the synchronous client: the rewards, and the last observation."""
    rewards = []
    with GenericEnvClient(base_url=url).sync() as env:
        first = env.reset(seed=episode["seed"], episode_id="from-python", task=episode["task_id"])
        assert first.reward is None and first.done is False, first
        seen = first.observation
        assert seen["instruction"] and seen["instruction"] in seen["text"] and seen["image"] is None, seen
        assert {tool["name"] for tool in seen["available_tools"]} >= {"nav_to", "pick", "place", "finish"}, seen
        assert {entry["id"] for entry in seen["receptacles"]} >= {"table_1"}, seen
        assert env.state() == {
            "episode_id": "from-python", "step_count": 0, "status": "playing", "task_id": episode["task_id"],
            "trace": seen["metadata"]["trace"],
        }, env.state()
        texts, told = [], json.dumps(seen)
        for call in episode["calls"]:
            result = env.step(call)
            rewards.append(result.reward)
            texts.append(result.observation["text"])
            told += json.dumps(result.observation)
            assert result.done == (call["name"] == "finish"), result
        assert texts == episode["texts"]
        assert episode["instances"] and not [name for name in episode["instances"] if name in told], told
        assert env.state()["step_count"] == len(rewards) and env.state()["status"] == "ended"
        assert "reset()" in refused(lambda: env.step(call), "EXECUTION_ERROR")
        # The session goes on after an error, and after an episode.
        assert refused(lambda: env.reset(task="no such task"), "EXECUTION_ERROR")
        assert refused(lambda: env.reset(tsak="x"), "VALIDATION_ERROR")
        assert refused(lambda: env.step({"tool": "nav_to"}), "VALIDATION_ERROR")
        assert env.reset(seed=3).observation["ok"] is True
        failed = env.step(GenericAction(name="nav_to", arguments={"receptacle_name": "nowhere"}))
        assert failed.observation["ok"] is False and failed.observation["error"]["code"], failed
        assert failed.reward is not None and not failed.done
    return {"rewards": rewards, "trace": seen["metadata"]["trace"], "last": result.observation}


async def play_async(url, episode, image):
    """The same with the asynchronous client and images on demand."""
    rewards, images = [], 0
    async with GenericEnvClient(base_url=url) as env:
        first = await env.reset(seed=episode["seed"], task=episode["task_id"], image=image)
        for call in [None, *episode["calls"]]:
            result = first if call is None else await env.step({**call, "metadata": {"reel/policy": {"reasoning": "because"}}})
            if call:
                rewards.append(result.reward)
            if result.observation["image"]:
                images += 1
                png = base64.b64decode(result.observation["image"])
                assert io.BytesIO(png).read(8) == b"\x89PNG\r\n\x1a\n"
        metadata = result.observation["metadata"]
    assert (images > 1) == image, images
    return {"rewards": rewards, "trace": metadata["trace"], "done": result.done}


async def play_together(url, episodes):
    """Sessions side by side do not disturb each other."""
    jobs = [play_async(url, episode, image=number % 2 == 0) for number, episode in enumerate(episodes * 3)]
    return await asyncio.gather(*jobs)


async def play_tools(url, episode):
    """The same with the client that knows tools and no actions."""
    async with MCPToolClient(base_url=url) as env:
        names = [tool.name for tool in await env.list_tools()]
        await env.reset(task=episode["task_id"], seed=episode["seed"])
        rewards = []
        for call in episode["calls"]:
            result = await env.step(CallToolAction(tool_name=call["name"], arguments=call["arguments"]))
            rewards.append(result.reward)
            assert result.observation.error is None and result.observation.result["data"], result
        await env.reset()
        text = await env.call_tool("show_receptacles")
        assert isinstance(text, str) and text, text
        state = await env.state()
        assert state.step_count == 1, state
    return {"tools": names, "rewards": rewards}


def play_branch(url, episode, call):
    """Two episodes that start from a call of a recorded one: the rest as recorded, and another decision."""
    told = []
    for nested in [False, True]:
        with GenericEnvClient(base_url=url).sync() as env:
            origin = {"trace": episode["trace"], "call": call}
            first = env.reset(options=origin) if nested else env.reset(**origin, episode_id="branch-1")
            assert first.observation["metadata"]["parent"] == origin, first
            assert episode["texts"][call - 1] in first.observation["text"], first
            assert env.state()["step_count"] == call
            rewards = []
            calls = [{"name": "finish", "arguments": {}}] if nested else episode["calls"][call:]
            for one in calls:
                result = env.step(one)
                rewards.append(result.reward)
            assert result.done
            told.append({"rewards": rewards, "trace": first.observation["metadata"]["trace"]})
            assert "100" in refused(lambda: env.reset(trace=episode["trace"], call=100), "EXECUTION_ERROR")
            assert refused(lambda: env.reset(trace="none"), "EXECUTION_ERROR")
            assert refused(lambda: env.reset(call=1), "VALIDATION_ERROR")
            assert refused(lambda: env.reset(trace=episode["trace"], seed=1), "VALIDATION_ERROR")
    return told


def main():
    url, example = sys.argv[1:]
    wanted = json.load(sys.stdin)
    episodes = wanted["episodes"]
    answer = {
        "sync": [play_sync(url, episode) for episode in episodes],
        "async": asyncio.run(play_together(url, episodes)),
        "tools": asyncio.run(play_tools(url, episodes[0])),
        "branches": [play_branch(url, episode, call) for episode, call in zip(episodes, wanted["branch_calls"])],
        "criteria": {one["id"]: one["passed"] for one in validate_running_environment(url)["criteria"]},
    }
    print(json.dumps(answer))
    runpy.run_path(example)


if __name__ == "__main__":
    main()
