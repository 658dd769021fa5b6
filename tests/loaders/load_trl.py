"""TRL's preparation of rows, without a model: conversational, tools readable, every placeholder gets its image."""

import json

import datasets
from common import MANIFEST, check_image, check_total, shards, splits
from trl.data_utils import is_conversational, prepare_multimodal_messages

rows = images = 0
for split in splits():
    loaded = datasets.load_dataset("json", data_files={split: shards(split)}, split=split)
    loaded = loaded.cast_column("images", datasets.List(datasets.Image()))
    for row in loaded:
        rows += 1
        assert is_conversational(row), row.keys()
        turns = row["messages"] if "messages" in row else row["prompt"] + row["completion"]
        prepared = prepare_multimodal_messages(turns, row["images"])
        parts = [part for turn in prepared for part in turn["content"] or []]
        shown = [part["image"] for part in parts if part["type"] == "image"]
        assert len(shown) == len(row["images"])
        images += len(shown)
        for image in shown:
            check_image(image)
        roles = [turn["role"] for turn in turns]
        if MANIFEST["style"] == "single-turn":
            # The published prompt is a user's turn; one of a template may have a system's turn before it.
            assert roles in (["user", "assistant"], ["system", "user", "assistant"]), roles
        else:
            assert roles[0] == "system" and roles[-1] == "assistant", roles
            assert len(json.loads(row["tools"])) == 11
            for turn in turns:
                for call in turn.get("tool_calls") or []:
                    assert isinstance(json.loads(call["function"]["arguments"]), dict)
check_total(rows, images)
