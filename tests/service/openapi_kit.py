"""What the checks of the OpenAPI document share: the document, clients whose answers count, and what was seen of it."""

import collections
import concurrent.futures
import json
import signal
import subprocess
import threading
import urllib.parse

from harness import Server

# The server is busy, or the disk is full: documented where it can happen, and no break-down.
EXPECTED_SERVER_ERRORS = {503, 507}

CLAIM = {"of": "true", "holds": "asks = 0", "at_least": 0.5}


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


def together(work, parts):
    """What comes of doing something with every part, all at once."""
    with concurrent.futures.ThreadPoolExecutor(max(1, len(parts))) as threads:
        return [done.result() for done in [threads.submit(work, part) for part in parts]]
