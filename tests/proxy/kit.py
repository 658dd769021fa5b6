"""Agents on raw sockets and pipes, and `reel record` as a process of its own, for the tests of the recorder. Standard library only.

Every agent keeps what it received, byte for byte: chunk framing of HTTP taken off, nothing else.
"""

import json
import os
import pathlib
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent.parent / "service"))
from harness import REEL, Server, Skipped, environment, main, reel, until  # noqa: E402,F401

HELLO = {"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "raw", "version": "1"}}

# A server's certificate with its key, and the authority that signed it.
TLS = pathlib.Path(__file__).resolve().parent / "tls"


class Recorder:
    """`reel record` before a server on a port, or the command of one (`stdio`), on a free port of its own. `before` are words before
    the recorder's command. With `trusting` the server is spoken to over TLS, and has to have a certificate of that file's authority."""

    def __init__(self, upstream_port, *arguments, out=None, before=(), path="/mcp", stdio=(), trusting=None):
        self.folder = None if out else tempfile.TemporaryDirectory(prefix="reel-record-")
        self.out = pathlib.Path(out or self.folder.name)
        self.log = self.out.parent / f"{self.out.name}.log"
        command = [*before, REEL, "record", "--listen", "127.0.0.1:0", "--out", str(self.out), *map(str, arguments)]
        command += ["--stdio", "--", *map(str, stdio)] if stdio else ["--upstream", f"http{'s' if trusting else ''}://127.0.0.1:{upstream_port}{path}"]
        environment = {**os.environ, "SSL_CERT_FILE": str(trusting)} if trusting else None
        with open(self.log, "a") as log:
            self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True, env=environment)
        line = self.process.stdout.readline()
        found = re.search(r"http://127\.0\.0\.1:(\d+)", line)
        if not found:
            raise RuntimeError(f"the recorder did not start: {line}{self.log.read_text()}")
        self.port = int(found.group(1))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stop()
        if self.folder:
            self.folder.cleanup()
        self.log.unlink(missing_ok=True)

    def stop(self, how=signal.SIGTERM, patience=60):
        """Ends the process; what it said at last."""
        if self.process.poll() is None:
            self.process.send_signal(how)
        self.process.wait(patience)
        if not self.process.stdout.closed:
            self.said = self.process.stdout.read()
            self.process.stdout.close()
        return self.said

    def traces(self):
        return sorted(self.out.glob("*.mcap"))

    def parts(self):
        return sorted(self.out.glob("*.mcap.part"))


class Wire:
    """One HTTP/1.1 connection; requests written and responses read by hand."""

    def __init__(self, port, timeout=120):
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=timeout)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.port, self.buffer = port, b""

    def close(self):
        self.socket.close()

    def ask(self, method, target, body=None, headers=None):
        """Sends a request; (status, headers as they came, body as it came) of the response."""
        self.send(method, target, body, headers)
        status, head = self.head(method)
        return status, head, self.body(status, head)

    def send(self, method, target, body=None, headers=None):
        lines = [f"{method} {target} HTTP/1.1", f"Host: 127.0.0.1:{self.port}"]
        lines += [f"{name}: {value}" for name, value in (headers or {}).items()]
        if body is not None:
            lines.append(f"Content-Length: {len(body)}")
        self.socket.sendall("\r\n".join(lines).encode() + b"\r\n\r\n" + (body or b""))

    def more(self):
        piece = self.socket.recv(1 << 16)
        if not piece:
            raise ConnectionError("the connection ended")
        self.buffer += piece

    def head(self, method="GET"):
        while b"\r\n\r\n" not in self.buffer:
            self.more()
        head, self.buffer = self.buffer.split(b"\r\n\r\n", 1)
        self.method = method
        return int(head.split()[1]), head

    @staticmethod
    def value(head, name):
        found = re.search(rb"(?im)^" + name.encode() + rb":[ \t]*(.*?)[ \t]*$", head.replace(b"\r", b""))
        return found.group(1).decode() if found else None

    def body(self, status, head):
        if status in (202, 204, 304) and not self.value(head, "content-length") and not self.value(head, "transfer-encoding"):
            return b""
        if (self.value(head, "transfer-encoding") or "").lower() == "chunked":
            body = b""
            while chunk := self.chunk():
                body += chunk
            return body
        length = int(self.value(head, "content-length") or 0)
        while len(self.buffer) < length:
            self.more()
        body, self.buffer = self.buffer[:length], self.buffer[length:]
        return body

    def chunk(self):
        """The next chunk; empty at the end."""
        while b"\r\n" not in self.buffer:
            self.more()
        size, rest = self.buffer.split(b"\r\n", 1)
        length = int(size.split(b";")[0], 16)
        while len(rest) < length + 2:
            self.more()
            rest = self.buffer.split(b"\r\n", 1)[1]
        self.buffer = rest[length + 2 :]
        return rest[:length]


