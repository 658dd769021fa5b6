"""A server and an agent of protocol 2025-11-25, with the official SDK (mcp 1.30.0): streams that the server ends and the agent resumes, a call
that is a task, a question to the user in the middle of a call.

    revision_2025_11_25.py serve            prints its port, and serves Streamable HTTP
    revision_2025_11_25.py play URL         prints the text of each result as a line of JSON
"""

import asyncio
import contextlib
import json
import socket
import sys

import anyio
import mcp.types as types
import uvicorn
from mcp.client.session import ClientSession
from mcp.client.streamable_http import streamable_http_client
from mcp.server.lowlevel import Server
from mcp.server.streamable_http import EventMessage, EventStore
from mcp.server.streamable_http_manager import StreamableHTTPSessionManager
from starlette.applications import Starlette
from starlette.routing import Mount


class Events(EventStore):
    """Every event in memory, by its number."""

    def __init__(self):
        self.events = []

    async def store_event(self, stream_id, message):
        self.events.append((stream_id, message))
        return str(len(self.events) - 1)

    async def replay_events_after(self, last_event_id, send_callback):
        stream = self.events[int(last_event_id)][0]
        for number in range(int(last_event_id) + 1, len(self.events)):
            owner, message = self.events[number]
            if owner == stream and message is not None:
                await send_callback(EventMessage(message, str(number)))
        return stream


def text(words):
    return [types.TextContent(type="text", text=words)]


def serve():
    server = Server("revision")
    server.experimental.enable_tasks()
    schema = {"type": "object"}

    @server.list_tools()
    async def tools():
        tasks = types.ToolExecution(taskSupport="optional")
        return [types.Tool(name=name, inputSchema=schema, execution=tasks) for name in ("plain", "polled", "asking", "long")]

    @server.call_tool()
    async def call(name, arguments):
        context = server.request_context
        if name == "polled":
            await context.close_sse_stream()
            await anyio.sleep(0.5)
        if name == "asking":
            schema = {"type": "object", "properties": {"way": {"type": "string"}}}
            answer = await context.session.elicit("which way?", requestedSchema=schema, related_request_id=context.request_id)
            return text(f"went {answer.content['way']}")
        if name == "long":

            async def work(task):
                await task.update_status("on the way")
                await anyio.sleep(0.5)
                return types.CallToolResult(content=text(f"{name} {arguments['number']}"))

            return await context.experimental.run_task(work)
        return text(f"{name} {arguments['number']}")

    manager = StreamableHTTPSessionManager(server, event_store=Events(), retry_interval=100)

    @contextlib.asynccontextmanager
    async def lifespan(_):
        async with manager.run():
            yield

    application = Starlette(routes=[Mount("/mcp", app=manager.handle_request)], lifespan=lifespan)
    listener = socket.create_server(("127.0.0.1", 0))
    print(listener.getsockname()[1], flush=True)
    uvicorn.Server(uvicorn.Config(application, log_level="error")).run(sockets=[listener])


async def play(url):
    async def answered(context, params):
        return types.ElicitResult(action="accept", content={"way": "left"})

    def tell(result):
        print(json.dumps(result.content[0].text), flush=True)

    async with streamable_http_client(url) as (read, write, _), ClientSession(read, write, elicitation_callback=answered) as session:
        await session.initialize()
        await session.list_tools()
        for number in range(2):
            tell(await session.call_tool("plain", {"number": number}))
            tell(await session.call_tool("polled", {"number": number}))
            tell(await session.call_tool("asking", {}))
            made = await session.experimental.call_tool_as_task("long", {"number": number}, ttl=60_000)
            async for status in session.experimental.poll_task(made.task.taskId):
                last = status.status
            assert last == "completed", last
            tell(await session.experimental.get_task_result(made.task.taskId, types.CallToolResult))


if sys.argv[1] == "serve":
    serve()
else:
    asyncio.run(play(sys.argv[2]))
