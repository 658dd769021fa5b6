"""`reel serve` as an environment of OpenEnv: the unmodified client of openenv-core 0.3.0, and clients that are rude.
`openenv_contract.py [NAME...]`; the command is $REEL."""

import base64
import concurrent.futures
import contextlib
import json
import pathlib
import re
import subprocess
import tempfile
import time

from faults_access import token
from faults_kit import serving
from harness import Server, environment, main, reel, until
from raw_websocket import WebSocket

HERE = pathlib.Path(__file__).parent
PAGE = HERE.parent.parent / "docs" / "openenv.md"
SEED = 7


def recorded(path):
    """An episode that the oracle played: its calls, what came of them, and its rewards."""
    code, out, err = reel("show", path, "--json")
    assert code == 0, err
    trace = json.loads(out)
    steps = trace["steps"]
    return {
        "trace": path.stem, "task_id": trace["header"]["task_id"], "seed": trace["header"]["seed"],
        "calls": [step["input"]["call"] for step in steps], "texts": [step["outcome"]["text"] for step in steps],
        "rewards": [sum(term["value"] for term in step.get("reward", [])) for step in steps],
        "success": trace["end"]["metrics"]["success"], "total_reward": trace["end"]["metrics"]["total_reward"],
        "header": trace["header"], "instances": sorted({body["body"] for step in steps for body in step["bodies"]}),
    }


@contextlib.contextmanager
def playing():
    """A server with two tasks, and the oracle's episodes of them among its traces."""
    with tempfile.TemporaryDirectory(prefix="reel-openenv-") as folder:
        folder = pathlib.Path(folder)
        for command in [
            ("task", "generate", "--count", 2, "--out", folder / "tasks"),
            ("run", "--tasks", folder / "tasks", "--policy", "oracle", "--seed", SEED, "--out", folder / "data" / "traces"),
        ]:
            code, out, err = reel(*command)
            assert code == 0, f"{out}{err}"
        oracle = [recorded(path) for path in sorted((folder / "data" / "traces").glob("*.mcap"))]
        assert len(oracle) == 2 and all(episode["success"] for episode in oracle), oracle
        with Server("--tasks", folder / "tasks", "--run", "oe", data=folder / "data") as server:
            yield server, oracle


