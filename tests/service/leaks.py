"""Profile `paper` shows nothing privileged: every byte that reaches a policy in many episodes is searched for what it could not
know: instance and asset ids, poses, what is hidden, the goal. `leaks.py [--episodes N]`."""

import base64
import json
import random
import re
import struct
import sys

from harness import Agent, Server

#: Numbers that are no counts, markers or parts of a name: poses, sizes, rewards.
DECIMAL = re.compile(r"\d\.\d")
#: Words of ours for what only the simulator knows.
WORDS = ["instance", "asset", "world_graph", "goal", "reward", "success", "pose", "position", "yaw", "seed", "digest", "distractor"]
#: What a PNG may consist of: nothing that holds text.
CHUNKS = {b"IHDR", b"IDAT", b"IEND", b"sRGB", b"gAMA", b"PLTE"}


class Listener(Agent):
    """Keeps everything that was heard, as bytes and as what the calls said."""

    def __init__(self, *arguments, **named):
        self.heard = []
        super().__init__(*arguments, **named)

    def post(self, message):
        status, body = super().post(message)
        self.heard.append(body)
        return status, body


def chunks(png):
    """The kinds of chunks of a PNG."""
    assert png[:8] == b"\x89PNG\r\n\x1a\n"
    at = 8
    while at < len(png):
        size, kind = struct.unpack(">I4s", png[at : at + 8])
        yield kind
        at += 12 + size


def said(result):
    """What a result says in words, images apart; and the images."""
    words = [item["text"] for item in result["content"] if item["type"] == "text"]
    images = [base64.b64decode(item["data"]) for item in result["content"] if item["type"] == "image"]
    return "\n".join([*words, json.dumps(result.get("structuredContent"))]), images


def play(agent, task_id, dice):
    """An episode of a policy that tries a bit of everything; what it called and what was said then."""
    log = []

    def call(tool, **arguments):
        result = agent.call(tool, **arguments)
        text, images = said(result)
        log.append((tool, arguments, text))
        for image in images:
            assert set(chunks(image)) <= CHUNKS, set(chunks(image))
        return result.get("structuredContent", {})

    begun = call("finish_with_id", task_id=task_id)["episode"]
    places = [it["id"] for it in begun["receptacles"]]
    categories = sorted({"apple", "clock", "cup", "book", "toy", "box", "saucer", "plate"})
    markers = []
    for _ in range(14):
        tool = dice.choice(
            ["nav_to", "nav_to", "walk_around", "show_object_by_category", "show_receptacles", "gaze_at", "pick", "place", "open", "ask"]
        )
        arguments = {
            "nav_to": lambda: {"receptacle_name": dice.choice(places)},
            "show_object_by_category": lambda: {"target_category": dice.choice(categories)},
            "ask": lambda: {"question": dice.choice(["Which one do you mean?", "Where shall it go?", "Where is it?"])},
        }.get(tool, lambda: {"marker_id": dice.choice(markers or [1])} if tool in ("gaze_at", "pick", "place", "open") else {})()
        markers = call(tool, **arguments).get("markers", markers)
    call("list_receptacles")
    call("finish")
    return begun, log


def check(task, start, steps, begun, log):
    """Nothing of the task that could not be known is in what was said."""
    secrets = {it["instance"] for it in task["objects"]} | {it["asset"] for it in task["objects"]}
    places = {it["id"] for it in begun["receptacles"]}
    of = {it["instance"]: it["category"] for it in task["objects"]}
    #: Categories that the policy may have heard of: named by the instruction, by itself, or seen or listed by a call before.
    known = begun["instruction"].lower() + " " + " ".join(of[it["object"]] for it in start.get("visible", []))
    for number, (tool, arguments, text) in enumerate(log):
        about = f"{tool} {arguments}: {text[:300]}"
        for secret in secrets:
            assert secret not in text, f"{secret} in {about}"
        if number:  # the first text is the instruction, in people's words
            for word in WORDS:
                assert word not in text.lower(), f"'{word}' in {about}"
        assert not DECIMAL.search(text), about
        known += " " + json.dumps(arguments).lower()
        step = steps[number - 1] if 0 < number <= len(steps) else None
        if step:
            seen = [it["object"] for it in step.get("visible", [])] + step.get("listed", [])
            known += " " + " ".join(of[it] for it in seen)
            # A number stands for something, and what it stands for is not said.
            for marker in step["markers"]:
                target = marker["target"]
                assert target["kind"] == "receptacle" or target["id"] not in text, about
            if tool == "walk_around" and step["outcome"].get("error") is None:
                here = step["receptacle"]
                assert step.get("listed"), "something was found"
                assert here in places
        if tool in ("finish_with_id", "list_receptacles", "finish"):
            continue
        for category in set(of.values()):
            told = re.search(rf"\b{re.escape(category.lower())}\b", text.lower())
            assert not told or category.lower() in known, f"'{category}' was not to be known: {about}"


def hidden(task, steps):
    """No list holds what is behind a closed door."""
    doors = {place: state.get("door") for place, state in task["initial"].items()}
    for step in steps:
        for change in step["changes"]["physics"]:
            if change["event"] == "door":
                doors[change["receptacle"]] = change["to"]
        if step.get("listed"):
            assert doors.get(step["receptacle"]) != "closed", step


def main():
    episodes = int(sys.argv[sys.argv.index("--episodes") + 1]) if "--episodes" in sys.argv else 200
    with Server("--run", "leaks") as server:
        agent = Listener(server, "listener")
        ids = json.loads(agent.say("list_tasks"))
        dice, logs = random.Random(7), []
        for number in range(episodes):
            logs.append(play(agent, ids[number % len(ids)], dice))
        # `finish` has begun one more; what is left of it ends with the session.
        names = [it["trace"] for it in server.json("GET", "/api/traces?limit=1000")[1]["traces"]]
        played = {}
        for name in names:
            status, episode = server.json("GET", f"/api/traces/{name}/episode")
            if status == 200 and episode["steps"] > 1:
                steps = server.json("GET", f"/api/traces/{name}/steps?limit=1000")[1]
                played[episode["header"]["policy"]["parameters"]["number"]] = (episode["task"], episode["start"], steps)
        assert len(played) == episodes, (len(played), episodes)
        for (begun, log), number in zip(logs, sorted(played)):
            task, start, steps = played[number]
            assert task["task_id"] == begun["task_id"]
            check(task, start, steps, begun, log)
            hidden(task, steps)
        # And whatever else came over the wire: headers of events, errors, tool lists.
        secrets = {value for task, _, _ in played.values() for it in task["objects"] for value in (it["instance"], it["asset"])}
        wire = b"\n".join(agent.heard)
        found = [secret for secret in secrets if len(secret) > 6 and secret.encode() in wire]
        assert not found, found
        print(f"{episodes} episodes, {sum(map(len, agent.heard))} bytes heard, {len(secrets)} names searched for: nothing leaks")


if __name__ == "__main__":
    main()
