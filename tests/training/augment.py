"""Episodes told anew with other names, so that what is learnt is to read names and not to know them.

Furniture that has a door stays furniture that has one, and so on: a word only gives way to another of its kind, everywhere in the
episode. What the episode says stays true of itself. Numbers and the order of the list of receptacles change as well.
"""

import dataclasses
import itertools
import re

import data
import scenes

DOORS = sorted({kind for name in ("refrigerator", "microwave", "washingmachine") for kind in scenes.INSTEAD[name]})
OPEN = sorted({kind for kinds in scenes.INSTEAD.values() for kind in kinds} - set(DOORS))
ROOMS = sorted({room.split("/")[0] for room in scenes.ROOMS})


def kinds(examples):
    """Words that may stand for each other: of furniture, rooms, looks, and the categories of objects in the training split."""
    furniture = {*DOORS, *OPEN}
    categories = {example.action["args"].get("target_category") for example in examples} - {None} - furniture
    return [DOORS, OPEN, ROOMS, scenes.COLOURS, scenes.TOPS, scenes.SIZES, sorted(categories)]


def retold(examples, draw):
    """The examples, every other episode with other names."""
    words = kinds(examples)
    for _, steps in itertools.groupby(examples, lambda one: one.episode):
        yield from steps if draw.random() < 0.5 else renamed(list(steps), words, draw)


def renamed(steps, kinds, draw):
    """The steps of one episode with other names."""
    other = {}
    for words in kinds:
        other.update(zip(words, (words[index] for index in draw.permutation(len(words)))))
    longest_first = sorted(other, key=len, reverse=True)
    names = re.compile(r"(?<![A-Za-z])(?:" + "|".join(map(re.escape, longest_first)) + r")(?![A-Za-z])", re.IGNORECASE)
    lines = steps[0].receptacles.split("\n")
    numbers = {}
    for place in re.findall(r"^- (\S+?)_(\d+) ", steps[0].receptacles, flags=re.MULTILINE):
        free = numbers.setdefault(place[0], {})
        free[place[1]] = None
    for free in numbers.values():
        free.update(zip(free, map(str, 1 + draw.permutation(max(12, len(free))))))
    ids = re.compile(r"(?<![A-Za-z_])(" + "|".join(map(re.escape, numbers)) + r")_(\d+)(?![0-9])")

    def anew(text):
        text = ids.sub(lambda found: f"{found[1]}_{numbers[found[1]].get(found[2], found[2])}", text)
        return names.sub(lambda found: other[found[0].lower()], text)

    order = draw.permutation(len(lines))
    receptacles, last = anew("\n".join(lines[index] for index in order)), None
    for step in steps:
        answer = anew(step.answer)
        action = data.parse(answer)
        yield dataclasses.replace(
            step, task=anew(step.task), receptacles=receptacles, last=last, outcome=anew(step.outcome), answer=answer, action=action
        )
        last = action
