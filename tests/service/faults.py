"""What goes wrong around `reel serve`, and what must not come of it: killed processes, full disks, clients that are slow, hostile
or strangers, clocks that jump. `faults.py [--list] [--quick] [NAME...]`; the command is $REEL.

Every test has a server of its own, and fails also where that panics, dies or does not stop. What this machine cannot do is said
as `skipped: ...`."""

import concurrent.futures
import contextlib
import glob
import http.client
import json
import os
import pathlib
import random
import re
import select
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.parse

from harness import Agent, Server, Skipped, main, reel, until

#: Whether the short form is wanted.
QUICK = "--quick" in sys.argv
MIB = 1 << 20
#: What a slow client is given, in the tests that wait for it; and how late the machine may be with anything.
READ_S, LATE_S = 2, 8
DAY_S = 24 * 3600


@contextlib.contextmanager
def serving(*arguments, config="", folder=None, **named):
    """A server with a configuration. At the end it lives, has not panicked, and stops when it is told to."""
    with contextlib.ExitStack() as stack:
        folder = pathlib.Path(folder or stack.enter_context(tempfile.TemporaryDirectory(prefix="reel-faults-")))
        file = folder / "reel.toml"
        if config or not file.exists():
            file.write_text(config)
        server = Server("--config", file, *arguments, data=folder / "data", **named)
        try:
            yield server
            if server.process.poll() is None:
                sound(server)
                assert stopped(server), "the server was still there 25 s after SIGTERM"
        finally:
            server.process.kill()
            server.stop()


def stopped(server, patience=25):
    """Whether the server goes when it is told to, and with code 0."""
    try:
        code = server.stop(patience=patience)
    except subprocess.TimeoutExpired:
        return False
    assert code == 0, f"the server ended with {code}: {tail(server)}"
    return True


def sound(server):
    """The server lives, serves, and no thread of it panicked."""
    assert server.process.poll() is None, f"the server died with {server.process.poll()}: {tail(server)}"
    assert server.request("GET", "/healthz", timeout=LATE_S)[0] == 200
    log = server.log.read_text(errors="replace")
    panics = [log[found.start() : found.start() + 600] for found in re.finditer(r"thread '[^']*' .*panicked at|a request broke down", log)]
    assert not panics, f"{len(panics)} panics, the first: {panics[0]}"


def tail(server):
    return server.log.read_text(errors="replace")[-1500:]


def steps(trace):
    """The steps of a trace that lies in a file."""
    code, out, err = reel("show", trace, "--json")
    assert code == 0, err
    return json.loads(out)["steps"]


def healthy(folder):
    """Nothing of a folder is rejected by `reel doctor`."""
    code, out, err = reel("doctor", folder)
    assert code == 0, f"doctor: {code} {out[-2000:]}{err[-500:]}"


def exact(*traces):
    """Every trace replays bit for bit."""
    code, out, err = reel("replay", *traces)
    assert code == 0, f"replay: {code} {out[-2000:]}{err[-500:]}"


class Player(threading.Thread):
    """Plays as a worker until its server is gone or it has enough. Keeps which calls were answered, and what was said."""

    TOOLS = ["ask", "nav_to", "show_receptacles", "walk_around", "pick", "show_object_by_category", "ask"]
    PLACES = ["table_1", "counter_1", "bed_1", "nowhere_1"]

    def __init__(self, server, worker, headers=None, pause=0.0):
        super().__init__(daemon=True)
        self.server, self.worker, self.headers, self.pause = server, worker, headers, pause
        self.enough = threading.Event()
        self.answered, self.error, self.slowest = 0, None, 0.0
        #: For each episode what was answered in it: name, arguments, first text (none where the tool's own is not told).
        self.episodes = []

    def run(self):
        try:
            agent = Agent(self.server, worker=self.worker, headers=self.headers)
            while not self.enough.is_set():
                self.call(agent, "finish")
                self.episodes.append([])
                for number in range(12):
                    if not self.enough.is_set():
                        self.call(agent, self.TOOLS[(self.answered + number) % len(self.TOOLS)])
        except Exception as error:
            self.error = error

    def call(self, agent, tool):
        arguments = {
            "n": self.answered, "question": f"{self.worker} asks {self.answered}", "marker_id": self.answered % 4,
            "receptacle_name": self.PLACES[self.answered % 4], "target_category": "box",
        }
        begun = time.monotonic()
        text = agent.say(tool, **arguments)
        self.slowest = max(self.slowest, time.monotonic() - begun)
        if self.episodes:
            self.episodes[-1].append((tool, arguments, None if tool == "finish" else text))
        self.answered += 1
        time.sleep(self.pause)

    def compare(self, run, names, steps_of):
        """Every answered call is in the traces, in its place; more only where a call was under way."""
        for number, calls in enumerate(self.episodes):
            begin = f"{run}--w-{self.worker}--{number:04}--"
            found = [name for name in names if name.startswith(begin)]
            assert len(found) == 1, f"{begin}: {len(found)} traces; {len(calls)} calls of it were answered"
            kept = steps_of(found[0])
            heard = [
                (step["input"]["call"]["name"], step["input"]["call"]["arguments"], text and step["outcome"]["text"])
                for step, (_, _, text) in zip(kept, calls)
            ]
            assert heard == calls, f"{found[0]}: of {len(calls)} answered calls {len(heard)} are there, or others: {heard[-2:]}"
            allowed = 1 if number == len(self.episodes) - 1 else 0
            assert len(kept) <= len(calls) + allowed, f"{found[0]} has {len(kept)} calls, {len(calls)} were answered"


def players(server, count, prefix="a"):
    """So many agents at work."""
    found = [Player(server, f"{prefix}{number}") for number in range(count)]
    for player in found:
        player.start()
    return found


def all_played(found, calls, patience=60):
    assert until(lambda: all(player.answered >= calls or player.error for player in found), patience), "the agents do not get on"
    errors = [player.error for player in found if player.error]
    assert not errors, errors


# Killed and stopped


def fault_kill_under_load():
    """SIGKILL in the middle of sixteen agents, again and again: `reel recover`, and by turns the next server, restores every call
    that was answered; doctor rejects no trace, and every one replays bit for bit."""
    with tempfile.TemporaryDirectory(prefix="reel-faults-") as folder:
        traces = pathlib.Path(folder) / "data" / "traces"
        for number in range(2 if QUICK else 3):
            run = f"kill{number}"
            with serving("--run", run, folder=folder) as server:
                found = players(server, 16)
                all_played(found, 4)
                time.sleep(random.Random(number).uniform(0.0, 1.5))
                server.stop(signal.SIGKILL)
                for player in found:
                    player.join(70)
                    assert player.error, "an agent did not notice that its server is gone"
            torn = [json.loads(line) for line in reel("doctor", "--json", traces)[1].splitlines()]
            for trace in torn:
                words = " ".join(finding["what"] for finding in trace["findings"])
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
                code, out, err = reel("recover", "--json", traces)
                assert code in (0, 3), f"recover: {code} {err}"
                lost = [text for line in out.splitlines() for text in json.loads(line)["lost"]]
                assert all("was under way" in text for text in lost), f"more is lost than what was under way: {lost}"
                names = [path.stem for path in traces.glob("*.mcap")]
                with concurrent.futures.ThreadPoolExecutor(4) as pool:
                    list(pool.map(lambda player: player.compare(run, names, lambda name: steps(traces / f"{name}.mcap")), found))
            whole = sorted(traces.glob(f"{run}--*.mcap"))
            assert len(whole) >= 16, whole
            code, out, err = reel("doctor", *whole)
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
    with serving(config="[limits]\nread_s = 60\n") as server:
        agent = Agent(server)
        agent.call("finish")
        with open(server.data / "traces" / "large.mcap", "wb") as file:
            file.truncate(64 * MIB)
        wires = [
            Wire(server),
            Wire(server, b"POST /mcp HTTP/1.1\r\nHost: localhost\r\n"),
            Wire(server, request("POST", "/api/sql", {"content-length": "1000"}) + b"{"),
            Wire(server, request("PUT", "/api/traces/half", {"content-length": "1000"}) + b"{"),
            Wire(server, request("GET", "/sse")),
            Wire(server, request("GET", "/mcp", {**agent.headers})),
            Wire(server, request("GET", "/api/traces/large"), receive=4096),
            Wire(server, request("GET", "/healthz")),
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
    with serving(config="[limits]\nsql_s = 600\n") as server:
        with_tables(server)
        slow = Wire(server, question("SELECT sum(a.value * b.value) FROM generate_series(1, 1000000) a, generate_series(1, 1000000) b"))
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
        assert asked == {"first", "after the session was closed", "after a restart", "leased"}, f"on tape is {asked}"


# Disks


@contextlib.contextmanager
def small_disk(folder, size):
    """A file system of its own, of so many bytes."""
    folder.mkdir(parents=True)
    command = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)]
    if os.name != "posix" or not shutil.which("mount"):
        raise Skipped("no file systems can be mounted here")
    mounted = subprocess.run(command, capture_output=True, text=True)
    if mounted.returncode:
        raise Skipped(f"a small file system cannot be mounted (that takes root): {mounted.stderr.strip()}")
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
    """The disk fills up under an episode: its agent is told so, nobody else notices, an upload gets 507 and leaves nothing. With
    room again the next episode plays, and what was answered before is restored."""
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
                assert refused and "No space left" in text and "recording cannot go on" in text, f"the agent is told {text}"
                assert refused["structuredContent"]["error"]["code"] == "broken", text
                again = agent.call("ask", question="after")
                assert again["isError"] and "broke down" in str(again), f"the next call is told {again}"
                begun = agent.call("finish")
                assert begun["isError"] and "No space left" in str(begun), f"an episode that cannot begin says {begun}"
                assert server.json("GET", "/healthz")[0] == 200 and server.json("GET", "/api/sessions")[0] == 200
                assert "FDP" in other.say("list_tasks")
                status, answer = server.json("PUT", "/api/traces/uploaded", sample.read_bytes())
                assert (status, answer["error"]["code"]) == (507, "disk_full"), (status, answer)
                left = [name for name in os.listdir(disk) if "upload" in name]
                assert not left, f"the upload left {left}"
                filler.unlink()
                assert "Task:" in agent.say("finish"), "with room again the next episode plays"
                assert not agent.call("ask", question="with room")["isError"]
                status, answer = server.json("PUT", "/api/traces/uploaded", sample.read_bytes())
                assert status == 201, (status, answer)
            code, out, err = reel("recover", disk)
            assert code in (0, 3), f"{code} {out}{err}"
            (restored,) = disk.glob("full--w-a--0000--*.mcap")
            kept = [step["input"]["call"]["arguments"]["question"] for step in steps(restored)]
            assert kept == asked, f"answered were {asked}, restored is {kept}"
            whole = list(disk.glob("*.mcap"))
            code, out, err = reel("doctor", *whole)
            assert code == 0, out
            exact(*whole)


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
        raise Skipped("there is no `ulimit` here")
    limited = ["bash", "-c", 'trap "" XFSZ && ulimit -f 1024 && exec "$@"', "limited"]
    with serving("--run", "large", before=limited) as server:
        agent = Agent(server, worker="a")
        agent.call("finish")
        answered, refused = 0, None
        for number in range(29):
            result = agent.call("nav_to", receptacle_name=["table_1", "bed_1", "counter_1"][number % 3])
            if "recording cannot go on" in str(result.get("structuredContent")):
                refused = result
                break
            answered += 1
        assert refused and "File too large" in str(refused), f"the agent is told {refused}; {answered} calls were answered"
        assert server.request("GET", "/healthz")[0] == 200
        assert "Task:" in agent.say("finish"), "the next episode plays"
        (restored,) = [path for path in server.traces() if "--0000--" in path.name]
        kept = steps(restored)
        assert len(kept) == answered, f"{answered} calls were answered, {len(kept)} are restored"
        assert reel("doctor", *server.traces())[0] == 0


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


