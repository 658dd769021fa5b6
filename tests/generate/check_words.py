"""Whether instructions mean what they should, found out from their words alone.

    python3 check_words.py LIBRARY.json SCENE.json FOLDER

A precise instruction has to mean exactly one receptacle as source and as destination, and exactly one of all objects of the task
for each that moves; a fuzzy one (SUL) at least two objects on the source. Knows nothing of how Reel words or checks instructions:
an object is meant when it stands where the instruction says and every word of the description is said of it.
"""

import json
import pathlib
import re
import sys

import yaml

# What instructions say around their objects.
ENDS = r" (?:from|located at|at|to|on|in|and (?:carry|place|put|bring|move|deposit|leave|travel|drive)|then)(?= )|[,.?]|$"
EMPTY = {"a", "an", "the", "with", "and", "of", "in", "on", "its", "as"}
PLACE = re.compile(r"\[(\w+)\]")


def words(text):
    return {re.sub(r"(?<=[a-z]{3})s$", "", word) for word in re.findall(r"[a-z0-9-]+", text.lower())} - EMPTY


def said_of(thing, extra=()):
    values = [word for kind in thing.get("attributes", {}).values() for word in kind]
    return words(" ".join([thing["category"], thing.get("detailed_caption", ""), *values, *extra]))


class Checker:
    def __init__(self, library, scene):
        # Categories by what they are for.
        self.purposes = {}
        for row in library:
            self.purposes.setdefault(row["purpose"], set()).add(row["category"])
        self.receptacles = scene["receptacles"]
        self.findings = []
        self.by_kind = {"precise": 0, "fuzzy": 0}

    def masked(self, text):
        """The text with every caption of a receptacle as `[id]`; a caption that several have, as `[?]`."""
        captions = {}
        for one in self.receptacles:
            for caption in one["captions"]:
                captions.setdefault(caption.lower(), set()).add(one["id"])
        lower = text.lower()
        for caption in sorted(captions, key=len, reverse=True):
            ids = captions[caption]
            lower = re.sub(rf"\b{re.escape(caption)}(?!\w)", f"[{ids.copy().pop() if len(ids) == 1 else '?'}]", lower)
        return lower

    def phrases(self, text):
        """What stands in a masked text as an object: `a ...`, `the ...` up to where the instruction goes on."""
        return [found.group(1) for found in re.finditer(rf"(?:^|(?<=\s))((?:a|an|the) (?:(?!\[).)+?)(?={ENDS})", text)]

    def check(self, file):
        with open(file, encoding="utf-8") as opened:
            root = yaml.safe_load(opened)
        episode = root["episodes"][0]
        problem = lambda what, text: self.findings.append(f"{file}: {what}: {text}")
        precise, told = episode["task_description"], episode["benchmark_instruction"]
        moves = episode.get("moves") or {
            f"{episode['target_object_id']}_on_{episode['src']}_at_{episode['task_id']}": episode["dest"]
        }
        objects = {key: dict(item, place=episode["placements"][key]["furniture"]) for key, item in root["objects"].items()}
        self.precise(precise, moves, objects, lambda what: problem(what, precise))
        self.by_kind["precise"] += 1
        if episode["family"] == "SUL":
            self.by_kind["fuzzy"] += 1
            here = [item for item in objects.values() if item["place"] == episode["src"]]
            categories = self.purposes.get(episode["purpose"], {episode["purpose"]})
            candidates = [item for item in here if item["category"] in categories]
            if episode["purpose"] not in told or len(candidates) < 2:
                problem(f"means {len(candidates)} objects", told)
            if episode["purpose"] not in self.purposes and objects[next(iter(moves))]["category"] != episode["purpose"]:
                problem("names no purpose", told)

    def precise(self, text, moves, objects, problem):
        masked = self.masked(text)
        named = set(PLACE.findall(masked))
        wanted = {objects[key]["place"] for key in moves} | set(moves.values())
        if named != wanted:
            return problem(f"names {sorted(named)}, not {sorted(wanted)}")
        sources = {objects[key]["place"] for key in moves}
        met = set()
        # Several objects are joined by "and" before another article.
        parts = re.split(r",? and (?=the )|, (?=the )", masked)
        phrases = [phrase for part in parts for phrase in self.phrases(part)]
        for phrase in phrases:
            asked = words(phrase)
            fits = [key for key, item in objects.items() if item["place"] in sources and asked <= said_of(item)]
            # Where several sources are named, the object is on the one named next.
            if len(fits) > 1 and len(sources) > 1:
                after = masked[masked.index(phrase) + len(phrase):]
                place = next(iter(PLACE.findall(after)), None)
                fits = [key for key in fits if objects[key]["place"] == place]
            if len(fits) != 1:
                return problem(f"{phrase!r} means {fits}")
            met.add(fits[0])
        if met != set(moves):
            problem(f"means {sorted(met)}, not {sorted(moves)}; it says {phrases}")


def main():
    library, scene, folder = sys.argv[1:]
    with open(library, encoding="utf-8") as one, open(scene, encoding="utf-8") as other:
        checker = Checker(json.load(one), json.load(other))
    files = sorted(pathlib.Path(folder).rglob("*.yaml"))
    for file in files:
        checker.check(file)
    for finding in checker.findings:
        print(finding)
    print(f"{checker.by_kind['precise']} precise and {checker.by_kind['fuzzy']} fuzzy instructions, {len(checker.findings)} findings")
    sys.exit(1 if checker.findings or not files else 0)


if __name__ == "__main__":
    main()
