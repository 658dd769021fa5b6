"""What `reel serve` answers over REST against what its OpenAPI document says. For every documented status there is a request
that provokes it, and Schemathesis makes many more. Exits 1 when the server breaks down, when an answer is not documented, and
when a documented one never comes; where Schemathesis cannot be installed, it says so and exits 0.

    REEL=~/.cache/reel/debug/reel python3 tests/service/openapi.py --seconds 300
"""

import argparse
import collections
import concurrent.futures
import json
import pathlib
import random
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.parse

import openapi_fuzz
from harness import Agent, Server, environment, reel, until

# The server is busy, or the disk is full: documented where it can happen, and no break-down.
EXPECTED_SERVER_ERRORS = {503, 507}

CLAIM = {"of": "true", "holds": "asks = 0", "at_least": 0.5}

# A server with little of everything, so that every limit can be met.
NARROW = """
[limits]
sessions = 1
workers = 1
read_timeout_s = 3
body_mib = 1
upload_mib = 1
requests_per_s = 1
burst = 200
sql_rows = 1
sql_timeout_s = 8
analyses = 1
worker_timeout_s = 1
"""


class Bounded(Server):
    """A server that is ended in any case."""

    def stop(self, how=signal.SIGTERM, patience=30):
        try:
            return super().stop(how, patience)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            return "no end in time"


class Document:
    """The OpenAPI document of a server."""

    def __init__(self, document):
        self.document = document
        methods = ("get", "put", "post", "delete")
        paths = document["paths"].items()
        self.operations = {(name.upper(), path): item[name] for path, item in paths for name in methods if name in item}
        self.answers = {
            (*operation, int(status)): answer
            for operation, said in self.operations.items() for status, answer in said["responses"].items()
        }


class Seen:
    """What was answered, and what was wrong with it."""

    def __init__(self, document):
        self.document = document
        self.counts = collections.Counter()
        self.complaints = []
        self.lock = threading.Lock()

    def complain(self, text):
        with self.lock:
            if text not in self.complaints:
                self.complaints.append(text)

    def add(self, method, path, status):
        # Methods that the document does not have are asked for, too.
        if (method, path) in self.document.operations:
            with self.lock:
                self.counts[method, path, status] += 1

    def check(self, method, path, status, kind, text):
        """Adds an answer whose body is at hand."""
        self.add(method, path, status)
        kinds = self.document.answers.get((method, path, status), {}).get("content")
        if kinds is not None and kind.partition(";")[0] not in kinds:
            self.complain(f"{method} {path}: {status} is of type '{kind}' instead of {' or '.join(kinds)}")
        if status >= 400:
            try:
                error = json.loads(text)["error"]
                assert isinstance(error["code"], str) and isinstance(error["message"], str)
            except (ValueError, KeyError, TypeError, AssertionError):
                self.complain(f"{method} {path}: {status} does not say what is wrong: {text[:200]!r}")

    def end(self, server):
        """Ends a server, which has to end well."""
        code = server.stop()
        if code != 0:
            self.complain(f"the server ended with {code}")

    def unseen(self):
        return sorted(set(self.document.answers) - set(self.counts))

    def undocumented(self):
        return sorted(set(self.counts) - set(self.document.answers))

    def broken(self):
        return sorted(seen for seen in self.counts if seen[2] >= 500 and seen[2] not in EXPECTED_SERVER_ERRORS)


class Client:
    """Requests to a server, with one token or none, whose answers count."""

    def __init__(self, server, seen, token=None):
        self.server, self.seen = server, seen
        self.headers = {"authorization": f"Bearer {token}"} if token else {}

    def send(self, method, path, body=None, query="", headers=None, timeout=60, **names):
        """(status, value) of a request; names fill the path."""
        names = {name: urllib.parse.quote(value, safe="") for name, value in names.items()}
        query = f"?{urllib.parse.urlencode(query)}" if isinstance(query, dict) else query
        headers = {**self.headers, **(headers or {})}
        status, found, text = self.server.request(method, path.format(**names) + query, body, headers, timeout)
        found = {name.lower(): value for name, value in found.items()}
        kind = found.get("content-type", "")
        self.seen.check(method, path, status, kind, text)
        return status, json.loads(text) if kind.startswith("application/json") else text

    def expect(self, status, method, path, *arguments, **names):
        """The value of an answer, which has to have this status."""
        found, value = self.send(method, path, *arguments, **names)
        if found != status:
            shown = " ".join(str(part) for part in (*arguments, *names.values()))[:200]
            self.seen.complain(f"{method} {path} {shown}: {found} instead of {status}: {str(value)[:300]}")
        return value


