"""What the loaders' tests share: the manifest of the dataset in the working folder, and what must hold of its rows."""

import collections
import json
import pathlib
import sys

MANIFEST = json.loads(pathlib.Path("manifest.json").read_text())


def shards(split):
    """The files of a split."""
    return [shard["path"] for shard in MANIFEST["shards"].get(split, [])]


def splits():
    """The splits with the number of rows that the manifest promises."""
    return {split: sum(shard["rows"] for shard in files) for split, files in MANIFEST["shards"].items()}


def check_image(image):
    """A picture decodes, within the budget."""
    image.load()
    budget = MANIFEST["writer"]["pictures"]["pixels_max"]
    assert image.width > 0 and (budget is None or image.width * image.height <= budget), image.size


def check_path(path):
    """A picture's file decodes."""
    from PIL import Image

    with Image.open(path) as image:
        check_image(image)


def check_total(rows, images):
    """All rows and pictures that the manifest promises came."""
    assert rows == MANIFEST["counts"]["examples"], (rows, MANIFEST["counts"]["examples"])
    assert images == MANIFEST["counts"]["images"], (images, MANIFEST["counts"]["images"])
    print(f"{rows} rows, {images} images decoded")


def check_provenance(row):
    """A row says where it comes from."""
    provenance = row["provenance"]
    for key in ["trace_digest", "episode", "call", "verdict", "preset_digest", "rules_version", "table_version"]:
        assert provenance[key] is not None, key


def without_torch():
    """Lets a trainer's package be imported where torch is not installed: any part of torch, and of what else only training
    needs, is an empty stand-in. Returns what to say of it."""
    import importlib.abc
    import importlib.machinery
    import importlib.util
    import types

    if importlib.util.find_spec("torch") is not None:
        return ""
    absent = collections.OrderedDict()

    class Stand(type):
        def __getattr__(cls, name):
            if name.startswith("__"):
                raise AttributeError(name)
            return stand(name)

        def __or__(cls, other):
            return cls

        __ror__ = __or__

        def __getitem__(cls, key):
            return cls

        def __iter__(cls):
            return iter(())

    def stand(name):
        return Stand(name, (), {"__init__": lambda self, *a, **k: None, "__call__": lambda self, f=None, *a, **k: f,
                                "__getattr__": lambda self, name: stand(name), "__enter__": lambda self: self,
                                "__exit__": lambda self, *a: None})

    class Module(types.ModuleType):
        __version__ = "0.0"

        def __getattr__(self, name):
            if name.startswith("__"):
                raise AttributeError(name)
            return stand(name)

    class Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
        def find_spec(self, name, path=None, target=None):
            top = name.split(".")[0]
            if top in {"torch", "torchvision", "torchaudio", "torchdata", "peft", "accelerate", "deepspeed"} or (
                top in absent and importlib.machinery.PathFinder.find_spec(top) is None
            ):
                return importlib.machinery.ModuleSpec(name, self, is_package=True)
            return None

        def create_module(self, spec):
            return Module(spec.name)

        def exec_module(self, module):
            module.__path__ = []

    import transformers  # before the stand-in, so that it knows that torch is absent

    del transformers
    sys.meta_path.append(Finder())
    for name in list(sys.modules):
        if name.split(".")[0] in {"peft", "accelerate"}:
            del sys.modules[name]
    return ", torch replaced by an empty stand-in"
