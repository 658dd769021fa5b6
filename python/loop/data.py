"""Examples of `reel export sft --format ms-swift --style single-turn`: the prompt of a decision, its image, and the answer."""

import dataclasses
import json
import pathlib
import random
import re
from collections.abc import Sequence

import torch
from torch import Tensor

import images
from model import Config, Policy, Sequences
from notes import lacking
from tokenizer import ANSWER, END, IMAGE, Tokenizer

MARK = "<image>"  # stands for the image in the text of a prompt
ROOM = re.compile(r"^\d+\) In ([^:\n]+): ([^\n]*)\.$", re.MULTILINE)
RECEPTACLE = re.compile(r"\b([a-z]+(?:_[a-z]+)*)_(\d+)\b")
DESTINATION = re.compile(r'"receptacle_name": ?"([^"]+)"')
NAMED_ROOM = re.compile(r"\b(?:at|want|bring it to) [^;<]*? in the ([a-z ]+?)(?:;|</think>)")
HISTORY = re.compile(r'"History": ?"\d+\) ([^"]*)"')
JUDGED = re.compile(r"want ([^;<]+); (([a-z_]+_\d+) in [^;<]+); (yes|no[^;<]*)</think>")
SAW = re.compile(r"saw ([^0-9]+) (\d+: .+)")
OBSERVED = "Last observation: "  # where the part of a prompt begins that the image is in


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


def is_noted(one: Example) -> bool:
    """Whether an expert wrote it: of a branch, the decisions of the parent have no words."""
    return one.answer.startswith("<think>")


def contradicts_named_room(one: Example) -> bool:
    """Whether the expert goes to another room than the task names: the oracle's plan visits look-alikes wherever they stand."""
    goes, wanted = DESTINATION.search(one.answer), NAMED_ROOM.search(one.answer)
    if not goes or not wanted or "; yes" in one.answer:
        return False
    rooms = {room.split("/")[0] for room, listed in ROOM.findall(one.prompt) if goes[1] in listed.split(", ")}
    return wanted[1] not in rooms


class Comparisons:
    """What is seen in an image, compared with what some instruction wants: short examples from which a policy learns to see and to compare.

    Receptacles are compared with what instructions want of the same category, half of these from the same home and half from all homes, and a
    half of them the one that is seen; objects with the look of one of them, or with one that is not among them.
    """

    def __init__(self, examples: Sequence[Example]) -> None:
        self.wanted: dict[tuple[str, str], dict[str, str]] = {}  # by home and category: phrases, and which receptacle each means
        self.phrases: dict[str, set[str]] = {}  # of all homes, by category
        self.looks: dict[str, set[str]] = {}  # of objects, by category
        self.examples: list[Example] = []
        for one in examples:
            judged, saw = JUDGED.search(one.answer), self.saw(one)
            if judged:
                self.phrases.setdefault(category(judged[3]), set()).add(judged[1])
            if judged and judged[4] == "yes":
                self.wanted.setdefault((one.scene, category(judged[3])), {})[judged[1]] = judged[3]
            if saw:
                self.looks.setdefault(saw[0], set()).update(saw[1].values())
            if one.image and (judged or saw):
                self.examples.append(one)

    @staticmethod
    def saw(one: Example) -> tuple[str, dict[str, str]] | None:
        """The category that was looked for, and the look of each numbered object."""
        line = HISTORY.search(one.answer)
        found = SAW.fullmatch(line[1]) if line else None
        return (found[1], dict(part.split(": ", 1) for part in found[2].split("; "))) if found else None

    def draw(self, one: Example, rng: random.Random) -> Example:
        """A comparison for the image of a decision."""
        judged = JUDGED.search(one.answer)
        if judged:
            wanted, verdict = self.receptacle(one.scene, judged, rng) if rng.random() < 0.5 else self.foreign(judged, rng)
            seen = judged[2]
        else:
            sought, objects = self.saw(one) or ("", {})
            wanted, verdict = self.thing(sought, objects, rng)
            seen = "; ".join(f"{number}: {look}" for number, look in objects.items())
        prompt = f"want {wanted}\n{one.prompt[one.prompt.index(OBSERVED) :]}"
        return dataclasses.replace(one, prompt=prompt, answer=f"want {wanted}; {seen}; {verdict}")

    def receptacle(self, home: str, judged: re.Match[str], rng: random.Random) -> tuple[str, str]:
        known = self.wanted.get((home, category(judged[3])), {})
        fitting = sorted(phrase for phrase, name in known.items() if name == judged[3])
        others = sorted(phrase for phrase, name in known.items() if name != judged[3])
        if fitting and (not others or rng.random() < 0.5):
            return rng.choice(fitting), "yes"
        if others:
            wanted = rng.choice(others)
            return wanted, "no" + lacking(wanted, judged[2])
        return judged[1], judged[4]

    def foreign(self, judged: re.Match[str], rng: random.Random) -> tuple[str, str]:
        """A phrase of any home, which fits if all its words stand in what is seen."""
        missing = {phrase: lacking(phrase, judged[2]) for phrase in sorted(self.phrases[category(judged[3])])}
        fitting = [phrase for phrase, word in missing.items() if not word]
        others = [phrase for phrase, word in missing.items() if word]
        wanted = rng.choice(fitting if fitting and (not others or rng.random() < 0.5) else others)
        return wanted, f"no{missing[wanted]}" if missing[wanted] else "yes"

    def thing(self, sought: str, objects: dict[str, str], rng: random.Random) -> tuple[str, str]:
        looks = list(objects.values())
        alone = [number for number, look in objects.items() if looks.count(look) == 1]
        absent = sorted(self.looks.get(sought, set()) - set(looks))
        if absent and (not alone or rng.random() < 0.2):
            return f"{rng.choice(absent)} {sought}", "no"
        if not alone:
            return sought, f"{next(iter(objects))} fits"
        number = rng.choice(alone)
        return f"{objects[number]} {sought}", f"{number} fits"


def category(name: str) -> str:
    """`kitchen_table` of `kitchen_table_2`."""
    return name.rsplit("_", 1)[0]


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
    """What a policy sees of the images of a set: their features, computed once and kept. A blind policy sees nothing."""

    def __init__(self, policy: Policy) -> None:
        self.encoder, self.blind = policy.encoder, policy.config.blind
        self.kept: dict[pathlib.Path, Tensor] = {}

    def get(self, path: pathlib.Path | None) -> Tensor | None:
        """The features [tokens, width] of the image of a file."""
        if path is None or self.blind:
            return None
        if path not in self.kept:
            self.kept[path] = self.encoder.features(images.load(path))
        return self.kept[path]


@dataclasses.dataclass(frozen=True)
class Batch:
    """Rows one behind the other, as `Policy.logprobs` takes them."""

    tokens: Tensor
    features: Tensor | None
    sequences: Sequences


def batch(rows: Sequence[Row], pictures: Pictures) -> Batch:
    """The rows as tensors."""
    shown = [features for one in rows if (features := pictures.get(one.image)) is not None]
    return Batch(
        torch.tensor([token for one in rows for token in one.prompt + one.answer]),
        torch.stack(shown) if shown else None,
        Sequences([len(one.prompt) for one in rows], [len(one) for one in rows]),
    )


def batches(rows: Sequence[Row], most: int) -> list[list[int]]:
    """The numbers of rows in batches of at most `most` tokens, in their order."""
    found: list[list[int]] = [[]]
    tokens = 0
    for index, one in enumerate(rows):
        if found[-1] and tokens + len(one) > most:
            found.append([])
            tokens = 0
        found[-1].append(index)
        tokens += len(one)
    return found
