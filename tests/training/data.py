"""Episodes of a TRL file (`reel export sft --format trl --style multi-turn`), step by step, and the text that the model is shown."""

import dataclasses
import json
import re


@dataclasses.dataclass
class Example:
    """One step of an episode."""

    episode: str
    call: int
    scene: str
    family: str
    task: str
    receptacles: str
    last: dict | None  # the action before this step
    outcome: str  # what it came to
    answer: str  # the call, as chat templates write it
    action: dict  # {"tool_name": .., "args": {..}}

    @property
    def given(self):
        """What the user or a tool says right before this step."""
        return self.outcome if self.last else f"Task: {self.task}\n\nReceptacles:\n{self.receptacles}\n"


def read(paths):
    """The steps of the episodes in JSONL files, in order."""
    examples = []
    for path in paths:
        with open(path, encoding="utf-8") as lines:
            for line in lines:
                examples.extend(steps(json.loads(line)))
    return sorted(examples, key=lambda one: (one.scene, one.episode, one.call))


def steps(row):
    """The steps of one episode. Left out are what is equal in all episodes (how to behave, the tools), the images and the reasoning."""
    about, turns = row["provenance"], [turn for turn in row["messages"] if turn["role"] != "system"]
    opening = plain(turns[0]["content"])
    if turns[0]["role"] != "user" or len(turns) % 2:
        raise ValueError(f"the turns of {about['episode']} do not take turns")
    last = None
    for call, (told, said) in enumerate(zip(turns[::2], turns[1::2])):
        (called,) = said["tool_calls"]
        action = {"tool_name": called["function"]["name"], "args": json.loads(called["function"]["arguments"])}
        yield Example(
            about["episode"], call, about["scene"], about["family"], section(opening, "Task"), section(opening, "Receptacles"),
            last, plain(told["content"]).strip() if last else "", written(action), action,
        )
        last = action


def plain(content):
    """The text of a message, whether a string or a list of parts."""
    if isinstance(content, str):
        return content
    return "".join(part["text"] for part in content if part["type"] == "text")


def section(text, name):
    """What stands under `name:`, up to the next empty line."""
    found = re.search(rf"^{re.escape(name)}:\s(.*?)(?=\n\n|\Z)", text, flags=re.DOTALL | re.MULTILINE)
    return found.group(1).strip() if found else ""


def written(action):
    """A call as chat templates write it."""
    return "<tool_call>" + json.dumps({"name": action["tool_name"], "arguments": action["args"]}, separators=(",", ":")) + "</tool_call>"


def parse(answer):
    """The action of an answer: its last call; None if there is none that can be read."""
    for text in reversed(answer.split("<tool_call>")[1:]):
        try:
            action, _ = json.JSONDecoder().raw_decode(text.strip())
            name, arguments = action["name"], action["arguments"]
        except (ValueError, KeyError, TypeError):
            continue
        if isinstance(name, str) and isinstance(arguments, dict):
            return {"tool_name": name, "args": arguments}
    return None
