"""Faults: what clients are told when something does not work: by the codes of their protocol, without paths of the server, and
without advice for somebody else."""

import base64
import http.client
import json
import re

from faults_kit import JSON_BODY, LATE_S, Wire, analyst, posted, request, serving, with_tables

NEWEST = "2026-07-28"
#: What a request of the newest protocol says of itself.
META = {
    "io.modelcontextprotocol/protocolVersion": NEWEST, "io.modelcontextprotocol/clientInfo": {"name": "raw", "version": "1"},
    "io.modelcontextprotocol/clientCapabilities": {},
}
PATHS = ["/mcp", "/w/a/mcp", "/analysis/mcp"]


def asked(server, path, message, headers=None):
    """Status of a message, and the JSON that answers it."""
    status, _, body = server.request("POST", path, json.dumps(message), {**JSON_BODY, **(headers or {})}, timeout=LATE_S)
    text = body.decode()
    data = [line[5:] for line in text.splitlines() if line.startswith("data:") and line[5:].strip()] or [text]
    try:
        return status, json.loads(data[-1])
    except ValueError:
        return status, text


def hello(server, path, version):
    """(session, version that was agreed on)."""
    params = {"protocolVersion": version, "capabilities": {}, "clientInfo": {"name": "raw", "version": "1"}}
    message = {"jsonrpc": "2.0", "id": 1, "method": "initialize", "params": params}
    status, headers, body = server.request("POST", path, json.dumps(message), JSON_BODY)
    assert status == 200, (path, version, status, body)
    (session,) = [value for name, value in headers.items() if name.lower() == "mcp-session-id"]
    return session, re.search(rb'"protocolVersion":"([^"]*)"', body)[1].decode()


def fault_words_of_the_protocol():
    """Wrong params, methods that are not declared, batches: each has the code that JSON-RPC gives it. No revision is agreed on
    whose batches are not taken."""
    with serving() as server:
        for path in PATHS:
            agreed = {version: hello(server, path, version)[1] for version in ["2024-11-05", "2025-03-26", "2025-06-18", NEWEST]}
            assert agreed == {
                "2024-11-05": "2024-11-05", "2025-03-26": "2024-11-05", "2025-06-18": "2025-06-18", NEWEST: "2025-11-25",
            }, (path, agreed)
            session = {"mcp-session-id": hello(server, path, "2025-06-18")[0]}
            plain = {"jsonrpc": "2.0", "id": 7}
            call = {**plain, "method": "tools/call"}
            for params in [{}, {"name": 3}, {"name": "ask", "arguments": [1]}, {"name": "ask", "arguments": "x"}]:
                status, answer = asked(server, path, {**call, "params": params}, session)
                assert (status, answer["error"]["code"], answer["id"]) == (200, -32602, 7), (path, params, status, answer)
            status, answer = asked(server, path, call, session)
            assert answer["error"]["code"] == -32602 and "missing" in answer["error"]["message"], (path, answer)
            undeclared = ["prompts/list", "resources/list", "resources/templates/list", "prompts/get", "nonsense"]
            complete = {"ref": {"type": "ref/prompt", "name": "x"}, "argument": {"name": "a", "value": "b"}}
            for method, params in [*((method, {}) for method in undeclared), ("completion/complete", complete)]:
                status, answer = asked(server, path, {**plain, "method": method, "params": params}, session)
                assert answer.get("error", {}).get("code") == -32601, (path, method, answer)
            # What does not read as a message at all.
            ping = {**plain, "method": "ping"}
            bodies = [
                ([ping, ping], -32600), ([], -32600), (1, -32600), ({"method": "ping"}, -32600), ({**ping, "params": [1]}, -32602),
                ({**plain, "method": "initialize", "params": {"protocolVersion": 3}}, -32602),
            ]
            for body, code in bodies:
                for headers in [session, {}]:
                    status, answer = asked(server, path, body, headers)
                    found = answer["error"]["code"] if isinstance(answer, dict) else answer
                    assert found == code and status in (200, 400), (path, body, headers, status, answer)
            wire = Wire(server, posted(path, b'{"jsonrpc":', session))
            assert wire.status() == 400 and b"-32700" in wire.heard, wire.heard[-200:]
            assert asked(server, path, ping, session)[1]["result"] == {}, "the session goes on"


