"""The prompts and answers of REAL's trainer, for `export_python.py`: one prompt a decision, filled in with what the trainer
remembers of the decisions before, and the answer that its parsers read.

Template, sentences and tool names are read from `src/prompt` and `src/world/src/tool.rs`. The texts of an episode grow
line by line, and what an answer leaves in the memory is taken from the values that the answer was made of.
"""

import functools
import json
import math
import os
import re
from pathlib import Path
from typing import NamedTuple

import orjson
from blake3 import blake3

SOURCES = Path(__file__).parents[2] / "src"
# Calls whose texts are kept.
CALLS_KEPT = 65536
# As `src/prompt/src` has it.
MAX_TURNS, ASKS_PER_TURN = 50, 0.15
RAW_LENGTH_MAX = 100
REVISION = "2"
NOTHING_NEW = "I noted nothing new."
LEGACY_TOOLS = {"place_on_top": "place"}
REPORTED_ERRORS = (
    "[[internal error]]", "error executing", "traceback", "no object in the inventory", "cannot place object into a closed",
    "not found in the marker map", "cannot find a non-occluded position", "not found in the scene", "not implemented yet",
    "not recognized", "not aligned to bread target", "selected marker_id", "hand is empty",
)  # fmt: skip

NUMBERED = re.compile(r"[0-9]+\)\s*(\S.*)", re.DOTALL)
SENTENCE_END = re.compile(r"[.!?;](?=[\t\n\f\r ])")
BREAK = "; \t\n\f\r"
PER_DECISION = re.compile(r"\{(?:TASK_PROGRESS|LAST_ACTION|LAST_OBS|ask_count|hand_state_description)\}")


class Prompts(NamedTuple):
    """The template up to the first value that changes from decision to decision, the rest, the sentences, the digest of all."""

    shared: str
    rest: str
    wording: dict
    digest: str


@functools.cache
def prompts():
    template, system = ((SOURCES / f"prompt/texts/{name}.txt").read_text() for name in ("prompt", "conversation"))
    defaults = (SOURCES / "prompt/src/wording.rs").read_text().partition("impl Default")[2]
    sentences = re.findall(r'^ +(\w+): (?:own\(\s*"((?:[^"\\]|\\.)*)",?\s*\)|String::new\(\))', defaults, re.MULTILINE | re.DOTALL)
    wording = {name: json.loads('"' + re.sub(r"\\\n\s*", "", text) + '"') for name, text in sentences}
    digest = blake3(template.encode()).hexdigest() + orjson.dumps(wording).decode() + system + REVISION
    text = template.rstrip()
    split = PER_DECISION.search(text).start()
    return Prompts(text[:split], text[split:], wording, blake3(digest.encode()).hexdigest())


@functools.cache
def tools():
    """The tools' names in the published code by their names in the paper."""
    return dict(re.findall(r'\bspec\(\s*"(\w+)",\s*"(\w+)",', (SOURCES / "world/src/tool.rs").read_text()))


def values_of(instruction, receptacles):
    """The values that all prompts of a task share; receptacles as the scene has them."""
    rooms = {}
    for receptacle in receptacles:
        rooms.setdefault(receptacle["room"], []).append(receptacle["id"])
    lines = "".join(f"{number}) In {room}: {', '.join(ids)}.\n" for number, (room, ids) in enumerate(rooms.items(), 1))
    scene = prompts().wording["scene_heading"] + lines
    return {"SCENE_DESCRIPTION": scene, "TASK": instruction, "max_ask_limit": math.ceil(MAX_TURNS * ASKS_PER_TURN)}


class Call(NamedTuple):
    """A call as the published clients know it: the tool, the action as answers have it and as prompts show it."""

    tool: str
    action: str
    shown: str


@functools.lru_cache(CALLS_KEPT)
def call_of(name, args):
    arguments = orjson.loads(args)
    if isinstance(arguments, dict) and type(arguments.get("marker_id")) in (int, float):
        arguments["marker_id"] = orjson.dumps(arguments["marker_id"]).decode()
    tool = tools().get(name) or LEGACY_TOOLS.get(name, name)
    action = {"tool_name": tool, "args": arguments}
    return Call(tool, orjson.dumps(action).decode(), json.dumps(action))


