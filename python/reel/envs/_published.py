"""Answers and prompts in the form of REAL's published trainer (docs/real-agents.md)."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

from .._types import Record
from .._reel import ReelError
from ._calls import NO_CALL, Call, plain
from ._rollouts import text_of


LEGACY_TOOLS = {
    "nav_to": "navigate_to",
    "walk_around": "explore_receptacle",
    "gaze_at": "focus_on",
    "show_object_by_category": "find_objects",
    "show_receptacles": "highlight_receptacles",
    "place_on_top": "place",
}
"""Tool names of earlier versions, which the trainer still reads, and what they mean."""

ARGUMENTS = {
    "navigate_to": "receptacle_name",
    "find_objects": "target_category",
    "focus_on": "marker_id",
    "pick": "marker_id",
    "place": "marker_id",
    "open": "marker_id",
    "close": "marker_id",
    "ask": "question",
}
"""The required argument of each tool that has one."""

OBJECTS_MAX = 1000
"""Places in an answer that are tried as the beginning of an object."""

ERRORS = (
    "[[internal error]]", "error executing", "traceback", "no object in the inventory",
    "cannot place object into a closed", "not found in the marker map", "cannot find a non-occluded position",
    "not found in the scene", "not implemented yet", "not recognized", "not aligned to bread target",
    "selected marker_id", "hand is empty",
)  # fmt: skip
"""Texts of an observation that count as an error, in lower case."""

ANSWER_FORM = (
    "Answer with your reasoning in <think>...</think> and then one JSON object, with nothing after it:\n"
    '{"summary": {"History": "a numbered line for each step, the newest last", "New Schedule": "what is left to do", '
    '"Current subtask": "what you do now"}, "next action": {"tool_name": "...", "args": {}}}'
)
"""How a model is told to answer in a conversation."""


def after_think(text: str) -> str:
    """The part of an answer after its last `</think>`."""
    return text.rpartition("</think>")[2]


def objects(text: str) -> Iterator[Record]:
    """The JSON object at each `{` of a text that begins one, nested ones too."""
    decoder = json.JSONDecoder()
    for at in [match.start() for match in re.finditer(r"\{", text)][:OBJECTS_MAX]:
        try:
            value, _ = decoder.raw_decode(text, at)
        except (ValueError, RecursionError):
            continue
        if isinstance(value, dict):
            yield cast("Record", value)


@dataclass(frozen=True)
class Answer:
    """What the trainer takes out of a model's answer."""

    call: Call
    """The call that is made; `NO_CALL` if the answer holds none."""
    problem: str | None
    """Why the answer holds no call; None if it does."""
    reasoning: str
    """The text before the last `</think>`, without the tags."""
    summary: Any
    """The memory that the answer writes; None if it writes none."""
    last_action: Any
    """The action as the memory keeps it; None if the former one stays."""


def read_answer(text: str) -> Answer:
    """Reads an answer as the published trainer and its gym do.

    The call is the first usable one of the JSON objects after the last `</think>`, nested ones
    included. The memory is read from the first `{` to the last `}`.
    """
    body = after_think(text)
    call, problem = NO_CALL, "completion is empty"
    if text.strip():
        problems: list[str] = []
        problem = None
        for found in objects(body):
            try:
                call = action_of(found)
                break
            except ValueError as error:
                problems.append(str(error))
        else:
            problem = ": ".join(["no valid JSON tool action found", *(["; ".join(problems)] if problems else [])])
    reasoning = text.rpartition("</think>")[0].replace("<think>", "").strip()
    summary, last_action = memory_of(body)
    return Answer(call, problem, reasoning, summary, last_action)


def action_of(found: Mapping[str, Any]) -> Call:
    """The call that an object of an answer means.

    Raises:
        ValueError: it is none; the text says why.
    """
    action: Any = found
    for key in ("next action", "next_action"):
        if key in found:
            action = found[key]
            break
    if isinstance(action, str):
        name, arguments = shorthand(action)
    elif isinstance(action, Mapping):
        fields = cast("Mapping[str, Any]", action)
        name = next((fields[key] for key in ("tool_name", "tool", "name") if fields.get(key)), None)
        arguments = fields.get("args", fields.get("arguments", {}))
    else:
        raise ValueError("action must be an object or function shorthand")
    if not isinstance(name, str) or not name.strip():
        raise ValueError("tool_name is missing")
    if arguments is None:
        arguments = {}
    if not isinstance(arguments, Mapping):
        raise ValueError("args must be a JSON object")
    return LEGACY_TOOLS.get(name.strip(), name.strip()), plain(cast("Mapping[str, Any]", arguments))


