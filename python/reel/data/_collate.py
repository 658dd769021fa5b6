"""Samples as one batch."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


def collate(samples: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Samples as one batch, a `collate_fn` for PyTorch's loader: numbers and frames as tensors (or
    NumPy arrays where PyTorch is missing), everything else, also what is sometimes None, as lists.

    Integers are int64, or uint64 where one needs it; if neither type holds all of them, they stay a
    list. Integers beside floats are float64, unless that would round one: then they stay a list, too.
    Frames are stacked to N x 480 x 640 x 3, uint8.
    """
    batch: dict[str, Any] = {}
    for name in samples[0]:
        values: list[Any] = [sample[name] for sample in samples]
        kinds: set[type[Any]] = {type(value) for value in values}
        if kinds <= {bool}:
            batch[name] = tensor(np.asarray(values))
        elif kinds <= {int, float} and (dtype := number_type(values)) is not None:
            batch[name] = tensor(np.asarray(values, dtype))
        elif kinds == {np.ndarray} and len({(value.shape, value.dtype) for value in values}) == 1:
            batch[name] = tensor(np.stack(values))
        else:
            batch[name] = values
    return batch


def number_type(values: Sequence[int | float]) -> type[np.number[Any]] | None:
    """The type that holds all numbers exactly; None if there is none."""
    whole = [value for value in values if isinstance(value, int)]
    low, high = min(whole, default=0), max(whole, default=0)
    if len(whole) < len(values):
        return np.float64 if max(-low, high) <= 2**53 else None
    if -(2**63) <= low and high < 2**63:
        return np.int64
    return np.uint64 if low >= 0 and high < 2**64 else None


def tensor(array: NDArray[Any]) -> Any:
    """An array as a tensor of PyTorch where it is loaded."""
    torch: Any = sys.modules.get("torch")
    return array if torch is None else torch.from_numpy(array)


__all__ = ["collate"]
