"""Examples of a TRL file (`reel export sft --format trl`), and the part of their text that the model is shown."""

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
    prompt: str  # what changes from step to step: see `shown`
    answer: str  # the whole text of the assistant
    action: dict  # {"tool_name": .., "args": {..}}


def read(paths):
    """The examples of JSONL files, episode by episode."""
    examples = []
    for path in paths:
        with open(path, encoding="utf-8") as lines:
            examples.extend(example(json.loads(line)) for line in lines if line.strip())
    return sorted(examples, key=lambda one: (one.scene, one.episode, one.call))


def example(row):
    about = row["provenance"]
    text = {turn["role"]: plain(turn["content"]) for turn in [*row["prompt"], *row["completion"]]}
    answer = text["assistant"]
    action = parse(answer)
    if action is None:
        raise ValueError(f"no action in the answer of {about['example']}")
    return Example(about["episode"], about["call"], about["scene"], about["family"], shown(text["user"]), answer, action)


def plain(content):
    """The text of a message, whether a string or a list of parts."""
    if isinstance(content, str):
        return content
    return "".join(part["text"] for part in content if part["type"] == "text")


def shown(user):
    """The prompt without what is equal in all examples (the JSON of the tools) and without the tag of the picture."""
    without_tools = re.sub(r"Tools:\n.*?\n\n", "", user, count=1, flags=re.DOTALL)
    return re.sub(r"\s*Current view:.*$", "", without_tools, flags=re.DOTALL).strip()


def section(prompt, name):
    """What stands under `name:` in a prompt, up to the next empty line or field."""
    found = re.search(rf"^{re.escape(name)}:[ \n](.*?)(?=\n\n|\n[A-Z][a-z ]+: ?|\Z)", prompt, flags=re.DOTALL | re.MULTILINE)
    return found.group(1).strip() if found else ""


def parse(answer):
    """The action of an answer, read leniently: after the reasoning, from the last `next_action`; None if there is none."""
    text = answer.split("</think>")[-1]
    for start in reversed([found.end() for found in re.finditer(r'"next[_ ]action"\s*:\s*', text)]):
        try:
            action, _ = json.JSONDecoder().raw_decode(text[start:])
        except json.JSONDecodeError:
            continue
        name = action.get("tool_name", action.get("name")) if isinstance(action, dict) else None
        arguments = action.get("args", action.get("arguments", {})) if isinstance(action, dict) else None
        if isinstance(name, str) and isinstance(arguments, dict):
            return {"tool_name": name, "args": arguments}
    return None
