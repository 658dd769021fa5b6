"""A `reel serve` process of its own for a test, and plain HTTP and MCP towards it. Standard library only."""

import contextlib
import http.client
import json
import os
import pathlib
import re
import signal
import ssl
import subprocess
import sys
import tempfile
import time
import traceback

REEL = os.environ.get("REEL", "reel")


class Skipped(Exception):
    """A test that this machine cannot do: `Skipped(NEED, WHY)`, with a section NEED of tests/skips.toml."""


class Server:
    """`reel serve` on a free port of the loopback, in a folder of its own. `before` are words before the command, which end in its
    execution: a shell that lowers limits, say. With `cafile` it serves TLS, with a certificate that this file vouches for."""

    def __init__(self, *arguments, data=None, environment=None, before=(), cafile=None):
        self.tls = ssl.create_default_context(cafile=cafile) if cafile else None
        self.folder = None if data else tempfile.TemporaryDirectory(prefix="reel-service-")
        self.data = pathlib.Path(data or self.folder.name)
        self.log = self.data / "serve.log"
        self.data.mkdir(parents=True, exist_ok=True)
        if "--config" not in arguments:
            config = self.data / "serve.toml"
            config.write_text("ingest_new = false\n")
            arguments = ("--config", config, *arguments)
        command = [*before, REEL, "serve", "--listen", "127.0.0.1:0", "--data", str(self.data), *map(str, arguments)]
        with open(self.log, "a") as log:
            self.process = subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=log, text=True, env={**os.environ, **(environment or {})}
            )
        line = self.process.stdout.readline()
        found = re.search(r"https?://127\.0\.0\.1:(\d+)", line)
        if not found:
            self.process.wait(30)
            raise RuntimeError(f"the server did not start: {line}{self.log.read_text()}")
        self.port = int(found.group(1))
        self.url = f"http{'s' if self.tls else ''}://127.0.0.1:{self.port}"

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stop()
        if self.folder:
            self.folder.cleanup()

    def stop(self, how=signal.SIGTERM, patience=60):
        """Ends the process; its exit code."""
        if self.process.poll() is None:
            self.process.send_signal(how)
        code = self.process.wait(patience)
        self.process.stdout.close()
        return code

    def request(self, method, path, body=None, headers=None, timeout=60):
        """(status, headers, bytes) of one request on a connection of its own."""
        if self.tls:
            connection = http.client.HTTPSConnection("127.0.0.1", self.port, timeout=timeout, context=self.tls)
        else:
            connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=timeout)
        with contextlib.closing(connection):
            if isinstance(body, (dict, list)):
                body, headers = json.dumps(body), {"content-type": "application/json", **(headers or {})}
            # What is refused before it is read whole is answered all the same.
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):
                connection.request(method, path, body, headers or {})
            answer = connection.getresponse()
            return answer.status, dict(answer.getheaders()), answer.read()

    def json(self, method, path, body=None, headers=None):
        """(status, value) of one request."""
        status, _, text = self.request(method, path, body, headers)
        return status, json.loads(text) if text else None

    def traces(self):
        """The finished traces, by path."""
        return sorted((self.data / "traces").glob("*.mcap"))


class Agent:
    """One MCP session over Streamable HTTP (protocol 2025-06-18), or of a worker."""

    def __init__(self, server, worker=None, headers=None):
        self.server, self.path = server, f"/w/{worker}/mcp" if worker else "/mcp"
        self.headers = {
            "content-type": "application/json", "accept": "application/json, text/event-stream",
            "mcp-protocol-version": "2025-06-18", **(headers or {}),
        }
        self.number = 0
        hello = {"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "harness", "version": "1"}}
        self.rpc("initialize", hello)
        self.post({"jsonrpc": "2.0", "method": "notifications/initialized"})

    def post(self, message):
        status, headers, body = self.server.request("POST", self.path, json.dumps(message), self.headers)
        for name, value in headers.items():
            if name.lower() == "mcp-session-id":
                self.headers["mcp-session-id"] = value
        return status, body

    def rpc(self, method, params):
        """The result of a request; raises with the error's text."""
        self.number += 1
        status, body = self.post({"jsonrpc": "2.0", "id": self.number, "method": method, "params": params})
        if status != 200:
            raise RuntimeError(f"{method}: {status} {body.decode(errors='replace')[:500]}")
        text = body.decode()
        # One JSON value, or server-sent events of which one is the answer.
        data = [text] if text.startswith("{") else [line[5:] for line in text.splitlines() if line.startswith("data:")]
        for answer in (json.loads(part) for part in data if part.strip()):
            if answer.get("id") == self.number:
                if "error" in answer:
                    raise RuntimeError(answer["error"]["message"])
                return answer["result"]
        raise RuntimeError(f"{method}: no answer in {text[:500]}")

    def call(self, tool, **arguments):
        """The result of a tool call."""
        return self.rpc("tools/call", {"name": tool, "arguments": arguments})

    def say(self, tool, **arguments):
        """The first text of a tool call's result."""
        texts = [item["text"] for item in self.call(tool, **arguments)["content"] if item["type"] == "text"]
        return texts[0] if texts else ""


def until(condition, patience=30, every=0.1):
    """Waits for something to become true."""
    end = time.monotonic() + patience
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(every)
    return False


def reel(*arguments):
    """Runs the command; (exit code, standard output, standard error)."""
    done = subprocess.run([REEL, *map(str, arguments)], capture_output=True, text=True)
    return done.returncode, done.stdout, done.stderr


def environment(name):
    """The Python of an environment of tests/python.sh, made where it is not there yet."""
    script = pathlib.Path(__file__).resolve().parent.parent / "python.sh"
    made = subprocess.run([script, name], capture_output=True, text=True)
    if made.returncode:
        raise Skipped("python", f"{name} cannot be installed: {made.stderr.strip()[-300:]}")
    return made.stdout.strip()


def main(prefix, tests):
    """Runs the functions of a file whose names begin so (or those named on the command line); exits with 1 where one fails."""
    known = {name.removeprefix(prefix): test for name, test in tests.items() if name.startswith(prefix) and callable(test)}
    wanted = [name for name in sys.argv[1:] if not name.startswith("--")]
    if "--list" in sys.argv:
        print("\n".join(known))
        return
    failed = 0
    for name in wanted or known:
        begun = time.monotonic()
        try:
            known[name]()
        except Skipped as skipped:
            need, why = skipped.args
            print(f"skipped: {need}: {name}: {why}", flush=True)
        except Exception as error:  # a failed assertion, or whatever kept it from being made
            failed += 1
            print(f"FAILED {name}: {type(error).__name__}: {error}", flush=True)
            traceback.print_exc()
        else:
            print(f"ok {name} ({time.monotonic() - begun:.1f} s)", flush=True)
    sys.exit(1 if failed else 0)