def example(url, folder):
    """The Python of the page, for this server."""
    (block,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert "http://127.0.0.1:8801" in block
    path = pathlib.Path(folder) / "example.py"
    path.write_text(block.replace("http://127.0.0.1:8801", url))
    return path


def play_the_unmodified_client():
    """Sync and async, side by side, in both forms of actions, and from calls of recorded episodes: equal rewards, exact traces."""
    python = environment("openenv")
    with playing() as (server, oracle):
        branch_calls = [len(episode["calls"]) // 2 for episode in oracle]
        wanted = {"episodes": oracle, "branch_calls": branch_calls}
        command = [python, HERE / "openenv_client.py", server.url, example(server.url, server.data)]
        done = subprocess.run(list(map(str, command)), input=json.dumps(wanted), capture_output=True, text=True, timeout=600)
        assert done.returncode == 0, done.stderr[-3000:]
        told = json.loads(done.stdout.splitlines()[0])
        for episode, played in zip(oracle, told["sync"]):
            assert played["rewards"] == episode["rewards"], (played, episode["rewards"])
            assert abs(sum(played["rewards"]) - episode["total_reward"]) < 1e-9
        for number, played in enumerate(told["async"]):
            assert played["done"] and played["rewards"] == oracle[number % 2]["rewards"], played
        assert told["tools"]["rewards"] == oracle[0]["rewards"], told["tools"]
        assert "finish_with_id" not in told["tools"]["tools"], told["tools"]
        # The endpoint /mcp is that of the Model Context Protocol itself, which demands a handshake.
        assert [name for name, passed in told["criteria"].items() if not passed] == ["mcp_endpoint"], told["criteria"]
        assert until(lambda: not server.json("GET", "/api/sessions")[1]), "sessions outlive their sockets"
        assert server.stop() == 0
        traces = {path.stem: path for path in server.traces()}
        code, out, err = reel("replay", *traces.values())
        assert code == 0, f"{out}{err}"
        for played in [*told["sync"], *told["async"]]:
            episode = recorded(traces[played["trace"]])
            assert episode["success"] and episode["rewards"] == played["rewards"], played["trace"]
        assert recorded(traces[told["sync"][0]["trace"]])["header"]["policy"]["parameters"]["episode_id"] == "from-python"
        check_branches(oracle, branch_calls, told["branches"], traces)


def check_branches(oracle, branch_calls, branches, traces):
    """Branches name their parent, are a group, and went as told."""
    for episode, call, siblings in zip(oracle, branch_calls, branches):
        again, other = [recorded(traces[played["trace"]]) for played in siblings]
        assert again["rewards"] == episode["rewards"] and again["success"], again
        assert siblings[0]["rewards"] == episode["rewards"][call:]
        assert len(other["calls"]) == call + 1 and not other["success"], other
        assert {one["header"]["group_id"] for one in (again, other)} == {f"oe--{episode['trace']}--{call}"}
        assert [one["header"]["rollout_index"] for one in (again, other)] == [0, 1]
        for played in siblings:
            code, out, err = reel("branch", traces[episode["trace"]], "--check", traces[played["trace"]])
            assert code == 0, f"{out}{err}"


def error(answer, code):
    assert answer["type"] == "error" and answer["data"]["code"] == code and answer["data"]["message"], answer
    return answer["data"]


def play_broken_messages():
    """What is no message is answered with an error, and the session goes on; what is too large closes the socket."""
    with serving("--run", "oe", config="[limits]\nbody_mib = 1\n") as server, WebSocket(server) as client:
        assert client.status == 101
        assert client.ask({"type": "reset", "data": {"seed": 1}})["data"]["done"] is False
        for text in ["", "{", "nonsense", '{"type": "step"', "[" * 10_000, '{"type": NaN}', '"\\ud800"']:
            error(client.ask(text), "INVALID_JSON")
        client.frame(b"\x00\x01", WebSocket.BINARY)
        error(client.answer(), "INVALID_JSON")
        for message in [{}, {"type": "dance"}, {"type": 3}, {"type": None}, {"type": "x" * 100_000}]:
            assert len(error(client.ask(message), "UNKNOWN_TYPE")["message"]) < 200
        step = {"name": "nav_to", "arguments": {"receptacle_name": "table_1"}}
        for message in [
            [], 7, "text", None, {"type": "step"}, {"type": "step", "data": []}, {"type": "step", "data": {}},
            {"type": "step", "data": {"name": 1}}, {"type": "step", "data": {**step, "arguments": [1]}},
            {"type": "step", "data": {**step, "more": 1}}, {"type": "step", "data": step, "more": 1},
            {"type": "step", "data": {**step, "type": "fly"}}, {"type": "step", "data": {**step, "metadata": 3}},
            {"type": "step", "data": {**step, "metadata": {"reel/policy": {"thought": 1}}}}, {"type": "state", "data": {}},
            {"type": "step", "data": {"name": "finish_with_id", "arguments": {"task_id": "FDP/home_0001"}}},
            {"type": "reset", "data": []}, {"type": "reset", "data": {"seed": -1}}, {"type": "reset", "data": {"seed": 1.5}},
            {"type": "reset", "data": {"seed": 2**64}}, {"type": "reset", "data": {"episode_id": "../x"}},
            {"type": "reset", "data": {"episode_id": "x" * 49}}, {"type": "reset", "data": {"call": 0}},
            {"type": "reset", "data": {"task": "a", "options": {"task": "b"}}}, {"type": "reset", "data": {"options": {"seed": 1}}},
        ]:
            (found,) = error(client.ask(json.dumps(message)), "VALIDATION_ERROR")["errors"]
            assert found["type"] and found["msg"] and isinstance(found["loc"], list), found
        for name in ["../../etc/passwd", "no such", "x" * 300, "", "nowhere"]:
            found = error(client.ask({"type": "reset", "data": {"trace": name}}), "EXECUTION_ERROR")
            assert str(server.data) not in found["message"], found
        # The episode of before still runs: no call was made, none was lost.
        assert client.ask({"type": "state"})["data"]["step_count"] == 0
        assert client.ask({"type": "step", "data": step})["data"]["observation"]["decision"] == 1
        client.frame("hello", WebSocket.PING)
        assert client.receive() == (WebSocket.PONG, b"hello")
        # In pieces it is one message all the same.
        client.frame('{"type": ', final=False)
        client.frame('"state"}', opcode=0)
        assert client.answer()["data"]["step_count"] == 1
        check_rpc(client)
        client.frame("x" * (1 << 20) + "yz")
        assert client.closed() == 1009
        check_rude(server)
        assert until(lambda: not server.json("GET", "/api/sessions")[1]), "sessions outlive their sockets"


def check_rpc(client):
    """The tools of MCP inside the socket."""
    ask = lambda **request: client.ask({"type": "mcp", "data": {"jsonrpc": "2.0", "id": 1, **request}})["data"]
    tools = ask(method="tools/list")["result"]["tools"]
    assert {"nav_to", "finish"} <= {tool["name"] for tool in tools} and all(tool["inputSchema"] for tool in tools)
    said = ask(method="tools/call", params={"name": "show_receptacles", "arguments": {}})
    assert said["id"] == 1 and said["result"]["structured_content"]["decision"] == 2 and "reward" not in json.dumps(said), said
    for request, code in [
        ({"method": "dance"}, -32601), ({"method": 3}, -32600), ({"method": "tools/call"}, -32602),
        ({"method": "tools/list", "jsonrpc": "1.0"}, -32600), ({"method": "tools/list", "params": []}, -32602),
        ({"method": "tools/call", "params": {"name": "nav_to", "arguments": 3}}, -32602),
    ]:
        assert ask(**request)["error"]["code"] == code, request


def check_rude(server):
    """Sockets that break the protocol of WebSockets are closed, and nothing else happens."""
    for frame in [
        {"payload": b"\xff\xfe{}"}, {"payload": "{}", "masked": False}, {"payload": "{}", "opcode": 5}, {"payload": "{}", "opcode": 0},
        {"payload": b"", "length": 1 << 62}, {"payload": "x" * 200, "opcode": WebSocket.PING},
    ]:
        with WebSocket(server) as client:
            assert client.ask({"type": "reset"})["type"] == "observation"
            client.frame(**frame)
            assert client.closed() in (None, 1002, 1007, 1009), frame
    # One that says nothing, one that leaves in the middle of a call.
    with WebSocket(server):
        pass
    for _ in range(8):
        with WebSocket(server) as client:
            client.ask({"type": "reset", "data": {"task": "FDP/home_0001"}})
            client.frame(json.dumps({"type": "step", "data": {"name": "show_receptacles"}}))


def play_calls_in_flight_are_recorded():
    """A client that goes away in the middle of a call loses nothing: the call is in the trace, which replays."""
    with serving("--run", "oe") as server:
        for _ in range(6):
            with WebSocket(server) as client:
                client.ask({"type": "reset", "data": {"seed": 0}})
                client.frame(json.dumps({"type": "step", "data": {"name": "nav_to", "arguments": {"receptacle_name": "table_1"}}}))
                time.sleep(0.02)
        assert until(lambda: not server.json("GET", "/api/sessions")[1]), "sessions outlive their sockets"
        traces = server.traces()
        lengths = [len(recorded_steps(path)) for path in traces]
        assert len(traces) == 6 and set(lengths) <= {0, 1} and 1 in lengths, lengths
        code, out, err = reel("replay", *traces)
        assert code == 0, f"{out}{err}"


def recorded_steps(path):
    code, out, err = reel("show", path, "--json")
    assert code == 0, err
    return json.loads(out)["steps"]


def play_limits():
    """Sessions over the limit are told so in the contract's words; idle ones are closed; many run at once."""
    config = "[limits]\nsessions = 4\nclose_after_s = 2\nworkers = 2\nsimulators = 2\n"
    with serving("--run", "oe", config=config) as server:
        with contextlib.ExitStack() as stack:
            clients = [stack.enter_context(WebSocket(server)) for _ in range(4)]
            with concurrent.futures.ThreadPoolExecutor(4) as pool:
                begun = list(pool.map(lambda client: client.ask({"type": "reset", "data": {"seed": 5}}), clients))
            tasks = {answer["data"]["observation"]["text"] for answer in begun}
            assert len(tasks) == 1, "equal seeds begin equal episodes"
            with WebSocket(server) as fifth:
                found = error(fifth.answer(), "CAPACITY_REACHED")
                assert (found["active_sessions"], found["max_sessions"]) == (4, 4), found
                assert fifth.closed() == 1013
            # Who says nothing for close_after_s is closed.
            assert [client.closed() for client in clients] == [1001] * 4
        assert until(lambda: not server.json("GET", "/api/sessions")[1])
        with WebSocket(server) as client:
            assert client.ask({"type": "state"})["data"] == {
                "episode_id": None, "step_count": 0, "status": "empty", "task_id": None, "trace": None,
            }
            client.frame(json.dumps({"type": "close"}))
            assert client.closed() == 1000


def play_roles():
    """Role act plays; role read besides sees rewards and starts from recorded episodes. Tokens come in headers or in the URL."""
    with tempfile.TemporaryDirectory(prefix="reel-openenv-") as folder:
        data = pathlib.Path(folder) / "data"
        act, both = token(data, "actor", "act"), token(data, "trainer", "act", "read")
        reader, hasty = token(data, "reader", "read"), token(data, "gone", "act")
        with serving("--run", "oe", folder=folder) as server:
            basic = lambda secret: {"authorization": "Basic " + base64.b64encode(f"reel:{secret}".encode()).decode()}
            bearer = lambda secret: {"authorization": f"Bearer {secret}"}
            for headers, status in [
                ({}, 401), (bearer("x"), 401), (basic("x"), 401), ({"authorization": "Basic ???"}, 401), (basic(reader), 403),
                (bearer(act), 101), (basic(act), 101), ({**bearer(act), "origin": "https://evil.example"}, 403),
            ]:
                with WebSocket(server, headers=headers) as client:
                    assert client.status == status, (headers, client.status)
            # Only there: a browser would send such a header by itself.
            assert server.request("GET", "/api/sessions", None, basic(both))[0] == 401
            rewards = {}
            for secret in [act, both]:
                with WebSocket(server, headers=basic(secret)) as client:
                    first = client.ask({"type": "reset", "data": {"seed": 1}})["data"]
                    step = {"type": "step", "data": {"name": "show_receptacles", "arguments": {}}}
                    rewards[secret] = client.ask(step)["data"]["reward"]
                    client.frame(json.dumps({"type": "close"}))
                    assert client.closed() == 1000
            trace = first["observation"]["metadata"]["trace"]
            assert rewards[act] is None and isinstance(rewards[both], float), rewards
            assert until(lambda: (data / "traces" / f"{trace}.mcap").exists())
            begin = {"type": "reset", "data": {"trace": trace, "call": 1}}
            with WebSocket(server, headers=bearer(act)) as client:
                assert "role 'read'" in error(client.ask(begin), "EXECUTION_ERROR")["message"]
            with WebSocket(server, headers=bearer(both)) as client:
                assert client.ask(begin)["data"]["observation"]["decision"] == 1
            # A token that is taken back closes its socket.
            with WebSocket(server, headers=bearer(hasty)) as client:
                client.ask({"type": "reset"})
                code, _, err = reel("server", "token", "revoke", "gone", "--data", data)
                assert code == 0, err
                assert client.closed() == 1008


def play_http():
    """The HTTP routes: an episode is named by its id."""
    with serving("--run", "oe") as server:
        assert server.json("GET", "/health") == (200, {"status": "healthy"})
        assert server.json("GET", "/metadata")[1]["name"] == "reel"
        assert set(server.json("GET", "/schema")[1]) == {"action", "observation", "state"}
        assert server.json("GET", "/state")[1]["step_count"] == 0
        status, begun = server.json("POST", "/reset", {"seed": 4, "image": True})
        episode = begun["observation"]["metadata"]["episode_id"]
        assert status == 200 and begun["reward"] is None and begun["observation"]["image"], begun
        step = {"action": {"name": "show_receptacles", "arguments": {}}, "episode_id": episode}
        status, made = server.json("POST", "/step", step)
        assert status == 200 and made["done"] is False and made["observation"]["image"] is None, made
        assert server.json("POST", "/step", {**step, "image": True, "timeout_s": 3.5})[1]["observation"]["image"]
        assert server.json("GET", f"/state?episode_id={episode}")[1]["step_count"] == 2
        for path, body, status in [
            ("/step", {"action": step["action"]}, 409), ("/step", {**step, "episode_id": "other"}, 404), ("/step", {}, 422),
            ("/step", {**step, "action": {}}, 422), ("/step", {**step, "action": 3}, 422), ("/reset", {"task": "none"}, 422),
            ("/reset", {"seed": -1}, 422), ("/reset", {"episode_id": "a/b"}, 422), ("/reset", {"trace": "none"}, 404),
        ]:
            assert server.json("POST", path, body)[0] == status, (path, body)
        assert len(server.json("GET", "/api/sessions")[1]) == 1, "a refused reset leaves no session"
        assert server.json("POST", "/step", {**step, "action": {"name": "finish"}})[1]["done"] is True
        assert server.json("GET", f"/state?episode_id={episode}")[0] == 404, "an ended episode has no session"


def play_shutdown():
    """A server that stops closes the sockets, and every trace is whole."""
    with serving("--run", "oe") as server:
        with contextlib.ExitStack() as stack:
            clients = [stack.enter_context(WebSocket(server)) for _ in range(3)]
            for client in clients:
                client.ask({"type": "reset"})
            begun = time.monotonic()
            server.process.terminate()
            assert [client.closed() for client in clients] == [1001] * 3
            server.process.wait(30)
            assert time.monotonic() - begun < 20
        assert len(server.traces()) == 3 and not list((server.data / "traces").glob("*.part"))


if __name__ == "__main__":
    main("play_", globals())
