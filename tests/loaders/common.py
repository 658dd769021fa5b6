"""What the loaders' tests share: the manifest of the dataset in the working folder, and what must hold of its rows.

Where REEL_FRAMES names a file, the frames of all rows have to be equal to what it holds: their pixels (8-bit RGB, row by
row), one frame after the other.
"""

import json
import os
import pathlib
import sys
import types

MANIFEST = json.loads(pathlib.Path("manifest.json").read_text())
FRAMES = open(os.environ["REEL_FRAMES"], "rb") if "REEL_FRAMES" in os.environ else None


def shards(split):
    """The files of a split."""
    return [shard["path"] for shard in MANIFEST["shards"].get(split, [])]


def splits():
    """The splits with the number of rows that the manifest promises."""
    return {split: sum(shard["rows"] for shard in files) for split, files in MANIFEST["shards"].items()}


def check_image(image):
    """An image decodes, within the budget."""
    image.load()
    budget = MANIFEST["writer"]["images"]["pixels_max"]
    assert image.width > 0 and (budget is None or image.width * image.height <= budget), image.size
    if FRAMES:
        pixels = image.convert("RGB").tobytes()
        assert pixels == FRAMES.read(len(pixels)), "the pixels are not those of the frame"


def check_path(path):
    """An image's file decodes."""
    from PIL import Image

    with Image.open(path) as image:
        check_image(image)


def check_total(rows, images):
    """All rows and images that the manifest promises came."""
    assert rows == MANIFEST["counts"]["examples"], (rows, MANIFEST["counts"]["examples"])
    assert images == MANIFEST["counts"]["images"], (images, MANIFEST["counts"]["images"])
    assert not (FRAMES and FRAMES.read(1)), "frames that no row showed"
    print(f"{rows} rows, {images} images decoded" + (" and equal to the frames" if FRAMES else ""))


def check_provenance(row):
    """A row says where it comes from."""
    provenance = row["provenance"]
    for key in ["trace_digest", "episode", "call", "verdict", "preset_digest", "rules_version", "table_version"]:
        assert provenance[key] is not None, key


def stand_in(*names):
    """Puts an empty module in place of packages that only training needs; each of its names is an empty class."""
    for name in names:
        module = types.ModuleType(name)
        module.__path__ = []
        module.__getattr__ = lambda name: type(name, (), {}) if not name.startswith("__") else getattr(object, name)
        sys.modules[name] = module


def bare(name, folder):
    """A package whose modules can be imported without what its `__init__` imports: all of training."""
    package = types.ModuleType(name)
    package.__path__ = [str(folder)]
    sys.modules[name] = package
    return package
