"""Faults: input that nobody means. The answer is a 4xx or words, never a 5xx, and everybody else plays on."""

import contextlib
import http.client
import json
import os
import pathlib
import random
import re
import signal
import threading
import time
import urllib.parse

from faults_kit import (
    LATE_S, MIB, QUICK, WAYS_OUT, Bystander, Stream, Wire, analyst, exact, healthy, posted, resident, serving, steps, with_tables,
)
from harness import Agent, reel, until


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
            "half": b'{"jsonrpc":', "a lone surrogate": b'{"question":"\\ud800"}', "no number": b'{"n":NaN}',
            "a zero": b"\x00",
            "UTF-16": '{"sql":"SELECT 1"}'.encode("utf-16"), "after the end": b'{"sql":"SELECT 1"} x',
            "a mark": b"\xef\xbb\xbf{}",
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
        # As deep as goes through: it is persisted, and can be read again.
        for depth in [10, 60, *range(110, 130)]:
            deep = b"[" * depth + b"]" * depth
            Wire(server, posted("/w/a/mcp", call % deep, session)).status()
        assert agent.call("ask", question="after all that")["structuredContent"]["ok"]
        assert "Task:" in sse.say("finish"), "the stream that sent it does not go on"
        agent.call("finish")
        healthy(server.traces()[0])
        exact(server.traces()[0])


def fault_bytes_that_are_no_text():
    """Bytes that are no UTF-8, controls and lengths beyond reason in paths, queries and headers: 4xx, or passed over."""
    with serving() as server:
        agent = Agent(server)
        targets = [
            b"/%ff", b"/api/traces/%ff", b"/api/traces/\xff", b"/api/traces?after=%ff%00", b"/w/%ff/mcp", b"/api/jobs/%00",
            b"/messages/?session_id=%ff", b"/api/episodes?family=%ff", b"/api/queries/%f0%28", b"/" + b"a" * 20_000,
            b"/api/traces/" + b"%2e" * 10_000,
        ]
        wrong = []
        for target in targets:
            wire = Wire(server, b"GET %b HTTP/1.1\r\nHost: localhost\r\n\r\n" % target)
            status = wire.status()
            if status is None or status >= 500:
                wrong.append((target[:60], status))
            wire.close()
        values = [b"\xff\xfe", b"\x01", b"a" * 20_000, "é".encode(), b"0" * 5000]
        names = [
            b"mcp-session-id", b"mcp-protocol-version", b"last-event-id", b"authorization", b"accept", b"range", b"origin",
            b"content-type", b"content-length", b"transfer-encoding",
        ]
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