def record(folder):
    """Plays a few tasks into the traces of a data folder; what was played."""
    def made(*arguments):
        code, out, err = reel(*arguments)
        if code != 0:
            raise RuntimeError(f"reel {' '.join(map(str, arguments))}: {code}: {err}")
        return out

    tasks, traces = folder / "tasks", folder / "data" / "traces"
    made("task", "generate", "--count", 4, "--seed", 3, "--out", tasks)
    episodes = []
    for policy, images in (("oracle", []), ("wrong-object", ["--no-images"])):
        lines = made("run", "--tasks", tasks, "--policy", policy, *images, "--out", traces, "--json").splitlines()
        episodes += [json.loads(line) for line in lines]
    for episode in episodes:
        episode["trace"] = pathlib.Path(episode["trace"]).stem
    (traces / "damaged.mcap").write_bytes(b"no trace at all")
    return episodes


def ended(client, job):
    """A job when it has ended."""
    path = "/api/jobs/{id}"
    stages = ("done", "failed", "cancelled")
    until(lambda: client.expect(200, "GET", path, id=str(job))["state"] in stages, patience=120)
    return client.expect(200, "GET", path, id=str(job))


def before_the_tables(client, episode):
    """Nothing was ingested yet."""
    client.expect(404, "GET", "/api/episodes")
    client.expect(404, "GET", "/api/labels")
    client.expect(404, "GET", "/api/episodes/{episode}", episode=episode["episode_id"])
    client.expect(404, "POST", "/api/sql", {"sql": "SELECT 1"})
    client.expect(404, "GET", "/api/attribution")
    client.expect(404, "POST", "/api/claims", CLAIM)
    for path in ("/api/remarks", "/api/counterfactuals"):
        client.expect(404, "GET", path, query={"episode": episode["episode_id"]})
    if client.expect(200, "GET", "/api/waiting")["traces"] == []:
        client.seen.complain("nothing waits for the first ingest")


def jobs(client, episode, recording):
    """Every kind of work, started, watched and stopped."""
    path = "/api/jobs/{id}"
    kinds = [
        {"kind": "ingest"}, {"kind": "replay", "traces": [episode["trace"]]}, {"kind": "blame"},
        {"kind": "taxonomy"}, {"kind": "reward", "preset": "paper"},
        {"kind": "export", "set": "sft", "name": "set", "options": {"format": "trl"}},
    ]
    # One is at work at a time: the last one waits.
    started = [client.expect(202, "POST", "/api/jobs", work) for work in [*kinds, {"kind": "replay"}]]
    last = str(started.pop()["id"])
    client.expect(202, "DELETE", path, id=last)
    events = client.expect(200, "GET", path + "/events", id=str(started[0]["id"])).decode()
    if '"state":"done"' not in events:
        client.seen.complain(f"the events of a job do not end with it: {events[-300:]}")
    for job in started:
        job = ended(client, job["id"])
        if job["state"] != "done":
            client.seen.complain(f"a job of kind {job['work']['kind']} is {job['state']}: {job['errors']}")
    if ended(client, last)["state"] != "cancelled":
        client.seen.complain("a job that was stopped went on")
    client.expect(409, "DELETE", path, id=last)
    client.expect(200, "GET", "/api/jobs")
    for method, rest in (("GET", ""), ("GET", "/events"), ("DELETE", "")):
        client.expect(400, method, path + rest, id="first")
        client.expect(404, method, path + rest, id="999999")
    client.expect(400, "POST", "/api/jobs", b"{")
    client.expect(400, "POST", "/api/jobs", {"kind": "replay", "traces": ["../tokens"]})
    client.expect(404, "POST", "/api/jobs", {"kind": "replay", "traces": ["nothing"]})
    client.expect(409, "POST", "/api/jobs", {"kind": "replay", "traces": [recording]})
    client.expect(422, "POST", "/api/jobs", {"kind": "export", "set": "sft", "name": "set", "options": {"out": "/"}})
    client.expect(422, "POST", "/api/jobs", {"kind": "reward", "preset": "/etc/passwd"})