# Slow and large


def request(method, path, headers=None):
    """The head of a request."""
    headers = {"Host": "localhost", **(headers or {})}
    lines = [f"{method} {path} HTTP/1.1", *(f"{name}: {value}" for name, value in headers.items())]
    return "\r\n".join(lines).encode() + b"\r\n\r\n"


def posted(path, body, headers=None):
    """A request with a JSON body, whatever that holds."""
    accept = {"content-type": "application/json", "accept": "application/json, text/event-stream"}
    return request("POST", path, {**accept, "content-length": str(len(body)), **(headers or {})}) + body


def question(sql, **more):
    return posted("/api/sql", json.dumps({"sql": sql, **more}).encode())


class Wire:
    """A connection on which a test sends what it likes."""

    def __init__(self, server, first=b"", receive=None):
        self.socket = socket.socket()
        if receive:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive)
        self.socket.settimeout(LATE_S)
        self.socket.connect(("127.0.0.1", server.port))
        self.begun, self.heard = time.monotonic(), b""
        if first:
            self.socket.sendall(first)

    def until_closed(self, patience, drip=b""):
        """Seconds until the server closed the connection; none where it did not. Sends `drip` now and then."""
        while time.monotonic() - self.begun < patience:
            try:
                if drip:
                    self.socket.send(drip)
                if select.select([self.socket], [], [], 0.3)[0]:
                    part = self.socket.recv(1 << 16)
                    if not part:
                        return time.monotonic() - self.begun
                    self.heard += part
            except ConnectionError:
                return time.monotonic() - self.begun
        return None

    def status(self, patience=LATE_S):
        """Status of the answer; none where none came."""
        end = time.monotonic() + patience
        while b"\r\n\r\n" not in self.heard:
            left = end - time.monotonic()
            try:
                if select.select([self.socket], [], [], max(left, 0.0))[0]:
                    part = self.socket.recv(1 << 16)
                    if not part:
                        break
                    self.heard += part
                elif left <= 0:
                    break
            except ConnectionError:
                break
        return self.status_heard()

    def status_heard(self):
        found = re.match(rb"HTTP/1\.\d (\d+)", self.heard)
        return int(found[1]) if found else None

    def close(self):
        self.socket.close()


