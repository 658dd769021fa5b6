"""Faults: servers that are killed and stopped, names that come again, disks that are full."""

import concurrent.futures
import contextlib
import json
import os
import pathlib
import random
import shutil
import signal
import subprocess
import tempfile
import time

from faults_kit import (
    LATE_S, MIB, QUICK, Wire, all_played, exact, healthy, long_form, players, posted, request, serving, steps, stopped, tail,
    with_tables,
)
from harness import Agent, Skipped, reel, until


def fault_kill_under_load():
    """SIGKILL in the middle of sixteen agents, again and again: `reel trace recover`, and by turns the next server, restores every call
    that was answered; doctor rejects no trace, and every one replays bit for bit."""
    with tempfile.TemporaryDirectory(prefix="reel-faults-") as folder:
        traces = pathlib.Path(folder) / "data" / "traces"
        for number in range(2 if QUICK else 3):
            run = f"kill{number}"
            with serving("--run", run, folder=folder) as server:
                found = players(server, 16)
                all_played(found, 2 if QUICK else 4)
                time.sleep(random.Random(number).uniform(0.0, 1.5))
                server.stop(signal.SIGKILL)
                for player in found:
                    player.join(70)
                    assert player.error, "an agent did not notice that its server is gone"
            torn = [json.loads(line) for line in reel("trace", "doctor", "--json", traces)[1].splitlines()]
            for trace in torn:
                words = " ".join(finding["message"] for finding in trace["findings"])
                if words == "the state after settling":
                    # killed before it began: were a call of it answered, the comparison below would miss it
                    os.unlink(trace["path"])
                    continue
                assert not words or trace["path"].endswith(".part"), f"doctor rejects {trace}"
                fine = "never finished" in words or "but not what came of it" in words or "last record is not whole" in words
                assert not words or fine, f"{trace['path']}: {words}"
            if number % 2:
                with serving("--run", f"after{number}", folder=folder) as server:
                    listed = server.json("GET", "/api/traces?limit=1000")[1]["traces"]
                    names = sorted({trace["trace"] for trace in listed if not trace["recording"]})
                    for player in found:
                        player.compare(run, names, lambda name: server.json("GET", f"/api/traces/{name}/steps")[1])
            else:
                code, out, err = reel("trace", "recover", "--json", traces)
                assert code in (0, 3), f"recover: {code} {err}"
                lost = [text for line in out.splitlines() for text in json.loads(line)["lost"]]
                # killed while its start was written: were a call of it answered, the comparison below would miss it
                lost = [text for text in lost if "; 0 steps are readable" not in text]
                assert all("was under way" in text for text in lost), f"more is lost than what was under way: {lost}"
                names = [path.stem for path in traces.glob("*.mcap")]
                with concurrent.futures.ThreadPoolExecutor(4) as pool:
                    list(pool.map(lambda player: player.compare(run, names, lambda name: steps(traces / f"{name}.mcap")), found))
            whole = sorted(traces.glob(f"{run}--*.mcap"))
            assert len(whole) >= 16, whole
            code, out, err = reel("trace", "doctor", *whole)
            assert code == 0, f"doctor: {out[-2000:]}{err}"
            exact(*whole)


def fault_stop_under_load():
    """SIGTERM while agents act: code 0, every trace whole, every answered call in it, nothing left in parts."""
    with tempfile.TemporaryDirectory(prefix="reel-faults-") as folder:
        with serving("--run", "stop", folder=folder) as server:
            found = players(server, 8)
            all_played(found, 5)
            begun = time.monotonic()
            assert server.stop(patience=25) == 0, tail(server)
            took = time.monotonic() - begun
            for player in found:
                player.join(70)
                assert player.error, "an agent did not notice that its server is gone"
        traces = pathlib.Path(folder) / "data" / "traces"
        others = [path.name for path in traces.iterdir() if path.suffix != ".mcap"]
        assert not others, f"after the stop there are {others}"
        healthy(traces)
        for player in found:
            player.compare("stop", [path.stem for path in traces.iterdir()], lambda name: steps(traces / f"{name}.mcap"))
        exact(traces)
        assert took < 15, f"stopping took {took:.1f} s"