def fault_hostile_calls():
    """Tool names and arguments that nobody means: an answer in words, no protocol error, no panic; what was sent is persisted to
    the letter and replays, and a bystander plays on."""
    with serving("--run", "hostile") as server, Bystander(server):
        agent = Agent(server, worker="a")
        numbers = random.Random(7)
        floats = [numbers.uniform(-1, 1) * 10 ** numbers.randint(-300, 300) for _ in range(500)]
        texts = [
            "", "\0", "\n", "x" * 300_000, "😀" * 1000, "\u202e", "\uffff", "%s%n", "../../etc/passwd", "'; DROP TABLE episodes",
            "\u00e9", "e\u0301",
        ]
        names = ["", "\0", "x" * 50_000, "../../x", "Finish", "finish ", "\uff46inish", "__proto__", "🤖", "finish\n"]
        markers = [
            -1, 2**31, 2**32, 2**63, 2**64 - 1, 2**64, 1e300, -1e300, 5e-324, 1.5, True, None, [], {}, "", "-1", "1e3", "\u0663",
            "9" * 400,
        ]
        spoken = {
            "ask": "question", "nav_to": "receptacle_name", "show_object_by_category": "target_category",
            "finish_with_id": "task_id",
        }
        calls = [(name, {"question": "q"}) for name in names]
        calls += [("pick", {"marker_id": marker}) for marker in markers]
        calls += [(tool, {name: text}) for text in texts for tool, name in spoken.items()]
        calls += [("ask", {"question": value}) for value in [1, None, [], {}, True, [["q"]]]]
        calls += [("ask", {"question": "q", "x": more}) for more in [floats, [-0.0, 1e22, 5e-324, 1.7976931348623157e308]]]
        calls += [("ask", {"question": "q", "k" * 10_000: 1, "": 2, "\0": 3}), ("walk_around", {str(n): n for n in range(5000)})]
        sent, wrong = [], []
        for number, (tool, arguments) in enumerate(calls):
            if number % 20 == 0:
                agent.call("finish")
            try:
                result = agent.call(tool, **arguments)
                assert result["content"][0]["text"], "an answer without words"
            except Exception as error:
                wrong.append((tool[:20], str(arguments)[:60], str(error)[:200]))
                continue
            if tool != "finish_with_id":
                sent.append((tool, arguments))
        assert not wrong, wrong
        # Whole messages that are none.
        method = {"jsonrpc": "2.0", "id": 1, "method": "ping"}
        call = {**method, "method": "tools/call"}
        messages = [
            [], {}, [[]], 1, "x", None, {"method": "initialize"}, {"jsonrpc": "2.0", "id": 9, "result": {}}, [method] * 100,
            {**method, "jsonrpc": "1.0"}, {**method, "id": {}}, {**method, "id": 2**63}, {**method, "id": -1.5},
            {**method, "method": ""}, {**method, "id": "x" * 100_000, "method": "tools/list"}, call,
            {**method, "method": "tools/list", "params": {"cursor": "\0"}}, {**method, "method": "resources/read"},
            {**method, "method": "logging/setLevel"}, {**call, "params": {"name": 3}},
            {**call, "params": {"name": "ask", "arguments": [1]}}, {**call, "params": {"name": "ask", "arguments": "x"}},
            {"jsonrpc": "2.0", "method": "notifications/cancelled", "params": {"requestId": 999999}},
        ]
        for message in messages:
            status, _, body = server.request("POST", agent.path, json.dumps(message), agent.headers, timeout=LATE_S)
            if status >= 500:
                wrong.append((str(message)[:80], status, body[:120]))
        assert not wrong, wrong
        agent.call("finish")
        whole = {path.name.split("--")[2]: path for path in server.traces() if "--w-a--" in path.name}
        kept = [step["input"]["call"] for path in sorted(whole.values()) for step in steps(path)]
        kept = [(call["name"], call["arguments"]) for call in kept if call["name"] != "finish"]
        assert kept == sent, "the tape holds other calls"
        code, out, err = reel("trace", "doctor", *whole.values())
        assert code == 0, out[-2000:]
        exact(*whole.values())


