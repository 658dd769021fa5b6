"""A server and an agent of protocol 2026-07-28, with the official SDK (mcp 2.3.0): requests without a session, a call that the agent makes
again with what the server asked for.

    revision_2026_07_28.py serve            prints its port, and serves Streamable HTTP
    revision_2026_07_28.py play URL         prints the text of each result as a line of JSON
"""

import asyncio
import json
import socket
import sys
from typing import Annotated

import uvicorn
from mcp.client.client import Client
from mcp.server.mcpserver import MCPServer
from mcp.server.mcpserver.resolve import Elicit, Resolve
from mcp_types import ElicitResult, Implementation
from pydantic import BaseModel


class Way(BaseModel):
    way: str


def ask() -> Elicit[Way]:
    return Elicit("which way?", Way)


def serve():
    server = MCPServer("revision")

    @server.tool()
    def plain(number: int) -> str:
        return f"plain {number}"

    @server.tool()
    def asking(number: int, answer: Annotated[Way, Resolve(ask)]) -> str:
        return f"went {answer.way} {number}"

    listener = socket.create_server(("127.0.0.1", 0))
    print(listener.getsockname()[1], flush=True)
    application = server.streamable_http_app(streamable_http_path="/mcp/")
    uvicorn.Server(uvicorn.Config(application, log_level="error")).run(sockets=[listener])


async def play(url):
    async def answered(context, params):
        return ElicitResult(action="accept", content={"way": "left"})

    name = Implementation(name="gym", version="1")
    async with Client(url, mode="2026-07-28", elicitation_callback=answered, client_info=name) as client:
        await client.list_tools()
        for number in range(3):
            for tool in ("plain", "asking"):
                result = await client.call_tool(tool, {"number": number})
                print(json.dumps(result.content[0].text), flush=True)


if sys.argv[1] == "serve":
    serve()
else:
    asyncio.run(play(sys.argv[2]))
