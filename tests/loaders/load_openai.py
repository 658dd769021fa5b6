"""The openai package's types of a request, every message and tool validated strictly; images as data URLs."""

import base64
import io
import json

from common import MANIFEST, check_image, check_provenance, check_total
from openai.types.chat import ChatCompletionMessageParam, ChatCompletionToolParam
from PIL import Image
from pydantic import TypeAdapter

message_type = TypeAdapter(ChatCompletionMessageParam)
tool_type = TypeAdapter(ChatCompletionToolParam)
rows = images = 0
for shard in [shard for shards in MANIFEST["shards"].values() for shard in shards]:
    lines = open(shard["path"]).read().splitlines()
    beside = open(shard["provenance"]).read().splitlines()
    assert len(lines) == len(beside) == shard["rows"]
    for line, provenance in zip(lines, beside):
        rows += 1
        check_provenance({"provenance": json.loads(provenance)})
        row = json.loads(line)
        assert set(row) <= {"messages", "tools", "parallel_tool_calls"}, row.keys()
        open_calls = []
        for message in row["messages"]:
            message_type.validate_python({key: value for key, value in message.items() if key != "weight"})
            if message["role"] == "tool":
                assert message["tool_call_id"] == open_calls.pop()
            assert not (open_calls and message["role"] != "tool"), "a call without its outcome"
            open_calls += [call["id"] for call in message.get("tool_calls", [])]
            for part in message["content"] if isinstance(message["content"], list) else []:
                if part["type"] == "image_url":
                    assert message["role"] == "user"
                    head, data = part["image_url"]["url"].split(",", 1)
                    assert head.startswith("data:image/")
                    check_image(Image.open(io.BytesIO(base64.b64decode(data, validate=True))))
                    images += 1
        for tool in row.get("tools", []):
            tool_type.validate_python(tool)
        assert ("tools" in row) == (MANIFEST["style"] != "single-turn")
check_total(rows, images)
