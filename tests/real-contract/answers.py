"""How REAL's four published clients read a model's answer, and what each remembers of it (docs/spec.md#answers).

Written from the contract and proven against `answers.json` and `memory.json`; it shares no code with Reel.
"""

import json
import re

TOOLS = {
    "list_receptacles": (),
    "navigate_to": ("receptacle_name",),
    "explore_receptacle": (),
    "focus_on": ("marker_id",),
    "find_objects": ("target_category",),
    "highlight_receptacles": (),
    "pick": ("marker_id",),
    "place": ("marker_id",),
    "open": ("marker_id",),
    "close": ("marker_id",),
}
"""The ten tools that every server lists, each with its required arguments."""

MODEL_TOOLS = {**TOOLS, "finish": (), "ask": ("question",)}
"""The tools that the trainer's prompt offers to the model."""

OLD_NAMES = {
    "nav_to": "navigate_to",
    "walk_around": "explore_receptacle",
    "show_receptacles": "highlight_receptacles",
    "show_object_by_category": "find_objects",
    "gaze_at": "focus_on",
    "place_on_top": "place",
}
"""Names of earlier releases, which the agent and the trainer still understand."""

PARSE_FAILED = "⟦parse failed⟧"
"""Stands for the entry that the scheduler's history gets when an answer is not strict JSON."""

RAW_CHARS = 100
"""Characters of an unreadable answer that the scheduler keeps as its last action."""


class Unreadable(ValueError):
    """The parser finds no action in an answer. The text says why."""


def canonical(name):
    """Today's name of a tool."""
    return OLD_NAMES.get(name, name)


def after_think(text):
    """The part of an answer behind its last `</think>`."""
    return text.rsplit("</think>", 1)[-1].strip()


def json_objects(text):
    """The objects that decode at each `{` of a text, in order; nested ones too."""
    decoder = json.JSONDecoder()
    for match in re.finditer(r"\{", text):
        try:
            value, _ = decoder.raw_decode(text, match.start())
        except ValueError:
            continue
        if isinstance(value, dict):
            yield value


def parse_agent(text):
    """The evaluation agent: the first object that decodes. Returns summary, tool_name and arguments."""
    body = after_think(text)
    if body.startswith("```"):
        body = re.sub(r"^```[A-Za-z]*\s*", "", body)
    answer = next(json_objects(body), None)
    if answer is None:
        raise Unreadable("no_json")
    action = answer.get("next_action") or answer.get("next action") or answer.get("action")
    if not isinstance(action, dict):
        raise Unreadable("no_action_object")
    name = action.get("tool_name") or action.get("name")
    if not isinstance(name, str) or not name:
        raise Unreadable("no_tool_name")
    arguments = action.get("args", action.get("arguments", {}))
    if not isinstance(arguments, dict):
        raise Unreadable("args_not_object")
    summary = answer.get("summary", {})
    if not isinstance(summary, dict):
        summary = {"history": str(summary)}
    return {"summary": summary, "tool_name": canonical(name), "arguments": arguments}


def parse_trainer(text):
    """The trainer's environment: the first usable object at any `{`. Returns the name as asked, the canonical one, arguments."""
    if not text.strip():
        raise Unreadable("empty")
    for answer in json_objects(after_think(text)):
        action = answer.get("next action", answer.get("next_action", answer))
        usable = shorthand(action) if isinstance(action, str) else call_of(action)
        if usable:
            name, arguments = usable
            return {"requested_tool_name": name, "tool_name": canonical(name), "arguments": arguments}
    raise Unreadable("no_action")


def call_of(action):
    """The name and the arguments of an action that is an object, or `None` if it is no call."""
    if not isinstance(action, dict):
        return None
    name = action.get("tool_name") or action.get("tool") or action.get("name")
    arguments = action.get("args", action.get("arguments", {}))
    arguments = {} if arguments is None else arguments
    if not isinstance(name, str) or not name.strip() or not isinstance(arguments, dict):
        return None
    return name.strip(), arguments


def shorthand(action):
    """The call that a text such as `pick(2)` stands for: its value goes to the only required argument."""
    match = re.fullmatch(r"\s*([A-Za-z_]\w*)\s*(?:\((.*)\))?\s*", action, re.DOTALL)
    if not match:
        return None
    name, inner = match.group(1), (match.group(2) or "").strip()
    if not inner:
        return name, {}
    required = MODEL_TOOLS.get(canonical(name), ())
    if len(required) != 1:
        return None
    return name, {required[0]: literal(inner)}


def literal(text):
    """The JSON value of a text, a quoted text without its quotes, or the text itself."""
    try:
        return json.loads(text)
    except ValueError:
        if len(text) >= 2 and text[0] == text[-1] == "'":
            return text[1:-1]
        return text


class GymMemory:
    """What the trainer's gym remembers: the two fields keep their values when an answer is not JSON."""

    def __init__(self, task_progress=None, last_action=None):
        self.task_progress = {} if task_progress is None else task_progress
        self.last_action = {} if last_action is None else last_action
        self.ask_count = 0

    def read(self, text):
        body = after_think(text)
        start, end = body.find("{"), body.rfind("}")
        try:
            answer = json.loads(body[start : end + 1]) if start >= 0 else {}
        except ValueError:
            return
        for key in ("summary", "Summary"):
            if key in answer:
                self.task_progress = answer[key]
                break
        if "next action" in answer:
            action = answer["next action"]
            if isinstance(action, str):
                self.last_action = {"action_str": action}
            elif isinstance(action, dict):
                self.last_action = action
        elif "tool_name" in answer:
            self.last_action = answer


class SchedulerMemory:
    """What the trainer's scheduler puts into the next prompt: a history that counts itself, and the last action."""

    def __init__(self):
        self.lines, self.last_action, self.ask_count = [], {}, 0

    def read(self, text):
        try:
            answer = json.loads(after_think(text))
            history = answer["summary"]["History"] if "summary" in answer and "History" in answer["summary"] else ""
            history = history.strip() if history else ""
        except (ValueError, TypeError, AttributeError):
            self.lines.append(PARSE_FAILED)
            self.last_action = {"raw": text[:RAW_CHARS]}
            return
        if history:
            self.lines.append(re.sub(r"^\d+\)\s*", "", history.splitlines()[-1]))
        if "next action" in answer:
            self.last_action = answer["next action"]

    @property
    def task_progress(self):
        """The text of the prompt's slot."""
        if not self.lines:
            return "{}"
        return "{'History': '" + "\n".join(f"{i}) {line}" for i, line in enumerate(self.lines)) + "'}"


class AgentMemory:
    """What the evaluation agent keeps between two decisions."""

    def __init__(self):
        self.task_progress, self.last_action, self.observation = {}, {}, ""

    def decide(self, text):
        """Reads an answer. Fails if there is no action in it, which ends the episode."""
        answer = parse_agent(text)
        self.task_progress = answer["summary"]
        self.last_action = {"tool_name": answer["tool_name"], "args": answer["arguments"]}
        return answer

    def observe(self, result_type, text, images):
        """Keeps the result of a call: its text, or one mark an image."""
        self.observation = f"Images: {' '.join(['<image>'] * images)}" if result_type == "image" else f"Text: {text}"
