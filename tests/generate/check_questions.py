"""Whether every question of annotated episodes had to be asked, found out from the words alone.

    python3 check_questions.py REEL LIBRARY.json SCENE.json FOLDER TRACES

FOLDER has the task files that `reel task annotate` wrote, TRACES the episodes of the oracle. The episode has to ask what the plan
says, as often and in that order. What was said before a question (the instruction and earlier replies) has to leave at least two
things possible for what it asks about, among them the right one, and with the reply exactly that one; in the end everything is told.
Where strategy A asks for the source, fewer are left: the user tells a room. A dialogue of strategy A is at least two asks before any
other call.
No identifier may be spoken. Knows nothing of how Reel words or checks questions: an object is meant when every word of the
description is said of it, a receptacle when it is called by its caption or by its room.
"""

import json
import pathlib
import re
import subprocess
import sys

import yaml
from check_words import PLACE, Checker, said_of, words

ENDS_OF = {"source": "src", "destination": "dest"}


class Talk(Checker):
    """One episode: what its words leave possible."""

    def __init__(self, library, scene, task, trace):
        super().__init__(library, scene)
        self.scene = {one["id"]: one for one in self.receptacles}
        self.episode = task["episodes"][0]
        placements = self.episode["placements"]
        self.objects = {key: dict(item, place=placements[key]["furniture"]) for key, item in task["objects"].items()}
        self.target = next(
            key for key, item in self.objects.items()
            if item["original_id"] == self.episode["target_object_id"] and item["place"] == self.episode["src"]
        )
        self.moves = self.episode.get("moves") or {self.target: self.episode["dest"]}
        self.told = [self.episode["benchmark_instruction"]]
        self.trace = trace
        self.narrowed = set()

    def check(self, problem):
        """How many questions were asked."""
        planned = [step["args"] for step in self.episode["execution_plan"] if step["action"] == "ask"]
        asked = [step for step in self.trace["steps"] if step["tool"] == "ask"]
        if len(planned) != len(asked) or not planned:
            problem(f"{len(planned)} questions in the plan, {len(asked)} in the episode")
            return len(asked)
        self.speaks_no_id(self.told[0], problem)
        for plan, step in zip(planned, asked):
            about, question, reply = plan["about"], step["input"]["call"]["arguments"]["question"], step["reply"]["text"]
            if question != plan.get("question", question):
                problem(f"asks {question!r}, not {plan['question']!r}")
            if about == "object" and plan["strategy"] != "A":
                problem(f"strategy {plan['strategy']} asks about the {about}")
            self.narrowed |= {about} if (about, plan["strategy"]) == ("source", "A") else set()
            self.speaks_no_id(question, problem)
            before = self.possible(about)
            if len(before) < 2 or self.right(about) not in before:
                problem(f"{question!r} need not be asked: {sorted(before)} fit {self.told}")
            self.told.append(reply)
            after = self.possible(about)
            if not self.is_told(about, after) or len(after) >= len(before):
                problem(f"{reply!r} leaves {sorted(after)}, not {self.right(about)}")
        for about in ["object", "source", "destination"] if len(self.moves) == 1 else ["destination"]:
            if not self.is_told(about, self.possible(about)):
                problem(f"in the end {sorted(self.possible(about))} fit as {about}: {self.told}")
        tools = [step["tool"] for step in self.trace["steps"]]
        turns = next((index for index, tool in enumerate(tools) if tool != "ask"), len(tools))
        if any(plan["strategy"] == "A" and plan["about"] != "object" for plan in planned) and turns < 2:
            problem(f"a dialogue of {turns} turns")
        return len(asked)

    def is_told(self, about, possible):
        return self.right(about) in possible if about in self.narrowed else possible == {self.right(about)}

    def right(self, about):
        return self.target if about == "object" else self.episode[ENDS_OF[about]]

    def possible(self, about):
        return self.possible_objects() if about == "object" else self.possible_places(about)

    def possible_objects(self):
        here = {key for key, item in self.objects.items() if item["place"] == self.episode["src"]}
        kinds = {one["category"].lower() for one in self.receptacles}
        for index, text in enumerate(self.told):
            if index == 0:
                # What the instruction leaves open altogether stands where a receptacle would.
                masked = re.sub("somewhere in the home|its place", "[?]", self.masked(text))
                phrases = [phrase for phrase in self.phrases(masked) if re.sub("^(a|an|the) ", "", phrase) not in kinds]
            else:
                phrases = re.findall(r"i mean (.+?)(?:\. |\.?$)", text.lower())
            for phrase in phrases:
                here &= {key for key in here if self.fits(phrase, self.objects[key])}
        return here

    def fits(self, phrase, item):
        phrase = re.sub(r"^this [^:]*:", "", phrase)
        name = re.sub("^(a|an|the) ", "", phrase)
        if name in self.purposes:
            return item["category"] in self.purposes[name]
        return name == "what i asked for" or words(phrase) <= said_of(item)

    def possible_places(self, about):
        right = self.scene[self.right(about)]
        others = {self.objects[key]["place"] for key in self.moves} if about == "destination" else {self.episode["dest"]}
        lids = {one.get("covers") for one in self.receptacles}
        told = words(self.told[0])
        # An instruction without a word about it means any kind.
        silent = not (words(right["category"]) & told) and not any(caption.lower() in self.told[0].lower() for caption in right["captions"])
        left = {
            key for key, one in self.scene.items()
            if (silent or one["category"] == right["category"] or one["category"].endswith(" " + right["category"]))
            and one.get("placeable", True) and not one.get("covers") and key not in lids and key not in others
        }
        for index, text in enumerate(self.told):
            if index > 0:
                # What a reply says about the one is no word about the other.
                speaks = "put it" if about == "destination" else "look around|check what is"
                text = " ".join(part for part in re.split(r"(?<=\.) ", text) if re.search(speaks, part.lower()))
            masked = self.masked(text)
            named = set(PLACE.findall(masked)) & left
            rooms = {one["room"].split("/")[0] for one in self.receptacles}
            in_room = {key for key in left if any(f"in the {room}" in masked and self.scene[key]["room"].split("/")[0] == room for room in rooms)}
            left = named or in_room or left
        return left

    def speaks_no_id(self, text, problem):
        raw = [key for key in [*self.scene, *self.objects] if "_" in key and key.lower() in text.lower()]
        if raw:
            problem(f"{text!r} speaks {raw}")