def shorthand(text: str) -> tuple[str, Record]:
    """`tool`, `tool()` or `tool(x)`, where `x` goes to the tool's only required argument."""
    found = re.fullmatch(r"([A-Za-z_]\w*)\s*(?:\((.*)\))?", text.strip(), re.DOTALL)
    if found is None:
        raise ValueError(f"invalid action shorthand: {text!r}")
    name, argument = found[1], (found[2] or "").strip()
    if not argument:
        return name, {}
    key = ARGUMENTS.get(LEGACY_TOOLS.get(name, name))
    if key is None:
        raise ValueError(f"{name} shorthand is ambiguous; emit JSON arguments")
    try:
        return name, {key: json.loads(argument)}
    except ValueError:
        return name, {key: argument.strip("\"'")}


def memory_of(body: str) -> tuple[Any, Any]:
    """Summary and last action of an answer, from its first `{` to its last `}`; None for each that is
    not there."""
    first, last = body.find("{"), body.rfind("}")
    if not 0 <= first < last:
        return None, None
    try:
        found = json.loads(body[first : last + 1])
    except (ValueError, RecursionError):
        return None, None
    if not isinstance(found, dict):
        return None, None
    fields = cast("Record", found)
    action: Any = fields.get("next action")
    if isinstance(action, str):
        action = {"action_str": action}
    elif "next action" not in fields and "tool_name" in fields:
        action = fields
    elif not isinstance(action, dict):
        action = None
    return fields.get("summary", fields.get("Summary")), cast("Any", action)


def ask_limit(max_turns: int) -> int:
    """How many questions a prompt allows in a rollout of so many turns; nothing enforces it."""
    return math.ceil(0.15 * max_turns)


def scene_lines(receptacles: Sequence[tuple[str, str, str]]) -> str:
    """The scene in a prompt: a heading, then a line for each room."""
    rooms: dict[str, list[str]] = {}
    for name, _, room in receptacles:
        rooms.setdefault(room, []).append(name)
    lines = [f"{number}) In {room}: {', '.join(names)}.\n" for number, (room, names) in enumerate(rooms.items(), 1)]
    return "Rooms and their receptacles:\n" + "".join(lines)


def result_text(tool: str, text: str) -> str:
    """What a prompt shows of a tool's text."""
    return text.strip() or f"{tool} gave no text."


@dataclass
class Prompt:
    """A prompt template with its memory: each turn's prompt holds all that the model knows."""

    template: str
    """A text with the published placeholders: {TASK}, {SCENE_DESCRIPTION}, ..."""
    max_turns: int
    """Turns of a rollout."""
    summary: Any = field(default_factory=dict)  # pyright: ignore[reportUnknownVariableType]
    last_action: Any = field(default_factory=dict)  # pyright: ignore[reportUnknownVariableType]
    ask_count: int = 0
    occupied: bool = False
    """Whether the hand counts as occupied: after any pick without an error, until a place."""

    @classmethod
    def load(cls, path: str | Path | None, max_turns: int) -> Prompt:
        """A template from a file; None: the one that comes with Reel."""
        try:
            text = text_of("prompt.txt") if path is None else Path(path).read_text(encoding="utf-8")
        except OSError as error:
            raise ReelError(f"cannot read the prompt {path}: {error.strerror}; give the path of a template") from error
        return cls(text.rstrip(), max_turns)

    def update(self, answer: Answer, text: str) -> None:
        """Takes in an answer and what its call gave."""
        if answer.summary is not None:
            self.summary = answer.summary
        if answer.last_action is not None:
            self.last_action = answer.last_action
        tool = answer.call[0]
        self.ask_count += tool == "ask"
        if tool in ("pick", "place") and not any(error in text.lower() for error in ERRORS):
            self.occupied = tool == "pick"

    def render(self, task: str, scene: str, observation: str, held: str | None) -> str:
        """The prompt of the next turn.

        Args:
            task: the instruction.
            scene: rooms and receptacles (`scene_lines`).
            observation: what the last call gave, with `<image>` where its image belongs; empty before
                the first.
            held: category of what the gripper holds; None if nothing.
        """
        hand = f"holding: {held or 'an object'}" if self.occupied else "empty"
        values = {
            "SCENE_DESCRIPTION": scene,
            "TASK": task,
            "TASK_PROGRESS": json.dumps(self.summary or {}, indent=2),
            "LAST_ACTION": json.dumps(self.last_action or {}),
            "LAST_OBS": observation,
            "max_ask_limit": ask_limit(self.max_turns),
            "ask_count": self.ask_count,
            "hand_state_description": hand,
        }
        try:
            return self.template.format(**values)
        except (KeyError, IndexError, ValueError) as error:
            known = ", ".join(f"{{{name}}}" for name in values)
            raise ReelError(
                f"the prompt template cannot be filled in: {error!r}; the placeholders are {known}, and braces of the text are doubled"
            ) from error


__all__ = ["ANSWER_FORM", "Answer", "Prompt", "read_answer", "result_text", "scene_lines"]
