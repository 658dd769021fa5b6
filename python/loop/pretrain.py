"""Trains the image encoder alone, on what stands where: frames with masks from `reel export coco`, and the attributes of what is in them.

    reel export coco traces --marks --out coco
    python pretrain.py --coco coco --traces traces --reel reel --out encoder --updates 600
    python sft.py --encoder encoder ...

Every cell of a grid over an image is labelled with the words of the object or receptacle that fills it: category, colours, materials, parts
("handles: brass"), and the number of its marker. The simulator knows all of this and the policy is told none of it: what is trained on labels
is the encoder's weights alone, in homes of training.
"""

import argparse
import collections
import concurrent.futures
import dataclasses
import json
import pathlib
import random
import subprocess
import time
import typing

import numpy
import torch
from torch import Tensor, nn
from torch.nn import functional

import images
import model

CELL = 32  # pixels of the camera's image on a side
OBJECT, RECEPTACLE = 0.15, 0.5  # shares of a cell from which it is labelled
PLAIN = {"size", "shape", "colour", "material"}


@dataclasses.dataclass(frozen=True)
class Frame:
    """An image, and the words of its cells that are not empty, by the number of the cell."""

    path: pathlib.Path
    cells: dict[int, frozenset[str]]


@dataclasses.dataclass(frozen=True)
class Described:
    """What a trace says of its instances: words by name, and after each call the marker of each."""

    objects: dict[str, set[str]]
    receptacles: dict[str, set[str]]
    markers: list[dict[str, str]]


def run_lengths(counts: str) -> list[int]:
    """The runs of a mask in COCO's compressed form."""
    runs: list[int] = []
    at = 0
    while at < len(counts):
        value = shift = 0
        while True:
            code = ord(counts[at]) - 48
            value |= (code & 31) << shift
            at, shift = at + 1, shift + 5
            if not code & 32:
                break
        if code & 16:
            value -= 1 << shift
        runs.append(value + (runs[-2] if len(runs) > 2 else 0))
    return runs


def mask(segmentation: dict[str, typing.Any]) -> numpy.ndarray:
    """A mask [height, width] from its runs, which go down the columns."""
    height, width = segmentation["size"]
    runs = run_lengths(segmentation["counts"])
    values = numpy.arange(len(runs)) % 2 == 1
    return numpy.repeat(values, runs).reshape(width, height).T


def words(thing: dict[str, typing.Any]) -> set[str]:
    """What a cell is labelled with: the category, and attributes; those of a part with the part's name."""
    found = {f"category: {thing['category']}"}
    for kind, values in (thing.get("attributes") or {}).items():
        found |= {value if kind in PLAIN else f"{kind}: {value}" for value in values}
    return found


def describe(reel: str, trace: pathlib.Path) -> tuple[str, Described]:
    """The episode of a trace, and what it says of its instances."""
    shown = json.loads(subprocess.run([reel, "show", "--json", str(trace)], check=True, capture_output=True, text=True).stdout)
    return shown["header"]["episode_id"], Described(
        {thing["instance"]: words(thing) for thing in shown["task"]["objects"]},
        {place["id"]: words(place) for place in shown["scene"]["receptacles"]},
        [{one["target"]["id"]: f"marker: {one['id']}" for one in step["markers"]} for step in shown["steps"]],
    )