def fault_words_of_the_newest_protocol():
    """Where nothing says whose world it is, the protocol without sessions is not spoken, and never named as spoken."""
    with serving() as server:
        headers = {"mcp-protocol-version": NEWEST}
        listed = {"jsonrpc": "2.0", "id": 3, "method": "tools/list", "params": {"_meta": META}}
        discover = {**listed, "method": "server/discover"}
        call = {**listed, "method": "tools/call", "params": {"name": "list_tasks", "arguments": {}, "_meta": META}}
        for message in [listed, discover, call]:
            more = {**headers, "mcp-method": message["method"], **({"mcp-name": "list_tasks"} if message is call else {})}
            status, answer = asked(server, "/mcp", message, more)
            assert (status, answer["error"]["code"]) == (400, -32022), (message["method"], status, answer)
            assert answer["error"]["data"]["supported"] == ["2024-11-05", "2025-06-18", "2025-11-25"], answer
            status, answer = asked(server, "/w/a/mcp", message, more)
            assert status == 200 and "result" in answer, (message["method"], status, answer)
            if message is discover:
                assert answer["result"]["supportedVersions"][-1] == NEWEST, answer
        # One that nobody knows.
        future = json.loads(json.dumps(listed).replace(NEWEST, "2099-01-01"))
        for path, newest in [("/mcp", "2025-11-25"), ("/w/a/mcp", NEWEST), ("/analysis/mcp", NEWEST)]:
            status, answer = asked(server, path, future, {"mcp-protocol-version": "2099-01-01", "mcp-method": "tools/list"})
            assert (status, answer["error"]["data"]["supported"][-1]) == (400, newest), (path, status, answer)


def fault_sessions_that_are_not_there():
    """DELETE of a session: 400 without an id, 404 where there is none of it, 2xx once where there is."""
    with serving() as server:
        for path in PATHS:
            end = lambda headers: server.request("DELETE", path, None, headers)[0]  # noqa: B023, E731
            assert end({}) == 400, path
            for session in ["x", "0" * 36, "x" * 5000]:
                assert end({"mcp-session-id": session}) == 404, (path, session[:40])
            session = {"mcp-session-id": hello(server, path, "2025-06-18")[0]}
            assert end(session) in (200, 202, 204), path
            assert end(session) == 404, f"{path}: ended twice"
            assert asked(server, path, {"jsonrpc": "2.0", "id": 1, "method": "ping"}, session)[0] == 404


def fault_methods_that_a_path_does_not_have():
    """405 in JSON and with `Allow`, on the paths of the transport of 2024 as on every other one."""
    with serving() as server:
        cases = [
            ("POST", "/sse", "GET"), ("DELETE", "/sse", "GET"), ("POST", "/w/a/sse", "GET"), ("GET", "/messages/", "POST"),
            ("POST", "/healthz", "GET"), ("DELETE", "/api/sql", "POST"), ("PUT", "/api/openapi.json", "GET"),
        ]
        for method, path, allowed in cases:
            status, headers, body = server.request(method, path)
            allow = {name.lower(): value for name, value in headers.items()}.get("allow", "")
            assert status == 405 and allowed in allow.split(","), (method, path, status, headers)
            assert json.loads(body)["error"]["code"] == "method_not_allowed", (method, path, body)


