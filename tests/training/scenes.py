"""Homes with other furniture, other names and other captions, made from the home that comes with Reel.

A split by scene needs several scenes. Rooms and the places of the furniture stay, so that whatever is generated in
the original is possible in its variants; what a policy reads of a scene changes: room names, categories, ids, captions.

    python3 scenes.py src/tasks/src/data/home.json OUT 1 2 3
"""

import argparse
import json
import pathlib
import random

ROOMS = ["kitchen/0", "kitchen/1", "living room/0", "living room/1", "study room/0", "dining room/0", "washing room/0",
         "bedroom/0", "bedroom/1", "bedroom/2", "guest room/0", "hall/0", "playroom/0", "workshop/0"]
# What may stand where a piece of the original stands: the same height, and a door where it has one.
INSTEAD = {
    "refrigerator": ["refrigerator", "fridge", "freezer", "wardrobe"],
    "microwave": ["microwave", "oven"],
    "washingmachine": ["washingmachine", "dishwasher", "dryer"],
    "counter": ["counter", "workbench", "dresser", "cabinet"],
    "table": ["table", "desk", "stand", "bench"],
    "couch": ["couch", "sofa", "bench"],
    "cabinet": ["cabinet", "dresser", "sideboard", "unit"],
    "desk": ["desk", "table", "dresser", "workbench"],
    "shelf": ["shelf", "bookcase", "rack"],
    "bed": ["bed", "couch"],
}
COLOURS = ["white", "black", "brown", "green", "gray", "red", "blue", "yellow", "silver", "orange", "beige", "pink"]
TOPS = ["oak", "glass", "marble", "walnut", "ceramic", "granite", "steel", "pine"]
SIZES = ["small", "large", "low", "tall", "wide", "narrow", "long"]


def variant(home, seed):
    """The home with everything renamed. Equal seeds give equal homes."""
    draw = random.Random(seed)
    scene = json.loads(json.dumps(home))
    scene["scene_id"] = f"{home['scene_id']}_{seed}"
    rooms = dict(zip([room["name"] for room in scene["rooms"]], draw.sample(ROOMS, len(scene["rooms"]))))
    for room in scene["rooms"]:
        room["name"] = rooms[room["name"]]
    looks = draw.sample([(colour, top) for colour in COLOURS for top in TOPS], len(scene["receptacles"]))
    # Two kinds for each kind of the original, so that most pieces keep others like them.
    instead = {category: draw.sample(kinds, 2) for category, kinds in INSTEAD.items()}
    numbers = {}
    for receptacle, (colour, top) in zip(scene["receptacles"], looks):
        category = draw.choice(instead[receptacle["category"]])
        free = numbers.setdefault(category, draw.sample(range(1, 13), 12))
        size = draw.choice(SIZES)
        receptacle.update(id=f"{category}_{free.pop()}", category=category, room=rooms[receptacle["room"]])
        receptacle["attributes"] = {"colour": [colour], "top": [top], "size": [size]}
        room = receptacle["room"].split("/")[0]
        captions = [f"the {size} {colour} {category}", f"the {category} with the {colour} {top} top",
                    f"the {colour} {category} in the {room}", f"the {category}"]
        receptacle["captions"] = {caption: 1 for caption in draw.sample(captions, 3)}
    return scene


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("home", type=pathlib.Path)
    arguments.add_argument("out", type=pathlib.Path)
    arguments.add_argument("seeds", type=int, nargs="+", help="one home for each")
    arguments = arguments.parse_args()
    home = json.loads(arguments.home.read_text())
    arguments.out.mkdir(parents=True, exist_ok=True)
    for seed in arguments.seeds:
        scene = variant(home, seed)
        (arguments.out / f"{scene['scene_id']}.json").write_text(json.dumps(scene, indent=1))


if __name__ == "__main__":
    main()
