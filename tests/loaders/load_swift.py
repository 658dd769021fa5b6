"""ms-swift's AutoPreprocessor, strict: every row is kept, with its roles, pictures and tools."""

import json
import sys

import datasets
from common import MANIFEST, check_path, check_total, shards, splits, without_torch

try:
    note = without_torch()
    from swift.dataset import AutoPreprocessor
except Exception as error:
    print(f"swift.dataset cannot be imported here: {type(error).__name__}: {error}")
    sys.exit(77)

rows = images = 0
for split, promised in splits().items():
    loaded = datasets.load_dataset("json", data_files={split: shards(split)}, split=split)
    prepared = AutoPreprocessor()(loaded, strict=True, load_from_cache_file=False)
    assert len(prepared) == promised, (len(prepared), promised)
    for row in prepared:
        rows += 1
        roles = [message["role"] for message in row["messages"]]
        assert roles[:2] == ["system", "user"]
        paths = [image["path"] for image in row["images"] or []]
        assert sum(message["content"].count("<image>") for message in row["messages"]) == len(paths)
        if MANIFEST["style"] == "single-turn":
            assert roles == ["system", "user", "assistant"]
        else:
            assert roles[-1] == "tool_call" and set(roles) <= {"system", "user", "assistant", "tool_call", "tool_response"}
            assert len(row["tools"]) == 11
            for message in row["messages"]:
                if message["role"] == "tool_call":
                    assert set(json.loads(message["content"])) == {"name", "arguments"}
        for path in paths:
            check_path(path)
            images += 1
check_total(rows, images)
print(note, end="")
