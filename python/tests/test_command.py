"""The command line that the package carries, and the recorder."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

import reel


def test_the_command_line_comes_along(planner: reel.Episode) -> None:
    run = subprocess.run([sys.executable, "-m", "reel", "replay", str(planner.path), "--json"], capture_output=True, text=True)
    assert run.returncode == 0 and json.loads(run.stdout.splitlines()[0])["verdict"] == "exact"
    wrong = subprocess.run([sys.executable, "-m", "reel", "replay", "no-such.mcap"], capture_output=True, text=True)
    assert wrong.returncode == 2 and "no such trace" in wrong.stderr
    with pytest.raises(reel.ReelError, match="no such trace or folder"):
        reel.command("replay", "no-such.mcap")
    assert reel.command("--version").strip() == f"reel {reel.__version__}"
    assert isinstance(reel.command_json("replay", planner.path), dict)


def test_packed_episodes_are_traces(played: Path, tmp_path: Path) -> None:
    shard = tmp_path / "packed.mcap"
    reel.command("pack", played, "--out", shard)
    packed = [reel.open(path) for path in reel.trace_paths(shard)]
    assert {episode.digest for episode in packed} == {reel.open(path).digest for path in reel.trace_paths(played)}
    assert packed[0].replay().exact and packed[0].path == Path(f"{shard}#0")
    assert reel.open(f"{shard}#{packed[1].id}").digest == packed[1].digest
    with pytest.raises(reel.ReelError, match="no episode 'nobody' is among"):
        reel.open(f"{shard}#nobody")


def test_a_server_of_the_package_answers_in_sql(tasks: reel.Tasks, played: Path, tmp_path: Path) -> None:
    """Questions are asked in processes of their own: the command starts itself again, though the process is Python."""
    folder = tmp_path / "tasks"
    reel.Tasks.generate(1, folder, seed=5)
    reel.Store.ingest(played, tmp_path / "store")
    command = [sys.executable, "-m", "reel", "serve", "--tasks", str(folder), "--data", str(tmp_path / "served")]
    command += ["--store", str(tmp_path / "store"), "--listen", "127.0.0.1:0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as server:
        try:
            assert server.stdout is not None
            said = iter(server.stdout.readline, "")
            url = next(found.group() for line in said if (found := re.search(r"http://[\d.]+:\d+", line)))
            request = urllib.request.Request(
                url + "/api/sql",
                data=json.dumps({"sql": "SELECT count(*) AS episodes FROM episodes"}).encode(),
                headers={"content-type": "application/json"},
            )
            with urllib.request.urlopen(request, timeout=60) as answer:
                assert json.load(answer)[0]["episodes"] > 0
        finally:
            server.terminate()


def test_a_recorder_stands_between_agent_and_server(tasks: reel.Tasks, played: Path, tmp_path: Path) -> None:
    folder = tmp_path / "tasks"
    reel.Tasks.generate(1, folder, seed=5)
    server = [sys.executable, "-m", "reel", "mcp", "--tasks", str(folder), "--data", str(tmp_path / "served")]
    with reel.record(server, tmp_path / "recorded") as recorder:
        assert recorder.url.startswith("http://127.0.0.1:")
        request = urllib.request.Request(
            recorder.url,
            data=json.dumps({
                "jsonrpc": "2.0", "id": 1, "method": "initialize",
                "params": {"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "t", "version": "1"}},
            }).encode(),
            headers={"content-type": "application/json", "accept": "application/json, text/event-stream"},
        )  # fmt: skip
        with urllib.request.urlopen(request, timeout=30) as answer:
            assert b"serverInfo" in answer.read()
        assert recorder.episodes() == []
    for message, server in [
        (r"no such program: no-such-server \(of the server's command line `no-such-server --port 1`\)", ["no-such-server", "--port", "1"]),
        (r"no such program: .*/server.py", [str(tmp_path / "server.py")]),
        ("the command line of the server is empty", []),
        (r"a server's URL has no spaces.*as a list: \['python', 'server.py'\]", "python server.py"),
    ]:
        with pytest.raises(reel.ReelError, match=message):
            reel.record(server, tmp_path / "missing")
        assert not (tmp_path / "missing").exists()
    with pytest.raises(reel.ReelError, match="proxy or robot"):
        reel.record("http://127.0.0.1:1/mcp", tmp_path / "x", backend="spaceship")
