"""Counts which decisions of an exported set need the image: where the text of the prompt leaves several possibilities.

    python decisions.py set

The rules read prompts, never answers. A decision needs the image

- after an arrival, if several receptacles of this kind are listed and the task does not tell them apart by room;
- after a search that numbered several objects of the category;
- nowhere else.
"""

import collections
import json
import pathlib
import re
import sys

import data

ARRIVED = re.compile(r"Result: Arrived at ([a-z]+)_(\d+)\.$")
FOUND = re.compile(r"Result: Found (\d+) object")
TASK = re.compile(r"^Task: (.*)$", re.MULTILINE)


def kind(one: data.Example) -> str:
    """What the last result leaves open."""
    if found := FOUND.search(one.prompt):
        return "image: which of several objects" if int(found[1]) > 1 else "text: one object"
    if arrived := ARRIVED.search(one.prompt):
        alike = [room.split("/")[0] for room, listed in data.ROOM.findall(one.prompt) for name in listed.split(", ") if name.rsplit("_", 1)[0] == arrived[1]]
        if len(alike) < 2:
            return "text: the only receptacle of its kind"
        task = TASK.search(one.prompt)
        told = [room for room in set(alike) if task and f"in the {room}" in task[1]]
        return "text: the room tells look-alikes apart" if any(alike.count(room) == 1 for room in told) else "image: one of several look-alikes"
    if data.MARK not in one.prompt:
        return "text: no image is shown"
    return "text: the tool's result says what is next"


def main() -> None:
    examples = data.read(pathlib.Path(sys.argv[1]))
    counts = collections.Counter(kind(one) for one in examples)
    needs: dict[str, bool] = collections.defaultdict(bool)
    for one in examples:
        needs[one.episode] |= kind(one).startswith("image")
    print(json.dumps({
        "decisions": len(examples), "by_kind": dict(counts.most_common()), "image_share": sum(count for name, count in counts.items() if name.startswith("image")) / len(examples),
        "episodes": len(needs), "episodes_with_such_a_decision": sum(needs.values()),
    }, indent=1))


if __name__ == "__main__":
    main()