def fault_advice_for_somebody_else():
    """No error over REST or MCP names an option of the command line, a command, or a path of the server; limits are named as
    reel.toml names them."""
    # Long enough for a question about rows on a busy machine.
    seconds = 10
    limits = f"[limits]\nsql_timeout_s = {seconds}\nsql_rows = 100\n"
    with serving(config=limits) as server:
        said = []

        def ask(sql, wanted="", **more):
            _, _, body = server.request("POST", "/api/sql", {"sql": sql, **more}, timeout=seconds + 3 * LATE_S)
            said.append(body.decode())
            assert wanted in said[-1], f"{sql} is answered without {wanted!r}: {said[-1][:400]}"

        for path in ["/api/episodes", "/api/queries/benchmark", "/api/labels"]:
            said.append(server.request("GET", path)[2].decode())
        ask("SELECT 1", "there are no tables yet")
        assistant = analyst(server)
        for tool, arguments in [("list_episodes", {}), ("query", {"sql": "SELECT 1"})]:
            said.append(str(assistant.call(tool, **arguments)))
        with_tables(server)
        series = "generate_series(1, 1000000)"
        ask(f"SELECT sum(a.value * b.value) FROM {series} a, {series} b", "(limits.sql_timeout_s)")
        ask("SELECT * FROM generate_series(1, 101)", "(limits.sql_rows)")
        ask("SELECT $a", "needs values")
        ask("SELECT 1", at=10**6)
        for sql in ["SELECT $a", "SELECT * FROM generate_series(1, 101)"]:
            said.append(str(assistant.call("query", sql=sql)))
        trace = server.traces()[0].stem
        for layer in ["rgb", "depth", "masks"]:
            shown = assistant.call("show_frame", trace=trace, step="start", layer=layer)
            assert not shown["isError"], shown
            assert {"name", "pixels", "depth_mm"} <= set(shown["structuredContent"]["visible"][0]), shown["structuredContent"]
            assert base64.b64decode(shown["content"][1]["data"]).startswith(b"\x89PNG"), shown["content"][1]["mimeType"]
        said.append(str(assistant.call("show_frame", trace=trace, step="999")))
        whole = server.traces()[0].read_bytes()
        (server.data / "traces" / "torn.mcap").write_bytes(whole[: len(whole) // 2])
        for tool in ["show_episode", "blame", "explain_failure"]:
            said.append(str(assistant.call(tool, trace="torn")))
        said.append(server.request("GET", "/api/traces/torn/steps")[2].decode())
        wrong = [text[:300] for text in said if re.search(r"`reel |\s--[a-z]", text) or str(server.data.resolve()) in text]
        assert not wrong, wrong


def fault_answers_that_are_cut_off():
    """An answer in SQL that a limit or an error ends: a status where it is short, however late the end comes; else the transfer
    breaks off, in every format, and HTTP/1.0, which cannot show that, gets none of it."""
    rows = 150_000
    with serving(config=f"[limits]\nsql_rows = {rows}\n") as server:
        with_tables(server)
        for form in ["json", "csv", "arrow"]:
            # 18,000 rows are some parts and less than a mebibyte.
            late = {"sql": "SELECT 10 / (15000 - value) AS n FROM generate_series(1, 18000)", "format": form}
            status, headers, body = server.request("POST", "/api/sql", late)
            assert (status, json.loads(body)["error"]["code"]) == (422, "bad_query"), (form, status, body[-200:])
            whole = {"sql": "SELECT value FROM generate_series(1, 18000)", "format": form}
            status, headers, body = server.request("POST", "/api/sql", whole)
            length = {name.lower(): value for name, value in headers.items()}.get("content-length")
            assert status == 200 and length == str(len(body)), (form, status, headers)
            large = "SELECT value, repeat('x', 40) AS x FROM generate_series(1, {})"
            try:
                status, _, body = server.request("POST", "/api/sql", {"sql": large.format(rows + 1), "format": form})
            except http.client.IncompleteRead:
                pass
            else:
                raise AssertionError(f"{form}: an answer that was cut off looks whole: {status}, {len(body)} bytes, {body[-80:]}")
            status, _, body = server.request("POST", "/api/sql", {"sql": large.format(rows), "format": form})
            assert status == 200 and len(body) > 6_000_000, (form, status, len(body))
            old = json.dumps({"sql": large.format(rows + 1), "format": form}).encode()
            head = request("POST", "/api/sql", {**JSON_BODY, "content-length": str(len(old))}).replace(b"HTTP/1.1", b"HTTP/1.0")
            wire = Wire(server, head + old)
            wire.until_closed(3 * LATE_S)
            assert wire.status_heard() == 422 and b"HTTP/1.0" in wire.heard, (form, wire.heard[:300])
