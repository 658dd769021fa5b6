"""Faults: strangers, wrong tokens and sessions, pages of somebody else's, names that lead elsewhere."""

import concurrent.futures
import json
import pathlib
import re
import tempfile
import time
import urllib.parse

from faults_kit import LATE_S, WAYS_OUT, Stream, Wire, analyst, exact, head_of, request, serving, steps, with_tables
from harness import Agent, reel, until


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
        strange = [
            "x", "0" * 36, "00000000-0000-0000-0000-000000000000", old, old.upper(), second.headers["mcp-session-id"] + "0",
            "../x", "x" * 5000, analysis.headers["mcp-session-id"], "w-a", "s-" + "0" * 32,
        ]
        for session in strange:
            for path in ["/mcp", "/w/a/mcp"]:
                for method in ["POST", "GET", "DELETE"]:
                    found = status(session, method, path)
                    assert found == 404, f"{method} {path} with session {session[:40]!r}: {found}"
        assert status(second.headers["mcp-session-id"], path="/analysis/mcp") == 404
        for method in ["POST", "GET", "DELETE"]:
            assert status(None, method) in range(400, 500), "without a session"
        # What another session was told cannot be heard again under one's own id.
        second.call("list_tasks"), Agent(server, worker="b").call("ask", question="private")
        for event in ["0", "0/1", "1/1", "1/2", "2/2", "0/9", "x", "", "1/1/1", "-1", "9" * 30, "x" * 5000]:
            wire = Wire(server, request("GET", "/mcp", {**second.headers, "last-event-id": event}))
            assert wire.status() in (*range(200, 300), *range(400, 500)), f"after event {event[:20]!r}: {wire.heard[:100]}"
            wire.until_closed(time.monotonic() - wire.begun + 0.1)
            others = [word for word in (b"private", b"no episode") if word in wire.heard]
            assert not others, f"after event {event[:20]!r} another session's answer comes"
            wire.close()
        # The life of the others went on, and nothing of all that is on their tapes.
        assert analysis.call("list_episodes")["content"]
        assert not second.call("ask", question="mine")["isError"]
        assert until(lambda: len(server.traces()) == 1, 20), "the episode of the session that was deleted is not whole"
        stood = [entry["steps"] for entry in server.json("GET", "/api/sessions")[1] if entry["session"].startswith("s-")]
        assert stood == [1], f"the other session has other calls than its own: {stood}"
        second.call("finish")
        asked = {step["input"]["call"]["arguments"].get("question") for path in server.traces() for step in steps(path)}
        assert asked == {"mine", None}, f"persisted is {asked}"
        # The transport of 2024.
        one, two = Stream(server), Stream(server)
        one.hello(), two.hello()
        one.say("finish"), two.say("finish")
        one.wire.close()
        gone = until(lambda: server.request("POST", f"/messages/?session_id={one.session}", call)[0] == 404, 10)
        assert gone, "the session of a stream that was closed is still there"
        for query, fine in [
            ("?session_id=x", 404), ("?session_id=" + "0" * 32, 404), ("?session_id=", 404), ("", 400), ("?other=1", 400),
            (f"?session_id={old}", 404), (f"?session_id={two.session[:-1]}", 404),
        ]:
            found = server.request("POST", f"/messages/{query}", call)[0]
            assert found == fine, f"/messages/{query}: {found}, not {fine}"
        assert '"decision":1,' in two.say("ask", question="mine too").replace(" ", ""), "the other stream goes on where it was"


def fault_worlds_apart():
    """Sessions, workers and streams at one time: each has its own world, from the briefing to the tape."""
    with serving("--run", "apart") as server:
        clients = [Agent(server), Agent(server), Agent(server, worker="a"), Agent(server, worker="b")]
        clients += [Stream(server), Stream(server, worker="c")]
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
            calls = [step["input"]["call"] for step in kept]
            places = [call["arguments"]["receptacle_name"] for call in calls if call["name"] == "nav_to"]
            turns = [number + turn for turn in range(4) if (number + turn) % 2]
            assert places == [["table_1", "bed_1", "counter_1"][turn % 3] for turn in turns], (path.name, places)
        assert sorted(seen) == [f"client {number}" for number in range(len(clients))]
        exact(*first)
        # A worker's world is the same by either transport, and nobody finds it by the name of a session.
        again = Agent(server, worker="c")
        assert again.call("ask", question="still me")["structuredContent"]["decision"] == 1
        assert Agent(server, worker="w-c").call("ask", question="x")["structuredContent"]["error"]["code"] == "no_episode"


