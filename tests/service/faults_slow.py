"""Faults: clients that are slow, half there, or want more than there is."""

import concurrent.futures
import contextlib
import http.client
import json
import os
import socket
import threading
import time

from faults_kit import JSON_BODY, LATE_S, MIB, READ_S, Stream, Wire, connections, exact, posted, request, resident, serving, steps
from harness import Agent, until


def fault_slow_clients():
    """Clients that say nothing, stop in the middle or trickle have `limits.read_timeout_s`, for the head and again for the body: closed,
    or answered 408. Meanwhile others are served at once."""
    with serving(config=f"[limits]\nread_timeout_s = {READ_S}\n") as server:
        head = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n"
        sized = {**JSON_BODY, "content-length": "100000"}
        # What is sent first, what trickles after it, and what may be answered. Who has not said what it wants may be told that it
        # is too late, or nothing; who speaks another protocol may be told at once.
        clients = {
            "silent": (b"", b"", [None, 408]),
            "a letter": (b"P", b"", [None, 408]),
            "half a preface of HTTP/2": (b"PRI * HTTP/2", b"", [None, 400, 408, 505]),
            "a preface of HTTP/2": (b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n", b"", [None, 400, 408, 505]),
            "half a head": (head, b"", [None, 408]),
            "a head that trickles": (head, b"x", [None, 408]),
            "idle after an answer": (head + b"\r\n", b"", [200]),
        }
        for path in ["/mcp", "/w/a/mcp", "/analysis/mcp", "/messages/?session_id=x", "/api/sql", "/api/jobs", "/nowhere"]:
            clients[f"half a body {path}"] = (request("POST", path, sized) + b"{", b"", [408])
            clients[f"a body that trickles {path}"] = (request("POST", path, sized) + b"{", b" ", [408])
        clients["half an upload"] = (request("PUT", "/api/traces/half", sized) + b"{", b"", [408])

        def wait(name):
            first, drip, answers = clients[name]
            wire = Wire(server, first)
            took = wire.until_closed(READ_S + LATE_S, drip)
            return name, took, wire.status_heard() in answers or wire.heard[:80]

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
        early = [(name, took) for name, took, _ in answers if took and took < READ_S / 2 and 505 not in clients[name][2]]
        wrong = [(name, said) for name, _, said in answers if said is not True]
        assert slowest < LATE_S / 2, f"another client waited {slowest:.1f} s"
        assert not early, f"closed before their time: {early}"
        assert not late, f"never closed: {[name for name, _ in late]}"
        assert not wrong, f"answered otherwise: {wrong}"
        assert os.listdir(server.data / "traces") == [], "an upload that stood still left something"


def fault_slow_upload():
    """An upload that trickles cannot hold its place for ever; one that is slow, but steady and done in time, is taken."""
    with serving("--run", "slow", config=f"[limits]\nread_timeout_s = {READ_S}\n") as server:
        wire = Wire(server, request("PUT", "/api/traces/slow", {"content-length": "100000"}))
        patience = 5 * READ_S + LATE_S
        assert wire.until_closed(patience, drip=b"x"), f"after {patience} s of three bytes a second it goes on"
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
    with serving(config=f"[limits]\nread_timeout_s = {READ_S}\n") as server:
        with open(server.data / "traces" / "large.mcap", "wb") as file:
            file.truncate(64 * MIB)
        idle = Wire(server, request("GET", "/api/traces/large"), receive=4096)
        reading = Wire(server, request("GET", "/api/traces/large"))
        while len(reading.heard) < 64 * MIB:
            part = reading.socket.recv(1 << 20)
            assert part, f"a client that reads was cut off after {len(reading.heard)} bytes"
            reading.heard += part
        reading.close()
        # This question itself is one.
        gone = until(lambda: connections(server) == 1, READ_S + 2 * LATE_S)
        assert gone, f"{READ_S + 2 * LATE_S} s after its last byte was read, the connection is still held"
        idle.close()


def fault_no_room_for_connections():
    """Connections that say nothing do not lock others out for longer than they have time."""
    with serving(config=f"[limits]\nread_timeout_s = {READ_S}\nconnections = 8\n") as server:
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
        gone = until(lambda: connections(server) == 1, 15)
        assert gone, f"{connections(server) - 1} connections are left of clients that are gone"
        assert server.json("GET", "/api/sessions")[1] == [], "sessions are left of clients that are gone"
        # The file of an upload goes when the server hears that its client has gone, which may be a little after.
        assert until(lambda: os.listdir(server.data / "traces") == [], 5), os.listdir(server.data / "traces")


def fault_large_bodies():
    """A hundred megabytes, announced or in chunks: 413 at once, on every route that takes a body, and no memory goes into it."""
    with serving(config="[limits]\nupload_mib = 8\n") as server:
        sse = Stream(server)
        paths = ["/mcp", "/w/a/mcp", "/analysis/mcp", "/api/sql", f"/messages/?session_id={sse.session}", "/api/jobs", "/nowhere"]
        routes = [("POST", path) for path in paths] + [("PUT", "/api/traces/large")]
        part = b"x" * (1 << 16)
        # What the first requests need is there before it is measured.
        assert Wire(server, posted("/api/sql", b'"' + b"x" * (3 * MIB) + b'"')).status() in range(400, 500)
        before, wrong = resident(server), []
        for method, path in routes:
            begun = time.monotonic()
            wire = Wire(server, request(method, path, {**JSON_BODY, "content-length": str(100 * MIB)}))
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
            wire = Wire(server, request(method, path, {**JSON_BODY, "transfer-encoding": "chunked"}))
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
        # A busy machine gives memory back late (23 MiB were seen); a single body that was kept would be 100.
        assert peak < 40 * MIB, f"the server took {peak / MIB:.0f} MiB for it"
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
    """More sessions or requests than there may be: 503 or 429 and when to come again, or a refusal in words; those who are in
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