def strange_requests(trace):
    """Method, path, body and headers of requests that nobody means, against a trace that is there."""
    numbers = ["-1", "0", "1001", "4294967296", str(2**63), str(2**64 - 1), str(2**64), "1e9", "NaN", "", "%00", "%D9%A3"]
    eyes = ["nan,nan,nan", "inf,0,0", "1e308,1e308,1e308", "1e-320,0,0", "0,0,0", "0,0", "0,0,0,0", "", "a,b,c", "1e39,0,0"]
    for eye in eyes:
        for other in ["0,0,0", "-inf,nan,0", eye]:
            yield "GET", f"/api/traces/{trace}/frames/0?camera=free&eye={eye}&look_at={other}", None, None
    for camera in ["follow:", "follow:" + "x" * 5000, "follow:%00", "free", "%ff", "head%00", "top-down" * 100]:
        yield "GET", f"/api/traces/{trace}/frames/0?camera={camera}", None, None
    for number in numbers:
        for path in [
            f"/api/traces/{trace}/frames/{number}", f"/api/traces/{trace}/steps?from={number}", f"/api/jobs/{number}",
            f"/api/traces/{trace}/steps?limit={number}", f"/api/traces?limit={number}", f"/api/episodes?limit={number}",
            f"/api/jobs/{number}/events",
        ]:
            yield "GET", path, None, None
        yield "DELETE", f"/api/jobs/{number}", None, None
    for way in [*WAYS_OUT, "*", "con", "a%20b"]:
        way = urllib.parse.quote(way, safe="%/")
        for path in ["", "/episode", "/steps", "/frames/0", "/blame", "/reward"]:
            yield "GET", f"/api/traces/{way}{path}", None, None
        for path in [f"/api/sessions/{way}", f"/api/queries/{way}", f"/api/traces?after={way}"]:
            yield "GET", path, None, None
        for path in [f"/api/traces/{way}", f"/api/sessions/{way}", f"/api/leases/{way}"]:
            yield "DELETE", path, None, None
        yield "PUT", f"/api/traces/{way}", b"x", None
        for path in [f"/api/traces/{way}/replay", f"/api/sessions/{way}/answer", f"/w/{way}/mcp"]:
            yield "POST", path, {"answer": "x"}, None
        yield "POST", f"/api/traces/{way}/branches", {"at": 0, "policy": "planner", "name": "other"}, None
    for word in ["%00", "..%2f", "x" * 5000, "%27%3b%20DROP%20TABLE%20episodes%3b%20--", "%ff"]:
        for path in [
            f"/api/episodes/{word}", f"/api/queries/benchmark?parameters={word}=1", f"/api/labels?episode={word}",
            f"/api/episodes?family={word}&task_id={word}&after={word}&policy={word}",
        ]:
            yield "GET", path, None, None
    most = 2**64 - 1
    for part in [f"{most}-", f"0-{most}", f"-{most}", "5-1", "-", "9" * 30 + "-", "0-0,2-3"]:
        yield "GET", f"/api/traces/{trace}", None, {"range": f"bytes={part}"}
    for path, plain, changes in strange_bodies(trace):
        for change in changes:
            yield "POST", path, {**plain, **change}, None
    for method, path in [
        ("BREW", "/healthz"), ("TRACE", "/api/sql"), ("OPTIONS", "/mcp"), ("PATCH", f"/api/traces/{trace}"), ("GET", "//"),
        ("POST", "/api/traces"), ("DELETE", "/"), ("GET", "/" + "a/" * 4000), ("PUT", "/mcp"), ("HEAD", f"/api/traces/{trace}"),
        ("GET", "/api/../api/traces"),
    ]:
        yield method, path, None, None


