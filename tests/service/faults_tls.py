"""Faults: TLS that is not spoken, certificates that change or are none, and changes that nobody is named for."""

import http.client
import json
import pathlib
import shutil
import socket
import ssl
import tempfile
import time

from faults_access import token
from faults_kit import LATE_S, Wire, request, serving, stopped
from harness import reel, until

#: Self-signed certificates and their keys, for these tests alone.
PAIRS = pathlib.Path(__file__).parent / "tls"
GOLDEN = pathlib.Path(__file__).resolve().parents[2] / "traces" / "golden"


def shown(port, trusted):
    """The certificate that a client gets which trusts one of the pairs; fails where it is the other."""
    context = ssl.create_default_context(cafile=PAIRS / f"{trusted}.pem")
    with context.wrap_socket(socket.create_connection(("127.0.0.1", port), LATE_S), server_hostname="localhost") as wire:
        return wire.getpeercert(True), wire.version()


def over_tls(port, trusted, method, path, body=None, headers=None):
    """(status, body) of a request over TLS."""
    context = ssl.create_default_context(cafile=PAIRS / f"{trusted}.pem")
    connection = http.client.HTTPSConnection("localhost", port, timeout=LATE_S, context=context)
    connection.request(method, path, body, headers or {})
    answer = connection.getresponse()
    return answer.status, answer.read()


