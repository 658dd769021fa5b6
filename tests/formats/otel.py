"""Spans of OpenTelemetry between Reel and others: a collector made of the official messages takes what Reel sends, the official
messages read the files that Reel writes, and what the official SDK recorded of other agents becomes traces, from files and over HTTP.
Where the packages cannot be installed, it says so.

    REEL=~/.cache/reel/debug/reel python3 tests/formats/otel.py
"""

import gzip
import http.server
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import threading
import time

HERE = pathlib.Path(__file__).resolve().parent
REEL = os.environ.get("REEL", "reel")


def reel(folder, *arguments, code=0, environment=None):
    done = subprocess.run([REEL, *map(str, arguments)], cwd=folder, capture_output=True, text=True, env={**os.environ, **(environment or {})})
    assert done.returncode == code, f"reel {arguments}: {done.returncode}: {done.stdout}{done.stderr}"
    return done


class Collector:
    """A collector that takes spans with the official messages. `answers` are statuses of its next answers, before it takes all."""

    def __init__(self):
        from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest, ExportTraceServiceResponse

        self.requests, self.bodies, self.headers, self.answers, self.rejects = [], [], [], [], 0
        collector = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_POST(self):
                body = self.rfile.read(int(self.headers["content-length"]))
                if self.headers.get("content-encoding") == "gzip":
                    body = gzip.decompress(body)
                status = collector.answers.pop(0) if collector.answers else 200
                answer = ExportTraceServiceResponse()
                if status == 200:
                    assert self.path == "/v1/traces" and self.headers["content-type"] == "application/x-protobuf", f"{self.path} {self.headers}"
                    assert len(body) < 4 << 20, f"a request of {len(body)} bytes"
                    collector.bodies.append(body)
                    collector.headers.append({name.lower(): value for name, value in self.headers.items()})
                    collector.requests.append(ExportTraceServiceRequest.FromString(body))
                    if collector.rejects:
                        answer.partial_success.rejected_spans = collector.rejects
                        answer.partial_success.error_message = "too \x1b[31mold"
                answer = answer.SerializeToString()
                self.send_response(status)
                if status == 503:
                    self.send_header("retry-after", "0")
                self.send_header("content-type", "application/x-protobuf")
                self.send_header("content-length", str(len(answer)))
                self.end_headers()
                self.wfile.write(answer)

            def log_message(self, *_):
                pass

        self.server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_port}"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def spans(self):
        return [span for request in self.requests for of in request.resource_spans for scope in of.scope_spans for span in scope.spans]


def attributes(span):
    """Attributes by name, as Python's values."""
    return {pair.key: getattr(pair.value, pair.value.WhichOneof("value")) for pair in span.attributes}


def written(folder):
    """Episodes with and without images."""
    reel(folder, "task", "generate", "--count", 2, "--seed", 3, "--out", "tasks")
    for policy, images in (("planner", []), ("wrong-object", ["--no-images"])):
        reel(folder, "run", "--tasks", "tasks", "--policy", policy, *images, "--out", "traces")


def sent(folder, collector):
    """A collector takes every span: once it was busy, with the headers of the environment, and says what it rejects."""
    collector.answers = [503, 503]
    environment = {"OTEL_EXPORTER_OTLP_ENDPOINT": collector.url, "OTEL_EXPORTER_OTLP_HEADERS": "authorization=Bearer%20secret"}
    reel(folder, "export", "otel", "traces", "--to", "env", "--images", "blob", environment=environment)
    assert not collector.answers and {one["authorization"] for one in collector.headers} == {"Bearer secret"}
    spans = collector.spans()
    roots = [span for span in spans if not span.parent_span_id]
    assert len(roots) == len(list((folder / "traces").glob("*.mcap"))) == 4
    assert len({(span.trace_id, span.span_id) for span in spans}) == len(spans)
    for root in roots:
        facts = attributes(root)
        assert facts["gen_ai.operation.name"] == "invoke_agent" and root.name == f"invoke_agent {facts['gen_ai.agent.name']}", f"{facts}"
        tools = [span for span in spans if span.trace_id == root.trace_id and span.name.startswith("execute_tool ")]
        assert len(tools) == facts["reel.steps"] and all(span.parent_span_id == root.span_id for span in tools)
        # Collectors throw away what is long ago.
        assert time.time() - root.end_time_unix_nano / 1e9 < 3600
        scores = {attributes(event)["gen_ai.evaluation.name"]: attributes(event)["gen_ai.evaluation.score.value"] for event in root.events}
        rewards = sum(attributes(span)["reel.reward"] for span in tools)
        assert scores["success"] == float(facts["reel.success"]) and abs(scores["total_reward"] - rewards) < 1e-9, f"{scores}"
    results = [attributes(span).get("gen_ai.tool.call.result", "") for span in spans]
    parts = [part for result in results if result.startswith("[") for part in json.loads(result)]
    blobs = [part for part in parts if part["type"] == "blob"]
    assert blobs and all(part["mime_type"] == "image/webp" for part in blobs)
    collector.rejects = 1
    done = reel(folder, "export", "otel", "traces", "--to", collector.url, code=1)
    assert "4 rejected" in done.stdout and "the collector says: too" in done.stderr and "\x1b" not in done.stderr, f"{done}"
    collector.rejects = 0
    collector.answers = [400]
    done = reel(folder, "export", "otel", "traces", "--to", collector.url, code=2)
    assert "status 400" in done.stderr, f"{done}"
    print(f"a collector takes {len(spans)} spans of {len(roots)} episodes, once it is not busy")
    return spans


