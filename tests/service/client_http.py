"""A whole episode over Streamable HTTP with the newest client library (mcp 2), by an agent that knows only what profile `paper`
shows: it looks everywhere for what the instruction names. Prints JSON.

    client_http.py URL
"""

import asyncio
import json
import sys

from mcp import Client


async def main():
    async with Client(sys.argv[1]) as client:
        tools = {tool.name: tool for tool in (await client.list_tools()).tools}

        async def call(tool, **arguments):
            result = await client.call_tool(tool, arguments)
            assert result.content[0].type == "text" and result.structured_content["text"], tool
            assert result.is_error == (not result.structured_content["ok"]), tool
            return result

        begun = (await call("finish")).structured_content["episode"]
        seen, calls, images = [], 0, 0
        for receptacle in begun["receptacles"][:8]:
            for tool, arguments in [("nav_to", {"receptacle_name": receptacle["id"]}), ("walk_around", {})]:
                result = await call(tool, **arguments)
                calls += 1
                images += sum(item.type == "image" and item.mime_type == "image/png" for item in result.content)
                seen += result.structured_content.get("markers", [])
        left = result.structured_content["decisions_left"]
        after = await call("finish")
        following = after.structured_content.get("episode", {})
        print(json.dumps({
            "task_id": begun["task_id"], "instruction": begun["instruction"], "tools": sorted(tools), "calls": calls, "left": left,
            "images": images, "markers": len(seen), "next": following.get("task_id"),
            "schemas": all(tool.output_schema for tool in tools.values()),
        }))


asyncio.run(main())