def fault_stop_while_clients_hang():
    """SIGTERM while streams are open, requests half sent and downloads unread: the server goes in its time all the same."""
    with serving(config="[limits]\nread_timeout_s = 60\n") as server:
        agent = Agent(server)
        agent.call("finish")
        with open(server.data / "traces" / "large.mcap", "wb") as file:
            file.truncate(64 * MIB)
        wires = [
            Wire(server),
            Wire(server, b"POST /mcp HTTP/1.1\r\nHost: localhost\r\n"),
            Wire(server, request("GET", "/sse")),
            Wire(server, request("GET", "/mcp", {**agent.headers})),
            Wire(server, request("GET", "/healthz")),
        ]
        if not QUICK:
            # These have all the time that open requests are given.
            wires += [
                Wire(server, request("POST", "/api/sql", {"content-length": "1000"}) + b"{"),
                Wire(server, request("PUT", "/api/traces/half", {"content-length": "1000"}) + b"{"),
                Wire(server, request("GET", "/api/traces/large"), receive=4096),
            ]
        time.sleep(0.5)
        begun = time.monotonic()
        assert stopped(server), "open connections keep the server from stopping"
        assert time.monotonic() - begun < 20, "stopping took too long"
        assert [path.suffix for path in (server.data / "traces").iterdir()] == [".mcap"] * 2, "the episode that ran is whole"
        for wire in wires:
            wire.close()


def fault_stop_while_a_question_runs():
    """SIGTERM while a question in SQL takes its time: the server goes, and does not wait for the answer."""
    long_form()
    with serving(config="[limits]\nsql_timeout_s = 600\n") as server:
        with_tables(server)
        sql = "SELECT sum(a.value * b.value) FROM generate_series(1, 1000000) a, generate_series(1, 1000000) b"
        slow = Wire(server, posted("/api/sql", json.dumps({"sql": sql}).encode()))
        time.sleep(1.5)
        begun = time.monotonic()
        assert stopped(server), "a question that runs keeps the server from stopping"
        assert time.monotonic() - begun < 20, "stopping took too long"
        slow.close()


def fault_names_are_taken_once():
    """A run, a worker and a lease that come again, after a restart, a close or a release, replace no trace of before."""
    with tempfile.TemporaryDirectory(prefix="reel-faults-") as folder:
        kept = {}

        def play(server, words):
            agent = Agent(server, worker="a")
            agent.call("finish")
            agent.call("ask", question=words)
            agent.call("finish")
            for path in server.traces():
                kept.setdefault(path.name, path.read_bytes())
                assert path.read_bytes() == kept[path.name], f"{path.name}, a finished trace, was replaced ({words})"

        with serving("--run", "again", folder=folder) as server:
            play(server, "first")
            assert server.request("DELETE", "/api/sessions/w-a")[0] == 204
            play(server, "after the session was closed")
            lease = {"worker": "b", "task_id": "FDP/home_0001", "rollouts": 1}
            for _ in range(2):
                assert server.json("POST", "/api/leases", lease)[0] == 201
                worker = Agent(server, worker="b")
                worker.call("finish")
                worker.call("ask", question="leased")
                assert server.request("DELETE", "/api/leases/b")[0] == 204
            leased = [path for path in server.traces() if "--w-b--" in path.name]
            assert len(leased) == 2, f"two leases of one worker left {[path.name for path in leased]}"
        with serving("--run", "again", folder=folder) as server:
            play(server, "after a restart")
        words = [step["input"]["call"]["arguments"] for path in server.traces() for step in steps(path)]
        asked = {argument["question"] for argument in words if "question" in argument}
        assert asked == {"first", "after the session was closed", "after a restart", "leased"}, f"persisted is {asked}"


