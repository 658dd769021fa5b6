"""A `reel serve` process, MCP sessions towards it over HTTP+SSE, and what `reel` says of the traces that it recorded."""

import asyncio
import base64
import contextlib
import json
import logging
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

from agent import png_size
from vectors import shared

IMAGE_SIZE = (640, 480)
FAMILIES = ("FDP", "FODP", "FDO", "SUL")
START_TIMEOUT_S = 120
STOP_TIMEOUT_S = 120
PROBE_TIMEOUT_S = 20
CONNECT_TIMEOUT_S = 60
SHORT_TASKS = 2
"""Tasks of each family in the short form."""


def reel_binary():
    return os.environ.get("REEL") or shutil.which("reel") or sys.exit("set REEL to the binary of reel")


def real_bench():
    """The folder of REAL-Bench: tasks by family and a scene."""
    return Path(os.environ.get("REEL_REAL_BENCH") or shared() / "real-bench")


def reel(*arguments):
    """Runs the command; its standard output. Fails with its standard error."""
    done = subprocess.run([reel_binary(), *map(str, arguments)], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"reel {' '.join(map(str, arguments))}: exit code {done.returncode}: {done.stderr[-2000:]}")
    return done.stdout


def query(store, sql):
    """The rows of a query."""
    return json.loads(reel("query", "--store", store, "--json", sql))


class Server:
    """`reel serve` on a free port of the loopback, with the traces in a folder of ours."""

    def __init__(self, data, *arguments):
        self.data = Path(data)
        self.data.mkdir(parents=True, exist_ok=True)
        command = [reel_binary(), "serve", "--listen", "127.0.0.1:0", "--data", str(data), *map(str, arguments)]
        self.log = self.data / "serve.log"
        with open(self.log, "w") as log:
            self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True)
        line = self.process.stdout.readline()
        found = re.search(r"http://[0-9.]+:(\d+)", line)
        if not found:
            self.process.kill()
            raise RuntimeError(f"{' '.join(command)} did not start: {line}{self.log.read_text()[-2000:]}")
        self.url = f"http://localhost:{found.group(1)}"

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        self.process.wait(STOP_TIMEOUT_S)
        self.process.stdout.close()

    @property
    def traces(self):
        return self.data / "traces"


async def probe(url):
    """The trainer's probe of a port: GET, the first line, close. Fails if none comes in time."""
    host, port, path = re.fullmatch(r"http://([^:/]+):(\d+)(/.*)", url).groups()
    async with asyncio.timeout(PROBE_TIMEOUT_S):
        reader, writer = await asyncio.open_connection(host, int(port))
        writer.write(f"GET {path} HTTP/1.1\r\nHost: {host}\r\nAccept: text/event-stream\r\n\r\n".encode())
        status = await reader.readline()
        writer.close()
    if b" 200 " not in status:
        raise RuntimeError(f"{url} answered {status!r}")


class Session:
    """One MCP connection. `call` answers as the clients of this folder expect."""

    def __init__(self, url):
        self.url, self.stack, self.results = url, None, []

    async def __aenter__(self):
        await self.reconnect()
        return self

    async def __aexit__(self, *_):
        await self.stack.aclose()

    async def reconnect(self):
        from mcp import ClientSession  # only the drives have it, each its own version
        from mcp.client.sse import sse_client

        logging.getLogger("client").setLevel(logging.ERROR)  # warns of each call of a tool that is not listed

        if self.stack:
            await self.stack.aclose()
        self.stack = contextlib.AsyncExitStack()
        streams = await self.stack.enter_async_context(sse_client(self.url, timeout=CONNECT_TIMEOUT_S))
        self.client = await self.stack.enter_async_context(ClientSession(*streams))
        await self.client.initialize()

    async def tools(self):
        listed = await self.client.list_tools()
        return [tool.model_dump(by_alias=True, exclude_none=True) for tool in listed.tools]

    async def call(self, name, arguments):
        result = await self.client.call_tool(name, arguments)
        items = [item.model_dump(by_alias=True, exclude_none=True) for item in result.content]
        answer = {"content": items, "isError": bool(result.isError)}
        self.results.append((name, arguments, answer))
        return answer


def form_problem(result):
    """What is wrong with the form of a tool's result (docs/spec.md#published-results), or `None`."""
    items = result["content"]
    if result["isError"]:
        return f"isError, with {items}"
    kinds = [item["type"] for item in items]
    if kinds == ["text"] and items[0]["text"].startswith("Error executing "):
        return None
    if kinds not in (["image", "text"], ["text", "image", "text"]):
        return f"the kinds of the items are {kinds}"
    if not items[-1]["text"].startswith("Debug Info:\n"):
        return f"the last text begins with {items[-1]['text'][:40]!r}"
    image = items[-2]
    try:
        size = png_size(base64.b64decode(image["data"]))
    except ValueError as error:
        return str(error)
    if image["mimeType"] != "image/png" or size != IMAGE_SIZE:
        return f"the image is {image['mimeType']} of {size}"
    missing = DEBUG_KEYS - json.loads(items[-1]["text"].removeprefix("Debug Info:\n")).keys()
    return f"the debug text lacks {sorted(missing)}" if missing else None


DEBUG_KEYS = {"CURRENT_LANDMARK", "CURRENT_POS", "CURRENT_INV", "CURRENT_MARKER_MAP", "world_graph", "WORLD_GRAPH"}


def require_bench():
    """The folder of REAL-Bench; ends the program aloud if it is absent."""
    folder = real_bench()
    if not (folder / "tasks").is_dir():
        print(f"skipped: real-bench: nothing at {folder}; clone https://github.com/InternRobotics/REAL and set REEL_REAL_BENCH")
        sys.exit(0)
    return folder
