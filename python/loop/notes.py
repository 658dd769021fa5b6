"""Writes what an expert says along with the oracle's decisions: terse words, the same for the same situation, from what the images show.

    reel dataset annotate traces && python notes.py --reel reel traces
    reel export sft --annotations notes ...

The annotator sees metadata that an agent does not (paper, expert annotation), but every word of a note stands in the instruction or in the
latest image and its text. A note compares what the instruction wants with what the image shows; its History adds one numbered line, which
the memory of REAL's trainer keeps. `reel export sft` reads the notes from `<trace>.notes.jsonl`, whose first line `reel dataset annotate`
writes.
"""

import argparse
import collections.abc
import concurrent.futures
import json
import pathlib
import re
import subprocess
import typing

Record = dict[str, typing.Any]
PLAIN = ["size", "colour", "material"]  # attributes whose words stand alone; of others the part is named
LITTLE = {"a", "an", "and", "at", "in", "of", "on", "the", "with"}
WORDS = ["size", "shape", "colour", "material"]  # attributes that an instruction may name


def look(attributes: dict[str, list[str]]) -> str:
    """What an image shows of a thing, in words: `small red ceramic`, `glass top, brown legs`."""
    plain = [word for kind in PLAIN for word in attributes.get(kind, [])]
    parts = [f"{' '.join(words)} {kind}" for kind, words in sorted(attributes.items()) if kind not in WORDS]
    return ", ".join([*([" ".join(plain)] if plain else []), *parts]) or "plain"


def phrase(instruction: str, captions: collections.abc.Iterable[str], fallback: str) -> str:
    """The longest caption that stands in the instruction, as it stands there and without its article."""
    bare = lambda caption: re.sub(r"^(the|an|a) ", "", caption.strip().rstrip("."), flags=re.IGNORECASE).lower()
    found = [bare(caption) for caption in captions if bare(caption) in instruction.lower()]
    longest = max(found, key=len, default="")
    start = instruction.lower().find(longest)
    return instruction[start : start + len(longest)] or fallback


def lacking(wanted: str, seen: str) -> str:
    """The first word of what is wanted that what is seen does not have, with a space before it; empty if there is none."""
    words, bare = lambda text: re.findall(r"[a-z]+", text.lower()), lambda word: word.removesuffix("s")
    there = {*map(bare, words(seen)), *LITTLE}
    return next((f" {word}" for word in words(wanted) if bare(word) not in there and word not in LITTLE), "")


def described(category: str, attributes: dict[str, list[str]], room: str = "") -> list[str]:
    """The ways in which an instruction may describe a thing by its attributes."""
    words = [word for kind in WORDS for word in attributes.get(kind, [])]
    pairs = [f"{one} {other}" for index, one in enumerate(words) for other in words[index + 1 :]]
    names = [f"{adjective} {category}" for adjective in [*pairs, *words]] + [category]
    return [f"{name} in the {room}" for name in names if room] + names


def comparable(phrase: str, category: str, attributes: collections.abc.Iterable[dict[str, list[str]]]) -> str:
    """The words of a phrase that a look can have, and the category: `pink leather diary` of `pink leather diary with a locked clasp`.

    Rare words are spelled letter by letter and seldom copied rightly. A phrase that does not name the category stays as it is.
    """
    words, named = phrase.split(), category.split()
    seen = {word for one in attributes for kind in PLAIN for value in one.get(kind, []) for word in value.split()}
    return " ".join(word for word in words if word in seen or word in named) if set(named) <= set(words) else phrase