def fault_tls():
    """TLS with a certificate from files: nobody is served in the clear, broken handshakes harm nobody, a certificate that was
    renewed is shown to new connections, and one that cannot be used leaves the old one."""
    with tempfile.TemporaryDirectory(prefix="reel-faults-") as folder:
        cert, key = pathlib.Path(folder) / "cert.pem", pathlib.Path(folder) / "key.pem"

        def install(name):
            for suffix, path in [("key", key), ("pem", cert)]:
                shutil.copyfile(PAIRS / f"{name}.{suffix}", path)

        install("first")
        files = ["--tls-cert", cert, "--tls-key", key]
        with serving(*files, folder=folder, cafile=PAIRS / "first.pem") as server:
            first, version = shown(server.port, "first")
            assert version in ("TLSv1.2", "TLSv1.3"), version
            assert over_tls(server.port, "first", "GET", "/healthz")[0] == 200
            hello = json.dumps({"jsonrpc": "2.0", "id": 1, "method": "initialize", "params": {
                "protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "tls", "version": "1"}}})
            accept = {"content-type": "application/json", "accept": "application/json, text/event-stream"}
            status, body = over_tls(server.port, "first", "POST", "/mcp", hello, accept)
            assert status == 200 and b"protocolVersion" in body, (status, body)
            for beginning in [request("GET", "/healthz"), b"\x16\x03\x01\xff\xff" + b"x" * 500, b"\x00" * 100]:
                wire = Wire(server, beginning)
                wire.until_closed(LATE_S)
                assert b"HTTP" not in wire.heard and b"ok" not in wire.heard, f"in the clear: {wire.heard[:200]}"
                wire.close()
            # A key alone does not fit, and a file that is none is none: the first certificate stays.
            shutil.copyfile(PAIRS / "second.key", key)
            time.sleep(1.5)
            assert shown(server.port, "first")[0] == first
            cert.write_text("no certificate")
            time.sleep(1.5)
            assert shown(server.port, "first")[0] == first
            install("second")

            def renewed():
                try:
                    return shown(server.port, "second")[0] != first
                except ssl.SSLError:
                    return False

            assert until(renewed, 4 + LATE_S), "a renewed certificate is not shown"
            install("first")
            assert until(lambda: over_tls_works(server.port), 4 + LATE_S)
            silent = Wire(server)
            time.sleep(0.2)
            begun = time.monotonic()
            assert stopped(server) and time.monotonic() - begun < 5 + LATE_S / 8, "a client that says nothing holds the server up"
            silent.close()
        for wrong, word in [((cert, cert), "private key"), ((PAIRS / "second.pem", key), "certificate"), ((folder + "/none", key), "none")]:
            code, _, err = reel("serve", "--listen", "127.0.0.1:0", "--data", folder + "/data", "--tls-cert", wrong[0], "--tls-key", wrong[1])
            assert code != 0 and word in err and "panicked" not in err, (wrong, code, err)


def over_tls_works(port):
    try:
        return over_tls(port, "first", "GET", "/healthz")[0] == 200
    except ssl.SSLError:
        return False


def fault_audit():
    """Every change is on the audit log before it is answered, with whose it was; what was refused for its role, too; strangers,
    readers and players are not."""
    with tempfile.TemporaryDirectory(prefix="reel-faults-") as folder:
        data = pathlib.Path(folder) / "data"
        secrets = {role: token(data, f"the-{role}", role) for role in ("act", "read", "admin")}
        with serving("--run", "audit", folder=folder) as server:
            bearer = {role: {"authorization": f"Bearer {secret}"} for role, secret in secrets.items()}

            def entries():
                code, out, err = reel("server", "audit", "--data", data, "--json")
                assert code == 0, err
                return [json.loads(line) for line in out.splitlines()]

            assert [entry["action"] for entry in entries()] == [f"token create the-{role} ({role})" for role in secrets]
            before = len(entries())
            for method, path in [("GET", "/api/traces"), ("POST", "/mcp"), ("PUT", "/api/traces/x"), ("POST", "/api/jobs")]:
                server.request(method, path, b"{}" if method != "GET" else None)
            server.request("GET", "/api/traces", None, bearer["read"])
            server.request("POST", "/api/sql", {"sql": "SELECT 1"}, bearer["read"])
            assert len(entries()) == before, entries()[before:]
            cases = [
                ("PUT", "/api/traces/x", b"no trace", "admin", 422), ("POST", "/api/jobs", {"kind": "ingest"}, "admin", None),
                ("DELETE", "/api/traces/none", None, "admin", 404), ("POST", "/api/jobs", {"kind": "ingest"}, "read", 403),
                ("DELETE", "/api/sessions/none", None, "act", 403),
            ]
            for method, path, body, role, expected in cases:
                status = server.request(method, path, body, bearer[role])[0]
                last = entries()[-1]
                found = (last["action"], last["token"], last["client"], last["status"])
                assert found == (f"{method} {path}", f"the-{role}", "127.0.0.1", status), (found, status)
                assert expected in (None, status), (method, path, status)
                wanted = body if isinstance(body, dict) and role == "admin" else None
                assert last.get("request") == wanted, last
            # A change whose client does not wait is one, too.
            trace = next(GOLDEN.glob("*.mcap")).read_bytes()
            names = [f"gone{number}" for number in range(20)]
            for name in names:
                assert server.request("PUT", f"/api/traces/{name}", trace, bearer["admin"])[0] == 201
            for name in names:
                wire = Wire(server, request("DELETE", f"/api/traces/{name}", bearer["admin"]))
                time.sleep(0.004)
                wire.close()
            there = lambda: {path.stem for path in server.traces()}  # noqa: E731
            until(lambda: not there() & set(names), 3)
            time.sleep(1)
            noted = {entry["action"].rpartition("/")[2] for entry in entries() if entry["action"].startswith("DELETE /api/traces/gone")}
            unnoted = set(names) - there() - noted
            assert not unnoted and len(noted) > 2, f"deleted and not on the log: {unnoted}; on it are {len(noted)}"
            # What is no name of a path fills no disk.
            server.request("DELETE", "/api/sessions/" + "x" * 50_000, None, bearer["read"])
            assert len(entries()[-1]["action"]) <= 500
            assert reel("server", "token", "revoke", "the-act", "--data", data)[0] == 0
            assert entries()[-1]["action"] == "token revoke the-act"
            text = (data / "audit.jsonl").read_text()
            assert not any(secret.removeprefix("reel_") in text for secret in secrets.values()), "a token is on the audit log"
            shown_to_people = reel("server", "audit", "--data", data)[1]
            assert shown_to_people.count("\n") == len(entries()) and "the-admin" in shown_to_people
