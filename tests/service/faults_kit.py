"""What the tests of faults share: a server that has to be sound at its end, agents that keep what was answered, connections by
hand."""

import contextlib
import http.client
import json
import pathlib
import re
import select
import socket
import subprocess
import sys
import tempfile
import threading
import time

from harness import Agent, Server, Skipped, reel, until

#: Whether the short form is wanted.
QUICK = "--quick" in sys.argv
MIB = 1 << 20
DAY_S = 24 * 3600
#: What a slow client is given, in the tests that wait for it; and how late the machine may be with anything: the short form runs
#: beside other tests.
READ_S, LATE_S = 2, 40 if QUICK else 8
#: What the server gives open requests when it stops, and what goes on at its very end.
STOP_S = 12 + LATE_S
#: Headers of a body in JSON, as MCP wants them.
JSON_BODY = {"content-type": "application/json", "accept": "application/json, text/event-stream"}


def long_form():
    """What follows is left out of the short form."""
    if QUICK:
        raise Skipped("time", "takes too long for the short form")


@contextlib.contextmanager
def serving(*arguments, config="", folder=None, **named):
    """A server with a configuration. At the end it lives, has not panicked, and stops when it is told to."""
    with contextlib.ExitStack() as stack:
        folder = pathlib.Path(folder or stack.enter_context(tempfile.TemporaryDirectory(prefix="reel-faults-")))
        file = folder / "reel.toml"
        if config or not file.exists():
            # Tests count jobs and processes; an ingest that nobody asked for would be among them.
            file.write_text("ingest_new = false\n" + config)
        server = Server("--config", file, *arguments, data=folder / "data", **named)
        try:
            yield server
            if server.process.poll() is None:
                sound(server)
                assert stopped(server), f"the server was still there {STOP_S} s after SIGTERM"
        except (OSError, http.client.HTTPException) as error:
            code = server.process.poll()
            state = "lives" if code is None else f"ended with {code}"
            raise AssertionError(f"{error!r}; the server {state}: {tail(server)}") from error
        finally:
            server.process.kill()
            server.stop()


def stopped(server):
    """Whether the server goes when it is told to, and with code 0."""
    try:
        code = server.stop(patience=STOP_S)
    except subprocess.TimeoutExpired:
        return False
    assert code == 0, f"the server ended with {code}: {tail(server)}"
    return True


def sound(server):
    """The server lives, serves, and no thread of it panicked."""
    assert server.process.poll() is None, f"the server died with {server.process.poll()}: {tail(server)}"
    assert server.request("GET", "/healthz", timeout=LATE_S)[0] == 200
    log = server.log.read_text(errors="replace")
    found = re.finditer(r"thread '[^']*' .*panicked at|request panicked", log)
    panics = [log[panic.start() : panic.start() + 600] for panic in found]
    assert not panics, f"{len(panics)} panics, the first: {panics[0]}"


def tail(server):
    return server.log.read_text(errors="replace")[-1500:]


def steps(trace):
    """The steps of a trace that lies in a file."""
    code, out, err = reel("show", trace, "--json")
    assert code == 0, err
    return json.loads(out)["steps"]


def healthy(folder):
    """Nothing of a folder is rejected by `reel trace doctor`."""
    code, out, err = reel("trace", "doctor", folder)
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


def all_played(found, calls, patience=60 + 3 * LATE_S):
    assert until(lambda: all(player.answered >= calls or player.error for player in found), patience), "the agents do not get on"
    errors = [player.error for player in found if player.error]
    assert not errors, errors


class Bystander:
    """Somebody who plays on while a test does its worst elsewhere."""

    def __init__(self, server, headers=None):
        self.player = Player(server, "bystander", headers, pause=0.2)

    def __enter__(self):
        self.player.start()
        return self.player

    def __exit__(self, kind, *_):
        self.player.enough.set()
        self.player.join(70)
        if kind is None:
            assert not self.player.error, f"the bystander's game broke off: {self.player.error}"
            assert self.player.answered > 3, f"the bystander made {self.player.answered} calls"


def with_tables(server):
    """A finished trace, and tables that hold it; its name."""
    agent = Agent(server, worker="recorded")
    agent.call("finish"), agent.call("nav_to", receptacle_name="table_1"), agent.call("show_receptacles"), agent.call("finish")
    agent.call("finish")
    job = server.json("POST", "/api/jobs", {"kind": "ingest"})[1]
    ended = lambda: server.json("GET", f"/api/jobs/{job['id']}")[1]["state"] not in ("waiting", "running")  # noqa: E731
    assert until(ended, 60), "the ingest does not end"
    assert server.json("GET", f"/api/jobs/{job['id']}")[1]["state"] == "done", server.json("GET", f"/api/jobs/{job['id']}")
    return server.traces()[0].stem


def analyst(server):
    """An assistant at `/analysis/mcp`."""
    agent = Agent.__new__(Agent)
    agent.server, agent.path, agent.number = server, "/analysis/mcp", 0
    agent.headers = {**JSON_BODY, "mcp-protocol-version": "2025-06-18"}
    client = {"name": "harness", "version": "1"}
    agent.rpc("initialize", {"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": client})
    agent.post({"jsonrpc": "2.0", "method": "notifications/initialized"})
    return agent


def request(method, path, headers=None):
    """The head of a request."""
    headers = {"Host": "localhost", **(headers or {})}
    lines = [f"{method} {path} HTTP/1.1", *(f"{name}: {value}" for name, value in headers.items())]
    return "\r\n".join(lines).encode() + b"\r\n\r\n"


def posted(path, body, headers=None):
    """A request with a JSON body, whatever that holds."""
    return request("POST", path, {**JSON_BODY, "content-length": str(len(body)), **(headers or {})}) + body


def connections(server):
    """How many connections the server holds, that of this question included."""
    return int(re.search(r"^reel_connections (\d+)", server.request("GET", "/metrics")[2].decode(), re.M)[1])


def head_of(server, method, path, headers=None):
    """Status of an answer, without its body: streams have no end."""
    if method in ("POST", "PUT"):
        wire = Wire(server, request(method, path, {**JSON_BODY, "content-length": "2", **(headers or {})}) + b"{}")
    else:
        wire = Wire(server, request(method, path, headers))
    status = wire.status()
    wire.close()
    return status


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


class Stream:
    """A client of legacy HTTP+SSE that reads no more than it is told to."""

    def __init__(self, server, worker=None, receive=None, headers=None):
        self.server, self.headers = server, headers or {}
        path = f"/w/{worker}/sse" if worker else "/sse"
        self.wire = Wire(server, request("GET", path, {"accept": "text/event-stream", **self.headers}), receive)
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
        return self.server.request("POST", f"/messages/?session_id={self.session}", message, self.headers, timeout)[0]

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


def resident(server, what="VmRSS"):
    """Memory of the server, in bytes."""
    status = pathlib.Path(f"/proc/{server.process.pid}/status")
    if not status.exists():
        raise Skipped("linux", "the memory of a process cannot be read here")
    return int(re.search(rf"{what}:\s+(\d+) kB", status.read_text())[1]) * 1024


#: Ways out of a folder.
WAYS_OUT = [
    "..%2fsecret", "..%2f..%2fsecret", "%2e%2e%2fsecret", "%2e%2e/secret", "..", "%2e%2e", "..%5csecret",
    "%252e%252e%252fsecret", "x%2f..%2f..%2fsecret",
    "%2fetc%2fpasswd", "....%2f%2fsecret", "secret%00", ".secret", "%c0%ae%c0%ae%c0%afsecret", "x%0a", "-rf", "secret.mcap",
    "%ff", "x" * 5000, "é",
]