def files_are_official(folder, sent):
    """The files hold the spans that a collector gets, in both encodings."""
    from opentelemetry.proto.trace.v1.trace_pb2 import TracesData

    reel(folder, "export", "otel", "traces", "--images", "blob", "--start", "2026-01-01T00:00:00Z", "--out", "jsonl")
    reel(folder, "export", "otel", "traces", "--images", "blob", "--start", "2026-01-01T00:00:00Z", "--format", "protobuf", "--out", "binpb")
    sys.path.insert(0, str(HERE))
    import foreign

    known = {(span.trace_id, span.span_id): attributes(span) for span in sent}
    for file in sorted((folder / "binpb").glob("*.binpb")):
        data = TracesData.FromString(file.read_bytes())
        spans = [span for of in data.resource_spans for scope in of.scope_spans for span in scope.spans]
        for span in spans:
            assert known.pop((span.trace_id, span.span_id)) == attributes(span), f"{file}: {span.name}"
        told = [json.loads(line) for line in (folder / "jsonl" / f"{file.stem}.jsonl").read_text().splitlines()]
        in_json = [span for one in told for of in one["resourceSpans"] for scope in of["scopeSpans"] for span in scope["spans"]]
        official = [span for of in foreign.otlp_json(data)["resourceSpans"] for scope in of["scopeSpans"] for span in scope["spans"]]
        assert len(in_json) == len(official) == len(spans)
        for ours, theirs in zip(in_json, official):
            assert ours == theirs, f"{ours} is not {theirs}"
    assert not known, f"{len(known)} spans are in no file"
    print("files in both encodings are read by the official messages")


def of_other_agents(folder):
    """Spans of the official SDK by three conventions are traces whose scores and failed calls SQL finds."""
    import foreign

    kept = HERE / "foreign" / "spans.jsonl"
    assert foreign.spans_file() == kept.read_text(), "tests/formats/foreign/spans.jsonl is stale"
    reel(folder, "import", "otel", kept, "--task", "test.case.name", "--success", "builds", "--out", "agents")
    check(folder, "agents", lambda number, grade: grade == "C")
    print(f"spans of {len(foreign.ATTEMPTS)} agents by three conventions are read and counted")


def check(folder, traces, succeeds):
    """The tables of traces of these attempts; `succeeds` says of number and grade what success is."""
    import foreign

    reel(folder, "ingest", traces, "--store", f"{traces}-store")
    sql = ("SELECT task_id, policy, family, success, scores, length, sequence_count(steps, '_[failed]') AS failed FROM episodes")
    rows = {row["task_id"]: row for row in json.loads(reel(folder, "query", "--store", f"{traces}-store", "--json", sql).stdout)}
    for number, (task, tools, grade) in enumerate(foreign.ATTEMPTS):
        row = rows.pop(f"builds/{task}")
        scored = task in ("parser", "lexer")
        assert (row["policy"], row["family"]) == ("coder", "other"), f"{row}"
        assert row["success"] is (succeeds(number, grade) if scored else None), f"{row}"
        # Each call is a step, and so is what was said at the end.
        assert row["length"] == len(tools) + scored and row["failed"] == (len(tools) if task == "linker" else 0), f"{row}"
        values = {score["name"]: (score["value"], score["label"]) for score in row["scores"] or []}
        assert values == ({"builds": (float(grade == "C"), grade), "tests.passed": (0.25 * number, None)} if scored else {}), f"{values}"
    assert not rows, f"{rows}"
    sql = "SELECT tool, count(*) AS calls FROM steps WHERE tool <> 'message' GROUP BY tool"
    counted = {row["tool"]: row["calls"] for row in json.loads(reel(folder, "query", "--store", f"{traces}-store", "--json", sql).stdout)}
    expected = [tool for _, tools, _ in foreign.ATTEMPTS for tool in tools]
    assert counted == {tool: expected.count(tool) for tool in set(expected)}, f"{counted}"


