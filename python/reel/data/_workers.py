"""Worker processes and ranks: which one this is, and what they share."""

from __future__ import annotations

import os
import sys
from multiprocessing.context import get_spawning_popen
from multiprocessing.sharedctypes import RawValue
from typing import Any

from .._reel import ReelError


class SharedNumber:
    """An integer that worker processes share with the process that started them, whether they were
    forked or spawned; a copy by other means of pickling has its own."""

    def __init__(self, value: int) -> None:
        self._cell: Any = RawValue("q", value)

    @property
    def value(self) -> int:
        """The number."""
        return int(self._cell.value)

    @value.setter
    def value(self, value: int) -> None:
        self._cell.value = value

    def __reduce__(self) -> tuple[Any, ...]:
        if get_spawning_popen() is None:
            return SharedNumber, (self.value,)
        return SharedNumber._of, (self._cell,)

    @classmethod
    def _of(cls, cell: Any) -> SharedNumber:
        number = cls.__new__(cls)
        number._cell = cell
        return number


def worker_of() -> tuple[int, int]:
    """Index of this worker process of a PyTorch loader, and how many there are; 0 of 1 elsewhere."""
    # in such a process PyTorch is loaded
    utils = sys.modules.get("torch.utils.data")
    info = utils.get_worker_info() if utils is not None else None
    return (0, 1) if info is None else (int(info.id), int(info.num_workers))


def distributed() -> tuple[int, int]:
    """Rank of this process, and the number of ranks."""
    module = sys.modules.get("torch.distributed")
    if module is not None and module.is_available() and module.is_initialized():
        return int(module.get_rank()), int(module.get_world_size())
    try:
        return int(os.environ.get("RANK", "0")), int(os.environ.get("WORLD_SIZE", "1"))
    except ValueError as error:
        raise ReelError(f"RANK and WORLD_SIZE have to be numbers ({error}); set them, or give rank and ranks") from error


__all__ = ["SharedNumber", "distributed", "worker_of"]