def strange_bodies(trace):
    """Path, a body that could be, and what makes it strange. Leases l1 to l5 are to be had."""
    planner = {"policy": "planner"}
    yield f"/api/traces/{trace}/branches", {"at": 0, "name": "made"}, [
        {**planner, "at": 2**63}, {**planner, "at": -1}, {**planner, "at": 0.5}, {**planner, "seed": -1},
        {**planner, "name": "m\0"}, {**planner, "name": "../made"}, {**planner, "parent_from": 0}, {"parent_from": 2**64 - 1},
        {"policy": "\0"}, {"policy": "model:http://localhost:1"}, {"calls": []},
        {"name": "made1", "calls": [{"name": "\0", "arguments": [1]}] * 50},
        {"name": "made2", "calls": [{"name": "finish", "arguments": {}}] * 3},
    ]
    yield "/api/labels", {"episode": "x", "class": "Other", "author": "a"}, [
        {"episode": ""}, {"episode": "--help"}, {"episode": "\0"}, {"note": "a\0b"}, {"author": "\n\0"}, {"note": "y" * 500_000},
        {"step": -(2**31)}, {"step": 2**31}, {"confidence": 1e308}, {"confidence": -1}, {"class": "\0"}, {"more": 1},
        {"sub_class": "--store=/tmp"},
    ]
    yield "/api/remarks", {"episode": "x", "kind": "tag", "text": "t", "author": "a"}, [
        {"episode": ""}, {"episode": "--help"}, {"episode": "\0"}, {"kind": "star"}, {"kind": "sta"}, {"text": "\0"}, {"text": "--store=/tmp"},
        {"text": "y" * 500_000}, {"kind": "comment", "text": "y" * 500_000}, {"author": "\n\0"}, {"step": 1}, {"step": 2**31}, {"more": 1},
    ]
    yield "/api/leases", {"worker": "leased", "task_id": "FDP/home_0001", "rollouts": 1}, [
        {"worker": "../x"}, {"worker": ""}, {"worker": "x" * 63}, {"task_id": "../x"}, {"task_id": "\0"}, {"rollouts": 0},
        {"rollouts": 2**32}, {"rollouts": -1}, {"seed": -1}, {"seed": 2**64}, {"worker": "l1", "seed": 2**64 - 1},
        {"worker": "l2", "group_id": "\0../\n"}, {"worker": "l3", "rollouts": 2**32 - 1},
        {"worker": "l4", "group_id": "g" * 500_000}, {"worker": "l5", "group_id": ""},
    ]
    yield "/api/jobs", {}, [
        {"kind": ""}, {"kind": "ingest", "traces": ["../secret"]}, {"kind": "ingest", "traces": trace},
        {"kind": "replay", "traces": ["--help"]}, {"kind": "replay", "traces": ["x" * 9000]},
        {"kind": "reward", "preset": "/etc/passwd"}, {"kind": "reward", "preset": "\0"},
    ]
    yield "/api/jobs", {"kind": "export", "set": "sft", "name": "set"}, [
        {"name": "../set"}, {"set": "all"}, {"options": {"out": "/tmp/x"}}, {"options": {"where": ["x"]}},
        {"options": {"store": "/"}}, {"options": {"tokenizer": "/etc/passwd"}}, {"options": {"where=x --out": "y"}},
    ]


def strange_words(trace):
    """Calls to an assistant's tools."""
    words = [urllib.parse.unquote(way) for way in WAYS_OUT if not re.search("%ff|%c0|x{9}", way)]
    for word in [*words[:: 8 if QUICK else 2], trace, "", None, 3]:
        for tool in ["show_episode", "blame", "explain_failure"]:
            yield tool, {"trace": word}
        yield "query", {"sql": word}
        yield "show_frame", {"trace": trace, "step": word, "camera": word, "layer": word}
        yield "show_frame", {"trace": word, "step": 0, "eye": word, "look_at": word}
        yield "list_episodes", {"where": word, "limit": -1}
        yield str(word), {}
    yield "list_episodes", {"where": "true) UNION SELECT 1", "limit": 2**64 - 1}


def fault_hostile_requests():
    """Numbers, names and cameras that cannot be, on every REST route and to every tool of assistants: 4xx, words, or an answer
    that means nothing worse; never 5xx. A bystander plays on."""
    with serving("--run", "rest") as server, Bystander(server):
        trace, wrong = with_tables(server), []
        requests = list(strange_requests(trace))
        if QUICK:
            requests = [one for number, one in enumerate(requests) if number % 5 == 0]
        for method, path, body, headers in requests:
            try:
                status, _, answer = server.request(method, path, body, headers, timeout=30)
            except OSError as error:
                status, answer = None, repr(error).encode()
            if status is None or status >= 500:
                wrong.append((method, path[:70], str(body)[:70], status, answer[:160]))
        assistant = analyst(server)
        for tool, arguments in strange_words(trace):
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
        assert not wrong, f"{len(wrong)} of {len(requests)}: {wrong}"
        code, out, _ = reel("trace", "doctor", *server.traces())
        assert code == 0, out[-1500:]


def processes_of(server):
    """The processes that the server started and that live."""
    found = []
    for stat in pathlib.Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            state, parent = stat.read_text().rpartition(")")[2].split()[:2]
            if int(parent) == server.process.pid and state != "Z":
                found.append(int(stat.parent.name))
    return found


