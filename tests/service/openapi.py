"""What `reel serve` answers over REST against what its OpenAPI document says. For every documented status there is a request
that provokes it, and Schemathesis makes many more. Exits 1 when the server breaks down, when an answer is not documented, and
when a documented one never comes; where Schemathesis cannot be installed, it says so and goes without.

    REEL=~/.cache/reel/debug/reel python3 tests/service/openapi.py --seconds 300
"""

import argparse
import collections
import json
import pathlib
import random
import signal
import subprocess
import sys
import tempfile
import threading

import openapi_fuzz
from harness import REEL, Agent, Skipped, environment, reel, until
from openapi_kit import CLAIM, Bounded, Client, Document, Seen
from openapi_limits import narrow_server


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


def recorded_elsewhere(folder):
    """An episode of a server that is not this one, among the traces: nothing can execute it, and it has no images; its name."""
    calls = [("initialize", {"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "openapi", "version": "1"}}),
             ("tools/call", {"name": "walk_around", "arguments": {}})]
    said = "".join(json.dumps({"jsonrpc": "2.0", "id": number, "method": method, "params": parameters}) + "\n"
                   for number, (method, parameters) in enumerate(calls))
    server = [REEL, "mcp", "--tasks", folder / "tasks", "--data", folder / "elsewhere"]
    command = [REEL, "record", "--out", folder / "data" / "traces", "--stdio", "--", *server]
    subprocess.run(command, input=said, capture_output=True, text=True, check=True)
    [trace] = (folder / "data" / "traces").glob("record-*.mcap")
    return trace.stem


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
        {"kind": "taxonomy"}, {"kind": "reward", "preset": "paper"}, {"kind": "counterfactuals", "traces": [episode["trace"]]},
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


def traces(client, episode, recording, elsewhere):
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
    client.expect(204, "GET", frames, query={"if_any": "true"}, trace=elsewhere, step="0")
    client.expect(422, "GET", frames, trace=elsewhere, step="0")
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


def environments(client, task, recording):
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
    client.expect(409, "POST", "/reset", {"trace": recording})


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


def answered(client, trace):
    """The answer of the user in an episode is labelled, once its tables have it."""
    ended(client, client.expect(202, "POST", "/api/jobs", {"kind": "ingest", "traces": [trace]})["id"])
    steps = client.expect(200, "GET", "/api/traces/{trace}/steps", trace=trace)
    step = next(at for at, step in enumerate(steps) if step["input"]["call"]["name"] == "ask")
    asked = {"sql": "SELECT episode_id FROM episodes WHERE trace LIKE '%/' || $trace || '.mcap'", "parameters": {"trace": trace}}
    [of] = client.expect(200, "POST", "/api/sql", asked)
    client.expect(201, "POST", "/api/answer-labels", {"episode": of["episode_id"], "step": step, "author": "ann", "label": "faithful"})


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
    answered(client, trace)
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


def open_server(folder, episodes, elsewhere):
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
        traces(client, succeeded, recording, elsewhere)
        tables(client, failed)
        exports(client, folder / "data")
        opinions(client, failed)
        definitions(client, folder / "data")
        claims(client, folder / "data")
        ingested = client.expect(200, "GET", "/api/episodes")["episodes"]
        if {episode["episode_id"] for episode in episodes} - {episode["episode_id"] for episode in ingested}:
            seen.complain("the tables do not have every episode that was ingested")
        sessions(client, agent, failed["task_id"], succeeded["trace"])
        agent.call("finish")
        listed = client.expect(200, "GET", "/api/traces", query={"limit": 1000})["traces"]
        environments(client, failed["task_id"], next(file["trace"] for file in listed if file["recording"]))
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


def document_of(server):
    status, document = server.json("GET", "/api/openapi.json")
    if status != 200:
        raise RuntimeError(f"/api/openapi.json: {status}")
    return document


def say(what):
    print(f"openapi: {what}", file=sys.stderr, flush=True)


def schemathesis():
    """Its Python, or None with the reason said."""
    try:
        return environment("schemathesis")
    except Skipped as skipped:
        need, why = skipped.args
        print(f"skipped: {need}: {why}", flush=True)


def main():
    arguments = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    arguments.add_argument("--seconds", type=int, default=300, help="how long Schemathesis runs (300)")
    arguments.add_argument("--short", action="store_true", help="without Schemathesis")
    arguments.add_argument("--seed", type=int, default=random.randrange(1 << 32), help="of what Schemathesis draws")
    arguments = arguments.parse_args()
    seconds, python = (0, None) if arguments.short else (arguments.seconds, schemathesis())
    # Whatever ends this ends its servers.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("openapi: stopped"))
    signal.signal(signal.SIGALRM, lambda *_: sys.exit("openapi: this takes far too long"))
    signal.alarm(seconds + 600)
    with tempfile.TemporaryDirectory(prefix="reel-openapi-") as folder:
        folder = pathlib.Path(folder)
        say("recording episodes")
        episodes = record(folder)
        say("asking a server without tokens")
        seen = open_server(folder, episodes, recorded_elsewhere(folder))
        made = tokens(folder / "data")
        say("asking a server with tokens and narrow limits")
        narrow_server(folder, seen, made, episodes)
        asked = sum(seen.counts.values())
        fuzzed = ""
        if python:
            say(f"schemathesis asks for {seconds} s, with seed {arguments.seed}")
            answers = fuzzed_server(folder, seen, made, episodes, python, seconds, arguments.seed)
            fuzzed = f", {answers} by schemathesis {openapi_fuzz.VERSION} in {seconds} s"

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
        f"{asked} requests made for them{fuzzed}; "
        f"{len(seen.complaints)} complaints"
    )
    return 1 if seen.complaints or any(wrong.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
