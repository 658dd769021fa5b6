"""Options of a dataset: their types and values."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal

from .._reel import ReelError

Sample = dict[str, Any]
Images = Literal["none", "recorded", "rendered", "auto"]
Moment = Literal["decision", "result"]
Verify = Literal["stored", "replay", "off"]
Transform = Callable[[Sample], Any]

IMAGES: tuple[Images, ...] = ("none", "recorded", "rendered", "auto")
MOMENTS: tuple[Moment, ...] = ("decision", "result")
VERIFY: tuple[Verify, ...] = ("stored", "replay", "off")


def check_choice(name: str, value: str, choices: Sequence[str]) -> None:
    """Refuses a value that is not among the choices."""
    if value not in choices:
        raise ReelError(f"unknown {name}='{value}': choose {', '.join(choices[:-1])} or {choices[-1]}")


__all__ = ["IMAGES", "MOMENTS", "VERIFY", "Images", "Moment", "Sample", "Transform", "Verify", "check_choice"]