def traces(client, episode, recording):
    """Files, and what is made of them."""
    name, path = episode["trace"], "/api/traces/{trace}"
    client.expect(200, "GET", "/api/traces", query={"limit": 2})
    client.expect(400, "GET", "/api/traces", query={"limit": 0})

    file = client.expect(200, "GET", path, trace=name)
    if client.expect(206, "GET", path, headers={"range": "bytes=4-7"}, trace=name) != file[4:8]:
        client.seen.complain("a range of a trace is not that of the file")
    client.expect(416, "GET", path, headers={"range": f"bytes={len(file)}-"}, trace=name)
    client.expect(201, "PUT", path, file, trace="again")
    client.expect(409, "PUT", path, file, trace="again")
    client.expect(422, "PUT", path, file[:-100], trace="cut")
    client.expect(400, "PUT", path, file, trace="../again")
    client.expect(204, "DELETE", path, trace="again")

    branches, branch = path + "/branches", {"at": 0, "policy": "oracle", "name": "branch"}
    client.expect(201, "POST", branches, branch, trace=name)
    client.expect(409, "POST", branches, branch, trace=name)
    client.expect(400, "POST", branches, {**branch, "name": "../branch"}, trace=name)
    client.expect(422, "POST", branches, {**branch, "at": 999, "name": "other"}, trace=name)

    frames, steps, reward = path + "/frames/{step}", path + "/steps", path + "/reward"
    for step in ("start", "0", "1.png"):
        client.expect(200, "GET", frames, trace=name, step=step)
    client.expect(200, "GET", frames, query={"camera": "follow:target"}, trace=name, step="2")
    client.expect(400, "GET", frames, query={"camera": "free"}, trace=name, step="2")
    client.expect(400, "GET", frames, trace=name, step="now")
    client.expect(404, "GET", frames, trace=name, step="999")
    client.expect(400, "GET", steps, query={"from": -1}, trace=name)
    client.expect(400, "GET", path + "/blame", query={"alternative": "maybe"}, trace=name)
    client.expect(422, "GET", reward, query={"preset": "unknown"}, trace=name)

    reads = [("GET", path + rest) for rest in (
        "/episode", "/scene", "/scene.glb", "/instances", "/steps", "/frames/{step}", "/frames/{step}/markers", "/blame", "/reward",
        "/rrd", "/compare/{other}",
    )]
    place = {"step": "start", "other": "branch"}
    for method, rest in [*reads, ("POST", path + "/replay")]:
        client.expect(200, method, rest, trace=name, **place)
        client.expect(422, method, rest, trace="damaged", **place)
    bodies = {("POST", branches): branch}
    for method, rest in [*reads, ("POST", path + "/replay"), ("POST", branches), ("GET", path), ("DELETE", path)]:
        body = bodies.get((method, rest))
        client.expect(400, method, rest, body, trace="a b", **place)
        client.expect(404, method, rest, body, trace="nothing", **place)
        client.expect(409, method, rest, body, trace=recording, **place)


def tables(client, episode):
    """Episodes, SQL, named queries, labels."""
    client.expect(200, "GET", "/api/episodes", query={"family": episode["family"], "success": "true", "limit": 1})
    client.expect(400, "GET", "/api/episodes", query={"limit": 1001})

    label = {"episode": episode["episode_id"], "class": "Other", "author": "ann", "step": 0, "confidence": 0.5, "note": "why"}
    client.expect(201, "POST", "/api/labels", label)
    client.expect(201, "POST", "/api/labels", {**label, "author": "cem", "adjudicate": True})
    client.expect(400, "POST", "/api/labels", b"{")
    for wrong in ({"author": None}, {"author": " "}, {"class": "Luck"}, {"note": "\0"}, {"note": "x" * 200_000}, {"step": 999}):
        client.expect(422, "POST", "/api/labels", {**label, **wrong})
    if len(client.expect(200, "GET", "/api/labels", query={"episode": episode["episode_id"]})) != 2:
        client.seen.complain("there are not the labels that were kept")
    client.expect(400, "GET", "/api/labels", query="?episode=%ff&episode=x")

    client.expect(200, "GET", "/api/episodes/{episode}", episode=episode["episode_id"])
    client.expect(404, "GET", "/api/episodes/{episode}", episode="nothing")
    client.expect(400, "GET", "/api/episodes/{episode}", episode=b"\xff")

    for form in ("json", "csv", "arrow", "parquet"):
        client.expect(200, "POST", "/api/sql", {"sql": "SELECT * FROM episodes", "format": form})
        client.expect(200, "GET", "/api/queries/{name}", query={"format": form}, name="overview")
    client.expect(400, "POST", "/api/sql", b"\xff")
    for version in (99, 2**63 - 2, 2**64 - 1):
        client.expect(404, "POST", "/api/sql", {"sql": "SELECT 1", "at": version})
    client.expect(422, "POST", "/api/sql", b'["SELECT 1", {}, "json", null]')
    client.expect(422, "POST", "/api/sql", {"sql": "SELECT " + "x" * (3 << 20)})
    for sql in ("", "SELECT", "DROP TABLE episodes", "SELECT 1; SELECT 2", "SELECT $unknown", "SELECT 1 / 0"):
        client.expect(422, "POST", "/api/sql", {"sql": sql})

    client.expect(200, "GET", "/api/queries")
    client.expect(400, "GET", "/api/queries/{name}", query={"format": "xml"}, name="overview")
    client.expect(404, "GET", "/api/queries/{name}", name="unknown")
    client.expect(422, "GET", "/api/queries/{name}", query={"parameters": "unknown=1"}, name="overview")