def token(server_data, name, *roles):
    """A new token."""
    code, out, err = reel("server", "token", "create", name, "--data", server_data, *(f"--role={role}" for role in roles))
    assert code == 0, err
    return re.search(r"reel_[0-9a-f]{64}", out)[0]


#: Requests to what the OpenAPI document does not describe, by the role that it takes.
OTHERS = {
    "act": "POST /mcp, GET /mcp, DELETE /mcp, GET /sse, POST /messages/?session_id=x, POST /w/a/mcp, GET /w/a/sse, GET /ws",
    "read": "POST /analysis/mcp, HEAD /api/traces/x",
}
#: What the document must not open to less than an admin without this script being told.
ADMINS = {
    ("PUT", "/api/traces/x"), ("DELETE", "/api/traces/x"), ("POST", "/api/traces/x/branches"), ("POST", "/api/jobs"),
    ("DELETE", "/api/jobs/1"), ("POST", "/api/labels"), ("POST", "/api/remarks"), ("DELETE", "/api/remarks/x"),
    ("DELETE", "/api/sessions/x"), ("POST", "/api/sessions/x/answer"),
    ("PUT", "/api/definitions/x"), ("DELETE", "/api/definitions/x"),
}


def routes_of(document):
    """(role, method, path) of every operation that the document puts behind a token, and of what it does not describe."""
    listed = [(role, *one.split()) for role, requests in OTHERS.items() for one in requests.split(",")]
    for path, operations in document["paths"].items():
        path = re.sub(r"\{(id|step)\}", "1", path)
        path = re.sub(r"\{[^}]*\}", "x", path)
        for method, operation in operations.items():
            for requirement in operation.get("security", []):
                (role,) = requirement["token"]
                listed.append((role, method.upper(), path))
    # A name is no route: a trace may be called like the last part of another path.
    names = ("replay", "blame", "sql", "leases")
    return listed + [("admin", method, f"/api/traces/{name}") for method in ("PUT", "DELETE") for name in names]


