"""LLaMA-Factory's own reading of dataset_info.json and its sharegpt converter: no row is skipped as abnormal."""

import importlib
import json
import pathlib
import sys
import types
from importlib.util import find_spec

import datasets
from common import MANIFEST, bare, check_path, check_total, shards, splits, stand_in

# Its package imports all of training; the parser and the converter stand alone below it.
folder = pathlib.Path(find_spec("llamafactory").submodule_search_locations[0])
note = ""
if find_spec("torch") is None:
    bare("llamafactory", folder)
    bare("llamafactory.data", folder / "data")
    bare("llamafactory.extras", folder / "extras")
    stand_in("peft", "peft.utils")
    misc = types.ModuleType("llamafactory.extras.misc")
    misc.use_modelscope = misc.use_openmind = lambda: False
    sys.modules["llamafactory.extras.misc"] = misc
    note = "parser and converter alone, torch is not installed; "
parser = importlib.import_module("llamafactory.data.parser")
converter = importlib.import_module("llamafactory.data.converter")

arguments = types.SimpleNamespace(media_dir=str(pathlib.Path.cwd()), image_dir=str(pathlib.Path.cwd()))
rows = images = 0
for split, promised in splits().items():
    (attribute,) = parser.get_dataset_list([f"{MANIFEST['name']}_{split}"], ".")
    assert attribute.formatting == "sharegpt" and pathlib.Path(attribute.dataset_name).is_dir()
    loaded = datasets.load_dataset("json", data_files={split: shards(split)}, split=split)
    assert len(loaded) == promised
    convert = converter.get_dataset_converter(attribute.formatting, attribute, arguments)
    for row in loaded:
        rows += 1
        converted = convert(row)
        assert converted["_prompt"] and len(converted["_response"]) == 1, "skipped as abnormal"
        paths = converted["_images"] or []
        turns = converted["_prompt"] + converted["_response"]
        assert sum(turn["content"].count("<image>") for turn in turns) == len(paths)
        roles = {turn["role"] for turn in turns}
        if MANIFEST["style"] == "single-turn":
            assert roles == {"user", "assistant"}, roles
        else:
            assert roles <= {"user", "function", "observation"} and converted["_system"], roles
            assert len(json.loads(converted["_tools"])) == 11
            for turn in turns:
                if turn["role"] == "function":
                    call = json.loads(turn["content"].rpartition("</think>\n")[2])
                    assert set(call) == {"name", "arguments"}
        for path in paths:
            check_path(path)
            images += 1
print(note, end="")
check_total(rows, images)
