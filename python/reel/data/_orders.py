"""Orders of an epoch, equal on every machine."""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.int64]


def shuffled_keys(count: int, seed: int, epoch: int) -> NDArray[np.uint64]:
    """A number for each index that sorting shuffles by: SplitMix64, equal on every machine and with
    every version of NumPy."""
    start = int.from_bytes(hashlib.blake2b(f"{seed} {epoch}".encode(), digest_size=8).digest(), "little")
    state = np.arange(1, count + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(start)
    state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return state ^ (state >> np.uint64(31))


__all__ = ["Indices", "shuffled_keys"]