def fault_questions_that_end_their_process():
    """A question that no limit foresaw, or whose process somebody kills, is an error of that question alone; one whose client or
    server goes away ends."""
    unforeseen = (
        "SELECT array_length(array_agg(w)) FROM (SELECT s.step, array_agg(repeat('x', 100000)) OVER (PARTITION BY s.step % 2 "
        "ORDER BY s.step ROWS BETWEEN UNBOUNDED PRECEDING AND UNBOUNDED FOLLOWING) AS w FROM steps s, generate_series(1, 900))"
    )
    slow = "SELECT sum(a.value * b.value) FROM generate_series(1, 1000000) a, generate_series(1, 1000000) b"
    with serving(config="[limits]\nsql_timeout_s = 60\n") as server, Bystander(server):
        with_tables(server)
        ask = lambda sql: server.json("POST", "/api/sql", {"sql": sql})  # noqa: E731
        status, body = ask(unforeseen)
        assert (status, body["error"]["code"]) == (422, "over_limit"), (status, body)
        assert ask("SELECT 1 AS n") == (200, [{"n": 1}])
        # Idle ones are used again.
        (first,) = processes_of(server)
        assert ask("SELECT 2 AS n") == (200, [{"n": 2}]) and processes_of(server) == [first]
        # One that was killed while it was idle is no harm, nor one with a question.
        os.kill(first, signal.SIGKILL)
        assert until(lambda: first not in processes_of(server), 5)
        found = ask("SELECT 3 AS n")
        assert found == (200, [{"n": 3}]), found
        wire = Wire(server, posted("/api/sql", json.dumps({"sql": slow}).encode()))
        time.sleep(1)
        (busy,) = processes_of(server)
        os.kill(busy, signal.SIGKILL)
        assert wire.status() == 422, wire.heard[:300]
        assert ask("SELECT 4 AS n") == (200, [{"n": 4}])
        wire = Wire(server, posted("/api/sql", json.dumps({"sql": slow}).encode()))
        time.sleep(1)
        (busy,) = processes_of(server)
        wire.close()
        assert until(lambda: busy not in processes_of(server), 3 + LATE_S), "the question of a client that went away goes on"
        # So does one of an assistant that goes.
        assistant = analyst(server)

        def assistant_asks():
            with contextlib.suppress(Exception):
                assistant.call("query", sql=slow)

        asking = threading.Thread(target=assistant_asks, daemon=True)
        asking.start()
        assert until(lambda: processes_of(server), 5 + LATE_S)
        time.sleep(1)
        assert server.request("DELETE", "/analysis/mcp", None, assistant.headers)[0] < 300
        assert until(lambda: not processes_of(server), 3 + LATE_S), "the question of an assistant that went away goes on"
        # An answer of which each batch is large is not held by the server.
        ask("SELECT 5 AS n")
        before = resident(server)
        columns = ", ".join(f"repeat('x', 16000 + value % 2) AS c{number}" for number in range(6))
        wire = Wire(server, posted("/api/sql", json.dumps({"sql": f"SELECT {columns} FROM range(1, 1501)"}).encode()))
        assert wire.status() == 200, wire.heard[:300]
        time.sleep(1)
        grown = resident(server) - before
        assert grown < 40 * MIB, f"a large answer that waits takes {grown / MIB:.0f} MiB of the server"
        wire.close()
        wire = Wire(server, posted("/api/sql", json.dumps({"sql": slow}).encode()))
        time.sleep(1)
        (busy,) = processes_of(server)
    assert until(lambda: not pathlib.Path(f"/proc/{busy}/stat").exists(), 3 + LATE_S), "a question goes on without its server"
    wire.close()


