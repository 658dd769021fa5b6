"""Samples as a stream, split over worker processes and ranks."""

from __future__ import annotations

import functools
import importlib.util
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, Concatenate, Literal, ParamSpec, TypeVar

import numpy as np

from .._reel import ReelError
from ._options import check_choice
from ._orders import Indices
from ._workers import SharedNumber, distributed, worker_of

if TYPE_CHECKING:
    from ._dataset import Dataset


P = ParamSpec("P")
D = TypeVar("D")
S = TypeVar("S")


def method_of(stream: Callable[Concatenate[D, P], S]) -> Callable[Concatenate[D, P], S]:
    """A class of streams as a method of the dataset that it is made of, with the arguments of the class."""

    @functools.wraps(stream, assigned=("__doc__",), updated=())
    def iterable(dataset: D, *args: P.args, **options: P.kwargs) -> S:
        return stream(dataset, *args, **options)

    return iterable


class IterableDataset:
    """The samples of a dataset as a stream, split over worker processes and ranks.

    The order of an epoch is a list of all samples (`Dataset.order`). It is cut into *steps* of
    `ranks * batch_size` samples; of each step a rank gets its run of `batch_size` samples, its
    batch. The batches of a rank go to its worker processes in turn, which is the turn in which
    PyTorch's `DataLoader` takes them.

    - What a `DataLoader(stream, batch_size=B, num_workers=W)` yields is the same for every W, if
      `batch_size=B` is also said here (1 for a loader with `batch_size=None`).
    - The samples of a step are the same for every number of ranks with the same
      `ranks * batch_size`.

    `state_dict` and `load_state_dict` go on in the middle of an epoch with exactly the next sample:

    - in one process: at any sample;
    - with torchdata's `StatefulDataLoader`: it saves and loads the state of each worker, for the
      same number of workers;
    - with a plain `DataLoader` and workers, which read ahead: `state_dict(batches=N)` after N
      batches of this rank; any number of workers, and of ranks, may go on from there.

    In a process with PyTorch it is an instance of `torch.utils.data.IterableDataset`.

    Args:
        dataset: the samples.
        batch_size: the `batch_size` of the loader; with another one all samples still come once, but
            their order depends on the number of workers.
        shuffle_seed: seed of the order; None: that of the dataset, else the order of the rows.
        shuffle_window: episodes whose samples are shuffled together (`Dataset.order`).
        rank: index of this process among those that train together; None: as `torch.distributed`
            or the variables RANK and WORLD_SIZE say, else 0 of 1.
        ranks: number of those processes.
        uneven: what becomes of a last step with fewer samples: `drop` leaves out at most
            `ranks - 1` samples, so that all ranks get equally many; `keep` gives some ranks one
            more.
    """

    def __init__(
        self,
        dataset: Dataset,
        *,
        batch_size: int = 1,
        shuffle_seed: int | None = None,
        shuffle_window: int | None = None,
        rank: int | None = None,
        ranks: int | None = None,
        uneven: Literal["drop", "keep"] = "drop",
    ) -> None:
        check_choice("uneven", uneven, ("drop", "keep"))
        if batch_size < 1:
            raise ReelError(f"batch_size={batch_size}: give at least 1")
        if (rank is None) != (ranks is None):
            raise ReelError("give rank and ranks, or neither")
        here, all_of_them = distributed() if rank is None or ranks is None else (rank, ranks)
        if not 0 <= here < all_of_them:
            raise ReelError(f"rank={here}: there are {all_of_them} ranks, from 0")
        self.dataset = dataset
        self.batch_size = batch_size
        self.shuffle_seed = dataset.shuffle_seed if shuffle_seed is None else shuffle_seed
        self.shuffle_window = shuffle_window
        self.rank = here
        self.ranks = all_of_them
        self.uneven = uneven
        self._epoch = SharedNumber(0)
        self._start = 0
        self._yielded = 0
        self._state_epoch = 0
        self._resume = False
        self._resume_worker = (0, 1)
        register_with_torch()

    # --- epochs

    @property
    def epoch(self) -> int:
        """The epoch that the next iteration goes through."""
        return self._epoch.value

    def set_epoch(self, epoch: int) -> None:
        """Chooses the epoch, from 0, and with it the order. Worker processes that persist see it,
        too. Choosing the epoch that was loaded keeps the place in it."""
        self._epoch.value = epoch

    def __len__(self) -> int:
        """Samples of a whole epoch for this rank."""
        return len(self._of_rank(np.arange(len(self.dataset), dtype=np.int64)))

    def order(self) -> Indices:
        """The indices of all samples in this epoch, for all ranks, in order."""
        return self.dataset.order(
            self.epoch, shuffle_seed=self.shuffle_seed, shuffle_window=self.shuffle_window
        )

    def _of_rank(self, order: Indices) -> Indices:
        """The part of an order that this rank gets."""
        size, ranks = self.batch_size, self.ranks
        whole = len(order) // (size * ranks)
        full = order[: whole * size * ranks].reshape(whole, ranks, size)[:, self.rank].reshape(-1)
        rest = order[whole * size * ranks :]
        each, more = divmod(len(rest), ranks)
        if self.uneven == "drop":
            return np.concatenate([full, rest[self.rank * each :][:each]])
        first = self.rank * each + min(self.rank, more)
        return np.concatenate([full, rest[first : first + each + (self.rank < more)]])

    def __iter__(self) -> Iterator[Any]:
        if not self._resume or self._state_epoch != self.epoch:
            self._start = self._yielded = 0
        self._resume = False
        self._state_epoch = self.epoch
        here = worker_of()
        if self._yielded and here != self._resume_worker:
            raise ReelError(
                "the state that was loaded is in the middle of a batch: worker processes can go on only after a whole one; "
                "save state_dict(batches=N)"
            )
        return self._samples(*here)

    def _samples(self, worker: int, workers: int) -> Iterator[Any]:
        mine = self._of_rank(self.order()[self._start :])
        # every `workers`-th batch
        batch = np.arange(len(mine)) // self.batch_size
        mine = mine[batch % workers == worker]
        for index in mine[self._yielded :].tolist():
            sample = self.dataset[index]
            # before the sample is given away: a state that is taken now is that after it
            self._yielded += 1
            yield sample

    # --- resuming

    def state_dict(self, batches: int | None = None) -> dict[str, Any]:
        """Where the iteration is: numbers and texts.

        Args:
            batches: batches that this rank took in this epoch from a plain `DataLoader` with worker
                processes, since the epoch began or `load_state_dict` was called. None: the place of
                the iteration in this process.
        """
        worker, workers = worker_of()
        start, yielded = self._start, self._yielded
        if self._state_epoch != self.epoch:
            start = yielded = 0
        if batches is not None:
            count = len(self.dataset)
            start, yielded = min(start + batches * self.batch_size * self.ranks, count), 0
            worker, workers = 0, 1
        return {
            "format": 1,
            "samples": self.dataset.fingerprint,
            "seed": self.shuffle_seed,
            "window": self.shuffle_window,
            "epoch": self.epoch,
            "start": start,
            "yielded": yielded,
            "worker": worker,
            "workers": workers,
            "rank": self.rank,
            "ranks": self.ranks,
            "batch_size": self.batch_size,
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Goes on from a state: the next iteration begins there.

        Raises:
            ReelError: the state is of other samples or another order, or of a worker of another
                number of workers.
        """
        wanted = {"format": 1, "samples": self.dataset.fingerprint, "seed": self.shuffle_seed, "window": self.shuffle_window}
        for key, value in wanted.items():
            if state.get(key) != value:
                raise ReelError(
                    f"the state is of another dataset: its {key} is {state.get(key)!r}, here it is {value!r}; make the "
                    "dataset with the store version, query and options that it was saved with"
                )
        worker, workers = worker_of()
        start, yielded = int(state["start"]), int(state["yielded"])
        here = {"worker": worker, "workers": workers, "rank": self.rank, "ranks": self.ranks, "batch_size": self.batch_size}
        if state["workers"] == 1 and (state["ranks"] == 1 or yielded % state["batch_size"] == 0):
            # any split of what is left goes on from there
            start, yielded = min(start + yielded * int(state["ranks"]), len(self.dataset)), 0
        elif yielded and any(state[key] != value for key, value in here.items()):
            if state["workers"] > 1:
                raise ReelError(
                    f"the state is of worker {state['worker']} of {state['workers']}, this is worker {worker} of "
                    f"{workers}; load it with the same numbers of workers and ranks and the same batch size, or save "
                    "state_dict(batches=N)"
                )
            raise ReelError(
                f"the state is in the middle of a batch of rank {state['rank']} of {state['ranks']}; another number of "
                "ranks or workers can go on only after a whole batch"
            )
        self._epoch.value = self._state_epoch = int(state["epoch"])
        self._start, self._yielded = start, yielded
        self._resume = True
        self._resume_worker = (worker, workers)

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        register_with_torch()

    def __repr__(self) -> str:
        return (
            f"<IterableDataset of {len(self.dataset)} samples, epoch {self.epoch}, rank {self.rank} of {self.ranks}, "
            f"batches of {self.batch_size}>"
        )


def register_with_torch() -> None:
    """Makes `IterableDataset` one of PyTorch's, where PyTorch is installed: its loader asks."""
    if importlib.util.find_spec("torch") is not None:
        from torch.utils.data import IterableDataset as Base  # pyright: ignore

        if not issubclass(IterableDataset, Base):
            # its metaclass is that of abstract classes
            Base.register(IterableDataset)  # pyright: ignore


__all__ = ["IterableDataset"]