def opinions(client, episode):
    """What people say of episodes besides the label: answers of the user, stars, tags, comments; and what was measured."""
    which = episode["episode_id"]
    label = {"episode": which, "step": 0, "author": "ann", "label": "faithful"}
    client.expect(400, "POST", "/api/answer-labels", b"{")
    client.expect(422, "POST", "/api/answer-labels", {**label, "label": "so so"})
    mine = {"author": "dan"}
    client.expect(201, "POST", "/api/labels", {"episode": which, "class": "Other", **mine})
    client.expect(204, "DELETE", "/api/labels/{episode}", query=mine, episode=which)
    client.expect(422, "DELETE", "/api/labels/{episode}", query=mine, episode=which)
    client.expect(400, "DELETE", "/api/labels/{episode}", query={"author": "ann", "colour": "red"}, episode=b"\xff")

    path, remark = "/api/remarks", {"episode": which, "author": "ann", "kind": "tag", "text": "door"}
    client.expect(201, "POST", path, remark)
    client.expect(400, "POST", path, b"{")
    client.expect(422, "POST", path, {**remark, "text": "a, b"})
    said = client.expect(200, "GET", path, query={"episode": which})
    if [(one["kind"], one["text"]) for one in said] != [("tag", "door")]:
        client.seen.complain(f"the remarks are not those that were kept: {said}")
    client.expect(400, "GET", path, query="?episode=%ff&episode=x")
    for text in ("one", "two"):
        client.expect(201, "POST", path, {**remark, "author": "dan", "text": text})
    tag = {"author": "ann", "kind": "tag", "text": "door"}
    client.expect(204, "DELETE", path + "/{episode}", query=tag, episode=which)
    client.expect(422, "DELETE", path + "/{episode}", query=tag, episode=which)
    client.expect(400, "DELETE", path + "/{episode}", query={"kind": "wink"}, episode=which)

    client.expect(200, "GET", "/api/counterfactuals", query={"episode": which})
    client.expect(400, "GET", "/api/counterfactuals")
    if client.expect(200, "GET", "/api/attribution")["measured"] != 0:
        client.seen.complain("capabilities were measured, though nobody asked for it")


def exports(client, data):
    """Training sets: the one that a job made, and one that somebody has broken."""
    path = "/api/exports/{export}"
    broken = data / "exports" / "broken"
    broken.mkdir()
    (broken / "manifest.json").write_text("{}")
    if [one["name"] for one in client.expect(200, "GET", "/api/exports")].count("set") != 1:
        client.seen.complain("the training set that a job made is not listed")
    examples = client.expect(200, "GET", path + "/examples", query={"limit": 2}, export="set")
    if len(examples) != 2 or "turns" not in examples[0]:
        client.seen.complain(f"these are no two examples: {str(examples)[:200]}")
    client.expect(400, "GET", path + "/examples", query={"limit": 21}, export="set")
    for rest in ("", "/lint"):
        client.expect(200, "GET", path + rest, export="set")
    for rest in ("/examples", "/lint"):
        client.expect(422, "GET", path + rest, export="broken")
    for rest in ("", "/examples", "/lint"):
        client.expect(404, "GET", path + rest, export="nothing")
        client.expect(400, "GET", path + rest, export="../exports")


def claims(client, data):
    """Claims: counted, refused, kept and shown again."""
    counted = client.expect(200, "POST", "/api/claims", CLAIM)
    if counted["episodes"] < 1:
        client.seen.complain(f"a claim about all episodes counts {counted}")
    client.expect(400, "POST", "/api/claims", b"{")
    client.expect(422, "POST", "/api/claims", {**CLAIM, "holds": "nonsense > 1"})
    client.expect(201, "PUT", "/api/definitions/{file}", {"title": "Asks", "claim": CLAIM}, file="asks")
    path = "/api/claims/{file}"
    client.expect(200, "GET", path, file="asks")
    client.expect(404, "GET", path, file="nothing")
    client.expect(400, "GET", path, file="../asks")
    (data / "definitions" / "wrong.json").write_text("{")
    client.expect(422, "GET", path, file="wrong")