class Decisions:
    """Prompt and answer of one decision after the other."""

    def __init__(self, values):
        self.values = values
        # of the Histories in the answers
        self.history, self.lines, self.line_count, self.told_before = "", "", 0, ""
        # what the trainer remembers
        self.progress, self.progress_lines, self.last_action = "", 0, "{}"
        # what it shows of the call before: its text, none before the first
        self.observed, self.asks, self.occupied, self.held = None, 0, False, None

    def prompt(self, has_image):
        """The part of the prompt that the decisions of a task do not share."""
        _, rest, wording, _ = prompts()
        observation = ""
        if self.observed is not None:
            observation = wording["observed_image_and_text" if has_image else "observed_text"] + self.observed
        return rest.format(
            **self.values,
            ask_count=self.asks,
            hand_state_description=wording["hand_holding"].replace("{}", self.held or "an object")
            if self.occupied
            else wording["hand_empty"],
            TASK_PROGRESS=f"{{'History': '{self.progress}'}}" if self.progress else "{}",
            LAST_ACTION=self.last_action,
            LAST_OBS=observation,
        )

    def answer(self, step):
        """What the model is to say; the memory takes it in."""
        call = call_of(step.name, step.args)
        line = self.next_history(step.history)
        summary = {"History": self.history, "New Schedule": step.schedule, "Current subtask": step.subtask}
        thought = f"<think>{step.reasoning}</think>\n" if step.reasoning else ""
        body = f'{{"summary":{orjson.dumps(summary).decode()},"next action":{call.action}}}'
        answer = thought + body
        if "</think>" in body:  # REAL's trainer parses what follows the last one
            self.remember(prompts().wording["unreadable_answer"])
            self.last_action = json.dumps({"raw": answer[:RAW_LENGTH_MAX]})
        else:
            self.remember(line)
            self.last_action = call.shown
        return answer

    def observe(self, step, category):
        """Takes in what came of the call, and the category that is held then."""
        call, wording = call_of(step.name, step.args), prompts().wording
        text = step.outcome.strip()
        shown = "" if text.startswith(("{", "Debug Info:")) else text
        self.observed = shown or wording["no_text"].replace("{}", call.tool)
        self.asks += call.tool == "ask"
        if call.tool in ("pick", "place"):
            lower = self.observed.lower()
            if not any(error in lower for error in REPORTED_ERRORS):
                self.occupied = call.tool == "pick"
        self.held = category

    def next_history(self, told):
        """Makes the History of the next decision out of its prose; gives its last line, without the number."""
        lines = [line.strip() for line in told.strip().split("\n")]
        if all(map(NUMBERED.fullmatch, lines)):
            self.history, self.lines, self.line_count, self.told_before = told, "\n".join(lines), len(lines), ""
            return NUMBERED.fullmatch(lines[-1])[1]
        new = " ".join(told[shared_sentences(self.told_before, told) :].lstrip(BREAK).split())
        self.told_before = told
        if not told.strip():  # nobody wrote one
            self.history = ""
            return ""
        line = new or NOTHING_NEW
        before = f"{self.lines}\n" if self.lines else ""
        self.history = self.lines = f"{before}{self.line_count}) {line}"
        self.line_count += 1
        return line

    def remember(self, line):
        if not line:
            return
        before = f"{self.progress}\n" if self.progress else ""
        self.progress = f"{before}{self.progress_lines}) {line.strip()}"
        self.progress_lines += 1


def shared_sentences(before, told):
    """Where the sentences and clauses end with which both texts begin."""
    if told.startswith(before) and told[len(before) : len(before) + 1] in ("", *BREAK):
        return len(before)
    common = len(os.path.commonprefix((before, told)))
    return max((found.end() for found in SENTENCE_END.finditer(told, 0, common)), default=0)
