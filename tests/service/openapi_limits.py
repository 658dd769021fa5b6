"""What a server with tokens and narrow limits answers: before anything is done, when it is busy, and when its disk is in the way."""

import collections
import random
import signal
import socket
import threading
import time

from harness import until
from openapi_kit import CLAIM, Bounded, Client, together

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
        for path in ("/api/labels", "/api/remarks", "/api/attribution"):
            admin.expect(422, "GET", path)
        admin.expect(422, "GET", "/api/counterfactuals", query={"episode": labelled})
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

        crowded(server, clients, seen, episodes[0]["task_id"])
        lease = {"worker": "one", "task_id": episodes[0]["task_id"], "rollouts": 1}
        clients["actor"].expect(201, "POST", "/api/leases", lease)
        clients["actor"].expect(503, "POST", "/api/leases", {**lease, "worker": "two"})

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


def crowded(server, clients, seen, task):
    """An episode at which more want to look, and in which more want to act, than can be served within its patience: the
    server stands still for longer than that while they wait, for how many a machine serves is its own."""
    actor, path = clients["actor"], "/api/sessions/{session}"
    actor.expect(200, "POST", "/reset", {"task": task, "episode_id": "crowded"})
    actor.expect(503, "POST", "/reset", {"task": task})
    walk = {"action": {"name": "walk_around", "arguments": {}}, "episode_id": "crowded"}
    looking = [clients["hasty"], clients["reader"]] * 50
    looks = [(one, ("GET", path + what)) for one in looking for what in ("/frame", "/calls")]
    looks += [(actor, operation) for operation in [("GET", "/state")] * 50 + [("POST", "/step")] * 20]

    def look(one):
        client, (method, what) = one
        body, query = (walk, "") if method == "POST" else (None, {"episode_id": "crowded"} if what == "/state" else "")
        answered = what, client.send(method, what, body, query, session="openenv-crowded")[0]
        served.append(answered)
        return answered

    def stand_still():
        until(lambda: len(served) >= 30, every=0.005)
        server.process.send_signal(signal.SIGSTOP)
        time.sleep(1.5)
        server.process.send_signal(signal.SIGCONT)

    random.Random(1).shuffle(looks)
    served = []
    still = threading.Thread(target=stand_still)
    still.start()
    got = together(look, looks)
    still.join()
    for what in sorted({what for what, _ in got}):
        statuses = collections.Counter(status for path, status in got if path == what)
        if not {200, 503} <= set(statuses):
            seen.complain(f"{statuses.total()} at once who ask for {what} get {statuses}")
    clients["admin"].expect(204, "DELETE", path, session="openenv-crowded")


def operations_with(seen, status):
    """The operations that document a status."""
    return [(method, path) for method, path, documented in seen.document.answers if documented == status]


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