def environments(client, task):
    """Episodes of clients of OpenEnv over HTTP."""
    for path in ("/health", "/metadata", "/schema", "/state"):
        client.expect(200, "GET", path)
    begun = client.expect(200, "POST", "/reset", {"task": task, "episode_id": "mine"})
    if begun["done"]:
        client.seen.complain(f"an episode is over before it began: {begun}")
    action = {"name": "walk_around", "arguments": {}}
    client.expect(200, "POST", "/step", {"action": action, "episode_id": "mine"})
    if client.expect(200, "GET", "/state", query={"episode_id": "mine"})["step_count"] != 1:
        client.seen.complain("an episode of one step has another number of them")
    for method, path, body in (("POST", "/reset", b"{"), ("POST", "/step", b"{")):
        client.expect(400, method, path, body)
    client.expect(400, "GET", "/state", query={"episode_id": "../mine"})
    client.expect(404, "GET", "/state", query={"episode_id": "nobody"})
    client.expect(404, "POST", "/step", {"action": action, "episode_id": "nobody"})
    client.expect(409, "POST", "/step", {"action": action})
    client.expect(422, "POST", "/step", {"action": {}, "episode_id": "mine"})
    client.expect(422, "POST", "/reset", {"weather": "rain"})
    client.expect(404, "POST", "/reset", {"trace": "nothing"})


def definitions(client, data):
    """Panels: kept, listed, refused, gone; and one that somebody has broken."""
    path, panel = "/api/definitions/{file}", {"title": "Episodes", "sql": "SELECT count(*) FROM episodes"}
    client.expect(201, "PUT", path, panel, file="mine")
    client.expect(422, "PUT", path, {"title": "Neither"}, file="mine")
    client.expect(400, "PUT", path, b"{", file="mine")
    (data / "definitions" / "broken.json").write_text("{")
    listed = {one["name"]: one for one in client.expect(200, "GET", "/api/definitions")}
    if listed["mine"]["definition"] != panel or "problem" not in listed["broken"]:
        client.seen.complain(f"the panels are not those that were kept: {listed['mine']}, {listed['broken']}")
    client.expect(204, "DELETE", path, file="mine")
    client.expect(404, "DELETE", path, file="mine")
    for method in ("PUT", "DELETE"):
        client.expect(400, method, path, panel, file="../mine")


def sessions(client, agent, task, played):
    """Live sessions, prompt groups, and a question that a person answers."""
    path = "/api/sessions/{session}"
    answer = {"answer": "the one by the window"}
    said = []
    asking = threading.Thread(target=lambda: said.append(agent.say("ask", question="Which one?")), daemon=True)
    asking.start()
    if not until(lambda: client.expect(200, "GET", "/api/questions")):
        client.seen.complain("a question is nowhere to be answered")
    session = client.expect(200, "GET", "/api/questions")[0]["session"]
    client.expect(200, "GET", path + "/question", session=session)
    client.expect(400, "GET", path + "/question", session=b"\xff")
    client.expect(422, "POST", path + "/answer", {"answer": 1}, session=session)
    client.expect(400, "POST", path + "/answer", b"", session=session)
    client.expect(204, "POST", path + "/answer", answer, session=session)
    asking.join(30)
    if answer["answer"] not in "".join(said):
        client.seen.complain(f"the answer did not arrive: {said}")
    client.expect(404, "POST", path + "/answer", answer, session=session)
    client.expect(404, "GET", path + "/question", session=session)

    client.expect(200, "GET", "/api/sessions")
    # Where something stands there is something to see.
    scene = client.expect(200, "GET", "/api/traces/{trace}/scene", trace=played)
    for receptacle in scene["receptacles"]:
        agent.call("nav_to", receptacle_name=receptacle["id"])
        if client.expect(200, "GET", path + "/calls", session=session)["in_view"]:
            break
    client.expect(200, "GET", path, session=session)
    at_play = [file["trace"] for file in client.expect(200, "GET", "/api/traces", query={"limit": 1000})["traces"] if file["recording"]]
    client.expect(200, "GET", path + "/frame", session=session)
    told = client.expect(200, "GET", path + "/calls", session=session)
    client.expect(204, "DELETE", path, session=session)
    # What was told while it was at play is what the trace says.
    [trace] = at_play
    steps = client.expect(200, "GET", "/api/traces/{trace}/steps", trace=trace)
    visible = sorted(one["object"] for one in steps[-1]["visible"])
    if not visible or sorted(told["in_view"]) != visible:
        client.seen.complain(f"in view are said to be {told['in_view']}, recorded are {visible}")
    if [call["tool"] for call in told["decisions"]] != [step["input"]["call"]["name"] for step in steps]:
        client.seen.complain(f"the calls are said to be {told['decisions']}, recorded are {steps}")
    for of_now in ("/frame", "/calls"):
        client.expect(404, "GET", path + of_now, session=session)
        client.expect(400, "GET", path + of_now, session=b"\xff")
    for method in ("GET", "DELETE"):
        client.expect(404, method, path, session=session)
        client.expect(400, method, path, session=b"\xff")

    lease = {"worker": "one", "task_id": task, "rollouts": 2}
    client.expect(201, "POST", "/api/leases", lease)
    # Nothing is at play there yet.
    ended = client.expect(200, "GET", "/api/sessions")[0]["session"]
    for of_now in ("/frame", "/calls"):
        client.expect(409, "GET", path + of_now, session=ended)
    client.expect(409, "POST", "/api/leases", {**lease, "seed": 1})
    for worker in ("", "..", "a/b", "x" * 63):
        client.expect(400, "POST", "/api/leases", {**lease, "worker": worker})
    client.expect(422, "POST", "/api/leases", {**lease, "worker": "two", "task_id": "unknown"})
    client.expect(422, "POST", "/api/leases", {**lease, "rollouts": 0})
    client.expect(204, "DELETE", "/api/leases/{worker}", worker="one")
    client.expect(404, "DELETE", "/api/leases/{worker}", worker="one")
    client.expect(400, "DELETE", "/api/leases/{worker}", worker="a b")


