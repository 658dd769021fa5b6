"""Agents in processes of their own play through the service: the published client library over HTTP+SSE, the newest over
Streamable HTTP, a trainer's worker that comes back. `players.py [NAME...]`; the command is $REEL, the benchmark's data
$REEL_REAL_BENCH."""

import json
import os
import pathlib
import shutil
import subprocess
import tempfile

from harness import REEL, Agent, Server, Skipped, environment, main, reel

HERE = pathlib.Path(__file__).parent
FAMILIES = ["FDP", "FODP", "FDO", "SUL"]


def run(python, script, *arguments):
    """What a client in a fresh process printed, a value a line."""
    done = subprocess.run([str(python), str(HERE / script), *map(str, arguments)], capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, f"{script}: {done.stderr[-3000:]}"
    return [json.loads(line) for line in done.stdout.splitlines()]


def exact(server):
    """Every trace of a server that has stopped replays bit for bit."""
    traces = server.traces()
    code, out, err = reel("replay", *traces)
    assert code == 0, f"{out}{err}"
    return len(traces)


def play_published_client_over_sse():
    """mcp 1.9.4, the flow of the evaluation agent, two episodes from a fresh process."""
    python = environment("mcp-1.9.4")
    with Server("--profile", "real-repo") as server:
        lines = run(python, "client_sse.py", f"{server.url}/sse", "--episodes", 2)
        assert [line["success"] for line in lines[:2]] == [True, True], lines
        assert lines[0]["tools"] == 12, lines[0]
        assert server.stop() == 0
        assert exact(server) == 2


def play_newest_client_over_http():
    """The newest mcp over Streamable HTTP: with sessions at /mcp, without at a worker's path."""
    python = environment("tests")
    with Server() as server:
        for path in ["/mcp", "/w/one/mcp"]:
            [line] = run(python, "client_http.py", f"{server.url}{path}")
            assert line["calls"] == 16 and line["left"] == 14 and line["images"] >= 8 and line["schemas"], line
            assert line["next"] and line["next"] != line["task_id"], line
        assert server.stop() == 0
        # Of each the episode that was finished, and the next one, which ended with its session.
        assert exact(server) == 4


def play_dropped_connection_resumes():
    """A worker that is gone in the middle goes on where it was, `finish_with_id` aborts and restarts, nobody sees another's world."""
    python = environment("mcp-1.9.4")
    with Server("--profile", "real-repo") as server:
        [gone] = run(python, "client_sse.py", f"{server.url}/w/seven/sse", "--calls", 3)
        other = Agent(server, "eight")
        task = json.loads(other.say("finish"))
        other.call("navigate_to", receptacle_name=task["destination_furniture"])
        # A new connection of the same worker, over the other transport: the same robot stands where it stood.
        again = Agent(server, "seven")
        debug = again.call("find_objects", target_category="unicorn")["content"][-1]["text"]
        state = json.loads(debug.removeprefix("Debug Info:\n"))
        for key in ["CURRENT_LANDMARK", "CURRENT_POS", "CURRENT_INV", "world_graph"]:
            assert state[key] == gone["state"][key], key
        debug = other.call("find_objects", target_category="unicorn")["content"][-1]["text"]
        assert json.loads(debug.removeprefix("Debug Info:\n"))["CURRENT_LANDMARK"] == task["destination_furniture"]
        # The same id aborts and restarts.
        ids = json.loads(again.say("list_tasks"))
        for task_id in [gone["task"], ids[-1], gone["task"]]:
            restarted = json.loads(again.say("finish_with_id", task_id=task_id))
            assert restarted["task_id"] == task_id
            assert restarted["initial_world_graph"] != restarted["target_world_graph"]
        assert again.say("finish_with_id", task_id="nobody's").startswith("Error executing finish_with_id: ")
        [line] = run(python, "client_sse.py", f"{server.url}/w/seven/sse", "--episodes", 1, "--begin", gone["task"])[:1]
        assert line["success"] and line["task_id"] == gone["task"], line
        assert server.stop() == 0
        reasons = [json.loads(reel("show", trace, "--json")[1])["end"]["reason"] for trace in server.traces()]
        assert reasons.count("aborted") == len(reasons), reasons
        assert exact(server) == len(reasons)


def play_over_stdio():
    """A client that starts `reel mcp` as a command; what it played is a whole trace when it is gone."""
    with tempfile.TemporaryDirectory() as folder:
        command = [REEL, "mcp", "--data", folder]
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

        def say(message, answered=True):
            process.stdin.write(json.dumps({"jsonrpc": "2.0", **message}) + "\n")
            process.stdin.flush()
            return json.loads(process.stdout.readline())["result"] if answered else None

        hello = {"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "stdio", "version": "1"}}
        say({"id": 1, "method": "initialize", "params": hello})
        say({"method": "notifications/initialized"}, answered=False)
        for number, (tool, arguments) in enumerate([("finish", {}), ("nav_to", {"receptacle_name": "table_1"})], 2):
            result = say({"id": number, "method": "tools/call", "params": {"name": tool, "arguments": arguments}})
            assert result["structuredContent"]["ok"] and result["content"][1]["mimeType"] == "image/png", result
        process.stdin.close()
        assert process.wait(30) == 0, process.stderr.read()
        [trace] = pathlib.Path(folder, "traces").glob("*.mcap")
        code, out, err = reel("replay", trace)
        assert code == 0, f"{out}{err}"
        process.stdout.close()
        process.stderr.close()


def play_prompt_group():
    """A leased simulator plays G rollouts of one task and seed; their traces are one group; it is given back."""
    with Server() as server:
        status, tasks = 200, json.loads(Agent(server).say("list_tasks"))
        lease = {"worker": "trainer", "task_id": tasks[1], "seed": 5, "rollouts": 2}
        status, leased = server.json("POST", "/api/leases", lease)
        assert status == 201 and leased["mcp"] == "/w/trainer/mcp", leased
        assert server.json("POST", "/api/leases", {**lease, "rollouts": 3})[0] == 409
        agent = Agent(server, "trainer")
        begun = [agent.call("finish") for _ in range(3)]
        assert [it["structuredContent"].get("episode", {}).get("task_id") for it in begun] == [tasks[1], tasks[1], None]
        assert server.request("DELETE", "/api/leases/trainer")[0] == 204
        assert server.request("DELETE", "/api/leases/trainer")[0] == 404
        assert server.stop() == 0
        headers = [json.loads(reel("show", trace, "--json")[1])["header"] for trace in server.traces()]
        groups = [(it["group_id"], it["rollout_index"], it["seed"]) for it in headers]
        assert groups == [(leased["group_id"], 0, 5), (leased["group_id"], 1, 5)], groups


def play_real_bench():
    """The evaluation agent's flow on 20 tasks of REAL-Bench, five of each family, judged by the client."""
    bench = pathlib.Path(os.environ.get("REEL_REAL_BENCH", ""))
    if not (bench / "s7_scene.json").exists():
        raise Skipped("real-bench", "REEL_REAL_BENCH is not its folder")
    python = environment("mcp-1.9.4")
    with tempfile.TemporaryDirectory() as folder:
        for family in FAMILIES:
            files = sorted((bench / "tasks" / family).glob("*.yaml"))
            target = pathlib.Path(folder) / family
            target.mkdir()
            for file in files[:: max(1, len(files) // 5)][:5]:
                shutil.copy(file, target)
        arguments = ["--tasks", folder, "--scene", bench / "s7_scene.json", "--profile", "real-repo"]
        with Server(*arguments) as server:
            lines = run(python, "client_sse.py", f"{server.url}/sse")
            assert lines[-1] == {"end": "All evaluation episodes completed."}, lines[-1]
            played = lines[:-1]
            failed = [line for line in played if not line["success"]]
            assert len(played) == 20 and not failed, failed
            assert {line["family"] for line in played} == set(FAMILIES)
            assert server.stop() == 0
            assert exact(server) == 20


if __name__ == "__main__":
    main("play_", dict(globals()))
