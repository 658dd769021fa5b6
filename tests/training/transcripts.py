"""Draws failed episodes of a store and writes them down for people who label them without knowing what Reel says.

    python3 transcripts.py --reel reel --store store --count 60 --out blind

Each `NN.txt` holds the task, which object is the target and where it has to go, what the markers stood for, and the transcript of
`reel show`; nothing of the tables `classes` and `blame`. `index.json` says which episode each one is.
"""

import argparse
import json
import pathlib
import random
import subprocess


def reel(binary, *arguments):
    return subprocess.run([binary, *arguments], check=True, capture_output=True, text=True).stdout


def captions(receptacle):
    return ", ".join(receptacle["captions"])


def truth(trace):
    """What only the simulator knows: target, destination, what resembles them, and the furniture as it looks."""
    task, goal, initial = trace["task"], trace["task"]["goal"], trace["task"]["initial"]
    furniture = {one["id"]: one for one in trace["scene"]["receptacles"]}
    ends = {thing: place for place, state in goal.items() for thing in state["content"]}
    moved, others = [], []
    for thing in task["objects"]:
        name, start, end = thing["instance"], thing["receptacle"], ends.get(thing["instance"])
        where = f"on {start} ({captions(furniture[start])})"
        if start == end:
            others.append(f"  {name}: {thing['caption']} It stands {where}.")
        else:
            moved.append(f"  {name}: {thing['caption']}\n    stands {where}\n    has to go to {end} ({captions(furniture[end])})")
    doors = lambda name: f", its door is {initial[name]['door']} at first" if initial[name].get("door") else ""
    places = [f"  {one['id']} in {one['room']}: {captions(one)}{doors(one['id'])}" for one in furniture.values()]
    return "\n".join(["Target:", *moved, "Other objects, which stay where they are:", *(others or ["  none"]), "Furniture:", *places])


def markers(trace):
    """What the numbers stood for: each map when it was made, and of each call by a number what it meant."""
    lines, before = [], {}
    for step in trace["steps"]:
        call = step["input"]["call"]
        number = call["arguments"].get("marker_id") if isinstance(call["arguments"], dict) else None
        now = {str(one["id"]): one["target"]["id"] for one in step["markers"]}
        if number is not None:
            lines.append(f"  step {step['step']}: {call['name']} {number} = {before.get(str(number), 'not on the map')}")
        elif now and now != before:
            lines.append(f"  step {step['step']}: " + ", ".join(f"{one} = {name}" for one, name in now.items()))
        before = now
    return "\n".join(["What the markers stand for:", *lines])


def main():
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--reel", required=True, help="the binary")
    options.add_argument("--store", required=True)
    options.add_argument("--count", type=int, default=60)
    options.add_argument("--seed", type=int, default=1, help="of the draw")
    options.add_argument("--without", type=pathlib.Path, action="append", default=[], help="index.json of an earlier draw, whose episodes are left out")
    options.add_argument("--out", required=True, type=pathlib.Path)
    options = options.parse_args()

    query = "SELECT episode_id, trace FROM episodes WHERE NOT success ORDER BY episode_id"
    failures = json.loads(reel(options.reel, "query", "--store", options.store, "--json", query))
    before = {episode["episode_id"] for index in options.without for episode in json.loads(index.read_text()).values()}
    failures = [episode for episode in failures if episode["episode_id"] not in before]
    drawn = random.Random(options.seed).sample(failures, min(options.count, len(failures)))
    options.out.mkdir(parents=True, exist_ok=True)
    index = {}
    for number, episode in enumerate(drawn, 1):
        trace = json.loads(reel(options.reel, "show", "--json", episode["trace"]))
        text = "\n\n".join([truth(trace), markers(trace), reel(options.reel, "show", episode["trace"])])
        (options.out / f"{number:02}.txt").write_text(text)
        index[f"{number:02}"] = episode
    (options.out / "index.json").write_text(json.dumps(index, indent=1))
    print(f"{len(drawn)} of {len(failures)} failures in {options.out}")


if __name__ == "__main__":
    main()
