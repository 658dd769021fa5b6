"""Examples of `reel export sft --format ms-swift --style single-turn`: the prompt of a decision, its image, and the answer."""

import concurrent.futures
import dataclasses
import json
import pathlib
import random
import re
from collections.abc import Iterable, Iterator, Sequence

import numpy
import torch
from torch import Tensor

import images
from model import Config
from tokenizer import ANSWER, END, IMAGE, PAD, Tokenizer

MARK = "<image>"  # stands for the image in the text of a prompt
ROOM = re.compile(r"^\d+\) In ([^:\n]+): ([^\n]*)\.$", re.MULTILINE)
RECEPTACLE = re.compile(r"\b([a-z]+(?:_[a-z]+)*)_(\d+)\b")
DESTINATION = re.compile(r'"receptacle_name": ?"([^"]+)"')
NAMED_ROOM = re.compile(r"\b(?:at|want|bring it to) [^;<]*? in the ([a-z ]+?)(?:;|</think>)")
HISTORY = re.compile(r'"History": ?"\d+\) ([^"]*)"')
CAPTION = re.compile(r"(?:at \S+ in [^:]+: |saw [^0-9]+|gazed at )(.+)")


@dataclasses.dataclass(frozen=True)
class Example:
    """One decision."""

    episode: str
    call: int
    scene: str
    prompt: str
    image: pathlib.Path | None
    answer: str


@dataclasses.dataclass(frozen=True)
class Row:
    """One decision as tokens: the prompt up to the answer token, and the answer with the end token."""

    prompt: list[int]
    answer: list[int]
    image: pathlib.Path | None

    def __len__(self) -> int:
        return len(self.prompt) + len(self.answer)


def read(folder: pathlib.Path, part: str = "train") -> list[Example]:
    """The examples of one part of an exported set, sorted by episode and call."""
    found: list[Example] = []
    for path in sorted((folder / part).glob("*.jsonl")):
        with path.open(encoding="utf-8") as lines:
            found.extend(example(json.loads(line), folder) for line in lines)
    if not found:
        raise SystemExit(f"{folder / part} holds no examples; export with `reel export sft --format ms-swift --out {folder}`")
    return sorted(found, key=lambda one: (one.scene, one.episode, one.call))


def example(row: dict, folder: pathlib.Path) -> Example:
    """A row of the set. Fails if it is no single turn with at most one image."""
    user, assistant = row["messages"]
    shown, about = row.get("images") or [], row["provenance"]
    if (user["role"], assistant["role"]) != ("user", "assistant") or len(shown) != user["content"].count(MARK) or len(shown) > 1:
        raise ValueError(f"call {about['call']} of {about['episode']} is no single turn with one image at most; export with --style single-turn")
    image = folder / shown[0] if shown else None
    return Example(about["episode"], about["call"], about["scene"], user["content"], image, assistant["content"])


def contradicts_named_room(one: Example) -> bool:
    """Whether the expert goes to another room than the task names: the oracle's plan visits look-alikes wherever they stand."""
    goes, wanted = DESTINATION.search(one.answer), NAMED_ROOM.search(one.answer)
    if not goes or not wanted or "; yes" in one.answer:
        return False
    rooms = {room.split("/")[0] for room, listed in ROOM.findall(one.prompt) if goes[1] in listed.split(", ")}
    return wanted[1] not in rooms


def caption(one: Example) -> Example | None:
    """The decision's image with its observation as prompt, and what the image shows as answer; `None` if the answer does not say it."""
    line = HISTORY.search(one.answer)
    seen = CAPTION.fullmatch(line[1]) if line and one.image else None
    return dataclasses.replace(one, prompt=one.prompt[one.prompt.index("Last observation: ") :], answer=seen[1]) if seen else None


def prompt_tokens(tokenizer: Tokenizer, config: Config, prompt: str) -> list[int]:
    """The tokens of a prompt, as training and serving read it. Ends with the answer token."""
    tokens: list[int] = []
    for token in tokenizer.ids(prompt):
        tokens += [IMAGE] * config.image_tokens if token == IMAGE else [token]
    return [*tokens, ANSWER]


def row(tokenizer: Tokenizer, config: Config, one: Example) -> Row:
    return Row(prompt_tokens(tokenizer, config, one.prompt), [*tokenizer.ids(one.answer), END], one.image)


def renamed(one: Example, rng: random.Random) -> Example:
    """The decision in a home whose receptacles have other numbers and stand in another order of the list.

    What is learned then is to copy names and not to know them.
    """
    rooms = ROOM.findall(one.prompt)
    names = [name.rsplit("_", 1) for _, listed in rooms for name in listed.split(", ") if RECEPTACLE.fullmatch(name)]
    numbers: dict[str, dict[str, str]] = {}
    for kind, number in names:
        numbers.setdefault(kind, {})[number] = ""
    for known in numbers.values():
        drawn = rng.sample(range(1, max(9, len(known)) + 1), len(known))
        known.update(zip(known, map(str, drawn)))
    other = lambda found: f"{found[1]}_{numbers.get(found[1], {}).get(found[2], found[2])}"
    rng.shuffle(rooms)
    lines = [f"{index}) In {room}: {', '.join(rng.sample(listed.split(', '), listed.count(', ') + 1))}." for index, (room, listed) in enumerate(rooms, 1)]
    told = iter(lines)
    prompt = ROOM.sub(lambda _: next(told), one.prompt)
    return dataclasses.replace(one, prompt=RECEPTACLE.sub(other, prompt), answer=RECEPTACLE.sub(other, one.answer))


class Pictures:
    """The images of a set, shrunk once and kept."""

    def __init__(self, config: Config) -> None:
        self.config = config
        self.kept: dict[pathlib.Path, numpy.ndarray] = {}

    def load(self, paths: Iterable[pathlib.Path], jobs: int = 2) -> None:
        """Reads and shrinks the images of many files, some at a time."""
        with concurrent.futures.ThreadPoolExecutor(jobs) as pool:
            list(pool.map(self.get, sorted(set(paths))))

    def get(self, path: pathlib.Path) -> numpy.ndarray:
        if path not in self.kept:
            self.kept[path] = images.load(path, self.config.image_height, self.config.image_width)
        return self.kept[path]


@dataclasses.dataclass(frozen=True)
class Batch:
    """Rows padded at the end. Row `b` has its answer at `prompts[b]` to `ends[b] - 1`."""

    tokens: Tensor
    images: Tensor | None
    prompts: Tensor
    ends: Tensor


def batch(rows: Sequence[Row], pictures: Pictures) -> Batch:
    """The rows as tensors; a blind model gets no images."""
    tokens = torch.full((len(rows), max(map(len, rows))), PAD)
    for index, one in enumerate(rows):
        tokens[index, : len(one)] = torch.tensor(one.prompt + one.answer)
    shown = [pictures.get(one.image) for one in rows if one.image and not pictures.config.blind]
    return Batch(
        tokens,
        torch.from_numpy(numpy.stack(shown)) if shown else None,
        torch.tensor([len(one.prompt) for one in rows]),
        torch.tensor([len(one) for one in rows]),
    )


def batches(rows: Iterable[Row], most: int, rng: random.Random) -> Iterator[list[Row]]:
    """Batches of like lengths with at most `most` tokens, padding included, in random order."""
    ordered = sorted(rows, key=lambda one: (len(one), rng.random()))
    groups: list[list[Row]] = [[]]
    for one in ordered:
        if groups[-1] and (len(groups[-1]) + 1) * len(one) > most:
            groups.append([])
        groups[-1].append(one)
    rng.shuffle(groups)
    return iter(groups)