def main():
    reel, library, scene, folder, traces = sys.argv[1:]
    with open(library, encoding="utf-8") as one, open(scene, encoding="utf-8") as other:
        library, scene = json.load(one), json.load(other)
    episodes = {}
    for file in sorted(pathlib.Path(traces).rglob("*.mcap")):
        shown = json.loads(subprocess.run([reel, "show", "--json", file], check=True, capture_output=True).stdout)
        episodes[shown["header"]["task_id"]] = shown
    findings, questions = [], 0
    files = sorted(pathlib.Path(folder).rglob("*.yaml"))
    for file in files:
        with open(file, encoding="utf-8") as opened:
            task = yaml.safe_load(opened)
        problem = lambda what, file=file: findings.append(f"{file}: {what}")
        trace = episodes.get(task["episodes"][0]["benchmark_task_id"])
        if trace is None:
            problem("there is no episode")
        elif trace["task"]["instruction"] != task["episodes"][0]["benchmark_instruction"]:
            problem("the episode was told something else")
        else:
            questions += Talk(library, scene, task, trace).check(problem)
    for finding in findings:
        print(finding)
    print(f"{questions} questions in {len(files)} tasks, {len(findings)} findings")
    sys.exit(1 if findings or not questions else 0)


if __name__ == "__main__":
    main()