def taken_over_http(folder):
    """The official exporter sends spans to `reel serve --otlp-in`, whose archive has the episodes then."""
    import foreign
    from opentelemetry.exporter.otlp.proto.http import Compression
    from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
    from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceResponse

    sys.path.insert(0, str(HERE.parent / "service"))
    import harness

    # The second score: without the rule the first would say success, and says the opposite.
    flags = ("--otlp-in", "--otlp-task", "test.case.name", "--otlp-success", "tests.passed>=0.25")
    with harness.Server(*flags, data=folder / "served") as server:
        exporter = OTLPSpanExporter(endpoint=f"{server.url}/v1/traces", compression=Compression.Gzip)
        foreign.spans(exporter)
        in_json = json.loads((HERE / "foreign" / "spans.jsonl").read_text().splitlines()[0])
        # The spans of a trace are there already: sent again they are the same.
        status, headers, answer = server.request("POST", "/v1/traces", in_json)
        assert status == 200 and headers["content-type"] == "application/json" and json.loads(answer) == {}, f"{status} {answer}"
        odd = {"resourceSpans": [{"scopeSpans": [{"spans": [{"traceId": "ab", "spanId": "cd", "name": "odd"}]}]}]}
        status, _, answer = server.request("POST", "/v1/traces", odd)
        assert status == 200 and json.loads(answer)["partialSuccess"]["rejectedSpans"] == "1", f"{answer}"
        for body, headers, expected in (
            (b"none", {"content-type": "application/x-protobuf"}, 400),
            (b"{}", {"content-type": "text/plain"}, 415),
            (b"{}", {"content-type": "application/json", "content-encoding": "br"}, 415),
            (b"{}", {"content-type": "application/json", "content-encoding": "gzip"}, 200),
        ):
            status, _, answer = server.request("POST", "/v1/traces", body, headers)
            assert status == expected, f"{body} {headers}: {status} {answer}"
        status, headers, answer = server.request("POST", "/v1/traces", b"", {"content-type": "application/x-protobuf"})
        assert status == 200 and ExportTraceServiceResponse.FromString(answer) == ExportTraceServiceResponse()
    traces = sorted((folder / "served" / "traces").glob("*.mcap"))
    assert len(traces) == len(foreign.ATTEMPTS), f"{traces}"
    check(folder, "served/traces", lambda number, grade: 0.25 * number >= 0.25)
    # Without --otlp-in nobody takes them.
    with harness.Server(data=folder / "other") as server:
        status, _, _ = server.request("POST", "/v1/traces", {})
        assert status in (404, 405), f"{status}"
    print(f"the official exporter sends {len(traces)} episodes to the service")


def sent_as_they_end(folder, collector):
    """Episodes of a benchmark are sent when they end; a collector that is absent or busy costs them nothing."""
    before = len(collector.requests)
    done = reel(folder, "bench", "--tasks", "tasks", "--agent", "planner", "--no-images", "--out", "bench", "--otlp", collector.url)
    assert "spans sent" in done.stderr, f"{done.stderr}"
    spans = [span for request in collector.requests[before:] for of in request.resource_spans for scope in of.scope_spans for span in scope.spans]
    roots = [span for span in spans if not span.parent_span_id]
    assert len(roots) == len(list((folder / "bench").glob("*.mcap"))) == 2
    assert not any(key in attributes(span) for span in spans for key in ("reel.record", "gen_ai.tool.call.result")), "words are sent unasked"
    # The same spans as an export has, ids included.
    reel(folder, "export", "otel", "bench", "--no-content", "--out", "bench-spans")
    told = [json.loads(line) for file in (folder / "bench-spans").glob("*.jsonl") for line in file.read_text().splitlines()]
    ids = {span["spanId"] for one in told for of in one["resourceSpans"] for scope in of["scopeSpans"] for span in scope["spans"]}
    assert ids == {span.span_id.hex() for span in spans}
    environment = {"OTEL_EXPORTER_OTLP_ENDPOINT": "http://127.0.0.1:9"}
    done = reel(folder, "bench", "--tasks", "tasks", "--agent", "planner", "--no-images", "--out", "absent", environment=environment)
    assert "spans lost" in done.stderr or "dropped" in done.stderr, f"{done.stderr}"
    assert len(list((folder / "absent").glob("*.mcap"))) == 2
    print(f"{len(roots)} episodes are sent as they end")


def main():
    if "--inside" not in sys.argv:
        made = subprocess.run([HERE.parent / "python.sh", "formats"], capture_output=True, text=True)
        if made.returncode:
            print(f"skipped: python: OpenTelemetry's own libraries cannot be installed: {made.stderr.strip()[-300:]}")
            return 0
        return subprocess.run([made.stdout.strip(), __file__, "--inside"]).returncode
    with tempfile.TemporaryDirectory(prefix="reel-otel-") as folder:
        folder, collector = pathlib.Path(folder), Collector()
        written(folder)
        files_are_official(folder, sent(folder, collector))
        of_other_agents(folder)
        taken_over_http(folder)
        sent_as_they_end(folder, collector)
    return 0


if __name__ == "__main__":
    sys.exit(main())
