"""Gymnasium spaces of texts and of tool calls."""

from __future__ import annotations

import string
from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from gymnasium import spaces

from ._calls import ToolSet

SAMPLED = frozenset(string.ascii_letters + string.digits + string.punctuation + " \n")
"""Characters that samples consist of."""

TEXT_MAX = 1 << 16
"""Characters of a text in an observation; a longer one is cut."""

SAMPLE_MAX = 64
"""Characters of a sampled text."""


class UnicodeText(spaces.Text):
    """Texts of any Unicode characters.

    `gymnasium.spaces.Text` lists its characters one by one, which is too many for Unicode. Here
    every text up to the length is a member; samples are short and ASCII. Flattened, other characters
    count as question marks.
    """

    def __init__(self, max_length: int = TEXT_MAX, seed: int | np.random.Generator | None = None) -> None:
        super().__init__(max_length, min_length=0, charset=SAMPLED, seed=seed)

    def contains(self, x: Any) -> bool:
        """Whether it is a text of at most the length."""
        return isinstance(x, str) and len(x) <= self.max_length

    def sample(self, mask: Any = None, probability: Any = None) -> str:
        """A short ASCII text."""
        if mask is not None or probability is not None:
            return super().sample(mask, probability)
        length = int(self.np_random.integers(min(self.max_length, SAMPLE_MAX) + 1))
        picked = self.np_random.integers(len(self.character_list), size=length)
        return "".join(self.character_list[int(index)] for index in cast("list[int]", picked.tolist()))

    def character_index(self, char: str) -> np.int32:
        """The index of a character; that of the question mark for those that are not listed."""
        return super().character_index(char if char in self.character_set else "?")

    def __repr__(self) -> str:
        return f"UnicodeText({self.max_length})"

    def __eq__(self, other: object, /) -> bool:
        return isinstance(other, UnicodeText) and self.max_length == other.max_length

    __hash__ = None  # pyright: ignore[reportAssignmentType]


class ToolCallSpace(spaces.Dict):
    """Tool calls: `tool` is an index into `names`, `argument` its argument as text.

    A marker is written as its number; tools without an argument ignore it. Samples are calls that
    can be made: receptacles of the home, small marker numbers, words of the instruction.
    """

    def __init__(self, tools: ToolSet, seed: int | None = None) -> None:
        self.names = list(tools.names)
        """Names of the tools, by index."""
        self._arguments = list(tools.arguments)
        self._receptacles: list[str] = []
        self._words: list[str] = []
        super().__init__(  # pyright: ignore[reportUnknownMemberType]
            {"tool": spaces.Discrete(len(self.names)), "argument": UnicodeText()}, seed=seed
        )

    def set_vocabulary(self, receptacles: Sequence[str], instruction: str) -> None:
        """What samples are made of, of the episode that runs.

        Args:
            receptacles: names that a robot can go to.
            instruction: the task in words, of which objects are named.
        """
        self._receptacles = list(receptacles)
        self._words = sorted({word.strip(string.punctuation).lower() for word in instruction.split()} - {""})

    def sample(self, mask: Any = None, probability: Any = None) -> dict[str, Any]:
        """A call that can be made."""
        drawn = super().sample(mask, probability)
        if mask is None and probability is None:
            drawn["argument"] = self._argument(int(drawn["tool"]))
        return drawn

    def _argument(self, tool: int) -> str:
        random = self["argument"].np_random
        name = self._arguments[tool]
        if name is None:
            return ""
        if name == "marker_id":
            return str(random.integers(1, 9))
        known = self._receptacles if name == "receptacle_name" else self._words
        return known[random.integers(len(known))] if known else ""


__all__ = ["TEXT_MAX", "ToolCallSpace", "UnicodeText"]
