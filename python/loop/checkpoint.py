"""A model with its tokenizer in one folder: `config.json`, `tokenizer.json`, `weights.pt`, and `training.pt` to go on from."""

import dataclasses
import hashlib
import json
import pathlib
import typing

import torch

import model
from tokenizer import Tokenizer


def save(folder: pathlib.Path, policy: model.Policy, tokenizer: Tokenizer, training: dict[str, typing.Any] | None = None) -> None:
    """Writes the files, each as a whole or not at all."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "config.json").write_text(json.dumps(dataclasses.asdict(policy.config), indent=1), encoding="utf-8")
    tokenizer.save(folder / "tokenizer.json")
    write(folder / "weights.pt", policy.state_dict())
    if training is not None:
        write(folder / "training.pt", {"weights": policy.state_dict(), **training})


def write(path: pathlib.Path, content: dict[str, typing.Any]) -> None:
    beside = path.with_suffix(".new")
    torch.save(content, beside)
    beside.replace(path)


def load(folder: pathlib.Path) -> tuple[model.Policy, Tokenizer]:
    """The model and its tokenizer, ready to answer."""
    known = json.loads((folder / "config.json").read_text(encoding="utf-8"))
    config = model.Config(**{**known, "channels": tuple(known["channels"])})
    policy = model.build(config, 0)
    policy.load_state_dict(torch.load(folder / "weights.pt", weights_only=True))
    return policy.eval(), Tokenizer.load(folder / "tokenizer.json")


def training(folder: pathlib.Path) -> dict[str, typing.Any] | None:
    """What a training that was broken off left; `None` if there is none."""
    path = folder / "training.pt"
    return torch.load(path, weights_only=False) if path.exists() else None


def digest(policy: model.Policy) -> str:
    """Names the weights: equal weights have equal digests."""
    found = hashlib.blake2b(digest_size=16)
    for name, tensor in sorted(policy.state_dict().items()):
        found.update(name.encode() + tensor.detach().contiguous().numpy().tobytes())
    return found.hexdigest()
