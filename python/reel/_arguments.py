"""Arguments that have a range: checked before the native part converts them."""

from __future__ import annotations

import operator
import os
from typing import SupportsIndex

from ._reel import ReelError

U32_MAX = 2**32 - 1
U64_MAX = 2**64 - 1


class ArgumentError(ReelError, ValueError):
    """An argument is out of its range; the text names the argument and the range."""


def whole(name: str, value: SupportsIndex, low: int = 0, high: int = U64_MAX) -> int:
    """An integer from `low` to `high`.

    Raises:
        ArgumentError: it is smaller or larger.
    """
    number = operator.index(value)
    if not low <= number <= high:
        raise ArgumentError(f"{name}={number}: give an integer from {low} to {high}")
    return number


def threads(jobs: SupportsIndex | None) -> int:
    """How many threads work: `jobs`, or one for each core if it is None."""
    if jobs is None:
        return os.cpu_count() or 1
    number = operator.index(jobs)
    if not 1 <= number <= U32_MAX:
        raise ArgumentError(f"jobs={number}: give an integer from 1 on, or None for one for each core")
    return number


def call_index(call: SupportsIndex, count: int) -> int:
    """The index from 0 of a call of an episode with `count` calls, of which negative ones count from
    the end. `count` itself is the state after the last call.

    Raises:
        ArgumentError: the episode has no such call.
    """
    number = operator.index(call)
    if not -count <= number <= count:
        raise ArgumentError(
            f"unknown call {number}: the episode has {count} calls, from 0; negative ones count from the end, down to {-count}"
        )
    return number + count if number < 0 else number


def place_in_group(group: tuple[str, int] | None) -> tuple[str, int] | None:
    """A prompt group with the index of the rollout in it, in range."""
    return None if group is None else (group[0], whole("index in group", group[1], 0, U32_MAX))


__all__ = ["ArgumentError", "call_index", "place_in_group", "threads", "whole"]