class Episode:
    """What the notes of one episode are made from."""

    def __init__(self, trace: Record) -> None:
        self.task, self.steps = trace["task"], trace["steps"]
        # Of a branch only what comes after the parent's calls is an expert's.
        self.first = (trace["header"].get("parent") or {}).get("call", 0)
        self.places = {place["id"]: place for place in trace["scene"]["receptacles"]}
        self.objects = {thing["instance"]: thing for thing in self.task["objects"]}
        self.instruction = self.task["instruction"]
        target = self.objects[self.task["target"]]
        captions = [target.get("caption") or "", *described(target["category"], target.get("attributes", {}))]
        told = phrase(self.instruction, captions, self.task.get("purpose") or target["category"])
        self.wanted = comparable(told, target["category"], [thing.get("attributes", {}) for thing in self.task["objects"]])
        self.source, self.destination = self.place_phrase(self.task["src"]), self.place_phrase(self.task["dest"])
        self.told = ""

    def place_phrase(self, name: str) -> str:
        place = self.places[name]
        ways = [*place.get("captions", {}), *described(place["category"], place.get("attributes", {}), self.room(name))]
        return phrase(self.instruction, ways, place["category"])

    def room(self, name: str) -> str:
        return self.places[name]["room"].split("/")[0]

    def seen(self, target: Record) -> str:
        """What the image shows of a marked thing."""
        thing = self.objects.get(target["id"]) or self.places.get(target["id"])
        return look(thing.get("attributes", {})) if thing else "plain"

    def notes(self) -> list[dict[str, str]]:
        """A note for each decision."""
        found = []
        for index, step in enumerate(self.steps):
            last = self.steps[index - 1] if index else None
            line, seen = self.account(last, self.steps[index - 2] if index > 1 else None) if last else ("started", "")
            found.append({
                "reasoning": self.reason(step, last, seen) if index >= self.first else "",
                "history": f"{index}) {line}",
                "schedule": self.schedule(last),
                "subtask": step.get("tool") or "call",
            })
        return found

    def account(self, last: Record, before: Record | None) -> tuple[str, str]:
        """The History's line for the last call, and what its image shows."""
        call, error = last["input"]["call"], last["outcome"].get("error")
        arguments = call["arguments"] if isinstance(call["arguments"], dict) else {}
        marker = arguments.get("marker_id")
        targets = {one["id"]: one["target"] for one in (before or last)["markers"]}
        match last.get("tool"):
            case "nav_to":
                name = str(arguments.get("receptacle_name"))
                seen = f"{name} in {self.room(name)}: {look(self.places[name].get('attributes', {}))}" if name in self.places and not error else ""
                return (f"at {seen}" if seen else f"no way to {name}"), seen
            case "show_object_by_category":
                sought = str(arguments.get("target_category"))
                seen = "; ".join(f"{one['id']}: {self.seen(one['target'])}" for one in last["markers"]) if not error else ""
                return (f"saw {sought} {seen}" if seen else f"no {sought}"), seen
            case "walk_around":
                numbers = ", ".join(str(one["id"]) for one in last["markers"])
                return (f"walked around: {numbers}" if numbers and not error else "walked around: nothing"), ""
            case "gaze_at" if not error:
                target = next((one["target"] for one in last["markers"] if str(one["id"]) == str(marker)), None)
                seen = f"{marker}: {self.seen(target)}" if target else ""
                return (f"gazed at {seen}" if seen else f"gazed at {marker}"), seen
            case "ask":
                reply = (last.get("reply") or {}).get("text") or last["outcome"]["text"]
                self.told = reply
                return f"told: {reply}", ""
            case None:
                return (f"{call['name']} failed" if call["name"] else "gave no call"), ""
            case tool:
                name = targets.get(int(marker), {}).get("id", "") if str(marker).isdigit() else ""
                what = f" {name}" if name in self.places else f" {marker}" if marker is not None else ""
                return f"{tool}{what}{' failed' if error else ''}", ""

    def reason(self, step: Record, last: Record | None, seen: str) -> str:
        """What is wanted, what is seen, and whether it fits."""
        held = last is not None and last.get("held")
        tool = step.get("tool")
        picked = any(other.get("tool") == "pick" and not other["outcome"].get("error") for other in self.steps[: step["step"]])
        if picked and not held:
            return "all done" if tool == "finish" else "finish up"
        if last is None:
            return f"want {self.wanted} at {self.source}"
        if last.get("tool") == "nav_to" and seen:
            here = last["input"]["call"]["arguments"]["receptacle_name"]
            wanted, place = (self.destination, self.task["dest"]) if held else (self.source, self.task["src"])
            fits = here == place or (not held and tool == "show_object_by_category")
            return f"want {wanted}; {seen}; {'yes' if fits else 'no' + lacking(wanted, seen)}"
        if held:
            return f"bring it to {self.destination}"
        if last.get("tool") in ("show_object_by_category", "gaze_at") and seen:
            chosen = str((step["input"]["call"]["arguments"] or {}).get("marker_id", ""))
            verdict = f"{chosen} fits" if tool in ("gaze_at", "pick") and chosen else "unclear" if tool == "ask" else "no"
            return f"want {self.wanted}; {seen}; {verdict}"
        if last.get("tool") == "ask":
            return f"want {self.told}"
        return f"want {self.wanted}"

    def schedule(self, last: Record | None) -> str:
        held = last is not None and last.get("held")
        picked = last is not None and any(other.get("tool") == "pick" and not other["outcome"].get("error") for other in self.steps[: last["step"] + 1])
        return "carry, place, finish" if held else "finish" if picked else "find, pick, carry, place, finish"


def write(reel: str, trace: pathlib.Path) -> int:
    """Replaces the notes beside a trace; gives their number."""
    path = trace.with_name(trace.name + ".notes.jsonl")
    with path.open(encoding="utf-8") as lines:
        about = json.loads(next(lines))
    shown = subprocess.run([reel, "show", "--json", str(trace)], check=True, capture_output=True, text=True)
    notes = Episode(json.loads(shown.stdout)).notes()
    path.write_text("".join(json.dumps(line) + "\n" for line in [{**about, "annotator": "terse", "steps": len(notes)}, *notes]), encoding="utf-8")
    return len(notes)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("traces", type=pathlib.Path)
    parser.add_argument("--reel", default="reel", help="the binary")
    parser.add_argument("--jobs", type=int, default=1)
    chosen = parser.parse_args()
    traces = sorted(chosen.traces.rglob("*.mcap"))
    with concurrent.futures.ThreadPoolExecutor(chosen.jobs) as pool:
        counts = list(pool.map(lambda trace: write(chosen.reel, trace), traces))
    print(f"{sum(counts)} notes for {len(counts)} traces")


if __name__ == "__main__":
    main()
