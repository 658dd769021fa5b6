"""Tool calls out of whatever an agent answers: every answer is a call, one that the simulator
understands or one that it refuses with a text."""

from __future__ import annotations

import inspect
import json
import math
import numbers
from collections.abc import Mapping, Sequence
from typing import Any, cast

from .._play import OUTPUT_KEYS, Record, tools

Call = tuple[str, Any]
"""Name of a tool and its arguments: an object, or what the agent sent instead."""

NO_CALL: Call = ("", {})
"""An answer without a call: the simulator says so, and the step costs what an unreadable answer costs."""

RAW_MAX = 100_000
"""Characters of an unreadable answer that a trace keeps."""

DEPTH_MAX = 64
"""How deep arguments may be nested; what lies deeper becomes its text."""


def clean_text(text: str) -> str:
    """The text in Unicode that can be stored: half a surrogate pair becomes a question mark."""
    return text.encode("utf-8", "replace").decode("utf-8")


def plain(value: Any, depth: int = DEPTH_MAX) -> Any:
    """The value as JSON has it. What JSON lacks (NaN, large integers, objects) becomes its text."""
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, str):
        return clean_text(value)
    if isinstance(value, numbers.Integral):
        number = int(value)
        return number if -(2**63) <= number < 2**64 else str(number)
    if isinstance(value, numbers.Real):
        number = float(value)
        return number if math.isfinite(number) else str(number)
    if depth == 0:
        return clean_text(str(value)[:200])
    if isinstance(value, Mapping):
        entries = cast("Mapping[Any, Any]", value)
        return {clean_text(str(key)): plain(entry, depth - 1) for key, entry in entries.items()}
    if isinstance(value, Sequence) and not isinstance(value, (bytes, bytearray)):
        return [plain(item, depth - 1) for item in cast("Sequence[Any]", value)]
    return clean_text(str(value))


def parsed(text: str) -> Any:
    """The text as JSON; the text itself where it is none."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text


class ToolSet:
    """The tools of a profile, by index and by name."""

    def __init__(self, profile: str) -> None:
        self.profile = profile
        self.specs: list[Record] = tools(profile)
        self.names: list[str] = [spec["name"] for spec in self.specs]
        self.arguments: list[str | None] = [next(iter(spec["parameters"]["properties"]), None) for spec in self.specs]
        """Name of the argument of each tool; None for those without."""

    def functions(self) -> list[Record]:
        """The tools as OpenAI-compatible endpoints and chat templates take them."""
        return [{"type": "function", "function": spec} for spec in self.specs]

    def is_integer(self, index: int) -> bool:
        """Whether the argument of a tool is a number: a marker."""
        name = self.arguments[index]
        return name is not None and self.specs[index]["parameters"]["properties"][name]["type"] == "integer"

    def parameters(self, index: int) -> list[inspect.Parameter]:
        """The parameters of a tool as those of a Python function, whose schema libraries read."""
        name = self.arguments[index]
        if name is None:
            return []
        kind = int if self.is_integer(index) else str
        return [inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD, annotation=kind)]

    def call_at(self, index: int, argument: Any) -> Call:
        """The call of a tool by its index, with its argument as text or number. An index without a
        tool is a call that the simulator refuses."""
        if not 0 <= index < len(self.names):
            return f"tool {index}", {}
        name = self.arguments[index]
        if name is None:
            return self.names[index], {}
        value = plain(argument)
        if isinstance(value, str) and self.is_integer(index):
            digits = value.strip()
            value = int(digits) if digits.isascii() and digits.isdigit() and len(digits) < 10 else value
        return self.names[index], {name: value}

    def answer(self, action: Any) -> tuple[str, Any, Record | None]:
        """The call of an action in any form, and what the model wrote with it.

        Args:
            action: a sample of `ToolCallSpace`; `(name, arguments)` or `(index, argument)`; a mapping
                with `name` (or `tool_name`) and `arguments` (or `args`, `parameters`), which may hold
                what the model wrote (`raw`, `reasoning`, `history`, `plan`, `tokens`, `latency_ns`); any
                of them as JSON text. Anything else is an answer without a call.

        Returns:
            Name, arguments, and what the model wrote, for the trace (None if nothing).
        """
        output: Record | None = None
        if isinstance(action, str):
            output = {"raw": as_text(action)}
            action = parsed(action)
        if isinstance(action, Mapping):
            fields = {str(key): value for key, value in cast("Mapping[Any, Any]", action).items()}
            found = {key: plain(fields[key]) for key in OUTPUT_KEYS if fields.get(key) is not None}
            output = found or output
            if isinstance(fields.get("tool"), numbers.Integral):
                return *self.call_at(int(fields["tool"]), fields.get("argument", "")), output
            name = fields.get("name", fields.get("tool_name"))
            if isinstance(name, str):
                return *call(name, fields.get("arguments", fields.get("args", fields.get("parameters")))), output
            return *NO_CALL, output or {"raw": as_text(action)}
        if isinstance(action, (tuple, list)) and len(pair := cast("Sequence[Any]", action)) == 2:
            first, second = pair
            if isinstance(first, numbers.Integral):
                return *self.call_at(int(first), second), output
            if isinstance(first, str):
                return *call(first, second), output
        return *NO_CALL, output or {"raw": as_text(action)}


def call(name: str, arguments: Any) -> Call:
    """A call by name. Arguments as JSON text are read, as some endpoints send them."""
    value = parsed(arguments) if isinstance(arguments, str) and arguments.strip() else arguments
    return clean_text(name), {} if value is None or value == "" else plain(value)


def as_text(value: Any) -> str:
    """A value as text for the trace; very long ones are cut."""
    try:
        text = clean_text(value if isinstance(value, str) else str(value))[:RAW_MAX]
    except RecursionError:
        text = type(value).__name__
    return text or " "  # an empty one would not be kept


__all__ = ["NO_CALL", "Call", "ToolSet", "call", "clean_text", "parsed", "plain"]
