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

    Frames are stacked to N x 480 x 640 x 3, uint8.
    """
    batch: dict[str, Any] = {}
    for name in samples[0]:
        values: list[Any] = [sample[name] for sample in samples]
        kinds: set[type[Any]] = {type(value) for value in values}
        if kinds <= {bool} or kinds <= {int} or kinds <= {int, float}:
            batch[name] = tensor(np.asarray(values))
        elif kinds == {np.ndarray} and len({(value.shape, value.dtype) for value in values}) == 1:
            batch[name] = tensor(np.stack(values))
        else:
            batch[name] = values
    return batch


def tensor(array: NDArray[Any]) -> Any:
    """An array as a tensor of PyTorch where it is loaded."""
    torch: Any = sys.modules.get("torch")
    return array if torch is None else torch.from_numpy(array)


__all__ = ["collate"]