def fault_tokens():
    """No token, garbage, another scheme, another role, a revoked one: refused on every kind of route, and before anything else
    is looked at. Tokens, their hashes and the ids of sessions are in no log, no trace and no answer."""
    with tempfile.TemporaryDirectory(prefix="reel-faults-") as folder:
        data = pathlib.Path(folder) / "data"
        tokens = {role: token(data, f"the-{role}", role) for role in ("act", "read", "admin")}
        gone = token(data, "gone", "act", "read", "admin")
        hashes = re.findall(r'hash = "([0-9a-f]+)"', (data / "tokens.toml").read_text())
        assert len(hashes) == 4
        assert not any(secret in (data / "tokens.toml").read_text() for secret in [*tokens.values(), gone])
        with serving("--run", "tokens", folder=folder, config='log_filter = "debug"\n') as server:
            document = server.json("GET", "/api/openapi.json")[1]
            routes = routes_of(document)
            unguarded = {path for path, operations in document["paths"].items() for one in operations.values() if not one.get("security")}
            assert unguarded == {"/health", "/healthz", "/readyz"}, unguarded
            assert ADMINS <= {(method, path) for role, method, path in routes if role == "admin"}, routes
            assert {role for role, *_ in routes} == {"read", "act", "admin"} and len(routes) > 50, routes
            good = f"Bearer {tokens['admin']}"
            proofs = {
                "none": None, "empty": "", "garbage": "Bearer garbage", "no scheme": tokens["admin"], "scheme alone": "Bearer",
                "basic": f"Basic {tokens['admin']}", "scheme and blank": "Bearer ", "a hash": f"Bearer {hashes[2]}",
                "a beginning": good[:-1], "more": good + "0", "a list": f"Bearer x, {good}", "a prefix": "Bearer reel_",
                "upper case": f"Bearer {tokens['admin'].upper()}",
            }
            wrong = []
            for name, proof in proofs.items():
                for role, method, path in routes if name in ("none", "garbage") else routes[::7]:
                    found = head_of(server, method, path, {"authorization": proof} if proof is not None else {})
                    if found != 401:
                        wrong.append((name, method, path, found))
            for role, method, path in routes:
                for mine, secret in tokens.items():
                    found = head_of(server, method, path, {"authorization": f"Bearer {secret}"})
                    allowed = mine in (role, "admin")
                    if (found in (401, 403)) == allowed or found is None or found >= 500:
                        wrong.append((f"token of role {mine}", method, path, found))
            # Ways around: what is not the path of a route is nobody's.
            for path in [
                "/w/../api/traces", "/w/%2e%2e/api/traces", "//api/traces", "/api/leases/../traces", "/api/leases/%2e%2e/traces",
                "/api/./traces", "/mcp/../api/traces", "/API/traces", "/api/traces%2f", "/api/traces?x=/mcp",
                "/api/sessions;/mcp", "/metrics/", "/w/x/../../metrics",
            ]:
                found = head_of(server, "GET", path, {"authorization": f"Bearer {tokens['act']}"})
                if found is None or found < 400:
                    wrong.append(("act goes around", "GET", path, found))
            for path in ["/healthz", "/readyz", "/api/openapi.json"]:
                if (found := head_of(server, "GET", path)) != 200:
                    wrong.append(("nobody", "GET", path, found))
            status, headers, body = server.request("GET", "/api/traces")
            assert {name.lower(): value for name, value in headers.items()}.get("www-authenticate") == "Bearer", headers
            # Who may pass but asks in a way that a path does not take is told so, like of any other error.
            status, headers, body = server.request("DELETE", "/api/sql", None, {"authorization": good})
            allow = {name.lower(): value for name, value in headers.items()}.get("allow")
            assert (status, allow, json.loads(body)["error"]["code"]) == (405, "POST", "method_not_allowed"), (status, headers, body)
            # The token of a request that does not pass decides before its body does.
            begun = time.monotonic()
            wire = Wire(server, request("POST", "/api/sql", {"content-length": "1000"}))
            assert wire.status() == 401 and time.monotonic() - begun < LATE_S, "a stranger's body is waited for"
            wire.close()
            # Revoked: within two seconds, and for those who are already in.
            agent = Agent(server, headers={"authorization": f"Bearer {gone}"})
            agent.call("finish")
            assert reel("server", "token", "revoke", "gone", "--data", data)[0] == 0
            begun = time.monotonic()
            while head_of(server, "GET", "/api/traces", {"authorization": f"Bearer {gone}"}) != 401:
                assert time.monotonic() - begun < 2 + LATE_S, "a revoked token still works"
            took = time.monotonic() - begun
            assert took < 3, f"a revoked token worked for {took:.1f} s"
            ping = {"jsonrpc": "2.0", "id": 9, "method": "ping"}
            assert server.request("POST", "/mcp", ping, agent.headers)[0] == 401, "the session of a revoked token goes on"
            late = token(data, "late", "read")
            proof = {"authorization": f"bearer {late}"}
            assert until(lambda: head_of(server, "GET", "/api/traces", proof) == 200, 3), "a new token is not noticed"
            player = Agent(server, worker="p", headers={"authorization": f"Bearer {tokens['act']}"})
            player.call("finish"), player.call("ask", question="q"), player.call("finish")
            secrets = [secret.encode() for secret in [*tokens.values(), gone, late, *hashes]]
            said = b"".join(
                server.request("GET", path, None, {"authorization": f"Bearer {tokens['admin']}"})[2]
                for path in ["/api/sessions", "/metrics", "/api/jobs", "/api/openapi.json", "/api/traces"]
            )
            kept = b"".join(path.read_bytes() + reel("show", path, "--json")[1].encode() for path in server.traces())
            log = server.log.read_bytes()
            assert len(server.traces()) >= 1 and len(log) > 1000
            for what, text in [("an answer", said), ("a trace", kept), ("the log", log)]:
                for secret in secrets:
                    found = secret.removeprefix(b"reel_") in text
                    assert not found, f"a token or its hash is in {what}: {around(text, secret)}"
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
            assert reel("server", "token", "revoke", "only", "--data", data)[0] == 0
            time.sleep(2)
            status = server.request("GET", "/api/traces")[0]
            assert status == 401, "the last token was revoked, and now everybody may everything"
            (data / "tokens.toml").unlink()
            time.sleep(2)
            status = server.request("GET", "/api/traces")[0]
            assert status == 401, "the file of tokens is gone, and now everybody may everything"