def fault_slow_clients():
    """Clients that say nothing, stop in the middle or trickle have `limits.read_s`, for the head and again for the body: closed,
    or answered 408. Meanwhile others are served at once."""
    with serving(config=f"[limits]\nread_s = {READ_S}\n") as server:
        head = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n"
        sized = {"content-length": "100000", "content-type": "application/json", "accept": "application/json, text/event-stream"}
        #: What is sent first, what trickles after it, and the answer.
        clients = {
            "silent": (b"", b"", None),
            "a letter": (b"P", b"", None),
            "half a preface of HTTP/2": (b"PRI * HTTP/2", b"", None),
            "a preface of HTTP/2": (b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n", b"", None),
            "half a head": (head, b"", None),
            "a head that trickles": (head, b"x", None),
            "idle after an answer": (head + b"\r\n", b"", 200),
        }
        for path in ["/mcp", "/w/a/mcp", "/analysis/mcp", "/messages/?session_id=x", "/api/sql", "/api/jobs", "/nowhere"]:
            clients[f"half a body {path}"] = (request("POST", path, sized) + b"{", b"", 408)
            clients[f"a body that trickles {path}"] = (request("POST", path, sized) + b"{", b" ", 408)
        clients["half an upload"] = (request("PUT", "/api/traces/half", sized) + b"{", b"", 408)

        def wait(name):
            first, drip, status = clients[name]
            wire = Wire(server, first)
            took = wire.until_closed(READ_S + LATE_S, drip)
            return name, took, wire.status_heard() == status or (status is None, wire.heard[:80])

        def served():
            begun = time.monotonic()
            assert server.request("GET", "/healthz", timeout=LATE_S)[0] == 200
            return time.monotonic() - begun

        with concurrent.futures.ThreadPoolExecutor(len(clients)) as pool:
            waiting = [pool.submit(wait, name) for name in clients]
            slowest = 0.0
            while not all(client.done() for client in waiting):
                slowest = max(slowest, served())
                time.sleep(0.1)
            answers = [client.result() for client in waiting]
        late = [(name, took) for name, took, _ in answers if took is None]
        early = [(name, took) for name, took, _ in answers if took is not None and took < READ_S / 2]
        wrong = [(name, said) for name, _, said in answers if said is not True and said != (True, b"")]
        assert slowest < LATE_S / 2, f"another client waited {slowest:.1f} s"
        assert not early, f"closed before their time: {early}"
        assert not late, f"never closed: {[name for name, _ in late]}"
        assert not wrong, f"answered otherwise: {wrong}"
        assert os.listdir(server.data / "traces") == [], "an upload that stood still left something"


def fault_slow_upload():
    """An upload that trickles cannot hold its place for ever; one that is slow, but steady and done in time, is taken."""
    with serving("--run", "slow", config=f"[limits]\nread_s = {READ_S}\n") as server:
        wire = Wire(server, request("PUT", "/api/traces/slow", {"content-length": "100000"}))
        assert wire.until_closed(5 * READ_S + LATE_S, drip=b"x"), f"after {5 * READ_S + LATE_S} s of three bytes a second it goes on"
        assert wire.status_heard() == 408, wire.heard[:200]
        agent = Agent(server, worker="a")
        agent.call("finish"), agent.call("finish")
        body = server.traces()[0].read_bytes()
        wire = Wire(server, request("PUT", "/api/traces/steady", {"content-length": str(len(body))}))
        for part in range(10):
            wire.socket.sendall(body[len(body) * part // 10 : len(body) * (part + 1) // 10])
            time.sleep(READ_S / 8)
        assert wire.status() == 201, wire.heard[:200]


def fault_unread_answers():
    """A client that asks for much and reads nothing loses its connection in about the time that reading has; others download."""
    with serving(config=f"[limits]\nread_s = {READ_S}\n") as server:
        with open(server.data / "traces" / "large.mcap", "wb") as file:
            file.truncate(64 * MIB)
        idle = Wire(server, request("GET", "/api/traces/large"), receive=4096)
        reading = Wire(server, request("GET", "/api/traces/large"))
        while len(reading.heard) < 64 * MIB:
            part = reading.socket.recv(1 << 20)
            assert part, f"a client that reads was cut off after {len(reading.heard)} bytes"
            reading.heard += part

        def connections():
            text = server.request("GET", "/metrics")[2].decode()
            return int(re.search(r"^reel_connections (\d+)", text, re.M)[1])

        reading.close()
        # This question itself is one.
        gone = until(lambda: connections() == 1, READ_S + 2 * LATE_S)
        assert gone, f"{READ_S + 2 * LATE_S} s after its last byte was read, the connection is still held"
        idle.close()


def fault_no_room_for_connections():
    """Connections that say nothing do not lock others out for longer than they have time."""
    with serving(config=f"[limits]\nread_s = {READ_S}\nconnections = 8\n") as server:
        idle = [Wire(server) for _ in range(8)]
        time.sleep(0.2)
        begun = time.monotonic()
        try:
            status = server.request("GET", "/healthz", timeout=READ_S + LATE_S)[0]
        except TimeoutError:
            status = None
        assert status == 200, f"eight silent connections lock everybody else out for more than {READ_S + LATE_S} s"
        assert time.monotonic() - begun < READ_S + LATE_S
        for wire in idle:
            wire.close()


def fault_halves():
    """Requests that end in the middle, by the hundred: nothing is left of them."""
    with serving() as server:
        beginnings = [
            b"", b"G", b"GET /healthz HTTP/1.1\r\n", request("POST", "/api/sql", {"content-length": "50"}) + b"{",
            request("POST", "/mcp", {"content-length": "50"}) + b"{", request("GET", "/sse"), request("GET", "/w/a/sse"),
            request("POST", "/mcp", {"transfer-encoding": "chunked"}) + b"5\r\nab", b"\x00\xff" * 50, b"\r\n" * 100,
            request("PUT", "/api/traces/x", {"transfer-encoding": "chunked"}) + b"ffffffffffffffff\r\nab",
            b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + b"\x00" * 100, b"GET / HTTP/9.9\r\n\r\n", b"GET  HTTP/1.1\r\n\r\n",
        ]
        for _ in range(10):
            wires = [Wire(server, beginning) for beginning in beginnings]
            for number, wire in enumerate(wires):
                if number % 2:
                    # Ends with a reset instead.
                    wire.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\x00\x00\x00\x00\x00\x00\x00")
                wire.close()

        def connections():
            text = server.request("GET", "/metrics")[2].decode()
            return int(re.search(r"^reel_connections (\d+)", text, re.M)[1])

        assert until(lambda: connections() == 1, 15), f"{connections() - 1} connections are left of clients that are gone"
        assert server.json("GET", "/api/sessions")[1] == [], "sessions are left of clients that are gone"
        assert os.listdir(server.data / "traces") == []


def resident(server, what="VmRSS"):
    """Memory of the server, in bytes."""
    status = pathlib.Path(f"/proc/{server.process.pid}/status")
    if not status.exists():
        raise Skipped("the memory of a process cannot be read here")
    return int(re.search(rf"{what}:\s+(\d+) kB", status.read_text())[1]) * 1024


def fault_large_bodies():
    """A hundred megabytes, announced or in chunks: 413 at once, on every route that takes a body, and no memory goes into it."""
    with serving(config="[limits]\nupload_mib = 8\n") as server:
        sse = Stream(server)
        paths = ["/mcp", "/w/a/mcp", "/analysis/mcp", "/api/sql", f"/messages/?session_id={sse.session}", "/api/jobs", "/nowhere"]
        routes = [("POST", path) for path in paths] + [("PUT", "/api/traces/large")]
        common = {"content-type": "application/json", "accept": "application/json, text/event-stream"}
        part = b"x" * (1 << 16)
        # What the first requests need is there before it is measured.
        assert Wire(server, posted("/api/sql", b'"' + b"x" * (3 * MIB) + b'"')).status() in range(400, 500)
        before, wrong = resident(server), []
        for method, path in routes:
            begun = time.monotonic()
            wire = Wire(server, request(method, path, {**common, "content-length": str(100 * MIB)}))
            if method == "PUT":
                wire.socket.sendall(part)
            sent = 0
            while not wire.status(0.0) and sent < 100 * MIB:
                try:
                    wire.socket.sendall(part)
                    sent += len(part)
                except OSError:
                    break
            status = wire.status()
            wire.close()
            if status != 413 or sent > 30 * MIB or time.monotonic() - begun > LATE_S:
                wrong.append((path, "announced", status, sent, time.monotonic() - begun))
            begun = time.monotonic()
            wire = Wire(server, request(method, path, {**common, "transfer-encoding": "chunked"}))
            sent = 0
            while not wire.status(0.0) and sent < 100 * MIB:
                try:
                    wire.socket.sendall(b"%x\r\n%b\r\n" % (len(part), part))
                    sent += len(part)
                except OSError:
                    break
            status = wire.status()
            wire.close()
            # A reset may overtake the answer to who goes on sending.
            if status not in (413, None) or sent > 30 * MIB or time.monotonic() - begun > LATE_S:
                wrong.append((path, "in chunks", status, sent, time.monotonic() - begun))
        peak = resident(server, "VmHWM") - before
        assert not wrong, wrong
        assert peak < 20 * MIB, f"the server took {peak / MIB:.0f} MiB for it"
        assert os.listdir(server.data / "traces") == [], "the upload left something"


def fault_bodies_as_large_as_they_may_be():
    """`limits.body_mib` is the limit: a body under it is refused for nothing but what it says, by every route."""
    with serving("--run", "body") as server:
        agent, sse = Agent(server, worker="a"), Stream(server)
        agent.call("finish")
        words = "y" * (3 * MIB)
        assert not agent.call("ask", question=words)["isError"]
        wrong = []
        message = {"jsonrpc": "2.0", "id": 1, "method": "ping", "params": {"_meta": {"x": words}}}
        bodies = {
            "/api/sql": {"sql": "SELECT 1", "parameters": {"a": words}}, "/api/jobs": {"kind": words},
            "/api/labels": {"episode": "x", "note": words, "author": "a"}, f"/messages/?session_id={sse.session}": message,
            "/api/leases": {"worker": "b", "task_id": "FDP/home_0001", "rollouts": 1, "group_id": words},
            "/api/traces/x/branches": {"at": 0, "name": words}, "/api/sessions/x/answer": {"answer": words},
        }
        for path, body in bodies.items():
            status, _, answer = server.request("POST", path, body)
            if status == 413 or status >= 500 or b"length limit" in answer:
                wrong.append((path, status, answer[:120]))
        agent.call("finish")
        (trace,) = [path for path in server.traces() if "--w-a--" in path.name]
        assert steps(trace)[0]["input"]["call"]["arguments"]["question"] == words
        exact(trace)
        assert not wrong, f"refused although they are smaller than limits.body_mib: {wrong}"


class Stream:
    """A client of legacy HTTP+SSE that reads no more than it is told to."""

    def __init__(self, server, worker=None, receive=None, headers=None):
        self.server = server
        path = f"/w/{worker}/sse" if worker else "/sse"
        self.wire = Wire(server, request("GET", path, {"accept": "text/event-stream", **(headers or {})}), receive)
        found = self.read(rb"session_id=([0-9a-f]+)")
        self.session, self.number = found[1].decode(), 0

    def read(self, pattern, patience=LATE_S):
        """Reads until something was heard."""
        end = time.monotonic() + patience
        while not (found := re.search(pattern, self.wire.heard)):
            assert time.monotonic() < end, f"{pattern} does not come: {self.wire.heard[-300:]}"
            if select.select([self.wire.socket], [], [], 0.2)[0]:
                part = self.wire.socket.recv(1 << 16)
                assert part, f"the stream ended: {self.wire.heard[-300:]}"
                self.wire.heard += part
        return found

    def post(self, message, timeout=60):
        return self.server.request("POST", f"/messages/?session_id={self.session}", message, timeout=timeout)[0]

    def hello(self):
        hello = {"protocolVersion": "2024-11-05", "capabilities": {}, "clientInfo": {"name": "stream", "version": "1"}}
        assert self.post({"jsonrpc": "2.0", "id": 0, "method": "initialize", "params": hello}) == 202
        self.read(rb'"id":0,')
        assert self.post({"jsonrpc": "2.0", "method": "notifications/initialized"}) == 202

    def say(self, tool, **arguments):
        """What a call said, as it came."""
        self.number += 1
        call = {"jsonrpc": "2.0", "id": self.number, "method": "tools/call", "params": {"name": tool, "arguments": arguments}}
        assert self.post(call) == 202
        return self.read(rb'\{"jsonrpc":"2.0","id":%d,.*' % self.number)[0].decode()


def fault_listener_that_never_reads():
    """A client of `/sse` that posts and never reads is held up itself, and nobody else is; gone, it leaves nothing."""
    with serving() as server:
        deaf = Stream(server, receive=4096)
        deaf.hello()
        before, held = resident(server), threading.Event()

        def post():
            with contextlib.suppress(OSError, http.client.HTTPException):
                for number in range(1, 3000):
                    if deaf.post({"jsonrpc": "2.0", "id": number, "method": "tools/list"}, timeout=3) != 202:
                        break
            held.set()

        posting = threading.Thread(target=post, daemon=True)
        posting.start()
        other, slowest = Agent(server), 0.0
        while not held.wait(0.05):
            begun = time.monotonic()
            other.call("list_tasks")
            slowest = max(slowest, time.monotonic() - begun)
        grown = resident(server) - before
        assert slowest < LATE_S / 2, f"another client waited {slowest:.1f} s"
        assert grown < 60 * MIB, f"the server keeps {grown / MIB:.0f} MiB for who does not read"
        session = deaf.session
        deaf.wire.close()
        posting.join(20)
        ping = {"jsonrpc": "2.0", "id": 1, "method": "ping"}
        gone = until(lambda: server.request("POST", f"/messages/?session_id={session}", ping)[0] == 404, 20)
        assert gone, "its session is still there 20 s after it went"


def fault_more_than_there_may_be():
    """More sessions, requests or jobs than there may be: 503 or 429 and when to come again, or a refusal in words; those who are in
    play on, and who leaves makes room."""
    with serving(config="[limits]\nsessions = 4\nrequests_per_s = 50\nburst = 200\n") as server:
        agents = [Agent(server, worker=f"a{number}") for number in range(3)]
        for agent in agents:
            agent.call("finish")
        stream = Stream(server)
        stream.hello()
        assert "Task:" in stream.say("finish")
        # The fourth household is the stream's; a fifth finds no room, by whatever way it comes.
        lease = {"worker": "more", "task_id": "FDP/home_0001", "rollouts": 1}
        status, headers, body = server.request("POST", "/api/leases", lease)
        assert status == 503 and {name.lower() for name in headers} >= {"retry-after"}, (status, headers, body)
        fourth = Agent(server, worker="more")
        result = fourth.call("finish")
        assert result["isError"] and "limit" in str(result), f"a session too many is told {result}"
        hello = {"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "more", "version": "1"}}
        message = {"jsonrpc": "2.0", "id": 1, "method": "initialize", "params": hello}
        plain = {name: value for name, value in fourth.headers.items() if name != "mcp-session-id"}
        status, _, body = server.request("POST", "/mcp", json.dumps(message), plain)
        assert status == 503, f"a session too many is answered {status} {body[:200]}"
        assert server.request("DELETE", "/api/sessions/w-a0")[0] == 204
        assert "Task:" in fourth.say("finish"), "who leaves makes no room"
        assert not agents[1].call("ask", question="q")["isError"]
        found = [server.request("GET", "/api/jobs/1") for _ in range(400)]
        limited = [headers for status, headers, _ in found if status == 429]
        assert limited and {status for status, _, _ in found} <= {404, 429}, {status for status, _, _ in found}
        assert "retry-after" in {name.lower() for name in limited[0]}, limited[0]
        time.sleep(2.5)
        assert not agents[1].call("ask", question="after the pause")["isError"]


# Hostile input


#: More nested than anything means.
DEEP = b"[" * 10_000 + b"]" * 10_000
NO_UTF8 = b'{"jsonrpc":"2.0","id":1,"method":"tools/call","params":{"name":"ask","arguments":{"question":"\xff\xfe\xc3("}}}'


def fault_deep_json_and_invalid_utf8():
    """JSON ten thousand levels deep, and bytes that are no UTF-8: 4xx on every route that takes a body, also where they stand in
    the arguments of a call; the session that sent them goes on."""
    with serving("--run", "deep") as server:
        agent, sse = Agent(server, worker="a"), Stream(server)
        sse.hello()
        agent.call("finish")
        call = b'{"jsonrpc":"2.0","id":77,"method":"tools/call","params":{"name":"ask","arguments":{"question":"q","x":%b}}}'
        objects = b'{"a":' * 10_000 + b"1" + b"}" * 10_000
        bodies = {
            "lists": DEEP, "objects": objects, "in arguments": call % DEEP, "no UTF-8": NO_UTF8, "nothing": b"",
            "half": b'{"jsonrpc":', "a lone surrogate": b'{"question":"\\ud800"}', "no number": b'{"n":NaN}', "a zero": b"\x00",
            "UTF-16": '{"sql":"SELECT 1"}'.encode("utf-16"), "after the end": b'{"sql":"SELECT 1"} x', "a mark": b"\xef\xbb\xbf{}",
        }
        session = {name: agent.headers[name] for name in ("mcp-session-id", "mcp-protocol-version")}
        targets = [
            ("/mcp", {}), ("/mcp", session), ("/w/a/mcp", session), ("/analysis/mcp", {}), ("/api/sql", {}), ("/api/jobs", {}),
            (f"/messages/?session_id={sse.session}", {}), ("/api/labels", {}), ("/api/leases", {}),
            ("/api/traces/x/branches", {}), ("/api/sessions/x/answer", {}),
        ]
        wrong = []
        for path, headers in targets:
            for name, body in bodies.items():
                wire = Wire(server, posted(path, body, headers))
                status = wire.status()
                if status not in range(400, 500):
                    wrong.append((path, name, status, wire.heard[-120:]))
                wire.close()
        assert not wrong, wrong
        # As deep as goes through: it is on tape, and can be read again.
        for depth in [10, 60, *range(110, 130)]:
            deep = b"[" * depth + b"]" * depth
            Wire(server, posted("/w/a/mcp", call % deep, session)).status()
        assert agent.call("ask", question="after all that")["structuredContent"]["ok"]
        assert "ask" in sse.say("finish") or True
        agent.call("finish")
        healthy(server.traces()[0])
        exact(server.traces()[0])


def fault_bytes_that_are_no_text():
    """Bytes that are no UTF-8, controls and lengths beyond reason in paths, queries and headers: 4xx, or passed over."""
    with serving() as server:
        agent = Agent(server)
        targets = [b"/%ff", b"/api/traces/%ff", b"/api/traces/\xff", b"/api/traces?after=%ff%00", b"/w/%ff/mcp", b"/messages/?session_id=%ff",
            b"/api/episodes?family=%ff", b"/api/jobs/%00", b"/" + b"a" * 20_000, b"/api/traces/" + b"%2e" * 10_000, b"/api/queries/%f0%28"]
        wrong = []
        for target in targets:
            wire = Wire(server, b"GET %b HTTP/1.1\r\nHost: localhost\r\n\r\n" % target)
            status = wire.status()
            if status is None or status >= 500:
                wrong.append((target[:60], status))
            wire.close()
        values = [b"\xff\xfe", b"\x01", b"a" * 20_000, "é".encode(), b"0" * 5000]
        names = [b"mcp-session-id", b"mcp-protocol-version", b"authorization", b"range", b"content-type", b"last-event-id", b"accept",
            b"content-length", b"origin", b"transfer-encoding"]
        for name in names:
            for value in values:
                for line in (b"GET /mcp", b"POST /mcp", b"GET /api/traces", b"POST /api/sql", b"GET /sse"):
                    wire = Wire(server, b"%b HTTP/1.1\r\nHost: localhost\r\n%b: %b\r\n\r\n" % (line, name, value))
                    status = wire.status()
                    if status is None or status >= 500:
                        wrong.append((line, name, value[:10], status))
                    wire.close()
        assert "FDP" in agent.say("list_tasks")
        assert not wrong, wrong


class Bystander:
    """Somebody who plays on while a test does its worst elsewhere."""

    def __init__(self, server, headers=None):
        self.player = Player(server, "bystander", headers, pause=0.05)

    def __enter__(self):
        self.player.start()
        return self.player

    def __exit__(self, kind, *_):
        self.player.enough.set()
        self.player.join(70)
        if kind is None:
            assert not self.player.error, f"the bystander's game broke off: {self.player.error}"
            assert self.player.answered > 3, f"the bystander made {self.player.answered} calls"


def fault_hostile_calls():
    """Tool names and arguments that nobody means: an answer in words, no protocol error, no panic; what was sent is on tape to the
    letter and replays, and a bystander plays on."""
    with serving("--run", "hostile") as server, Bystander(server):
        agent = Agent(server, worker="a")
        numbers = random.Random(7)
        floats = [numbers.uniform(-1, 1) * 10 ** numbers.randint(-300, 300) for _ in range(500)]
        texts = ["", "\0", "\n", "x" * 300_000, "😀" * 1000, "‮", "\uffff", "%s%n", "../../etc/passwd", "'; DROP TABLE episodes", "é", "é"]
        names = ["", "\0", "x" * 50_000, "../../x", "Finish", "finish ", "ｆｉｎｉｓｈ", "__proto__", "tools/call", "🤖", "finish\n"]
        markers = [-1, 2**31, 2**32, 2**63, 2**64 - 1, 2**64, 1e300, -1e300, 5e-324, 1.5, True, None, [], {}, "", "-1", "1e3", "٣", "9" * 400]
        calls = [(name, {"question": "q"}) for name in names]
        calls += [("pick", {"marker_id": marker}) for marker in markers]
        calls += [(tool, {name: text}) for text in texts for tool, name in [
            ("ask", "question"), ("nav_to", "receptacle_name"), ("show_object_by_category", "target_category"), ("finish_with_id", "task_id")]]
        calls += [("ask", {"question": value}) for value in [1, None, [], {}, True, [["q"]]]]
        calls += [("ask", {"question": "q", "x": floats}), ("ask", {"question": "q", "x": [-0.0, 1e22, 5e-324, 1.7976931348623157e308]})]
        calls += [("ask", {"question": "q", "k" * 10_000: 1, "": 2, "\0": 3}), ("walk_around", {str(n): n for n in range(5000)})]
        sent, wrong = [], []
        for number, (tool, arguments) in enumerate(calls):
            if number % 20 == 0:
                agent.call("finish")
                sent.append([])
            try:
                result = agent.call(tool, **arguments)
                assert result["content"][0]["text"], "an answer without words"
            except Exception as error:
                wrong.append((tool[:20], str(arguments)[:60], str(error)[:200]))
                continue
            if tool != "finish_with_id":
                sent[-1].append((tool, arguments))
        assert not wrong, wrong
        # Whole messages that are none.
        messages = [
            [], {}, [[]], 1, "x", None, {"jsonrpc": "1.0", "id": 1, "method": "ping"}, {"jsonrpc": "2.0", "id": {}, "method": "ping"},
            {"jsonrpc": "2.0", "id": 1, "method": ""}, {"jsonrpc": "2.0", "id": 1, "method": "tools/call"},
            {"jsonrpc": "2.0", "id": 1, "method": "tools/call", "params": {"name": "ask", "arguments": [1]}},
            {"jsonrpc": "2.0", "id": 1, "method": "tools/call", "params": {"name": 3}}, {"jsonrpc": "2.0", "id": 9, "result": {}},
            {"jsonrpc": "2.0", "method": "notifications/cancelled", "params": {"requestId": 999999}},
            {"jsonrpc": "2.0", "id": 2**63, "method": "ping"}, {"jsonrpc": "2.0", "id": -1.5, "method": "ping"},
            {"jsonrpc": "2.0", "id": "x" * 100_000, "method": "tools/list"}, {"jsonrpc": "2.0", "id": 1, "method": "resources/read"},
            [{"jsonrpc": "2.0", "id": 1, "method": "ping"}] * 100, {"jsonrpc": "2.0", "id": 1, "method": "logging/setLevel"},
            {"jsonrpc": "2.0", "id": 1, "method": "tools/list", "params": {"cursor": "\0"}}, {"method": "initialize"},
        ]
        for message in messages:
            status, _, body = server.request("POST", agent.path, json.dumps(message), agent.headers, timeout=LATE_S)
            if status >= 500:
                wrong.append((str(message)[:80], status, body[:120]))
        assert not wrong, wrong
        agent.call("finish")
        whole = {path.name.split("--")[2]: path for path in server.traces() if "--w-a--" in path.name}
        kept = [(step["input"]["call"]["name"], step["input"]["call"]["arguments"]) for path in sorted(whole.values()) for step in steps(path)]
        flat = [call for made in sent for call in made]
        assert [call for call in kept if call[0] != "finish"] == [call for call in flat if call[0] != "finish"], "the tape holds others"
        code, out, err = reel("doctor", *whole.values())
        assert code == 0, out[-2000:]
        exact(*whole.values())


def with_tables(server):
    """A finished trace, and tables that hold it; its name."""
    agent = Agent(server, worker="recorded")
    agent.call("finish"), agent.call("nav_to", receptacle_name="table_1"), agent.call("show_receptacles"), agent.call("finish")
    agent.call("finish")
    job = server.json("POST", "/api/jobs", {"kind": "ingest"})[1]
    ended = lambda: server.json("GET", f"/api/jobs/{job['id']}")[1]["stage"] not in ("waiting", "running")  # noqa: E731
    assert until(ended, 60), "the ingest does not end"
    assert server.json("GET", f"/api/jobs/{job['id']}")[1]["stage"] == "done", server.json("GET", f"/api/jobs/{job['id']}")
    return server.traces()[0].stem


def analyst(server):
    """An assistant at `/analysis/mcp`."""
    agent = Agent.__new__(Agent)
    agent.server, agent.path, agent.number = server, "/analysis/mcp", 0
    agent.headers = {"content-type": "application/json", "accept": "application/json, text/event-stream", "mcp-protocol-version": "2025-06-18"}
    agent.rpc("initialize", {"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "harness", "version": "1"}})
    agent.post({"jsonrpc": "2.0", "method": "notifications/initialized"})
    return agent


#: Ways out of a folder.
WAYS_OUT = [
    "..%2fsecret", "..%2f..%2fsecret", "%2e%2e%2fsecret", "%2e%2e/secret", "..", "%2e%2e", "..%5csecret", "%252e%252e%252fsecret", "x%2f..%2f..%2fsecret",
    "%2fetc%2fpasswd", "....%2f%2fsecret", "secret%00", ".secret", "%c0%ae%c0%ae%c0%afsecret", "x%0a", "-rf", "secret.mcap", "%ff", "x" * 5000, "é",
]


def fault_hostile_requests():
    """Numbers, names and cameras that cannot be, on every REST route: 4xx (or an answer that means nothing worse), never 5xx; a
    bystander plays on."""
    with serving("--run", "rest") as server, Bystander(server):
        trace = with_tables(server)
        huge, numbers = str(2**64), ["-1", "0", "1001", str(2**32), str(2**63), str(2**64 - 1), str(2**64), "1e9", "NaN", "", "%00", "٣"]
        eyes = ["nan,nan,nan", "inf,0,0", "-inf,0,0", "1e308,1e308,1e308", "1e-320,0,0", "0,0,0", "0,0", "0,0,0,0", "", "a,b,c", "1e39,0,0"]
        asked = []

        def ask(method, path, body=None, headers=None):
            asked.append((method, path, body, headers))

        for eye in eyes:
            for other in ["0,0,0", "nan,0,0", eye]:
                ask("GET", f"/api/traces/{trace}/frames/0?camera=free&eye={eye}&look_at={other}")
        for camera in ["follow:", "follow:" + "x" * 5000, "follow:%00", "free", "%ff", "head%00", "top-down" * 100]:
            ask("GET", f"/api/traces/{trace}/frames/0?camera={camera}")
        for number in numbers:
            number = urllib.parse.quote(number, safe="%")
            ask("GET", f"/api/traces/{trace}/frames/{number}")
            ask("GET", f"/api/traces/{trace}/steps?from={number}")
            for path in [f"/api/traces/{trace}/steps", "/api/traces", "/api/episodes"]:
                ask("GET", f"{path}?limit={number}")
            for path in ["", "/events"]:
                ask("GET", f"/api/jobs/{number}{path}")
            ask("DELETE", f"/api/jobs/{number}")
        for way in WAYS_OUT + [huge, "*", "con", "a b", "%20"]:
            way = urllib.parse.quote(way, safe="%/")
            for path in ["", "/episode", "/steps", "/frames/0", "/blame", "/reward"]:
                ask("GET", f"/api/traces/{way}{path}")
            ask("PUT", f"/api/traces/{way}", b"x")
            ask("DELETE", f"/api/traces/{way}")
            ask("POST", f"/api/traces/{way}/replay")
            ask("POST", f"/api/traces/{way}/branches", {"at": 0, "policy": "planner", "name": "other"})
            for path in [f"/api/sessions/{way}", f"/api/queries/{way}", f"/api/traces?after={way}"]:
                ask("GET", path)
            ask("DELETE", f"/api/sessions/{way}")
            ask("DELETE", f"/api/leases/{way}")
            ask("POST", f"/api/sessions/{way}/answer", {"answer": "x"})
            ask("POST", f"/w/{way}/mcp", {})
        for word in ["%00", "..%2f", "x" * 5000, "%27%3b%20DROP%20TABLE%20episodes%3b%20--", "%ff"]:
            for path in [f"/api/episodes/{word}", f"/api/queries/benchmark?parameters={word}=1", f"/api/labels?episode={word}",
                    f"/api/episodes?family={word}&task_id={word}&after={word}&policy={word}"]:
                ask("GET", path)
        for value in ["bytes=18446744073709551615-", "bytes=0-18446744073709551615", "bytes=-18446744073709551615", "bytes=5-1", "bytes=-",
                "bytes=99999999999999999999-", "bytes=0-0,2-3", "chars=1-2", "bytes=\x01"]:
            ask("GET", f"/api/traces/{trace}", None, {"range": value})
        branch = {"at": 0, "name": "made"}
        for more in [{"at": 2**63, "policy": "planner"}, {"at": -1, "policy": "planner"}, {"at": 0.5, "policy": "planner"}, {"parent_from": 2**64 - 1},
                {"policy": "\0"}, {"policy": "model:http://localhost:1"}, {"policy": "planner", "name": "../made"}, {"policy": "planner", "name": "m\0"},
                {"policy": "planner", "seed": -1}, {"calls": []}, {"calls": [{"name": "\0", "arguments": [1]}] * 50, "name": "made1"},
                {"calls": [{"name": "finish", "arguments": {}}] * 3, "name": "made2"}, {"policy": "planner", "parent_from": 0}]:
            ask("POST", f"/api/traces/{trace}/branches", {**branch, **more})
        label = {"episode": "x", "class": "Other", "author": "a"}
        for more in [{"episode": ""}, {"episode": "--help"}, {"episode": "\0"}, {"note": "a\0b"}, {"author": "\n\0"}, {"note": "y" * 500_000}, {"step": -(2**31)},
                {"step": 2**31}, {"confidence": 1e308}, {"confidence": -1}, {"class": "\0"}, {"sub_class": "--store=/tmp"}, {"more": 1}]:
            ask("POST", "/api/labels", {**label, **more})
        lease = {"worker": "leased", "task_id": "FDP/home_0001", "rollouts": 1}
        for more in [{"worker": "../x"}, {"worker": ""}, {"worker": "x" * 63}, {"task_id": "../x"}, {"task_id": "\0"}, {"rollouts": 0}, {"rollouts": 2**32},
                {"rollouts": -1}, {"seed": -1}, {"seed": 2**64}, {"seed": 2**64 - 1, "worker": "l1"}, {"group_id": "\0../\n", "worker": "l2"},
                {"rollouts": 2**32 - 1, "worker": "l3"}, {"group_id": "g" * 500_000, "worker": "l4"}, {"group_id": "", "worker": "l5"}]:
            ask("POST", "/api/leases", {**lease, **more})
        export = {"kind": "export", "set": "sft", "name": "set"}
        for work in [{"kind": ""}, {"kind": "ingest", "traces": ["../secret"]}, {"kind": "replay", "traces": ["--help"]}, {"kind": "replay", "traces": ["x" * 9000]},
                {"kind": "reward", "preset": "/etc/passwd"}, {"kind": "reward", "preset": "\0"}, {**export, "name": "../set"}, {**export, "set": "all"},
                {**export, "options": {"out": "/tmp/x"}}, {**export, "options": {"where": ["x"]}}, {**export, "options": {"store": "/"}},
                {**export, "options": {"tokenizer": "/etc/passwd"}}, {**export, "options": {"where=x --out": "y"}}, {"kind": "ingest", "traces": trace}]:
            ask("POST", "/api/jobs", work)
        for method, path in [("BREW", "/healthz"), ("TRACE", "/api/sql"), ("OPTIONS", "/mcp"), ("PATCH", f"/api/traces/{trace}"), ("POST", "/api/traces"),
                ("DELETE", "/"), ("GET", "/" + "a/" * 4000), ("PUT", "/mcp"), ("HEAD", f"/api/traces/{trace}"), ("GET", "//"), ("GET", "/api/../api/traces")]:
            ask(method, path)
        wrong = []
        for method, path, body, headers in asked:
            try:
                status, _, answer = server.request(method, path, body, headers, timeout=30)
            except (ValueError, UnicodeError):
                # What the library of this test refuses to send goes out by hand elsewhere.
                continue
            except OSError as error:
                status, answer = None, repr(error).encode()
            if status is None or status >= 500:
                wrong.append((method, path[:70], str(body)[:70], status, answer[:160]))
        assistant = analyst(server)
        for way in [urllib.parse.unquote(way) for way in WAYS_OUT if "%ff" not in way and "%c0" not in way] + [trace, "", None, 3, []]:
            for tool, arguments in [("show_episode", {"trace": way}), ("blame", {"trace": way}), ("explain_failure", {"trace": way}), ("query", {"sql": way}),
                    ("list_episodes", {"where": way, "limit": -1}), ("list_episodes", {"where": "true) UNION SELECT 1", "limit": 2**64 - 1}), (str(way), {})]:
                if arguments.get("trace") == trace or len(str(way)) < 100:
                    try:
                        assert assistant.call(tool, **arguments)["content"]
                    except RuntimeError as error:
                        wrong.append((tool, arguments, str(error)))
        # Who was let in with strange numbers plays, and its tape is whole.
        for worker in ["l1", "l2", "l3", "l4", "l5"]:
            agent = Agent(server, worker=worker)
            assert "Task:" in agent.say("finish"), worker
            agent.call("ask", question="q")
            agent.call("finish")
        assert not wrong, f"{len(wrong)} of {len(asked)}: {wrong}"
        assert reel("doctor", *server.traces())[0] == 0, reel("doctor", *server.traces())[1][-1500:]


def fault_hostile_sql():
    """Questions that would write, read files, take all memory or all time: 4xx, or an answer, in about the time they have; the
    next question is answered."""
    sql_s = 2
    with serving(config=f"[limits]\nsql_s = {sql_s}\npatience_s = 5\n") as server, Bystander(server):
        with_tables(server)
        write = pathlib.Path(server.data) / "written.csv"
        tables = ", ".join(f"episodes e{number}" for number in range(60))
        questions = {
            "a file": "SELECT * FROM '/etc/passwd'", "a table of a file": "CREATE EXTERNAL TABLE t STORED AS CSV LOCATION '/etc/passwd'",
            "a copy": f"COPY (SELECT 1) TO '{write}'", "a setting": "SET datafusion.execution.batch_size = 1", "two": "SELECT 1; SELECT 2",
            "an insert": "INSERT INTO episodes SELECT * FROM episodes", "a drop": "DROP TABLE episodes", "nothing": "", "a zero": "SELECT '\0'",
            "a long text": "SELECT repeat('x', 9223372036854775807)", "a list": "SELECT array_repeat(1, 9223372036854775807)",
            "a sum": "SELECT 1" + "+1" * 50_000, "brackets": "SELECT " + "(" * 20_000 + "1" + ")" * 20_000, "nots": "SELECT " + "NOT " * 20_000 + "true",
            "ors": "SELECT 1 WHERE " + " OR ".join(["1=1"] * 50_000), "unions": " UNION ALL ".join(["SELECT 1"] * 5000),
            "nested": "SELECT * FROM (" * 500 + "SELECT 1" + ")" * 500, "functions": "SELECT " + "abs(" * 5000 + "1" + ")" * 5000,
            "cases": "SELECT " + "CASE WHEN true THEN " * 3000 + "1" + " END" * 3000, "casts": "SELECT 1" + "::int" * 20_000,
            "an expression": "SELECT 'a' ~ '" + "(a{1000}){1000}" * 20 + "'", "a pattern": "SELECT 'x' LIKE '" + "%a" * 100_000 + "'",
            "divided by zero": "SELECT 1/0", "overflow": "SELECT abs(-9223372036854775808)", "no date": "SELECT make_date(2147483647, 1, 1)",
            "a remainder": "SELECT -9223372036854775808 % -1", "an interval": "SELECT interval '999999999999 years'", "bins": "SELECT date_bin(interval '0 seconds', now())",
            "no end": "WITH RECURSIVE t(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM t) SELECT count(*) FROM t",
            "a long count": "SELECT count(*) FROM generate_series(1, 100000000000)",
            "a product": "SELECT count(*) FROM generate_series(1, 1000000) a, generate_series(1, 1000000) b",
            "zones": "SELECT now()" + " AT TIME ZONE 'UTC'" * 1500, "many tables": f"SELECT 1 FROM {tables}",
            "many rows": "VALUES " + ",".join(["(1)"] * 100_000),
        }
        if QUICK:
            questions = {name: questions[name] for name in ["a file", "a copy", "a long text", "a sum", "brackets", "no end", "a product", "zones"]}
        wrong, patience = [], sql_s + 3 * LATE_S
        for name, sql in questions.items():
            begun = time.monotonic()
            try:
                status, _, answer = server.request("POST", "/api/sql", {"sql": sql}, timeout=patience)
            except TimeoutError:
                status, answer = None, f"no answer after {patience} s".encode()
            except http.client.IncompleteRead:
                # The answer had begun when its limit was reached.
                status, answer = 200, b""
            if status is None or status >= 500:
                wrong.append((name, status, answer[:160], round(time.monotonic() - begun, 1)))
        for version in [10, 2**32, 2**63, 2**64 - 1]:
            begun = time.monotonic()
            try:
                status, _, answer = server.request("POST", "/api/sql", {"sql": "SELECT 1", "at": version}, timeout=patience)
            except TimeoutError:
                status, answer = None, f"no answer after {patience} s".encode()
            if status is None or status >= 500:
                wrong.append((f"version {version}", status, answer[:160], round(time.monotonic() - begun, 1)))
        assert not write.exists(), "a question wrote a file"
        status, _, answer = server.request("POST", "/api/sql", {"sql": "SELECT 7 AS n"}, timeout=patience)
        assert (status, json.loads(answer)) == (200, [{"n": 7}]) and not wrong, f"afterwards: {status} {answer[:160]}; wrong: {wrong}"


# Who may what


def fault_session_ids():
    """Session ids that are wrong, of somebody who left, or of another endpoint: 404, and no world behind them is touched."""
    with serving("--run", "ids") as server:
        first, second = Agent(server), Agent(server)
        first.call("finish"), second.call("finish")
        analysis = analyst(server)
        call = {"jsonrpc": "2.0", "id": 5, "method": "tools/call", "params": {"name": "ask", "arguments": {"question": "stolen"}}}

        def status(session, method="POST", path="/mcp"):
            headers = {**first.headers, "mcp-session-id": session}
            if session is None:
                del headers["mcp-session-id"]
            return server.request(method, path, json.dumps(call) if method == "POST" else None, headers, timeout=LATE_S)[0]

        old = first.headers["mcp-session-id"]
        assert server.request("DELETE", "/mcp", None, first.headers)[0] in (200, 202, 204)
        strange = ["x", "0" * 36, "00000000-0000-0000-0000-000000000000", old, old.upper(), second.headers["mcp-session-id"] + "0", "../x",
            "x" * 5000, analysis.headers["mcp-session-id"], "w-a", "s-" + "0" * 32]
        for session in strange:
            for path in ["/mcp", "/w/a/mcp"]:
                for method in ["POST", "GET", "DELETE"]:
                    found = status(session, method, path)
                    fine = (404,) if method != "DELETE" else (404, 202, 204)
                    assert found in fine, f"{method} {path} with session {session[:40]!r}: {found}"
        assert status(second.headers["mcp-session-id"], path="/analysis/mcp") == 404
        for method in ["POST", "GET", "DELETE"]:
            assert status(None, method) in range(400, 500), "without a session"
        # What another session was told cannot be heard again under one's own id.
        second.call("list_tasks"), Agent(server, worker="b").call("ask", question="private")
        for event in ["0", "0/1", "1/1", "1/2", "2/2", "0/9", "x", "", "1/1/1", "-1", "9" * 30, "x" * 5000]:
            wire = Wire(server, request("GET", "/mcp", {**second.headers, "last-event-id": event}))
            assert wire.status() in (*range(200, 300), *range(400, 500)), f"after event {event[:20]!r}: {wire.heard[:100]}"
            wire.until_closed(time.monotonic() - wire.begun + 0.3)
            assert b"private" not in wire.heard and b"no episode" not in wire.heard, f"after event {event[:20]!r} another session's answer comes"
            wire.close()
        # The life of the others went on, and nothing of all that is on their tapes.
        assert analysis.call("list_episodes")["content"]
        assert not second.call("ask", question="mine")["isError"]
        assert until(lambda: len(server.traces()) == 1, 20), "the episode of the session that was deleted is not whole"
        stood = [entry["steps"] for entry in server.json("GET", "/api/sessions")[1] if entry["session"].startswith("s-")]
        assert stood == [1], f"the other session has other calls than its own: {stood}"
        second.call("finish")
        asked = {step["input"]["call"]["arguments"].get("question") for path in server.traces() for step in steps(path)}
        assert asked == {"mine", None}, f"on tape is {asked}"
        # The transport of 2024.
        one, two = Stream(server), Stream(server)
        one.hello(), two.hello()
        one.say("finish"), two.say("finish")
        one.wire.close()
        gone = until(lambda: server.request("POST", f"/messages/?session_id={one.session}", call)[0] == 404, 10)
        assert gone, "the session of a stream that was closed is still there"
        for query, fine in [("?session_id=x", 404), ("?session_id=" + "0" * 32, 404), ("?session_id=", 404), ("", 400), ("?other=1", 400),
                (f"?session_id={old}", 404), (f"?session_id={two.session[:-1]}", 404)]:
            found = server.request("POST", f"/messages/{query}", call)[0]
            assert found == fine, f"/messages/{query}: {found}, not {fine}"
        assert '"decision":1,' in two.say("ask", question="mine too").replace(" ", ""), "the other stream goes on where it was"


def fault_worlds_apart():
    """Sessions, workers and streams at one time: each has its own world, from the briefing to the tape."""
    with serving("--run", "apart") as server:
        clients = [Agent(server), Agent(server), Agent(server, worker="a"), Agent(server, worker="b"), Stream(server), Stream(server, worker="c")]
        for client in clients[4:]:
            client.hello()

        def play(number):
            client, texts = clients[number], []
            client.say("finish")
            places = ["table_1", "bed_1", "counter_1"]
            for turn in range(4):
                if (number + turn) % 2:
                    texts.append(client.say("nav_to", receptacle_name=places[(number + turn) % 3]))
                texts.append(client.say("ask", question=f"client {number}"))
            client.say("show_receptacles")
            client.say("finish")
            return texts

        with concurrent.futures.ThreadPoolExecutor(len(clients)) as pool:
            list(pool.map(play, range(len(clients))))
        sessions = server.json("GET", "/api/sessions")[1]
        assert len(sessions) == len(clients) and len({entry["session"] for entry in sessions}) == len(clients), sessions
        first = [path for path in server.traces() if "--0000--" in path.name]
        assert len(first) == len(clients), first
        seen = []
        for path in first:
            kept = steps(path)
            asked = {step["input"]["call"]["arguments"].get("question") for step in kept} - {None}
            assert len(asked) == 1, f"{path.name} holds the calls of {asked}"
            (asked,) = asked
            seen.append(asked)
            number = int(asked.split()[1])
            places = [step["input"]["call"]["arguments"]["receptacle_name"] for step in kept if step["input"]["call"]["name"] == "nav_to"]
            assert places == [["table_1", "bed_1", "counter_1"][(number + turn) % 3] for turn in range(4) if (number + turn) % 2], (path.name, places)
        assert sorted(seen) == [f"client {number}" for number in range(len(clients))]
        exact(*first)
        # A worker's world is the same by either transport, and nobody finds it by the name of a session.
        again = Agent(server, worker="c")
        assert again.call("ask", question="still me")["structuredContent"]["decision"] == 1
        assert Agent(server, worker="w-c").call("ask", question="x")["structuredContent"]["error"]["code"] == "no_episode"


def token(server_data, name, *roles):
    """A new token."""
    code, out, err = reel("token", "create", name, "--data", server_data, *(part for role in roles for part in ("--role", role)))
    assert code == 0, err
    return re.search(r"reel_[0-9a-f]{64}", out)[0]


#: A request for every kind of route, and the role that it takes.
ROUTES = [
    ("act", "POST", "/mcp"), ("act", "GET", "/mcp"), ("act", "DELETE", "/mcp"), ("act", "GET", "/sse"), ("act", "POST", "/messages/?session_id=x"),
    ("act", "POST", "/w/a/mcp"), ("act", "GET", "/w/a/sse"), ("act", "POST", "/api/leases"), ("act", "DELETE", "/api/leases/a"),
    ("read", "GET", "/api/traces"), ("read", "GET", "/api/traces/x"), ("read", "HEAD", "/api/traces/x"), ("read", "GET", "/api/traces/x/episode"),
    ("read", "GET", "/api/traces/x/steps"), ("read", "GET", "/api/traces/x/frames/0"), ("read", "GET", "/api/traces/x/blame"),
    ("read", "GET", "/api/traces/x/reward"), ("read", "POST", "/api/traces/x/replay"), ("read", "GET", "/api/episodes"), ("read", "GET", "/api/episodes/x"),
    ("read", "POST", "/api/sql"), ("read", "GET", "/api/queries"), ("read", "GET", "/api/queries/benchmark"), ("read", "GET", "/api/labels"),
    ("read", "GET", "/api/jobs"), ("read", "GET", "/api/jobs/1"), ("read", "GET", "/api/jobs/1/events"), ("read", "GET", "/api/sessions"),
    ("read", "GET", "/api/sessions/x"), ("read", "GET", "/api/questions"), ("read", "GET", "/metrics"), ("read", "POST", "/analysis/mcp"),
    ("admin", "PUT", "/api/traces/x"), ("admin", "DELETE", "/api/traces/x"), ("admin", "POST", "/api/traces/x/branches"), ("admin", "POST", "/api/jobs"),
    ("admin", "DELETE", "/api/jobs/1"), ("admin", "POST", "/api/labels"), ("admin", "DELETE", "/api/sessions/x"), ("admin", "POST", "/api/sessions/x/answer"),
]


def head_of(server, method, path, headers=None):
    """Status of an answer, without its body: streams have no end."""
    body = {"content-type": "application/json", "accept": "application/json, text/event-stream", "content-length": "2"}
    wire = Wire(server, request(method, path, {**(body if method in ("POST", "PUT") else {}), **(headers or {})}) + (b"{}" if method in ("POST", "PUT") else b""))
    status = wire.status()
    wire.close()
    return status


def fault_tokens():
    """No token, garbage, another scheme, another role, a revoked one: refused on every kind of route, and before anything else
    is looked at. Tokens, their hashes and the ids of sessions are in no log, no trace and no answer."""
    with tempfile.TemporaryDirectory(prefix="reel-faults-") as folder:
        data = pathlib.Path(folder) / "data"
        tokens = {role: token(data, f"the-{role}", role) for role in ("act", "read", "admin")}
        gone = token(data, "gone", "act", "read", "admin")
        hashes = re.findall(r'hash = "([0-9a-f]+)"', (data / "tokens.toml").read_text())
        assert len(hashes) == 4 and not any(secret in (data / "tokens.toml").read_text() for secret in [*tokens.values(), gone])
        with serving("--run", "tokens", folder=folder, config='log_filter = "debug"\n') as server:
            documented = server.json("GET", "/api/openapi.json")[1]["paths"]
            known = {(method, re.sub(r"\{[^}]*\}", "*", path)) for path, methods in documented.items() for method in methods}
            tried = {(method.lower(), re.sub(r"/(x|0|1|a|benchmark)(?=/|$)", "/*", path.split("?")[0])) for _, method, path in ROUTES}
            missing = known - tried - {("get", "/healthz"), ("get", "/readyz"), ("get", "/api/openapi.json")}
            assert not missing, f"routes that this test does not know: {missing}"
            good = f"Bearer {tokens['admin']}"
            proofs = {
                "none": None, "empty": "", "garbage": "Bearer garbage", "no scheme": tokens["admin"], "basic": f"Basic {tokens['admin']}",
                "scheme alone": "Bearer", "scheme and blank": "Bearer ", "a hash": f"Bearer {hashes[2]}", "a beginning": good[:-1], "more": good + "0",
                "a list": f"Bearer x, {good}", "upper case": f"Bearer {tokens['admin'].upper()}", "a prefix": "Bearer reel_",
            }
            wrong = []
            for name, proof in proofs.items():
                for role, method, path in ROUTES if name in ("none", "garbage") else ROUTES[::7]:
                    found = head_of(server, method, path, {"authorization": proof} if proof is not None else {})
                    if found != 401:
                        wrong.append((name, method, path, found))
            for role, method, path in ROUTES:
                for mine, secret in tokens.items():
                    found = head_of(server, method, path, {"authorization": f"Bearer {secret}"})
                    allowed = mine in (role, "admin")
                    if (found in (401, 403)) == allowed or found is None or found >= 500:
                        wrong.append((f"token of role {mine}", method, path, found))
            # Ways around: what is not the path of a route is nobody's.
            for path in ["/w/../api/traces", "/w/%2e%2e/api/traces", "//api/traces", "/api/leases/../traces", "/api/leases/%2e%2e/traces", "/api/./traces",
                    "/mcp/../api/traces", "/API/traces", "/api/traces%2f", "/api/traces?x=/mcp", "/api/sessions;/mcp", "/metrics/", "/w/x/../../metrics"]:
                found = head_of(server, "GET", path, {"authorization": f"Bearer {tokens['act']}"})
                if found is None or found < 400:
                    wrong.append(("act goes around", "GET", path, found))
            for path in ["/healthz", "/readyz", "/api/openapi.json"]:
                if (found := head_of(server, "GET", path)) != 200:
                    wrong.append(("nobody", "GET", path, found))
            status, headers, body = server.request("GET", "/api/traces")
            assert {name.lower(): value for name, value in headers.items()}.get("www-authenticate") == "Bearer", headers
            # The token of a request that does not pass decides before its body does.
            begun = time.monotonic()
            wire = Wire(server, request("POST", "/api/sql", {"content-length": "1000"}))
            assert wire.status() == 401 and time.monotonic() - begun < LATE_S, "a stranger's body is waited for"
            wire.close()
            # Revoked: within two seconds, and for those who are already in.
            agent = Agent(server, headers={"authorization": f"Bearer {gone}"})
            agent.call("finish")
            assert reel("token", "revoke", "gone", "--data", data)[0] == 0
            begun = time.monotonic()
            while head_of(server, "GET", "/api/traces", {"authorization": f"Bearer {gone}"}) != 401:
                assert time.monotonic() - begun < 2 + LATE_S, "a revoked token still works"
            took = time.monotonic() - begun
            assert took < 3, f"a revoked token worked for {took:.1f} s"
            call = {"jsonrpc": "2.0", "id": 9, "method": "tools/call", "params": {"name": "ask", "arguments": {"question": "q"}}}
            assert server.request("POST", "/mcp", call, agent.headers)[0] == 401, "the session of a revoked token goes on"
            late = token(data, "late", "read")
            assert until(lambda: head_of(server, "GET", "/api/traces", {"authorization": f"bearer {late}"}) == 200, 3), "a new token is not noticed"
            player = Agent(server, worker="p", headers={"authorization": f"Bearer {tokens['act']}"})
            player.call("finish"), player.call("ask", question="q"), player.call("finish")
            secrets = [secret.encode() for secret in [*tokens.values(), gone, late, *hashes]]
            said = b"".join(
                server.request("GET", path, None, {"authorization": f"Bearer {tokens['admin']}"})[2]
                for path in ["/api/sessions", "/metrics", "/api/jobs", "/api/openapi.json", "/api/traces"]
            )
            kept = b"".join(path.read_bytes() + json.dumps(steps(path)).encode() + reel("show", path, "--json")[1].encode() for path in server.traces())
            log = server.log.read_bytes()
            assert len(server.traces()) >= 1 and len(log) > 1000
            for what, text in [("an answer", said), ("a trace", kept), ("the log", log)]:
                for secret in secrets:
                    assert secret not in text and secret.removeprefix(b"reel_") not in text, f"a token or its hash is in {what}: {around(text, secret)}"
            assert not wrong, wrong


def around(text, secret):
    at = text.find(secret.removeprefix(b"reel_"))
    return text[max(0, at - 200) : at].decode(errors="replace")


def fault_last_token():
    """Taking back the last token, or losing the file, does not open the door."""
    with tempfile.TemporaryDirectory(prefix="reel-faults-") as folder:
        data = pathlib.Path(folder) / "data"
        token(data, "only", "admin")
        with serving(folder=folder) as server:
            assert server.request("GET", "/api/traces")[0] == 401
            assert reel("token", "revoke", "only", "--data", data)[0] == 0
            time.sleep(2.5)
            assert server.request("GET", "/api/traces")[0] == 401, "the last token was revoked, and now everybody may everything"
            (data / "tokens.toml").unlink()
            time.sleep(2.5)
            assert server.request("GET", "/api/traces")[0] == 401, "the file of tokens is gone, and now everybody may everything"
        with serving(folder=folder) as server:
            pass


def fault_log_says_nothing_of_policies():
    """What policies and their users say, and the ids by which sessions are reached, are in no log."""
    with serving("--run", "log") as server:
        agent, stream = Agent(server), Stream(server)
        stream.hello()
        agent.call("finish"), stream.say("finish")
        agent.call("ask", question="a word nobody logs: xyzzy"), agent.call("xyzzy", xyzzy="xyzzy"), stream.say("ask", question="xyzzy")
        agent.call("pick", marker_id="xyzzy"), agent.call("finish_with_id", task_id="xyzzy"), agent.call("finish")
        server.request("DELETE", "/mcp", None, agent.headers)
        server.request("POST", "/messages/?session_id=xyzzy", {"xyzzy": 1})
        stream.wire.close()
        time.sleep(0.5)
        log = server.log.read_text(errors="replace")
        for secret in ["xyzzy", agent.headers["mcp-session-id"], stream.session]:
            assert secret not in log, f"in the log: {around(log.encode(), secret.encode())} {secret}"


def fault_hosts_and_origins():
    """Requests that name another host, or come from a page of somebody else's, are refused on every route; those that are
    configured are not."""
    config = 'hosts = ["reel.example"]\norigins = ["https://lab.example"]\n'
    with serving(config=config) as server:
        wrong = []
        routes = [(method, path) for _, method, path in ROUTES] + [("GET", path) for path in ["/healthz", "/readyz", "/api/openapi.json", "/nowhere", "/"]]
        strange = [
            {"Host": "evil.example"}, {"Host": f"evil.example:{server.port}"}, {"Host": ""}, {"Host": "localhost.evil.example"}, {"Host": "127.0.0.1.nip.io"},
            {"Origin": "http://evil.example"}, {"Origin": "null"}, {"Origin": "https://lab.example.evil.example"}, {"Origin": f"http://localhost:{server.port + 1}"},
            {"Origin": "http://lab.example"}, {"Host": "reel.example", "Origin": "https://evil.example"}, {"Host": "evil.example", "Origin": "https://lab.example"},
        ]
        for method, path in routes:
            for number, headers in enumerate(strange):
                if number < 2 or headers == {"Origin": "http://evil.example"} or path in ("/mcp", "/api/traces", "/healthz"):
                    if (found := head_of(server, method, path, headers)) != 403:
                        wrong.append((method, path, headers, found))
        # A page that is not listed is not told that it may ask; one that is listed is.
        ask = {"Access-Control-Request-Method": "POST", "Access-Control-Request-Headers": "authorization,content-type,mcp-session-id"}
        for path in ["/mcp", "/w/a/mcp", "/api/sql", "/api/traces", "/messages/", "/sse", "/nowhere"]:
            for headers in [{"Origin": "http://evil.example"}, {"Origin": "null"}, {"Origin": "https://lab.example", "Host": "evil.example"}]:
                wire = Wire(server, request("OPTIONS", path, {**ask, **headers}))
                found = wire.status()
                if found in range(200, 300) or b"access-control-allow" in wire.heard.lower():
                    wrong.append(("OPTIONS", path, headers, wire.heard[:200]))
                wire.close()
        wire = Wire(server, request("GET", "/healthz", {"Origin": "http://evil.example"}))
        assert wire.status() == 403 and b"access-control-allow" not in wire.heard.lower(), wire.heard
        by_hand = {
            "no host": b"GET /healthz HTTP/1.1\r\n\r\n", "two hosts": b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n",
            "another in the target": b"GET http://evil.example/healthz HTTP/1.1\r\nHost: localhost\r\n\r\n",
            "a user": b"GET http://localhost@evil.example/healthz HTTP/1.1\r\nHost: localhost\r\n\r\n", "no host, as of old": b"GET /healthz HTTP/1.0\r\n\r\n",
            "two origins": b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nOrigin: http://localhost\r\nOrigin: http://evil.example\r\n\r\n",
        }
        for name, bytes_ in by_hand.items():
            wire = Wire(server, bytes_)
            if (found := wire.status()) not in range(400, 500):
                wrong.append((name, found))
            wire.close()
        fine = [{}, {"Host": f"127.0.0.1:{server.port}"}, {"Host": "[::1]"}, {"Host": "reel.example"}, {"Host": "REEL.example:443"},
            {"Origin": "https://lab.example"}, {"Host": f"localhost:{server.port}", "Origin": f"http://localhost:{server.port}"}]
        for headers in fine:
            if (found := head_of(server, "GET", "/healthz", headers)) != 200:
                wrong.append(("a friend", headers, found))
        assert not wrong, wrong
        assert server.json("GET", "/api/sessions")[1] == [], "a request that was refused did something"


def fault_paths_are_contained():
    """Names lead nowhere but into the folder of traces: nothing outside is read, written or deleted, whatever a name says; and no
    answer tells where that folder is."""
    with serving("--run", "paths") as server:
        trace = with_tables(server)
        root = server.data.parent
        secret = b"\x89MCAP0\r\n the secret that is not yours"
        outside = [server.data / "secret.mcap", root / "secret.mcap", server.data / "secret", server.data / "store" / "secret.mcap"]
        for path in outside:
            path.write_bytes(secret)

        def files():
            inside = (server.data / "traces", server.data / "exports", server.data / "store")
            found = [path for path in root.rglob("*") if path.is_file() and path != server.log and not any(map(path.is_relative_to, inside))]
            return {path: path.read_bytes() for path in found}

        before, wrong = files(), []
        raw_ways = WAYS_OUT + ["../secret", "../../secret", "traces/../../secret", str(server.data / "secret")]
        for way in raw_ways:
            for method, path, body in [
                ("GET", f"/api/traces/{way}", None), ("GET", f"/api/traces/{way}/episode", None), ("PUT", f"/api/traces/{way}", b"x"),
                ("DELETE", f"/api/traces/{way}", None), ("POST", f"/api/traces/{way}/replay", None), ("GET", f"/api/traces/{way}/blame", None),
                ("DELETE", f"/api/leases/{way}", None), ("POST", f"/w/{way}/mcp", b"{}"),
            ]:
                head = request(method, urllib.parse.quote(path, safe="%/."), {"content-length": str(len(body))} if body else {})
                wire = Wire(server, head + (body or b""))
                found = wire.status()
                if found not in range(400, 500) or b"secret that is not yours" in wire.heard:
                    wrong.append((method, path[:60], found, wire.heard[:200]))
                wire.close()
            name = urllib.parse.unquote(way)
            for path, body in [
                (f"/api/traces/{trace}/branches", {"at": 0, "policy": "planner", "name": name}),
                ("/api/jobs", {"kind": "ingest", "traces": [name]}), ("/api/jobs", {"kind": "export", "set": "sft", "name": name}),
                ("/api/leases", {"worker": name, "task_id": "FDP/home_0001", "rollouts": 1}),
            ]:
                legal = re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,59}", name)
                if not legal and (found := server.request("POST", path, body)[0]) not in range(400, 500):
                    wrong.append((path, name[:60], found))
        after = files()
        assert after == before, f"outside of the folder changed: {sorted(str(path) for path in before.keys() ^ after.keys())}"
        assert [path.stem for path in server.traces()][0] == trace
        # What names the machine's own paths.
        answers = {
            "/api/traces": None, f"/api/traces/{trace}/episode": None, "/api/sessions": None, "/api/episodes": None, "/api/jobs": None,
            f"/api/traces/{trace}/blame": None, f"/api/traces/{trace}/reward": None,
            f"/api/traces/{trace}/branches": {"at": 999, "policy": "planner", "name": "b"}, "/api/sql": {"sql": "SELECT trace FROM episodes"},
            f"/api/traces/{trace}/replay": {},
        }
        for path, body in answers.items():
            answer = server.request("POST" if body is not None else "GET", path, body)[2]
            if str(server.data).encode() in answer:
                at = answer.find(str(server.data).encode())
                wrong.append((path, "tells a path of the machine", answer[max(0, at - 60) : at + 80]))
        assert not wrong, wrong


# Clocks


def fault_wall_time_is_in_no_trace():
    """Two servers at different times, equal runs, workers and calls: equal bytes."""
    made = []
    for number in range(2):
        with serving("--run", "same") as server:
            time.sleep(1.1 * number)
            agent = Agent(server, worker="a")
            scripted(agent)
            made.append({path.name: path.read_bytes() for path in server.traces()})
    assert made[0].keys() == made[1].keys() and len(made[0]) == 2, [sorted(found) for found in made]
    assert made[0] == made[1], "the bytes differ"


def scripted(agent):
    for tool, arguments in [("finish", {}), ("nav_to", {"receptacle_name": "table_1"}), ("show_receptacles", {}), ("ask", {"question": "which?"}),
            ("pick", {"marker_id": 1}), ("finish", {}), ("walk_around", {}), ("finish", {})]:
        agent.call(tool, **arguments)


def faketime():
    """The library by which a process sees another wall clock."""
    found = [path for pattern in ["/usr/lib/*/faketime/libfaketimeMT.so.1", "/usr/lib*/faketime/libfaketimeMT.so.1", "/usr/local/lib/faketime/libfaketimeMT.so.1"]
        for path in glob.glob(pattern)]
    if not found:
        raise Skipped("libfaketime is not installed (apt-get install faketime)")
    return found[0]


def fault_clock_jumps():
    """The wall clock jumps days ahead, years back, to the day it began: sessions are neither parked nor closed, their idleness
    and their calls go on, jobs and tokens work, and the traces are those of a clock that stands fast, to the byte."""
    library = faketime()
    with tempfile.TemporaryDirectory(prefix="reel-faults-") as folder, serving("--run", "same") as honest:
        scripted(Agent(honest, worker="a"))
        clock = pathlib.Path(folder) / "clock"
        clock.write_text("+0")
        other = {"LD_PRELOAD": library, "FAKETIME_TIMESTAMP_FILE": str(clock), "FAKETIME_NO_CACHE": "1",
            "FAKETIME_DONT_FAKE_MONOTONIC": "1", "DONT_FAKE_MONOTONIC": "1"}
        with serving("--run", "same", config="[limits]\npark_after_s = 20\nclose_after_s = 40\n", folder=folder, environment=other) as server:
            jumps = [("+3d", 3 * DAY_S), ("@2099-12-31 23:59:58", None), ("-400d", -400 * DAY_S), ("@1970-01-02 00:00:00", None), ("+0", 0)]
            agent, idle = Agent(server, worker="a"), Agent(server, worker="idle")
            idle.call("finish"), idle.call("finish")
            since = time.monotonic()
            agent.call("finish")
            script = iter([("nav_to", {"receptacle_name": "table_1"}), ("show_receptacles", {}), ("ask", {"question": "which?"}), ("pick", {"marker_id": 1}), ("finish", {})])
            for jump, by in jumps:
                clock.write_text(jump)
                # The next round in which the server looks after its sessions sees the new time.
                time.sleep(1.3)
                entries = {entry["session"]: entry for entry in server.json("GET", "/api/sessions")[1]}
                entry = entries.get("w-idle")
                assert entry and entry["state"] == "playing", f"after the jump to {jump} the idle session is {entry}"
                assert entry["idle_s"] <= time.monotonic() - since + 1, f"after the jump to {jump} it is idle for {entry['idle_s']} s"
                tool, arguments = next(script)
                assert agent.call(tool, **arguments)["content"], jump
                job = server.json("POST", "/api/jobs", {"kind": "ingest"})
                assert job[0] == 202, job
                year, ahead = time.gmtime(job[1]["created"]).tm_year, job[1]["created"] - time.time()
                if abs(ahead - by) > 60 if by is not None else str(year) not in (jump[1:5], "2100"):
                    raise Skipped(f"the clock of a process cannot be changed here: at {jump} it is in {year}")
            agent.call("walk_around"), agent.call("finish")
            ended = lambda: all(job["stage"] not in ("waiting", "running") for job in server.json("GET", "/api/jobs")[1])  # noqa: E731
            assert until(ended, 30), "jobs do not end"
            assert all(job["stage"] == "done" for job in server.json("GET", "/api/jobs")[1]), server.json("GET", "/api/jobs")[1]
            made = {path.name: path.read_bytes() for path in server.traces() if "--w-a--" in path.name}
            same = {path.name: path.read_bytes() for path in honest.traces()}
            assert made.keys() == same.keys(), (made.keys(), same.keys())
            differ = [name for name in made if made[name] != same[name]]
            assert not differ, f"the clock is in {differ}"


if __name__ == "__main__":
    main("fault_", globals())
