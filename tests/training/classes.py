"""What decides an argument: the text, the image, or neither.

The rule reads the task, the calls before a step and their outcomes, never the label of the step nor an answer.
"""

import dataclasses
import pathlib
import re

TEXT, IMAGE, NEITHER = "text", "image", "neither"


@dataclasses.dataclass
class Choice:
    """What the text leaves open about the argument of one call."""

    decides: str
    candidates: list


@dataclasses.dataclass
class Known:
    """What the text of all earlier steps taught, in the training split."""

    categories: set  # of objects that were looked for
    doors: set  # categories of furniture that was opened


@dataclasses.dataclass
class Situation:
    """What the calls and outcomes of an episode say before a step."""

    at: str = ""
    holds: bool = False
    placed: bool = False
    opened: set = dataclasses.field(default_factory=set)
    visited: list = dataclasses.field(default_factory=list)  # since the last pick, opening or place
    sought: str = ""
    markers: dict = dataclasses.field(default_factory=dict)
    gazed: int | None = None
    told: str = ""  # what the user replied

    def learn(self, call, outcome):
        tool, arguments = call["tool_name"], call["args"]
        marked = self.markers.get(arguments.get("marker_id"))
        if tool == "nav_to" and outcome.startswith("Arrived"):
            self.at, self.markers, self.gazed = arguments["receptacle_name"], {}, None
            self.visited.append(self.at)
        elif tool in ("show_object_by_category", "walk_around", "show_receptacles"):
            self.markers, self.gazed = numbered(outcome), None
            self.sought = arguments.get("target_category", self.sought)
        elif tool == "gaze_at":
            self.gazed = arguments["marker_id"]
        elif tool == "pick" and outcome.startswith("Picked"):
            self.holds, self.visited = True, []
        elif tool == "place" and outcome.startswith("Placed"):
            self.holds, self.placed, self.visited = False, True, []
        elif tool == "open" and outcome.startswith("Opened"):
            self.opened.add(marked)
            self.visited = []
        elif tool == "close" and outcome.startswith("Closed"):
            self.opened.discard(marked)
        elif tool == "ask":
            self.told += " " + outcome


def numbered(outcome):
    """{marker: what the text calls it, or None} of an outcome that numbers things."""
    listed = {int(number): name.strip().removeprefix("a(an) ").rstrip(".") for number, name in re.findall(r"(\d+): (\S[^\n]*)", outcome)}
    return listed or {int(number): None for number in re.findall(r"marker (\d+)", outcome)}


def furniture(receptacles):
    """{id: (category, words of its room)} of the list that the agent is given."""
    found = re.findall(r"^- (\S+) \(([^,()]+), ([^()]+)\)", receptacles, flags=re.MULTILINE)
    return {place: (category, set(re.findall(r"[a-z]+", room)) - {"room"}) for place, category, room in found}


def situations(examples):
    """The situation before each example, by (episode, call)."""
    before, now = {}, {}
    for example in sorted(examples, key=lambda one: (one.episode, one.call)):
        situation = now.setdefault(example.episode, Situation())
        if example.last:
            situation.learn(example.last, example.outcome)
        before[example.episode, example.call] = dataclasses.replace(
            situation, opened=set(situation.opened), visited=list(situation.visited), markers=dict(situation.markers)
        )
    return before


def known(examples):
    """What training examples teach about the world's words."""
    categories, doors, before = set(), set(), situations(examples)
    for example in examples:
        arguments = example.action["args"]
        categories.add(arguments.get("target_category"))
        if example.action["tool_name"] == "open":
            place = before[example.episode, example.call].markers.get(arguments.get("marker_id"))
            doors.add(furniture(example.receptacles).get(place, (None,))[0])
    return Known(categories - {None}, doors - {None})


def mentions(text, places):
    """Where a text names kinds of furniture, as [(start, category)]; spaces in a category do not matter."""
    found = {}
    for category in {category for category, _ in places.values()}:
        for match in re.finditer(r"\b" + " ?".join(map(re.escape, category)) + r"\b", text, flags=re.IGNORECASE):
            found[match.start()] = category
    return sorted(found.items())


def meant(phrase, places):
    """The furniture that a phrase may mean by its category, narrowed by a room or a neighbour that it names."""
    named = [category for _, category in mentions(phrase, places)]
    alike = [place for place, (category, _) in places.items() if named and category == named[0]]
    words = set(re.findall(r"[a-z]+", phrase.lower()))
    rooms = [place for place in alike if places[place][1] & words]
    beside = [room for category, room in places.values() if category in named[1:] and category != named[0]]
    near = [place for place in alike if places[place][1] in beside]
    return rooms or near or alike


def wordings():
    """How `reel task draw` words instructions, out of its source."""
    source = (pathlib.Path(__file__).parents[2] / "src/tasks/src/wording.rs").read_text(encoding="utf-8")
    templates = re.search(r"const TEMPLATES: .*?= &\[\n(.*?)\n\];", source, flags=re.DOTALL).group(1)
    return re.findall(r'"([^"]+)"', templates)


GAPS = {"src": "(?P<src>the .+?)", "dest": "(?P<dest>the .+)", "object": "(?P<object>.+?)", "at": "(?:on|in)"}
PATTERNS = [re.compile(wording.rstrip(".").format(**GAPS) + r"\.") for wording in wordings()]


def ends(task):
    """The phrases of source and destination of an instruction; empty where it is worded otherwise."""
    found = next(filter(None, (pattern.fullmatch(task) for pattern in PATTERNS)), None)
    return (found["src"], found["dest"]) if found else ("", "")


def goes_to(example, situation, learned):
    """The places that a `nav_to` may mean."""
    places = furniture(example.receptacles)
    source, destination = ends(example.task)
    first = [category for _, category in mentions(destination, places)][:1]
    if situation.placed and situation.opened:
        candidates = sorted(place for place in situation.opened if place)
    elif situation.holds or (first and first[0] in learned.doors and not situation.opened):
        candidates = meant(destination, places)
    else:
        candidates = meant(source, places)
    return [place for place in candidates if place not in situation.visited] or candidates


def choice(example, tool, situation, learned):
    """What the text leaves open about the argument of a call of `tool`."""
    if tool == "nav_to":
        candidates = goes_to(example, situation, learned)
    elif tool == "show_object_by_category":
        text = (example.task + situation.told).lower()
        return Choice(TEXT if any(category in text for category in learned.categories) else NEITHER, [])
    elif tool == "ask":
        return Choice(NEITHER, [])
    elif tool in ("place", "open", "close"):
        candidates = [number for number, name in situation.markers.items() if name == situation.at] or list(situation.markers)
    elif tool == "pick" and situation.gazed is not None:
        candidates = [situation.gazed]
    else:
        named = [number for number, name in situation.markers.items() if name in (None, situation.sought)]
        candidates = named or list(situation.markers)
    if not candidates:
        return Choice(NEITHER, [])
    return Choice(TEXT if len(candidates) == 1 else IMAGE, candidates)