def service(client):
    for path in ("/healthz", "/readyz", "/metrics"):
        client.expect(200, "GET", path)


def open_server(folder, episodes):
    """Everything that a server without tokens answers; what was seen."""
    failed = next(episode for episode in episodes if not episode["success"])
    succeeded = next(episode for episode in episodes if episode["success"])
    with Bounded("--tasks", folder / "tasks", "--ask", "rest", data=folder / "data") as server:
        seen = Seen(Document(document_of(server)))
        client = Client(server, seen)
        service(client)
        before_the_tables(client, failed)
        agent = Agent(server)
        agent.call("finish")
        listed = client.expect(200, "GET", "/api/traces", query={"limit": 1000})["traces"]
        recording = next(file["trace"] for file in listed if file["recording"])
        jobs(client, failed, recording)
        traces(client, succeeded, recording)
        tables(client, failed)
        exports(client, folder / "data")
        opinions(client, failed)
        definitions(client, folder / "data")
        claims(client, folder / "data")
        ingested = client.expect(200, "GET", "/api/episodes")["episodes"]
        if {episode["episode_id"] for episode in episodes} - {episode["episode_id"] for episode in ingested}:
            seen.complain("the tables do not have every episode that was ingested")
        sessions(client, agent, failed["task_id"], succeeded["trace"])
        environments(client, failed["task_id"])
        seen.end(server)
    return seen


def tokens(data):
    """Tokens by name: who may do everything, who may only play or read, who is in a hurry."""
    made = {}
    for name, role in (("admin", "admin"), ("actor", "act"), ("reader", "read"), ("hasty", "admin")):
        code, out, err = reel("server", "token", "create", name, "--role", role, "--data", data, "--json")
        if code != 0:
            raise RuntimeError(f"no token: {err}")
        made[name] = json.loads(out)["token"]
    return made


