"""verifiers 0.4 runs household tasks: its environment, rollouts and scores, with a model that is
scripted behind an OpenAI-compatible endpoint."""

from __future__ import annotations

import asyncio
import json
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("verifiers.v1", reason="verifiers is not installed: pip install 'reel[verifiers]'")

sys.path.insert(0, str(Path(__file__).parents[1]))

import reel  # noqa: E402
import verifiers.v1 as vf  # noqa: E402
from env_fixtures import calls, tasks, traces  # noqa: E402
from reel.envs import load_environment  # noqa: E402

Reply = Callable[[dict[str, Any]], dict[str, Any]]


def tool_call(name: str, **arguments: Any) -> dict[str, Any]:
    function = {"name": name, "arguments": json.dumps(arguments)}
    return {"content": None, "tool_calls": [{"id": "c1", "type": "function", "function": function}]}


@contextmanager
def endpoint(reply: Reply) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """An endpoint whose model answers as `reply` says; and the requests that it got."""
    requests: list[dict[str, Any]] = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            request = json.loads(self.rfile.read(int(self.headers["content-length"])))
            requests.append(request)
            message = {"role": "assistant", **reply(request)}
            finish = "tool_calls" if message.get("tool_calls") else "stop"
            body = json.dumps(
                {
                    "id": "1", "object": "chat.completion", "created": 0, "model": request["model"],
                    "choices": [{"index": 0, "message": message, "finish_reason": finish}],
                    "usage": {"prompt_tokens": 11, "completion_tokens": 7, "total_tokens": 18},
                }
            ).encode()  # fmt: skip
            self.send_response(200)
            self.send_header("content-type", "application/json")
            self.send_header("content-length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: Any) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/v1", requests
    finally:
        server.shutdown()


def play(env: vf.Env[Any], url: str, rollouts: int = 1) -> list[vf.Episode]:
    """Runs each task of an environment so often."""
    client = vf.EvalClientConfig(base_url=url, api_key_var="REEL_TEST_KEY")
    context = vf.ModelContext(model="scripted", client=client)

    async def run() -> list[vf.Episode]:
        async with env.serving():
            return [await env.run_episode(task, context) for task in env.taskset for _ in range(rollouts)]

    return asyncio.run(run())


def answers_so_far(request: dict[str, Any]) -> int:
    return sum(message["role"] == "assistant" for message in request["messages"])


@pytest.fixture(autouse=True)
def key(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("REEL_TEST_KEY", "none")


def test_a_rollout_is_played_scored_and_recorded(tmp_path: Path) -> None:
    trace = traces()[0]
    script = calls(trace)

    def reply(request: dict[str, Any]) -> dict[str, Any]:
        name, arguments = script[answers_so_far(request)]
        return tool_call(name, **arguments)

    env = load_environment(starts=[(str(trace), 0)], record_dir=tmp_path / "rollouts", group_size=2, images=True)
    with endpoint(reply) as (url, requests):
        episodes = play(env, url, rollouts=2)
    for episode in episodes:
        assert episode.ok, episode.errors or episode.traces[0].errors
        rollout = episode.traces[0]
        assert rollout.metrics["success"] == 1.0 and rollout.metrics["calls"] == len(script)
        assert rollout.reward == pytest.approx(reel.open(trace).total_reward)
        recorded = reel.open(rollout.info["reel"]["trace"])
        assert recorded.success and recorded.id == rollout.info["reel"]["episode_id"]
        output = recorded.steps[0].record["input"]["policy"]
        assert output["tokens"] == [11, 7] and "nav_to" in output["raw"] + str(script)
    headers = [reel.open(path).header for path in reel.trace_paths(tmp_path / "rollouts")]
    assert len({header["group_id"] for header in headers}) == 1
    assert sorted(header["rollout_index"] for header in headers) == [0, 1]
    assert all(reel.replay(tmp_path / "rollouts", progress=False))
    assert [tool["function"]["name"] for tool in requests[0]["tools"]] == [tool["name"] for tool in reel.tools()]
    first = requests[0]["messages"]
    assert first[0]["role"] == "system" and "Task: " in first[1]["content"][0]["text"]
    assert first[1]["content"][1]["image_url"]["url"].startswith("data:image/png;base64,")


def test_an_answer_without_a_call_is_a_step(tmp_path: Path) -> None:
    def reply(request: dict[str, Any]) -> dict[str, Any]:
        return {"content": "I think"} if answers_so_far(request) == 0 else tool_call("finish")

    env = load_environment(tasks(), images=False, record_dir=tmp_path, reward="success")
    assert len(list(env.taskset)) == 4
    with endpoint(reply) as (url, requests):
        episodes = play(env, url)
    assert len(episodes) == 4
    for episode in episodes:
        rollout = episode.traces[0]
        assert episode.ok and rollout.reward == 0.0 and rollout.metrics["calls"] == 2.0
        recorded = reel.open(rollout.info["reel"]["trace"])
        assert recorded.steps[0].error == "unparsable_output"
    assert "no call" in requests[1]["messages"][-1]["content"].lower()


def test_the_limit_of_a_rollout_ends_it(tmp_path: Path) -> None:
    env = load_environment(tasks(), images=False, record_dir=tmp_path)
    env.config.agent.max_turns = 2
    with endpoint(lambda _: tool_call("show_receptacles")) as (url, _):
        episode = play(env, url)[0]
    rollout = episode.traces[0]
    assert episode.ok and rollout.stop_condition == "max_turns" and rollout.metrics["calls"] == 2.0
    recorded = reel.open(rollout.info["reel"]["trace"])
    assert recorded.end and recorded.end["reason"] == "aborted"


def test_the_taskset_is_found_by_its_id() -> None:
    config = vf.resolve_env_config({"taskset": {"id": "reel-household", "tasks": str(tasks()), "images": False}})
    env = vf.load_environment(config)
    found = list(env.taskset)
    assert [task.data.task for task in found] == reel.Tasks.load(tasks()).ids
    assert len({task.key for task in found}) == 4
    assert vf.default_agent_harness("reel-household").id == "reel-household"


def test_the_tools_are_served_over_mcp_for_other_harnesses(tmp_path: Path) -> None:
    """A harness of the test's own connects to the tool server and plays."""
    from verifiers.v1.harnesses.utils.mcp import mcp_client

    seen: dict[str, Any] = {}

    class Harness(vf.Harness[vf.HarnessConfig]):
        APPENDS_SYSTEM_PROMPT = True
        SUPPORTS_MCP = True
        EXECUTES_CODE = False
        NEEDS_CONTAINER = False

        async def launch(self, ctx: Any, trace: Any, runtime: Any, endpoint: str, secret: str, urls: Any, data: Any) -> Any:  # noqa: PLR0913
            import openai

            (url,) = urls.values()
            async with mcp_client({"url": url}) as client:
                seen["tools"] = [tool.name for tool in (await client.list_tools()).tools]
                result = await client.call_tool("show_receptacles", {})
                seen["kinds"] = [block.type for block in result.content]
                model = openai.AsyncOpenAI(base_url=endpoint, api_key=secret)
                await model.chat.completions.create(model=ctx.model, messages=[{"role": "user", "content": "x"}])
                result = await client.call_tool("finish", {})
                seen["last"] = result.content[0].text
            return vf.ProgramResult(exit_code=0, stdout="", stderr="")

    env = load_environment(tasks(), record_dir=tmp_path)
    env.taskset.config.task.tool_server = True
    env = type(env)(env.config)
    task = next(iter(env.taskset))
    config = vf.AgentConfig(runtime=vf.SubprocessConfig())
    with endpoint(lambda _: {"content": "hello"}) as (url, _):
        client = vf.EvalClientConfig(base_url=url, api_key_var="REEL_TEST_KEY")

        async def run() -> Any:
            async with env.serving():
                agent = env._episode_agents(vf.ModelContext(model="m", client=client), [], None, None).agent  # noqa: SLF001
                agent.harness = Harness(vf.HarnessConfig(id="test"))
                return await agent.run(task)

        rollout = asyncio.run(run())
    assert config is not None
    assert seen["tools"] == [tool["name"] for tool in reel.tools()]
    assert seen["kinds"][0] == "text" and "ended" in seen["last"]
    assert rollout.metrics["calls"] == 2.0 and reel.open(rollout.info["reel"]["trace"]).end