class Http:
    """An agent over Streamable HTTP on one connection. `said` holds what it received: status, headers but the date, body."""

    def __init__(self, port, path="/mcp"):
        self.wire, self.path, self.number, self.said = Wire(port), path, 0, []
        self.headers = {
            "Content-Type": "application/json", "Accept": "application/json, text/event-stream",
            "Accept-Encoding": "gzip, deflate", "MCP-Protocol-Version": "2025-06-18",
        }
        self.rpc("initialize", HELLO)
        self.post({"jsonrpc": "2.0", "method": "notifications/initialized"})

    def post(self, message):
        return self.ask("POST", json.dumps(message).encode())

    def ask(self, method, body=None):
        status, head, body = self.wire.ask(method, self.path, body, self.headers)
        session = Wire.value(head, "mcp-session-id")
        if session:
            self.headers["Mcp-Session-Id"] = session
        lines = [line for line in head.split(b"\r\n") if not line.lower().startswith((b"date:", b"mcp-session-id:"))]
        self.said.append((status, lines, body))
        return status, body

    def rpc(self, method, params=None):
        self.number += 1
        status, body = self.post({"jsonrpc": "2.0", "id": self.number, "method": method, "params": params or {}})
        text = body.decode()
        data = [text] if text.startswith("{") else [line[5:] for line in text.splitlines() if line.startswith("data:")]
        answers = [json.loads(part) for part in data if part.strip()]
        return next((answer for answer in answers if answer.get("id") == self.number), {"status": status, "text": text})

    def call(self, tool, **arguments):
        return self.rpc("tools/call", {"name": tool, "arguments": arguments})

    def close(self):
        self.ask("DELETE")
        self.wire.close()


class Sse:
    """An agent over legacy HTTP+SSE: one connection listens, one posts."""

    def __init__(self, port, path="/sse"):
        self.stream, self.posts, self.number, self.said = Wire(port), Wire(port), 0, []
        self.stream.send("GET", path, headers={"Accept": "text/event-stream"})
        status, head = self.stream.head()
        assert status == 200, head
        self.said.append(("head", [line for line in head.split(b"\r\n") if not line.lower().startswith(b"date:")]))
        self.pending = b""
        endpoint = self.event()
        self.target = re.search(rb"data: ?(.*)", endpoint).group(1).decode().strip()
        self.rpc("initialize", HELLO)
        self.post({"jsonrpc": "2.0", "method": "notifications/initialized"})

    def event(self):
        while b"\n\n" not in self.pending and b"\r\n\r\n" not in self.pending:
            self.pending += self.stream.chunk()
        event, self.pending = re.split(rb"\r?\n\r?\n", self.pending, maxsplit=1)
        if not event.startswith(b":"):
            self.said.append(("event", re.sub(rb"session_id=\w+", b"session_id=", event)))
        return event

    def post(self, message):
        target = self.target if self.target.startswith("/") else "/" + self.target.split("/", 3)[3]
        status, head, body = self.posts.ask("POST", target, json.dumps(message).encode(), {"Content-Type": "application/json"})
        self.said.append(("post", status, body))
        return status, body

    def rpc(self, method, params=None):
        self.number += 1
        self.post({"jsonrpc": "2.0", "id": self.number, "method": method, "params": params or {}})
        while True:
            data = b"".join(line[5:] for line in self.event().splitlines() if line.startswith(b"data:"))
            message = json.loads(data) if data.strip() else {}
            if message.get("id") == self.number:
                return message

    def call(self, tool, **arguments):
        return self.rpc("tools/call", {"name": tool, "arguments": arguments})

    def close(self):
        self.stream.close()
        self.posts.close()