def narrow_server(folder, seen, made, episodes):
    """What the gate answers before anything is done, for every operation; and every limit."""
    data = folder / "data"
    config = folder / "narrow.toml"
    config.write_text(NARROW)
    labelled = next(episode for episode in episodes if not episode["success"])["episode_id"]
    nothing = {"trace": "nothing", "episode": "nothing", "session": "nothing", "worker": "nothing", "name": "nothing",
               "export": "nothing", "file": "nothing", "id": "999999", "step": "start", "other": "nothing"}
    bodies = {"/api/sql": {"sql": "SELECT 1"}, "/api/claims": CLAIM, "/api/definitions/{file}": {"title": "Panel", "sql": "SELECT 1"},
              "/api/traces/{trace}/branches": {"at": 0, "name": "nothing"}}

    with Bounded("--config", config, "--tasks", folder / "tasks", data=data) as server:
        clients = {name: Client(server, seen, token) for name, token in made.items()}
        admin, anybody = clients["admin"], Client(server, seen)
        secured = [key for key, said in seen.document.operations.items() if said.get("security")]
        with_body = [key for key, said in seen.document.operations.items() if "requestBody" in said]

        for method, path in seen.document.operations:
            anybody.expect(403, method, path, headers={"host": "elsewhere.example"}, **nothing)
        for method, path in secured:
            anybody.expect(401, method, path, **nothing)
            playing = path.startswith("/api/leases") or not path.startswith(("/api/", "/metrics"))
            clients["reader" if playing else "actor"].expect(403, method, path, **nothing)

        def large(key):
            # A trace is counted while it comes, everything else by what it says of itself.
            mib = 1 << 20
            counted = key == ("PUT", "/api/traces/{trace}")
            admin.expect(413, *key, b"x" * (mib + 1) if counted else None,
                         headers={} if counted else {"content-length": str(mib + 1)}, **nothing)

        def late(key):
            admin.expect(408, *key, b"{", headers={"content-length": "10"}, **nothing)

        together(large, with_body)
        together(late, with_body)

        # One row is all that there may be.
        admin.expect(422, "GET", "/api/episodes")
        for path in ("/api/labels", "/api/remarks"):
            admin.expect(422, "GET", path)
        admin.expect(422, "GET", "/api/episodes/{episode}", episode=labelled)

        # One is asking, and the others wait in vain.
        endless = {"sql": "SELECT count(*) FROM generate_series(1, 1000000000000)"}
        asking = threading.Thread(target=lambda: admin.expect(422, "POST", "/api/sql", endless))
        asking.start()
        time.sleep(1)
        others = {"/readyz", "/api/leases", "/reset", "/step", "/state", "/api/sessions/{session}/frame", "/api/sessions/{session}/calls"}
        waiting = [key for key in operations_with(seen, 503) if key[1] not in others]
        of = {path: {"episode": labelled} for path in ("/api/counterfactuals", "/api/remarks")}
        together(lambda key: admin.expect(503, *key, bodies.get(key[1]), query=of.get(key[1], ""), **{**nothing, "name": "overview"}),
                 waiting)
        asking.join()

        lease = {"worker": "one", "task_id": episodes[0]["task_id"], "rollouts": 1}
        clients["actor"].expect(201, "POST", "/api/leases", lease)
        clients["actor"].expect(503, "POST", "/api/leases", {**lease, "worker": "two"})

        # More want to look than can be served within its patience.
        Agent(server, worker="one", headers=clients["actor"].headers).call("finish")
        looking = [clients["hasty"], clients["reader"]] * 50
        session = admin.expect(200, "GET", "/api/sessions")[0]["session"]
        looks = [(one, "/api/sessions/{session}/" + what) for one in looking for what in ("frame", "calls")]
        got = together(lambda look: (look[1], look[0].send("GET", look[1], session=session)[0]), looks)
        for what in sorted({what for what, _ in got}):
            statuses = collections.Counter(status for path, status in got if path == what)
            if not {200, 503} <= set(statuses):
                seen.complain(f"a hundred who ask for {what} get {statuses}")

        (data / "definitions").rename(data / "elsewhere")
        (data / "definitions").write_text("no folder")
        try:
            panel = "/api/definitions/{file}"
            for method in ("PUT", "DELETE"):
                admin.expect(507, method, panel, bodies[panel], file="mine")
        finally:
            (data / "definitions").unlink()
            (data / "elsewhere").rename(data / "definitions")

        # A disk that cannot say whether there is a trace of that name.
        (data / "traces" / "round.mcap").symlink_to("round.mcap")
        try:
            branch = {"at": 0, "policy": "oracle", "name": "round"}
            admin.expect(507, "POST", "/api/traces/{trace}/branches", branch, trace=episodes[0]["trace"])
        finally:
            (data / "traces" / "round.mcap").unlink()

        (data / "traces").rename(data / "elsewhere")
        try:
            for path in ("/api/traces", "/api/waiting"):
                admin.expect(507, "GET", path)
            admin.expect(507, "PUT", "/api/traces/{trace}", b"", trace="nothing")
        finally:
            (data / "elsewhere").rename(data / "traces")

        for client, often, operations in (
            (anybody, "/healthz", set(seen.document.operations) - set(secured)), (clients["hasty"], "/metrics", secured),
        ):
            until(lambda: client.send("GET", often)[0] == 429, every=0)
            for method, path in operations:
                # A second later there is one more.
                if not until(lambda: client.send(method, path, **nothing)[0] == 429, patience=3, every=0):
                    seen.complain(f"{method} {path} can be asked without end")

        not_ready(server, seen)