@contextlib.contextmanager
def small_disk(folder, size):
    """A file system of its own, of so many bytes."""
    folder.mkdir(parents=True)
    command = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)]
    if os.name != "posix" or not shutil.which("mount"):
        raise Skipped("mount", "no file systems can be mounted here")
    mounted = subprocess.run(command, capture_output=True, text=True)
    if mounted.returncode:
        raise Skipped("mount", f"a small file system cannot be mounted (that takes root): {mounted.stderr.strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def fill(folder):
    """Takes all the space there is; the file that does."""
    path = folder / "filler"
    with open(path, "wb", buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(b"x" * 4096)
    return path


def fault_disk_full():
    """The disk fills up under an episode: its agent is told so and not where the traces lie, the server is not ready, nobody else
    notices, an upload gets 507 and leaves nothing. With room again the next episode plays, and what was answered before is
    restored."""
    with tempfile.TemporaryDirectory(prefix="reel-faults-") as folder:
        with small_disk(pathlib.Path(folder) / "data" / "traces", 3 * MIB) as disk:
            with serving("--run", "full", folder=folder) as server:
                agent, other = Agent(server, worker="a"), Agent(server)
                agent.call("finish")
                asked = ["before"]
                agent.call("ask", question="before")
                sample = pathlib.Path(folder) / "sample.mcap"
                other.call("finish"), other.call("finish")
                sample.write_bytes(server.traces()[0].read_bytes())
                filler = fill(disk)
                refused = None
                for number in range(200):
                    result = agent.call("ask", question=f"full {number}")
                    if result.get("isError"):
                        refused = result
                        break
                    asked.append(f"full {number}")
                text = json.dumps(refused)
                assert refused and "No space left" in text and "recording failed" in text, f"the agent is told {text}"
                assert refused["structuredContent"]["error"]["code"] == "broken", text
                assert "trace full--w-a--0000--" in text and "`reel " not in text, f"the agent is told {text}"
                logged = until(lambda: str(disk) in server.log.read_text(), 5)
                assert logged, "the log does not say where there is no room"
                again = agent.call("ask", question="after")
                assert again["isError"] and "failed and was ended" in str(again), f"the next call is told {again}"
                begun = agent.call("finish")
                assert begun["isError"] and "No space left" in str(begun), f"an episode that cannot begin says {begun}"
                assert str(disk.parent.resolve()) not in f"{text}{again}{begun}", "an agent is told a path of the server"
                status, answer = server.json("GET", "/readyz")
                assert (status, answer["error"]["code"]) == (503, "disk_full"), (status, answer)
                assert str(disk.parent) not in str(answer), answer
                assert server.json("GET", "/healthz")[0] == 200 and server.json("GET", "/api/sessions")[0] == 200
                assert "FDP" in other.say("list_tasks")
                status, answer = server.json("PUT", "/api/traces/uploaded", sample.read_bytes())
                assert (status, answer["error"]["code"]) == (507, "disk_full"), (status, answer)
                left = [name for name in os.listdir(disk) if "upload" in name]
                assert not left, f"the upload left {left}"
                branch = {"name": "branch", "at": 0, "policy": "oracle"}
                status, answer = server.json("POST", f"/api/traces/{server.traces()[0].stem}/branches", branch)
                assert (status, answer["error"]["code"]) == (507, "disk_full"), (status, answer)
                filler.unlink()
                assert server.json("GET", "/readyz")[0] == 200, "with room again it is ready"
                assert "Task:" in agent.say("finish"), "with room again the next episode plays"
                assert not agent.call("ask", question="with room")["isError"]
                status, answer = server.json("PUT", "/api/traces/uploaded", sample.read_bytes())
                assert status == 201, (status, answer)
            code, out, err = reel("trace", "recover", disk)
            assert code in (0, 3), f"{code} {out}{err}"
            (restored,) = disk.glob("full--w-a--0000--*.mcap")
            kept = [step["input"]["call"]["arguments"]["question"] for step in steps(restored)]
            assert kept == asked, f"answered were {asked}, restored is {kept}"
            whole = list(disk.glob("*.mcap"))
            code, out, err = reel("trace", "doctor", *whole)
            assert code == 0, out
            exact(*whole)


def fault_restored_in_part():
    """A call that was under way is lost for good, and said once: `reel trace recover` ends with 3 the first time and with 0 from
    then on; a server that starts there lists the trace that was restored, and no recording."""
    with tempfile.TemporaryDirectory(prefix="reel-faults-") as folder:
        with serving("--run", "torn", folder=folder) as server:
            agent = Agent(server, worker="a")
            agent.call("finish"), agent.call("ask", question="whole"), agent.call("ask", question="torn")
            server.stop(signal.SIGKILL)
        traces = pathlib.Path(folder) / "data" / "traces"
        (part,) = traces.glob("*.mcap.part")
        os.truncate(part, part.stat().st_size - 1)
        code, out, err = reel("trace", "recover", traces)
        assert code == 3 and "  lost: call 1 " in out, f"{code} {out}{err}"
        for _ in range(2):
            code, out, err = reel("trace", "recover", traces)
            assert code == 0 and "  lost before: call 1 " in out and "0 lost something" in out, f"{code} {out}{err}"
        assert part.exists(), "the evidence is gone"
        with serving(folder=folder) as server:
            listed = [(trace["trace"], trace["recording"]) for trace in server.json("GET", "/api/traces")[1]["traces"]]
            assert listed == [(part.name.removesuffix(".mcap.part"), False)], listed
            assert "restored what broke off" not in tail(server), tail(server)


def fault_stop_on_a_full_disk():
    """SIGTERM when no trace can be finished for want of room: the server goes, and every answered call can be restored."""
    with tempfile.TemporaryDirectory(prefix="reel-faults-") as folder:
        with small_disk(pathlib.Path(folder) / "data" / "traces", 2 * MIB) as disk:
            with serving("--run", "full", folder=folder) as server:
                agents = [Agent(server, worker=name) for name in ("a", "b", "c")]
                for agent in agents:
                    agent.call("finish"), agent.call("ask", question="before")
                filler = fill(disk)
                assert stopped(server), "a full disk keeps the server from stopping"
            filler.unlink()
            with serving(folder=folder) as server:
                found = [path for path in server.traces() if path.name.startswith("full--")]
                assert len(found) == 3, os.listdir(disk)
                for path in found:
                    kept = [step["input"]["call"]["arguments"]["question"] for step in steps(path)]
                    assert kept == ["before"], f"{path.name} holds {kept}"
            healthy(disk)


def fault_disk_full_under_the_log():
    """The log lies on the disk that is full: what cannot be said is not said, and everything else goes on."""
    with tempfile.TemporaryDirectory(prefix="reel-faults-") as folder:
        with small_disk(pathlib.Path(folder) / "data", 2 * MIB) as disk, serving(folder=folder) as server:
            agent = Agent(server, worker="a")
            agent.call("finish")
            filler = fill(disk)
            for number in range(300):
                answer = call_within(agent, LATE_S, "ask", question=f"full {number}")
                assert answer, f"call {number} on the full disk got no answer in {LATE_S} s"
                if answer.get("isError"):
                    break
            else:
                raise AssertionError("the disk was not full")
            for _ in range(20):
                assert call_within(agent, LATE_S, "finish"), f"with a full disk no answer came in {LATE_S} s"
                status, answer = server.json("PUT", "/api/traces/uploaded", b"x" * MIB)
                assert (status, answer["error"]["code"]) == (507, "disk_full"), (status, answer)
            assert server.json("GET", "/api/sessions")[0] == 200
            filler.unlink()
            assert "Task:" in agent.say("finish")


def call_within(agent, patience, tool, **arguments):
    """The result of a call; none where no answer came in time."""
    agent.number += 1
    message = {"jsonrpc": "2.0", "id": agent.number, "method": "tools/call", "params": {"name": tool, "arguments": arguments}}
    try:
        status, _, body = agent.server.request("POST", agent.path, json.dumps(message), agent.headers, timeout=patience)
    except TimeoutError:
        return None
    assert status == 200, (status, body)
    parts = [json.loads(line[5:]) for line in body.decode().splitlines() if line.startswith("data:") and line[5:].strip()]
    return next((part["result"] for part in parts if part.get("id") == agent.number), None)


def fault_file_too_large():
    """No file may be larger than a megabyte: the episode whose recording would be is ended, and restored; the next one plays."""
    if os.name != "posix" or not shutil.which("bash"):
        raise Skipped("linux", "there is no `ulimit` here")
    limited = ["bash", "-c", 'trap "" XFSZ && ulimit -f 1024 && exec "$@"', "limited"]
    with serving("--run", "large", before=limited) as server:
        agent = Agent(server, worker="a")
        agent.call("finish")
        answered, refused = 0, None
        for number in range(29):
            result = agent.call("nav_to", receptacle_name=["table_1", "bed_1", "counter_1"][number % 3])
            if "recording failed" in str(result.get("structuredContent")):
                refused = result
                break
            answered += 1
        assert refused and "File too large" in str(refused), f"the agent is told {refused}; {answered} calls were answered"
        assert server.request("GET", "/healthz")[0] == 200
        assert "Task:" in agent.say("finish"), "the next episode plays"
        (restored,) = [path for path in server.traces() if "--0000--" in path.name]
        kept = steps(restored)
        assert len(kept) == answered, f"{answered} calls were answered, {len(kept)} are restored"
        assert reel("trace", "doctor", *server.traces())[0] == 0


def fault_upload_breaks_off():
    """Uploads that are cut off, torn, no traces or there already leave nothing; one that died with the server is gone with the
    next one."""
    with tempfile.TemporaryDirectory(prefix="reel-faults-") as folder:
        with serving("--run", "up", folder=folder) as server:
            agent = Agent(server, worker="a")
            agent.call("finish"), agent.call("finish")
            (trace,) = server.traces()
            sound_bytes = trace.read_bytes()

            def there():
                return sorted(path.name for path in (server.data / "traces").iterdir() if not path.name.startswith("up--"))

            half = sound_bytes[: len(sound_bytes) // 2]
            for name, body in [("torn", half), ("empty", b""), ("garbage", b"\x89MCAP0\r\n" + bytes(1000)), ("text", b"hello")]:
                status, answer = server.json("PUT", f"/api/traces/{name}", body)
                assert (status, answer["error"]["code"]) == (422, "bad_trace"), (name, status, answer)
                assert str(server.data) not in answer["error"]["message"], f"a path of the server: {answer}"
            assert there() == [], there()
            wire = Wire(server, request("PUT", "/api/traces/cut", {"content-length": str(len(sound_bytes))}) + half)
            assert until(lambda: there() != [], 10), "nothing is taken"
            wire.close()
            assert until(lambda: there() == [], 10), f"an upload that was cut off left {there()}"
            assert server.request("PUT", "/api/traces/whole", sound_bytes)[0] == 201
            assert server.request("PUT", "/api/traces/whole", sound_bytes)[0] == 409
            assert server.request("GET", "/api/traces/whole")[2] == sound_bytes
            assert there() == ["whole.mcap"], there()
            wire = Wire(server, request("PUT", "/api/traces/killed", {"content-length": str(len(sound_bytes))}) + half)
            assert until(lambda: len(there()) == 2, 10), "nothing is taken"
            server.stop(signal.SIGKILL)
            wire.close()
        with serving(folder=folder) as server:
            left = [name for name in there() if name != "whole.mcap"]
            assert not left, f"what the killed server was taking is still there: {left}"