class Stdio:
    """An agent that starts its server as a command. `said` holds the lines it received."""

    def __init__(self, command):
        self.process = subprocess.Popen([str(word) for word in command], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        self.number, self.said, self.errors = 0, [], []
        threading.Thread(target=lambda: self.errors.extend(self.process.stderr), daemon=True).start()
        self.rpc("initialize", HELLO)
        self.post({"jsonrpc": "2.0", "method": "notifications/initialized"})

    def post(self, message):
        self.process.stdin.write(json.dumps(message).encode() + b"\n")
        self.process.stdin.flush()

    def rpc(self, method, params=None):
        self.number += 1
        self.post({"jsonrpc": "2.0", "id": self.number, "method": method, "params": params or {}})
        while True:
            line = self.process.stdout.readline()
            if not line:
                raise ConnectionError(b"".join(self.errors).decode(errors="replace"))
            self.said.append(line)
            message = json.loads(line)
            if message.get("id") == self.number:
                return message

    def call(self, tool, **arguments):
        return self.rpc("tools/call", {"name": tool, "arguments": arguments})

    def close(self):
        self.process.stdin.close()
        self.process.wait(60)


def texts(answer):
    return [item["text"] for item in answer["result"]["content"] if item["type"] == "text"]


def state(answer):
    """The debug information of a result, or nothing."""
    last = texts(answer)[-1:]
    return json.loads(last[0].removeprefix("Debug Info:\n")) if last and last[0].startswith("Debug Info:\n") else {}


def play(agent, decisions=None):
    """One episode as REAL's agent plays it; how many decisions it made. With `decisions` it stops after so many."""
    task = json.loads(texts(agent.call("finish"))[0])
    source, destination, target = task["source_furniture"], task["destination_furniture"], task["target_object"]
    made = 0

    class Enough(Exception):
        pass

    def call(tool, **arguments):
        nonlocal made
        if decisions is not None and made >= decisions:
            raise Enough
        made += 1
        return state(agent.call(tool, **arguments))

    def mark(tool, wanted, **arguments):
        markers = call(tool, **arguments).get("CURRENT_MARKER_MAP", {})
        return next((int(number) for number, thing in markers.items() if thing == wanted), 1)

    try:
        for place in (destination, source):
            call("navigate_to", receptacle_name=place)
            if task["initial_world_graph"][place].get("door") is False:
                call("open", marker_id=mark("highlight_receptacles", place))
        call("focus_on", marker_id=mark("explore_receptacle", target["name"]))
        call("pick", marker_id=mark("find_objects", target["name"], target_category=target["category"]))
        call("ask", target_category=target["category"], target_description="red")
        call("no_such_tool", a=1)
        call("pick", marker_id="none")
        call("navigate_to", receptacle_name=destination)
        call("place", marker_id=mark("highlight_receptacles", destination))
        while decisions is not None:
            call("highlight_receptacles")
    except Enough:
        pass
    return made


def tasks(folder, count=6):
    """Tasks that Reel makes, the same every time."""
    code, out, error = reel("task", "generate", "--count", count, "--seed", 3, "--out", folder)
    assert code == 0, out + error
    return folder


def seconds(work):
    begun = time.perf_counter()
    work()
    return time.perf_counter() - begun