def fuzzed_server(folder, seen, made, episodes, python, seconds, seed):
    """How many answers Schemathesis got."""
    config = folder / "fuzzed.toml"
    config.write_text(openapi_fuzz.CONFIG)
    with Bounded("--config", config, "--tasks", folder / "tasks", data=folder / "data") as server:
        answers, wrong = openapi_fuzz.fuzz(python, folder, server, seen.document.document, made, episodes, seconds, seed)
        for answer in answers:
            seen.add(*answer)
        if wrong:
            seen.complain(wrong)
        seen.end(server)
    return len(answers)


def operations_with(seen, status):
    """The operations that document a status."""
    return [(method, path) for method, path, documented in seen.document.answers if documented == status]


def together(work, parts):
    """What comes of doing something with every part, all at once."""
    with concurrent.futures.ThreadPoolExecutor(max(1, len(parts))) as threads:
        return [done.result() for done in [threads.submit(work, part) for part in parts]]


def not_ready(server, seen):
    """Ends a server while a request is half said, and says the rest."""
    def stopping():
        return server.log.read_text().count("stopping: no new calls")

    # Clients without tokens have just asked too often.
    time.sleep(1.5)
    with socket.create_connection(("127.0.0.1", server.port), timeout=20) as connection:
        connection.sendall(f"GET /readyz HTTP/1.1\r\nhost: 127.0.0.1:{server.port}\r\n".encode())
        time.sleep(0.5)
        before = stopping()
        server.process.send_signal(signal.SIGTERM)
        until(lambda: stopping() > before)
        time.sleep(0.2)
        connection.sendall(b"\r\n")
        answer = b""
        while part := connection.recv(1 << 16):
            answer += part
    head, _, body = answer.partition(b"\r\n\r\n")
    seen.check("GET", "/readyz", int((head.split() or [b"", b"0"])[1]), "application/json", body)
    seen.end(server)


def document_of(server):
    status, document = server.json("GET", "/api/openapi.json")
    if status != 200:
        raise RuntimeError(f"/api/openapi.json: {status}")
    return document


def say(what):
    print(f"openapi: {what}", file=sys.stderr, flush=True)


def main():
    arguments = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    arguments.add_argument("--seconds", type=int, default=300, help="how long Schemathesis runs (300)")
    arguments.add_argument("--short", action="store_true", help="the same as --seconds 25")
    arguments.add_argument("--seed", type=int, default=random.randrange(1 << 32), help="of what Schemathesis draws")
    arguments = arguments.parse_args()
    seconds = 25 if arguments.short else arguments.seconds

    python = environment("schemathesis")
    # Whatever ends this ends its servers.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("openapi: stopped"))
    signal.signal(signal.SIGALRM, lambda *_: sys.exit("openapi: this takes far too long"))
    signal.alarm(seconds + 600)
    with tempfile.TemporaryDirectory(prefix="reel-openapi-") as folder:
        folder = pathlib.Path(folder)
        say("recording episodes")
        episodes = record(folder)
        say("asking a server without tokens")
        seen = open_server(folder, episodes)
        made = tokens(folder / "data")
        say("asking a server with tokens and narrow limits")
        narrow_server(folder, seen, made, episodes)
        asked = sum(seen.counts.values())
        say(f"schemathesis asks for {seconds} s, with seed {arguments.seed}")
        fuzzed = fuzzed_server(folder, seen, made, episodes, python, seconds, arguments.seed)

    identifiers = collections.Counter(said.get("operationId") for said in seen.document.operations.values())
    for name in (name for name, count in identifiers.items() if count > 1):
        seen.complain(f"several operations are called '{name}'")
    wrong = {
        "broke down": seen.broken(),
        "seen, but not documented": seen.undocumented(),
        "documented, but never seen": seen.unseen(),
    }
    for title, answers in wrong.items():
        for method, path, status in answers:
            print(f"{title:27} {status} {method:6} {path}")
    for complaint in seen.complaints:
        print(f"wrong: {complaint}")
    operations, documented = len(seen.document.operations), len(seen.document.answers)
    print(
        f"openapi: {operations} operations, {documented} documented answers, {documented - len(seen.unseen())} seen; "
        f"{asked} requests made for them, {fuzzed} by schemathesis {openapi_fuzz.VERSION} in {seconds} s; "
        f"{len(seen.complaints)} complaints"
    )
    return 1 if seen.complaints or any(wrong.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