def label(annotations: list[dict[str, typing.Any]], about: Described, call: int | None) -> dict[int, frozenset[str]]:
    """The words of the cells of the image after a call; `None` is the image before the first."""
    markers = {} if call is None else about.markers[call]
    best: dict[int, tuple[bool, float, frozenset[str]]] = {}
    for one in annotations:
        name = one["instance"]
        is_object = name in about.objects
        known = about.objects.get(name) or about.receptacles.get(name)
        if known is None:
            continue
        covered = mask(one["segmentation"])
        shares = covered.reshape(covered.shape[0] // CELL, CELL, covered.shape[1] // CELL, CELL).mean((1, 3)).ravel()
        found = frozenset(known | ({markers[name]} if name in markers else set()))
        for cell in map(int, numpy.flatnonzero(shares >= (OBJECT if is_object else RECEPTACLE))):
            if cell not in best or (is_object, shares[cell]) > best[cell][:2]:
                best[cell] = (is_object, float(shares[cell]), found)
    return {cell: found for cell, (_, _, found) in best.items()}


def read(coco: pathlib.Path, traces: list[pathlib.Path], reel: str, jobs: int) -> list[Frame]:
    """The frames of an export of these traces."""
    with concurrent.futures.ThreadPoolExecutor(jobs) as pool:
        described = dict(pool.map(lambda trace: describe(reel, trace), traces))
    told = json.loads((coco / "instances.json").read_text(encoding="utf-8"))
    by_image: dict[int, list[dict[str, typing.Any]]] = collections.defaultdict(list)
    for one in told["annotations"]:
        by_image[one["image_id"]].append(one)
    return [
        Frame(coco / "images" / image["file_name"], label(by_image[image["id"]], described[image["episode_id"]], image["step"]))
        for image in told["images"]
    ]


class Heads(nn.Module):
    """Reads the words of cells off the features of the encoder, at both of its grids."""

    def __init__(self, config: model.Config, words: int) -> None:
        super().__init__()
        self.fine, self.coarse = nn.Conv2d(config.channels[2], words, 1), nn.Conv2d(config.width, words, 1)
        for head in (self.fine, self.coarse):
            nn.init.constant_(head.bias, -3.0)

    def forward(self, grids: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
        return self.fine(grids[0].float()), self.coarse(grids[1].float())


class Batches:
    """Images and labels as tensors."""

    def __init__(self, frames: list[Frame], vocabulary: list[str], jobs: int) -> None:
        self.frames = frames
        self.number = {word: index for index, word in enumerate(vocabulary)}
        with concurrent.futures.ThreadPoolExecutor(jobs) as pool:
            self.pixels = list(pool.map(lambda frame: images.load(frame.path), frames))

    def get(self, some: list[int]) -> tuple[Tensor, Tensor, Tensor]:
        """Images [batch, 3, height, width], words [batch, words, rows, columns] of the fine grid, and which cells hold anything."""
        rows, columns = images.HEIGHT // CELL, images.WIDTH // CELL
        labels = torch.zeros(len(some), rows * columns, len(self.number))
        for place, index in enumerate(some):
            for cell, found in self.frames[index].cells.items():
                labels[place, cell, [self.number[word] for word in found if word in self.number]] = 1
        labels = labels.view(len(some), rows, columns, -1).permute(0, 3, 1, 2)
        pixels = torch.from_numpy(numpy.stack([self.pixels[index] for index in some])).permute(0, 3, 1, 2).float() / 255
        return pixels, labels, labels.amax(1) > 0


def loss(heads: tuple[Tensor, Tensor], labels: Tensor, filled: Tensor) -> Tensor:
    """Cross-entropy of the words: fine cells that hold something count ten times as much, coarse ones have the words of their four."""
    fine = functional.binary_cross_entropy_with_logits(heads[0], labels, reduction="none").sum(1)
    coarse = functional.binary_cross_entropy_with_logits(heads[1], functional.max_pool2d(labels, 2, ceil_mode=True))
    weights = 0.1 + 0.9 * filled
    return (fine * weights).sum() / weights.sum() + coarse * labels.shape[1]


@torch.inference_mode()
def examine(encoder: model.ImageEncoder, heads: Heads, batches: Batches) -> dict[str, float]:
    """Over cells that hold something: how often the words of a kind are all right. A kind is what stands before the colon, or `plain`."""
    hits: dict[str, list[int]] = collections.defaultdict(lambda: [0, 0])
    kinds = collections.defaultdict(list)
    for word, index in batches.number.items():
        kinds[word.split(":")[0] if ":" in word else "plain"].append(index)
    for start in range(0, len(batches.frames), 32):
        pixels, labels, filled = batches.get(list(range(start, min(start + 32, len(batches.frames)))))
        said = heads(encoder.grids(pixels))[0] > 0
        for kind, members in kinds.items():
            wanted = labels[:, members] > 0
            there = wanted.any(1) & filled
            right = (said[:, members] == wanted).all(1) & there
            hits[kind][0] += int(right.sum())
            hits[kind][1] += int(there.sum())
    return {kind: round(right / max(1, count), 3) for kind, (right, count) in sorted(hits.items())}


def train(config: model.Config, batches: Batches, updates: int, rate: float, size: int, seed: int, held: Batches | None = None) -> tuple[model.ImageEncoder, Heads]:
    """The trained encoder, and what reads words off it."""
    encoder = model.build(config, seed).encoder
    heads = Heads(config, len(batches.number))
    parameters = [*encoder.parameters(), *heads.parameters()]
    steps = torch.optim.AdamW(parameters, lr=rate, weight_decay=0.01)
    rng, order, start = random.Random(seed), list[int](), time.monotonic()
    nn.Module.train(encoder, True)
    recent: list[float] = []
    for update in range(updates):
        if len(order) < size:
            order += rng.sample(range(len(batches.frames)), len(batches.frames))
        chosen, order = order[:size], order[size:]
        for group in steps.param_groups:
            group["lr"] = rate * min(1.0, (update + 1) / 50, 0.02 + (updates - update) / (0.4 * updates))
        pixels, labels, filled = batches.get(chosen)
        with model.products_in_16_bits(model.multiplies_16_bits()):
            grids = encoder.grids(pixels)
        value = loss(heads(grids), labels, filled)
        steps.zero_grad(set_to_none=True)
        value.backward()
        steps.step()
        recent.append(value.item())
        if (update + 1) % 50 == 0 or update + 1 == updates:
            line = {"update": update + 1, "loss": sum(recent) / len(recent), "minutes": (time.monotonic() - start) / 60, "cpu_seconds": time.process_time()}
            if held and ((update + 1) % 200 == 0 or update + 1 == updates):
                encoder.train()
                line["held_out"] = examine(encoder, heads, held)
                nn.Module.train(encoder, True)
            print(json.dumps(line), flush=True)
            recent.clear()
    return encoder.train(), heads


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--coco", required=True, type=pathlib.Path, help="folder of `reel export coco --marks`")
    parser.add_argument("--traces", required=True, type=pathlib.Path, nargs="+", help="the traces that it was made from")
    parser.add_argument("--held-out", type=pathlib.Path, nargs=2, metavar=("COCO", "TRACES"), help="measure on these")
    parser.add_argument("--reel", default="reel", help="the binary")
    parser.add_argument("--out", required=True, type=pathlib.Path, help="file of the weights")
    parser.add_argument("--updates", type=int, default=600)
    parser.add_argument("--size", type=int, default=32, help="images in a batch")
    parser.add_argument("--rate", type=float, default=2e-3)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--width", type=int, default=192, help="of the policy")
    chosen = parser.parse_args()
    config = model.Config(1, width=chosen.width)
    traces = lambda folders: sorted(path for folder in folders for path in folder.rglob("*.mcap"))
    frames = read(chosen.coco, traces(chosen.traces), chosen.reel, 2)
    counts = collections.Counter(word for frame in frames for word in set().union(*frame.cells.values()))
    vocabulary = sorted(word for word, count in counts.items() if count >= 5)
    print(f"{len(frames)} images, {sum(len(frame.cells) for frame in frames)} cells that hold something, {len(vocabulary)} words", flush=True)
    held = None
    if chosen.held_out:
        held = Batches(read(chosen.held_out[0], traces([chosen.held_out[1]]), chosen.reel, 2), vocabulary, 2)
    encoder, _ = train(config, Batches(frames, vocabulary, 2), chosen.updates, chosen.rate, chosen.size, chosen.seed, held)
    torch.save(encoder.state_dict(), chosen.out)


if __name__ == "__main__":
    main()