def fault_hostile_sql():
    """Questions that would write, read files, take all memory or all time: 4xx, or an answer, in about the time they have; the
    next question is answered."""
    sql_s = 2
    with serving(config=f"[limits]\nsql_timeout_s = {sql_s}\nworker_timeout_s = 5\n") as server, Bystander(server):
        with_tables(server)
        write = pathlib.Path(server.data) / "written.csv"
        series = "generate_series(1, 1000000)"
        questions = {
            "a file": "SELECT * FROM '/etc/passwd'",
            "a table of a file": "CREATE EXTERNAL TABLE t STORED AS CSV LOCATION '/etc/passwd'",
            "a copy": f"COPY (SELECT 1) TO '{write}'",
            "a setting": "SET datafusion.execution.batch_size = 1",
            "two questions": "SELECT 1; SELECT 2",
            "an insert": "INSERT INTO episodes SELECT * FROM episodes",
            "a drop": "DROP TABLE episodes",
            "nothing": "",
            "a zero": "SELECT '\0'",
            "a long text": "SELECT repeat('x', 9223372036854775807)",
            "a long list": "SELECT array_repeat(1, 9223372036854775807)",
            "a long sum": "SELECT 1" + "+1" * 50_000,
            "brackets": "SELECT " + "(" * 20_000 + "1" + ")" * 20_000,
            "nots": "SELECT " + "NOT " * 20_000 + "true",
            "ors": "SELECT 1 WHERE " + " OR ".join(["1=1"] * 50_000),
            "unions": " UNION ALL ".join(["SELECT 1"] * 5000),
            "nested questions": "SELECT * FROM (" * 500 + "SELECT 1" + ")" * 500,
            "nested calls": "SELECT " + "abs(" * 5000 + "1" + ")" * 5000,
            "nested cases": "SELECT " + "CASE WHEN true THEN " * 3000 + "1" + " END" * 3000,
            "casts": "SELECT 1" + "::int" * 20_000,
            "an expression": "SELECT 'a' ~ '" + "(a{1000}){1000}" * 20 + "'",
            "a pattern": "SELECT 'x' LIKE '" + "%a" * 100_000 + "'",
            "divided by zero": "SELECT 1/0",
            "an overflow": "SELECT abs(-9223372036854775808)",
            "a remainder": "SELECT -9223372036854775808 % -1",
            "no date": "SELECT make_date(2147483647, 1, 1)",
            "no interval": "SELECT interval '999999999999 years'",
            "no bins": "SELECT date_bin(interval '0 seconds', now())",
            "no end": "WITH RECURSIVE t(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM t) SELECT count(*) FROM t",
            "a long count": "SELECT count(*) FROM generate_series(1, 100000000000)",
            "a product": f"SELECT count(*) FROM {series} a, {series} b",
            "zones": "SELECT now()" + " AT TIME ZONE 'UTC'" * 1500,
            "many tables": "SELECT 1 FROM " + ", ".join(f"episodes e{number}" for number in range(60)),
            "many rows": "VALUES " + ",".join(["(1)"] * 100_000),
        }
        if QUICK:
            names = ["a file", "a copy", "a long text", "a long sum", "brackets", "no end", "a product"]
            questions = {name: questions[name] for name in names}
        wrong, patience = [], sql_s + 3 * LATE_S
        asked = {name: {"sql": sql} for name, sql in questions.items()}
        asked |= {f"version {at}": {"sql": "SELECT 1", "at": at} for at in [10, 2**32, 2**63, 2**64 - 1]}
        for name, question in asked.items():
            begun = time.monotonic()
            try:
                status, _, answer = server.request("POST", "/api/sql", question, timeout=patience)
            except TimeoutError:
                status, answer = None, f"no answer after {patience} s".encode()
            except http.client.IncompleteRead:
                # The answer had begun when its limit was reached.
                status, answer = 200, b""
            if status is None or status >= 500:
                wrong.append((name, status, answer[:160], round(time.monotonic() - begun, 1)))
        assert not write.exists(), "a question wrote a file"
        # What did not listen is left alone for a while, and two cores are few.
        for _ in range(10):
            status, _, answer = server.request("POST", "/api/sql", {"sql": "SELECT 7 AS n"}, timeout=patience)
            if status == 200:
                break
        said = f"afterwards: {status} {answer[:160]}; wrong: {wrong}"
        assert (status, json.loads(answer)) == (200, [{"n": 7}]) and not wrong, said
