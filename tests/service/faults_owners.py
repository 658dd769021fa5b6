"""Faults: tokens that take what is another's, take more than their share, or are taken back in the midst of a stream."""

import concurrent.futures
import contextlib
import pathlib
import tempfile
import threading
import time

from faults_access import token
from faults_kit import LATE_S, Stream, Wire, request, serving
from harness import Agent, reel, until


@contextlib.contextmanager
def serving_tokens(*names, config=""):
    """A server with tokens of these names (role act; `admin` and `read` have theirs), and the header of each."""
    with tempfile.TemporaryDirectory(prefix="reel-faults-") as folder:
        data = pathlib.Path(folder) / "data"
        headers = {}
        for name in names:
            role = name if name in ("admin", "read") else "act"
            headers[name] = {"authorization": f"Bearer {token(data, name, role)}"}
        with serving("--run", "owners", folder=folder, config=config) as server:
            yield server, headers


def sessions(server, headers):
    """Owner of every live session, by its name."""
    return {entry["session"]: entry["owner"] for entry in server.json("GET", "/api/sessions", None, headers)[1]}


def lease(worker):
    return {"worker": worker, "task_id": "FDP/home_0001", "rollouts": 2}


def fault_what_is_anothers():
    """A token neither acts in a worker of another, nor hears its session, nor ends its lease; an admin ends it."""
    with serving_tokens("one", "two", "admin", "read") as (server, headers):
        one = Agent(server, worker="a", headers=headers["one"])
        one.call("finish")
        two = Agent(server, worker="a", headers=headers["two"])
        for tool, arguments in [("finish", {}), ("ask", {"question": "stolen"}), ("finish_with_id", {"task_id": "x"})]:
            result = two.call(tool, **arguments)
            text = str(result["content"])
            assert result["isError"] and "another token" in text, f"{tool} in a worker of another token: {text[:200]}"
        assert one.call("ask", question="mine")["structuredContent"]["decision"] == 1, "another token has acted in this world"
        # Sessions of Streamable HTTP and streams of 2024, by their ids.
        own = Agent(server, headers=headers["one"])
        own.call("finish")
        theft = {**own.headers, **headers["two"]}
        ping = {"jsonrpc": "2.0", "id": 9, "method": "ping"}
        for method, body in [("POST", ping), ("GET", None), ("DELETE", None)]:
            found = server.request(method, "/mcp", body, {**theft, "accept": "text/event-stream, application/json"}, timeout=LATE_S)[0]
            assert found == 404, f"{method} /mcp in a session of another token: {found}"
        assert own.call("ask", question="still here")["structuredContent"]["decision"] == 1
        stream = Stream(server, headers=headers["one"])
        stream.hello()
        found = server.request("POST", f"/messages/?session_id={stream.session}", ping, headers["two"])[0]
        assert found == 404, f"a message into the stream of another token: {found}"
        # Leases.
        assert server.json("POST", "/api/leases", lease("l"), headers["one"])[0] == 201
        status, body = server.json("POST", "/api/leases", lease("l"), headers["two"])
        assert (status, body["error"]["code"]) == (403, "owner"), (status, body)
        status, body = server.json("DELETE", "/api/leases/l", None, headers["two"])
        assert (status, body["error"]["code"]) == (403, "owner"), (status, body)
        assert sessions(server, headers["read"])["w-l"] == "one"
        assert server.request("DELETE", "/api/leases/l", None, headers["admin"])[0] == 204
        assert server.json("POST", "/api/leases", lease("l"), headers["two"])[0] == 201, "the name is free again"


def fault_more_than_their_share():
    """One token cannot lock the others out: not by sessions, workers, leases or streams, and not by questions."""
    config = "[limits]\nsessions = 12\nsessions_per_token = 8\nanalyses = 2\nworkers = 1\n"
    with serving_tokens("greedy", "other", "read", "admin", config=config) as (server, headers):
        workers, refused = [], set()
        for number in range(10):
            agent = Agent(server, headers=headers["greedy"], worker=f"g{number}") if number < 8 else None
            if agent is None:
                try:
                    Agent(server, headers=headers["greedy"], worker=f"g{number}")
                except RuntimeError as error:
                    refused.add(str(error).split()[1])
                continue
            assert not agent.call("finish").get("isError"), f"session {number + 1} of 8"
            workers.append(agent)
        assert refused == {"429"}, f"a ninth session of one token is answered {refused}"
        status, body = server.json("POST", "/api/leases", lease("more"), headers["greedy"])
        assert (status, body["error"]["code"]) == (429, "quota"), (status, body)
        streams = [Stream(server, headers=headers["greedy"]) for _ in range(8)]
        wire = Wire(server, request("GET", "/sse", headers["greedy"]))
        assert wire.status() == 429, wire.heard[:200]
        for number in range(3):
            assert not Agent(server, headers=headers["other"], worker=f"o{number}").call("finish").get("isError")
        for stream in streams:
            stream.wire.close()
        # Calls go in turns: the other one waits for a call or two of the greedy one, not for one of each of its clients.
        other, enough, made = Agent(server, headers=headers["other"], worker="o0"), threading.Event(), []

        def play(agent):
            while not enough.is_set():
                agent.call("finish")
                made.append(agent)

        with concurrent.futures.ThreadPoolExecutor(8) as pool:
            busy = [pool.submit(play, agent) for agent in workers]
            assert until(lambda: len(made) > 16, 20 + LATE_S), "the greedy one does not get on"
            before, calls = len(made), 10
            for _ in range(calls):
                other.call("ask", question="and I")
            passed = (len(made) - before) / calls
            enough.set()
            [one.result() for one in busy]
        assert passed < 4, f"{passed} calls of the greedy token go before each call of the other"


def fault_revoked_in_the_midst():
    """A token that is taken back: its streams end, what it asked is not answered, its sessions are closed and their traces
    whole; nobody else notices."""
    with serving_tokens("gone", "stays", "admin") as (server, headers):
        agent = Agent(server, headers=headers["gone"], worker="a")
        agent.call("finish")
        stays = Agent(server, headers=headers["stays"], worker="b")
        stays.call("finish")
        streams = {name: Stream(server, headers=headers[name]) for name in ("gone", "stays")}
        for stream in streams.values():
            stream.hello()
            stream.say("finish")
        listening = {}
        for name in ("gone", "stays"):
            session = Agent(server, headers=headers[name])
            session.call("list_tasks")
            wire = Wire(server, request("GET", "/mcp", {**session.headers, "accept": "text/event-stream"}))
            assert wire.status() == 200
            listening[name] = wire
        assert reel("server", "token", "revoke", "gone", "--data", server.data)[0] == 0
        ends = lambda wire: wire.until_closed(time.monotonic() - wire.begun + 3 + LATE_S)  # noqa: E731
        assert ends(streams["gone"].wire), "the stream of 2024 goes on after its token was revoked"
        assert ends(listening["gone"]), "the stream of Streamable HTTP goes on after its token was revoked"
        whole = until(lambda: set(sessions(server, headers["admin"]).values()) == {"stays"}, 5 + LATE_S)
        assert whole, f"sessions are left of a revoked token: {sessions(server, headers['admin'])}"
        assert len(server.traces()) == 2, f"the episodes that ran under it: {server.traces()}"
        assert stays.call("ask", question="and I")["structuredContent"]["decision"] == 1
        assert "decision" in streams["stays"].say("ask", question="and I")
        assert not listening["stays"].until_closed(time.monotonic() - listening["stays"].begun + 0.2), "the stream of another token ended, too"
