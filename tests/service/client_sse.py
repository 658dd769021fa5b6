"""The flow of REAL's evaluation agent over legacy HTTP+SSE, with the published client library (mcp 1.9.4): `finish` gives the
task, calls give `Debug Info`, the client judges by the last world graph. Prints a line of JSON an episode.

    client_sse.py URL [--episodes N] [--calls N] [--begin TASK_ID]

With --calls it makes so many calls after the start and is gone in the middle of the episode, without a word.
"""

import argparse
import asyncio
import json
import os

from mcp import ClientSession
from mcp.client.sse import sse_client

COMPLETED = "All evaluation episodes completed."


class Gone(Exception):
    pass


class Episode:
    def __init__(self, session, task, most):
        self.session, self.task, self.most = session, task, most
        self.calls, self.state, self.texts = 0, {}, []

    async def call(self, tool, **arguments):
        """One call; the debug information after it stays in `state`."""
        if self.most is not None and self.calls >= self.most:
            raise Gone
        self.calls += 1
        result = await self.session.call_tool(tool, arguments)
        assert not result.isError, f"{tool}: a failure of the domain is no protocol error"
        texts = [item.text for item in result.content if item.type == "text"]
        images = [item for item in result.content if item.type == "image"]
        assert texts[-1].startswith("Debug Info:\n"), texts[-1][:80]
        assert len(images) == 1 and images[0].mimeType == "image/png"
        self.state = json.loads(texts[-1].removeprefix("Debug Info:\n"))
        self.texts.append(texts[0] if len(texts) > 1 else "")
        return self.texts[-1]

    async def mark(self, tool, wanted, **arguments):
        """Calls a tool that marks things; the number of the wanted one."""
        await self.call(tool, **arguments)
        markers = self.state["CURRENT_MARKER_MAP"] or {}
        return next((int(number) for number, thing in markers.items() if thing == wanted), None)

    async def drive(self, verb, receptacle):
        """Opens or closes a door, where there is one that stands the other way."""
        door = self.state.get("world_graph", self.task["initial_world_graph"]).get(receptacle, {}).get("door")
        if door is None or door == (verb == "open"):
            return
        await self.call("navigate_to", receptacle_name=receptacle)
        marker = await self.mark("highlight_receptacles", receptacle)
        await self.call(verb, marker_id=str(marker))

    async def play(self):
        """Moves the target as the task says."""
        task = self.task
        source, destination, target = task["source_furniture"], task["destination_furniture"], task["target_object"]
        await self.drive("open", destination)
        await self.drive("open", source)
        await self.call("navigate_to", receptacle_name=source)
        marker = await self.mark("explore_receptacle", target["name"])
        await self.call("pick", marker_id=str(marker))
        await self.call("navigate_to", receptacle_name=destination)
        marker = await self.mark("highlight_receptacles", destination)
        await self.call("place", marker_id=str(marker))
        await self.drive("close", source)
        await self.drive("close", destination)

    def success(self):
        """As the published agent judges."""

        def plain(graph):
            return {name: (sorted(state.get("content", [])), state.get("door")) for name, state in graph.items()}

        return plain(self.state["world_graph"]) == plain(self.task["target_world_graph"])


async def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("url")
    parser.add_argument("--episodes", type=int, default=1_000)
    parser.add_argument("--calls", type=int)
    parser.add_argument("--begin")
    options = parser.parse_args()
    async with sse_client(options.url) as streams, ClientSession(*streams) as session:
        await session.initialize()
        tools = [tool.name for tool in (await session.list_tools()).tools]
        for _ in range(options.episodes):
            begin = ("finish_with_id", {"task_id": options.begin}) if options.begin else ("finish", {})
            first = (await session.call_tool(*begin)).content[0].text
            if first == COMPLETED:
                break
            episode = Episode(session, json.loads(first), options.calls)
            try:
                await episode.play()
            except Gone:
                print(json.dumps({"gone": episode.calls, "state": episode.state, "task": episode.task["benchmark_task_id"]}), flush=True)
                os._exit(0)
            line = {"task_id": episode.task["benchmark_task_id"], "family": episode.task["family"], "success": episode.success()}
            print(json.dumps({**line, "calls": episode.calls, "texts": episode.texts, "tools": len(tools)}), flush=True)
    print(json.dumps({"end": first}), flush=True)


asyncio.run(main())