def fault_log_says_nothing_of_policies():
    """What policies and their users say, and the ids by which sessions are reached, are in no log."""
    with serving("--run", "log") as server:
        agent, stream = Agent(server), Stream(server)
        stream.hello()
        agent.call("finish"), stream.say("finish")
        agent.call("ask", question="a word nobody logs: xyzzy"), agent.call("xyzzy", xyzzy="xyzzy")
        stream.say("ask", question="xyzzy")
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
        routes = [(method, path) for _, method, path in routes_of(server.json("GET", "/api/openapi.json")[1])]
        routes += [("GET", path) for path in ["/healthz", "/readyz", "/api/openapi.json", "/nowhere", "/"]]
        strange = [
            {"Host": "evil.example"}, {"Host": f"evil.example:{server.port}"}, {"Host": ""}, {"Host": "127.0.0.1.nip.io"},
            {"Host": "localhost.evil.example"}, {"Host": "evil.example", "Origin": "https://lab.example"},
            {"Origin": "http://evil.example"}, {"Origin": "null"}, {"Origin": "https://lab.example.evil.example"},
            {"Origin": f"http://localhost:{server.port + 1}"}, {"Origin": "http://lab.example"},
            {"Host": "reel.example", "Origin": "https://evil.example"},
        ]
        for method, path in routes:
            for number, headers in enumerate(strange):
                if number < 2 or headers == {"Origin": "http://evil.example"} or path in ("/mcp", "/api/traces", "/healthz"):
                    if (found := head_of(server, method, path, headers)) != 403:
                        wrong.append((method, path, headers, found))
        # A page that is not listed is not told that it may ask; one that is listed is.
        ask = {"Access-Control-Request-Method": "POST", "Access-Control-Request-Headers": "authorization,mcp-session-id"}
        for path in ["/mcp", "/w/a/mcp", "/api/sql", "/api/traces", "/messages/", "/sse", "/nowhere"]:
            for headers in [strange[6], strange[7], {"Origin": "https://lab.example", "Host": "evil.example"}]:
                wire = Wire(server, request("OPTIONS", path, {**ask, **headers}))
                found = wire.status()
                if found in range(200, 300) or b"access-control-allow" in wire.heard.lower():
                    wrong.append(("OPTIONS", path, headers, wire.heard[:200]))
                wire.close()
        wire = Wire(server, request("GET", "/healthz", {"Origin": "http://evil.example"}))
        assert wire.status() == 403 and b"access-control-allow" not in wire.heard.lower(), wire.heard
        by_hand = {
            "no host": b"GET /healthz HTTP/1.1\r\n\r\n",
            "two hosts": b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n",
            "another in the target": b"GET http://evil.example/healthz HTTP/1.1\r\nHost: localhost\r\n\r\n",
            "a user": b"GET http://localhost@evil.example/healthz HTTP/1.1\r\nHost: localhost\r\n\r\n",
            "no host, as of old": b"GET /healthz HTTP/1.0\r\n\r\n",
            "two origins": b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nOrigin: http://localhost\r\n"
            b"Origin: http://evil.example\r\n\r\n",
        }
        for name, bytes_ in by_hand.items():
            wire = Wire(server, bytes_)
            if (found := wire.status()) not in range(400, 500):
                wrong.append((name, found))
            wire.close()
        fine = [
            {}, {"Host": f"127.0.0.1:{server.port}"}, {"Host": "[::1]"}, {"Host": "reel.example"}, {"Host": "REEL.example:443"},
            {"Origin": "https://lab.example"}, {"Host": f"localhost:{server.port}", "Origin": f"http://localhost:{server.port}"},
        ]
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
        for path in [server.data / "secret.mcap", root / "secret.mcap", server.data / "secret", server.data / "store/s.mcap"]:
            path.write_bytes(secret)

        def files():
            inside = (server.data / "traces", server.data / "exports", server.data / "store")
            found = [path for path in root.rglob("*") if path.is_file() and path not in (server.log, server.data / "audit.jsonl")]
            return {path: path.read_bytes() for path in found if not any(map(path.is_relative_to, inside))}

        before, wrong = files(), []
        raw_ways = WAYS_OUT + ["../secret", "../../secret", "traces/../../secret", str(server.data / "secret")]
        for way in raw_ways:
            for method, path, body in [
                ("GET", f"/api/traces/{way}", None), ("GET", f"/api/traces/{way}/episode", None),
                ("PUT", f"/api/traces/{way}", b"x"),
                ("DELETE", f"/api/traces/{way}", None), ("POST", f"/api/traces/{way}/replay", None),
                ("GET", f"/api/traces/{way}/blame", None),
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
                ("/api/jobs", {"kind": "ingest", "traces": [name]}),
                ("/api/jobs", {"kind": "export", "set": "sft", "name": name}),
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
            "/api/traces": None, f"/api/traces/{trace}/episode": None, "/api/sessions": None, "/api/episodes": None,
            "/api/jobs": None,
            f"/api/traces/{trace}/blame": None, f"/api/traces/{trace}/reward": None,
            f"/api/traces/{trace}/branches": {"at": 999, "policy": "planner", "name": "b"},
            f"/api/traces/{trace}/replay": {},
        }
        for path, body in answers.items():
            answer = server.request("POST" if body is not None else "GET", path, body)[2]
            if str(server.data).encode() in answer:
                at = answer.find(str(server.data).encode())
                wrong.append((path, "tells a path of the machine", answer[max(0, at - 60) : at + 80]))
        assert not wrong, wrong
