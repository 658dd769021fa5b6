"""ms-swift's AutoPreprocessor, strict: every row is kept, with its roles, images and tools."""

import contextlib
import importlib
import json
import pathlib
import sys
from importlib.util import find_spec
from unittest import mock

import datasets
import transformers  # noqa: F401, before the stand-in, so that it knows that torch is absent
from common import MANIFEST, bare, check_path, check_total, shards, splits, stand_in

note = ""
if find_spec("torch") is None:
    folder = pathlib.Path(find_spec("swift").submodule_search_locations[0])
    bare("swift", folder)
    bare("swift.dataset", folder / "dataset")
    utils = bare("swift.utils", folder / "utils")
    for module, names in [
        ("logger", ["get_logger"]),
        ("env", ["is_dist", "is_master"]),
        ("schema_utils", ["TOOL_KEYS", "remove_arrow_padding"]),
    ]:
        for name in names:
            setattr(utils, name, getattr(importlib.import_module(f"swift.utils.{module}"), name))
    utils.safe_ddp_context = lambda *args, **kwargs: contextlib.nullcontext()
    template = bare("swift.template", folder / "template")
    stand_in("torch")
    # Loggers ask whether torch is there: the answer stays no.
    with mock.patch("importlib.util.find_spec", lambda name, package=None: None if name == "torch" else find_spec(name, package)):
        template.history_to_messages = importlib.import_module("swift.template.utils").history_to_messages
    del sys.modules["torch"]
    stand_in("swift.dataset.utils")  # takes samples of rows, which is not asked for
    template.MaxLengthError = type("MaxLengthError", (ValueError,), {})
    note = "preprocessor alone, torch is not installed; "
AutoPreprocessor = importlib.import_module("swift.dataset.preprocessor.core").AutoPreprocessor

rows = images = 0
for split, promised in splits().items():
    loaded = datasets.load_dataset("json", data_files={split: shards(split)}, split=split)
    prepared = AutoPreprocessor()(loaded, strict=True, load_from_cache_file=False)
    assert len(prepared) == promised, (len(prepared), promised)
    for row in prepared:
        rows += 1
        roles = [message["role"] for message in row["messages"]]
        paths = [image["path"] for image in row["images"] or []]
        assert sum(message["content"].count("<image>") for message in row["messages"]) == len(paths)
        if MANIFEST["style"] == "single-turn":
            assert roles in (["user", "assistant"], ["system", "user", "assistant"]), roles
        else:
            assert roles[:2] == ["system", "user"] and roles[-1] == "tool_call" and set(roles) <= {"system", "user", "assistant", "tool_call", "tool_response"}
            assert len(row["tools"]) == 11
            for message in row["messages"]:
                if message["role"] == "tool_call":
                    assert set(json.loads(message["content"])) == {"name", "arguments"}
        for path in paths:
            check_path(path)
            images += 1
print(note, end="")
check_total(rows, images)
