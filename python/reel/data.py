"""Rows of a store as samples for training: for PyTorch, for `datasets`, and for plain loops.

    dataset = store.dataset("SELECT episode_id, step, tool, argument, reward FROM steps", images="auto")
    dataset[0]                      # a dictionary: the columns, and `frame`, `verdict`, `digest`
    DataLoader(dataset, batch_size=32, num_workers=4, collate_fn=reel.data.collate)

    samples = dataset.iterable(batch_size=32, shuffle_seed=7)
    DataLoader(samples, batch_size=32, num_workers=4, collate_fn=reel.data.collate)

PyTorch and `datasets` are optional: indexing and iteration work without them.
"""

from __future__ import annotations

import ctypes
import hashlib
import importlib
import importlib.util
import inspect
import json
import marshal
import os
import re
import sys
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, SupportsIndex

import numpy as np
from numpy.typing import NDArray

from ._reel import SIM_VERSION, ReelError
from ._types import Image

if TYPE_CHECKING:
    from ._episode import Episode
    from ._store import Store

Sample = dict[str, Any]
Images = Literal["none", "recorded", "rendered", "auto"]
Moment = Literal["decision", "result"]
Verify = Literal["stored", "replay", "off"]
Transform = Callable[[Sample], Any]
PathLike = str | os.PathLike[str]
Indices = NDArray[np.int64]

IMAGES: tuple[Images, ...] = ("none", "recorded", "rendered", "auto")
MOMENTS: tuple[Moment, ...] = ("decision", "result")
VERIFY: tuple[Verify, ...] = ("stored", "replay", "off")

UNVERIFIED = "unverified"
"""The verdict of an episode without a replay."""


class Dataset:
    """The rows of a query as samples, by index (map-style).

    A sample is a dictionary of the query's columns. If the query has the column `episode_id`, a
    sample also has `digest` (chain digest of the trace) and `verdict` (what a replay found); with
    the columns `episode_id` and `step` it has `frame` (480 x 640 x 3, uint8, RGB), if `images` says
    so.

    The rows are read once, at the version that the store has then, and are kept in memory as packed
    bytes: a store that grows does not change them, worker processes share them, and a pickled
    dataset holds them. Images and replays are made when a sample is asked for, in the process that
    asks.

    Rows come in the order of the query if it ends with ORDER BY, else by `episode_id`, `step` and
    the values of the row, so that equal rows always come in the same order.

    Args:
        store: the store, or its location.
        query: a question in SQL (docs/query.md), e.g. `SELECT * FROM steps WHERE success`. Fewer
            columns are faster.
        parameters: values of its `$parameters`.
        images: `none`: samples have no `frame`. `recorded`: the image of the trace. `rendered`: the
            image is rendered again, whether or not the trace holds it. `auto`: the image of the
            trace, or rendered if the trace holds no images.
        frame_at: `decision`: the latest image that the agent had when it made the call, the input
            of a policy. `result`: the image that the call returned. None where there is no such
            image.
        verify: `stored`: the verdict of the store (table `verdicts`) for this simulator version,
            `unverified` if there is none. `replay`: episodes without a stored verdict are replayed
            when their first sample is asked for, once a process (`verify()` does it at once for
            all). `off`: samples have no `verdict`.
        shuffle_seed: seed of the epochs' order for `order` and `iterable`; None: the order of the
            rows. Indexing is not affected.
        transform: a function of a sample; its value is returned instead. It must be picklable for
            worker processes that are spawned.
        open_traces: traces that a process keeps open.

    Raises:
        ReelError: the query is wrong, or lacks a column that the options need.
    """

    def __init__(
        self,
        store: Store | PathLike,
        query: str,
        *,
        parameters: Mapping[str, Any] | None = None,
        images: Images = "none",
        frame_at: Moment = "decision",
        verify: Verify = "stored",
        shuffle_seed: int | None = None,
        transform: Transform | None = None,
        open_traces: int = 16,
    ) -> None:
        from ._store import Store

        check_choice("images", images, IMAGES)
        check_choice("frame_at", frame_at, MOMENTS)
        check_choice("verify", verify, VERIFY)
        if open_traces < 1:
            raise ReelError(f"open_traces={open_traces}: give at least 1")
        given = store if isinstance(store, Store) else Store(store)
        location = given.location
        self.location = location if "://" in location else os.path.abspath(location)
        """Where the store lies."""
        self.version = given.version
        """The version of the store that the rows come from."""
        self.query = query
        """The question in SQL."""
        self.parameters = {name: str(value) for name, value in (parameters or {}).items()}
        """Values of the query's `$parameters`."""
        self.images: Images = images
        self.frame_at: Moment = frame_at
        self.verify_mode: Verify = verify
        self.shuffle_seed = shuffle_seed
        self.transform = transform
        self.open_traces = open_traces
        pinned = Store(self.location, self.version)
        self._rows = PackedRows.read(pinned, query, self.parameters)
        self._episodes = EpisodeTable.read(pinned, self._rows)
        self._traces: OrderedDict[int, Episode] = OrderedDict()
        self._check_columns()

    # --- what it holds

    @property
    def columns(self) -> list[str]:
        """Names of the query's columns."""
        return list(self._rows.columns)

    @property
    def fields(self) -> list[str]:
        """Keys of a sample (without a transform): the columns, then `frame`, `verdict`, `digest`."""
        return [*self._rows.columns, *self._added()]

    @property
    def nbytes(self) -> int:
        """Bytes that the rows take in memory."""
        return self._rows.nbytes

    @property
    def fingerprint(self) -> str:
        """Digest of the rows in their order. Equal for equal rows, whatever the store's version."""
        return self._rows.digest

    @property
    def verdicts(self) -> dict[str, int]:
        """How many of the episodes have each verdict, as far as it is known."""
        return dict(Counter(self._episodes.verdicts))

    def verify(self, *, jobs: int | None = None, progress: bool | None = None) -> dict[str, int]:
        """Replays the episodes without a verdict, on several threads.

        Args:
            jobs: threads; None: one for each core.
            progress: whether a bar is shown; None: in terminals and notebooks.

        Returns:
            How many of the episodes have each verdict. The store is not changed.
        """
        from concurrent.futures import ThreadPoolExecutor

        from ._progress import bar

        table = self._episodes
        unknown = [index for index, verdict in enumerate(table.verdicts) if verdict == UNVERIFIED]

        def replayed(index: int) -> str:
            return self._read(index).replay().name

        with bar(len(unknown), "replay", progress) as tell, ThreadPoolExecutor(jobs or os.cpu_count() or 1) as pool:
            for index, verdict in zip(unknown, pool.map(replayed, unknown), strict=True):
                table.verdicts[index] = verdict
                if tell is not None:
                    tell(1)
        return self.verdicts

    # --- samples

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, index: SupportsIndex) -> Any:
        """A sample, or what the transform makes of it. Negative indices count from the end."""
        count = len(self._rows)
        at = int(index)
        if at < 0:
            at += count
        if not 0 <= at < count:
            raise IndexError(f"sample {int(index)} of {count}")
        return self._sample(at)

    def __getitems__(self, indices: Iterable[SupportsIndex]) -> list[Any]:
        """Samples of a batch; PyTorch's loader asks for them so."""
        return [self[index] for index in indices]

    def __iter__(self) -> Iterator[Any]:
        return map(self._sample, range(len(self._rows)))

    def _sample(self, at: int) -> Any:
        rows = self._rows
        sample: Sample = dict(zip(rows.columns, rows[at]))
        table = self._episodes
        if table.known:
            index = int(table.episode_of[at])
            if self.images != "none":
                sample["frame"] = self._frame(index, sample)
            if self.verify_mode != "off":
                verdict = None if index < 0 else table.verdicts[index]
                if verdict == UNVERIFIED and self.verify_mode == "replay":
                    verdict = self._replayed(index)
                sample["verdict"] = verdict
            sample["digest"] = None if index < 0 else table.digests[index]
        return sample if self.transform is None else self.transform(sample)

    def _frame(self, index: int, sample: Sample) -> Image | None:
        step = sample["step"]
        if index < 0 or step is None:
            return None
        episode = self._open(index)
        # -1 is before the first decision, as in view `visible_objects`
        if not -1 <= step < len(episode):
            raise ReelError(f"{self._episodes.traces[index]}: no step {step}: there are {len(episode)}, from 0")
        try:
            if self.frame_at == "result" and step >= 0:
                return self._image(episode, step)
            for call in range(step - 1, -1, -1):
                image = self._image(episode, call)
                if image is not None:
                    return image
            return self._image(episode, None)
        except ReelError as error:
            text = str(error)
            path = self._episodes.traces[index]
            raise ReelError(text if path in text else f"{path}: {text}") from error

    def _image(self, episode: Episode, call: int | None) -> Image | None:
        """The image that a call returned (None: before the first), from where `images` says."""
        trace = episode._trace  # pyright: ignore[reportPrivateUsage]
        if self.images == "recorded" and not trace.image_count:
            raise ReelError(
                f"{episode.path}: the trace holds no images; images='auto' renders those of such traces"
            )
        if self.images == "rendered" and trace.image_count:
            # which calls return an image, the trace says
            given = trace.start() if call is None else trace.step(call)
            digests: Sample = given.get("digests") or {}
            if not digests.get("frame"):
                return None
            return episode.render(call=call).rgb
        return episode.frame(call)

    def _replayed(self, index: int) -> str:
        table = self._episodes
        table.verdicts[index] = self._open(index).replay().name
        return table.verdicts[index]

    def _open(self, index: int) -> Episode:
        """The episode, from those that are open, or read."""
        episode = self._traces.get(index)
        if episode is not None:
            self._traces.move_to_end(index)
            return episode
        episode = self._traces[index] = self._read(index)
        while len(self._traces) > self.open_traces:
            self._traces.popitem(last=False)
        return episode

    def _read(self, index: int) -> Episode:
        """The episode, if it still is the one that the rows come from."""
        from ._episode import open

        path, digest = self._episodes.traces[index], self._episodes.digests[index]
        episode = open(path)
        if episode.digest != digest:
            raise ReelError(
                f"{path}: the trace was changed since its ingest (digest {episode.digest[:12]}, then "
                f"{digest[:12]}); run `reel ingest` and make the dataset again"
            )
        return episode

    # --- orders

    def order(
        self, epoch: int = 0, *, shuffle_seed: int | None = None, shuffle_window: int | None = None
    ) -> Indices:
        """The order of the samples in an epoch: indices, int64, equal on every machine.

        `DataLoader(dataset, sampler=dataset.order(epoch)[seen:])` goes through an epoch from its
        sample `seen` on.

        Args:
            epoch: from 0.
            shuffle_seed: None: that of the dataset; if it has none either, the order is that of the
                rows.
            shuffle_window: None: samples are shuffled over the whole dataset. N: episodes are
                shuffled, then the samples of N episodes at a time, so that only N traces are open
                at once.
        """
        seed = self.shuffle_seed if shuffle_seed is None else shuffle_seed
        count = len(self._rows)
        if seed is None:
            return np.arange(count, dtype=np.int64)
        keys = shuffled_keys(count, seed, epoch)
        if shuffle_window is None:
            return np.argsort(keys, kind="stable")
        if shuffle_window < 1:
            raise ReelError(f"shuffle_window={shuffle_window}: give at least 1 episode")
        if not self._episodes.known:
            raise ReelError("shuffle_window needs the column `episode_id` in the query")
        episodes = self._episodes.episode_of
        # rows without an episode count as one more
        count_episodes = len(self._episodes.traces) + 1
        place = np.empty(count_episodes, dtype=np.int64)
        place[np.argsort(shuffled_keys(count_episodes, seed ^ 0x9E37, epoch), kind="stable")] = np.arange(count_episodes)
        return np.lexsort((keys, place[episodes] // shuffle_window)).astype(np.int64)

    def iterable(
        self,
        *,
        batch_size: int = 1,
        shuffle_seed: int | None = None,
        shuffle_window: int | None = None,
        rank: int | None = None,
        ranks: int | None = None,
        uneven: Literal["drop", "keep"] = "drop",
    ) -> IterableDataset:
        """The samples as a stream that is split over worker processes and ranks
        (`IterableDataset`, which documents the arguments)."""
        return IterableDataset(
            self,
            batch_size=batch_size,
            shuffle_seed=shuffle_seed,
            shuffle_window=shuffle_window,
            rank=rank,
            ranks=ranks,
            uneven=uneven,
        )

    # --- datasets

    def to_hf(
        self,
        *,
        streaming: bool = False,
        cache_dir: PathLike | None = None,
        num_proc: int | None = None,
        shards: int = 64,
    ) -> Any:
        """The samples as a `datasets.Dataset`, in the order of the rows.

        Args:
            streaming: a `datasets.IterableDataset`, whose samples are made when they are asked for,
                instead of a `datasets.Dataset`, whose samples (frames as PNG included) are written
                to the cache once.
            cache_dir: folder of the cache; None: that of `datasets`. A dataset of the same store
                version, query and options is found there again.
            num_proc: processes that write the cache.
            shards: parts of a streaming dataset, which worker processes share.

        Raises:
            ReelError: `datasets` is not installed, or the dataset is empty.
        """
        datasets = needed("datasets", "datasets")
        if not len(self):
            raise ReelError("the query gives no rows: nothing to make a dataset of")
        if self.images != "none":
            needed("PIL", "datasets")
        features = None if self.transform is not None else self._features(datasets)
        parts = min(len(self), shards if streaming else num_proc or 1)
        bounds = np.linspace(0, len(self), parts + 1).astype(int).tolist()
        arguments = {"dataset": self, "ranges": list(zip(bounds[:-1], bounds[1:], strict=True))}
        if streaming:
            return datasets.IterableDataset.from_generator(generate, features=features, gen_kwargs=arguments)
        made = datasets.Dataset.from_generator
        # older versions hash the arguments, which is slower
        known = "fingerprint" in inspect.signature(made).parameters
        return made(
            generate,
            features=features,
            gen_kwargs=arguments,
            cache_dir=None if cache_dir is None else os.fspath(cache_dir),
            num_proc=num_proc,
            **({"fingerprint": self._cache_key(datasets)} if known else {}),
        )

    def _cache_key(self, datasets: Any) -> str:
        """What the samples depend on, as a digest."""
        transform = None if self.transform is None else datasets.fingerprint.Hasher.hash(self.transform)
        parts = [
            self.location, self.version, self.query, self.parameters, self.fingerprint, self.images, self.frame_at,
            self.verify_mode, self._episodes.digests, self._episodes.verdicts, SIM_VERSION, transform,
        ]  # fmt: skip
        return hashlib.blake2b(json.dumps(parts).encode(), digest_size=16).hexdigest()

    def _features(self, datasets: Any) -> Any:
        """Types of the samples, from those of the columns."""
        pa = needed("pyarrow", "datasets")
        from ._store import Store

        batches = Store(self.location, self.version).sql(self.query, parameters=self.parameters, stream=True)
        fields = [(field.name, plain_type(pa, field.type)) for field in pa.schema(batches)]
        features = datasets.Features.from_arrow_schema(pa.schema(fields))
        for name in self._added():
            features[name] = datasets.Image() if name == "frame" else datasets.Value("string")
        return features

    # --- as an object

    def _added(self) -> list[str]:
        """Keys that a sample has beside the columns."""
        if not self._episodes.known:
            return []
        names = ["frame"] if self.images != "none" else []
        return [*names, *(["verdict"] if self.verify_mode != "off" else []), "digest"]

    def _check_columns(self) -> None:
        columns = self._rows.columns
        if self.images != "none" and len(self):
            missing = [name for name in ("episode_id", "step") if name not in columns]
            if missing:
                raise ReelError(
                    f"images='{self.images}' needs the column{'s' * (len(missing) > 1)} {' and '.join(missing)} in the "
                    "query: `SELECT episode_id, step, ... FROM steps`"
                )
        taken = [name for name in self._added() if name in columns]
        if taken:
            raise ReelError(
                f"the query has a column `{taken[0]}`, which every sample has already; give it another name: "
                f"`{taken[0]} AS my_{taken[0]}`"
            )

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_traces": OrderedDict()}

    def __repr__(self) -> str:
        return f"<Dataset of {len(self)} samples ({', '.join(self.fields)}), {self.location} version {self.version}>"


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


# --- rows


class PackedRows:
    """Rows as bytes, one after the other. Reading one takes a few microseconds and no library, and
    processes that are forked share the memory, because reading changes no reference count in it."""

    def __init__(self, columns: tuple[str, ...], data: bytes, offsets: Indices) -> None:
        self.columns = columns
        self._data = data
        self._offsets = offsets
        self._digest: str | None = None

    @classmethod
    def read(cls, store: Store, query: str, parameters: Mapping[str, str]) -> PackedRows:
        """Answers a query and packs the rows, in the query's order if it has one, else sorted."""
        columns: tuple[str, ...] = ()
        packed: list[bytes] = []
        keys: list[tuple[str, int]] = []
        ordered = ends_with_order(query)
        for batch in store.sql(query, parameters=parameters, stream=True):
            columns = tuple(batch.columns)
            rows = tuples(batch)
            if not ordered:
                places = [columns.index(name) if name in columns else None for name in ("episode_id", "step")]
                keys += [sort_key(row, *places) for row in rows]
            # version 2 of the format: equal values give equal bytes
            packed += [marshal.dumps(row, 2) for row in rows]
        if not ordered:
            packed = [row for _, row in sorted(zip(keys, packed, strict=True))]
        offsets = np.zeros(len(packed) + 1, dtype=np.int64)
        np.cumsum([len(row) for row in packed], out=offsets[1:])
        return cls(columns, b"".join(packed), offsets)

    def __len__(self) -> int:
        return len(self._offsets) - 1

    def __getitem__(self, at: int) -> tuple[Any, ...]:
        start, end = self._offsets[at : at + 2].tolist()
        return marshal.loads(self._data[start:end])

    def column(self, name: str) -> Iterator[Any]:
        """The values of a column."""
        at = self.columns.index(name)
        return (self[row][at] for row in range(len(self)))

    @property
    def nbytes(self) -> int:
        """Bytes in memory."""
        return len(self._data) + self._offsets.nbytes

    @property
    def digest(self) -> str:
        """Digest of the columns and all rows in order."""
        if self._digest is None:
            hasher = hashlib.blake2b("\n".join(self.columns).encode(), digest_size=16)
            hasher.update(self._offsets.tobytes())
            hasher.update(self._data)
            self._digest = hasher.hexdigest()
        return self._digest


class EpisodeTable:
    """The episodes that rows belong to."""

    def __init__(self, known: bool, episode_of: NDArray[np.int32]) -> None:
        self.known = known
        """Whether rows name their episode."""
        self.episode_of = episode_of
        """Index of each row's episode in the lists; -1: none."""
        self.traces: list[str] = []
        self.digests: list[str] = []
        self.verdicts: list[str] = []

    @classmethod
    def read(cls, store: Store, rows: PackedRows) -> EpisodeTable:
        """Looks up the episodes of rows: trace, digest, and the verdict for this simulator version."""
        episode_of = np.full(len(rows), -1, dtype=np.int32)
        if "episode_id" not in rows.columns:
            return cls(False, episode_of)
        table = cls(True, episode_of)
        # one file may have been replayed twice: the worst finding counts
        sql = """
            SELECT e.episode_id, e.trace, e.trace_digest, v.verdict
            FROM episodes e
            LEFT JOIN (
              SELECT
                trace_digest,
                CASE
                  WHEN bool_and(verdict = 'exact') THEN 'exact'
                  WHEN bool_or(verdict = 'diverged') THEN 'diverged'
                  ELSE max(verdict)
                END AS verdict
              FROM verdicts
              WHERE sim_version = CAST($sim_version AS INT)
              GROUP BY trace_digest
            ) v ON v.trace_digest = e.trace_digest"""
        found = store.sql(sql, parameters={"sim_version": SIM_VERSION}).rows()
        by_id = {row["episode_id"]: row for row in found}
        indices: dict[str, int] = {}
        for at, episode_id in enumerate(rows.column("episode_id")):
            index = indices.get(episode_id)
            if index is None:
                row = by_id.get(episode_id)
                if row is None:
                    continue
                index = indices[episode_id] = len(table.traces)
                table.traces.append(row["trace"])
                table.digests.append(row["trace_digest"])
                table.verdicts.append(row.get("verdict") or UNVERIFIED)
            episode_of[at] = index
        return table


def sort_key(row: tuple[Any, ...], episode: int | None, step: int | None) -> tuple[str, int]:
    """Where a row belongs: by episode and step; a missing one comes first."""
    named = None if episode is None else row[episode]
    number = None if step is None else row[step]
    return (named if isinstance(named, str) else "", number if isinstance(number, int) else -2)


class ArrowSchema(ctypes.Structure):
    """The start of a schema as Arrow's C data interface has it."""


ArrowSchema._fields_ = [
    ("format", ctypes.c_char_p),
    ("name", ctypes.c_char_p),
    ("metadata", ctypes.c_char_p),
    ("flags", ctypes.c_int64),
    ("n_children", ctypes.c_int64),
    ("children", ctypes.POINTER(ctypes.POINTER(ArrowSchema))),
]


def decimal_columns(table: Any) -> list[bool]:
    """Which columns are decimals: rows have those as text, which is for seeds of 64 bits."""
    pointer_of = ctypes.pythonapi.PyCapsule_GetPointer
    pointer_of.restype, pointer_of.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    # the capsule owns the schema
    capsule = table.__arrow_c_schema__()
    schema = ArrowSchema.from_address(pointer_of(capsule, b"arrow_schema"))
    return [schema.children[at].contents.format.startswith(b"d:") for at in range(schema.n_children)]


def tuples(batch: Any) -> list[tuple[Any, ...]]:
    """The rows of a native table; decimals as int, or float where they have a fraction."""
    columns: list[str] = batch.columns
    records: list[Sample] = batch.rows(0, len(batch))
    rows: list[tuple[Any, ...]] = [tuple(map(record.get, columns)) for record in records]
    decimal = decimal_columns(batch)
    if not any(decimal):
        return rows
    return [tuple(number(value) if odd else value for value, odd in zip(row, decimal, strict=True)) for row in rows]


def number(value: Any) -> Any:
    """A decimal that is written as text; anything else as it is."""
    if not isinstance(value, str):
        return value
    return float(value) if "." in value else int(value)


def plain_type(pa: Any, kind: Any) -> Any:
    """The Arrow type that a column of samples has in `datasets`: whole decimals are integers, times
    are text. `pa` is PyArrow."""
    types = pa.types
    if types.is_list(kind) or types.is_large_list(kind):
        return pa.list_(plain_type(pa, kind.value_type))
    if types.is_struct(kind):
        return pa.struct([(field.name, plain_type(pa, field.type)) for field in kind])
    if types.is_decimal(kind):
        return pa.uint64() if kind.scale == 0 else pa.float64()
    if types.is_dictionary(kind):
        return plain_type(pa, kind.value_type)
    if re.search("string|utf8|date|time|duration|interval", str(kind)):
        return pa.string()
    return kind


def ends_with_order(query: str) -> bool:
    """Whether a query orders its rows: ORDER BY outside of parentheses, texts and comments."""
    text = re.sub(r"--[^\n]*|/\*.*?\*/|'(?:[^']|'')*'|\"(?:[^\"]|\"\")*\"", " x ", query, flags=re.DOTALL)
    inner = None
    while inner != text:
        inner, text = text, re.sub(r"\([^()]*\)", " x ", text)
    return re.search(r"\border\s+by\b", text, re.IGNORECASE) is not None


# --- orders and processes


def shuffled_keys(count: int, seed: int, epoch: int) -> NDArray[np.uint64]:
    """A number for each index that sorting shuffles by: SplitMix64, equal on every machine and with
    every version of NumPy."""
    start = int.from_bytes(hashlib.blake2b(f"{seed} {epoch}".encode(), digest_size=8).digest(), "little")
    state = np.arange(1, count + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(start)
    state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return state ^ (state >> np.uint64(31))


class SharedNumber:
    """An integer that worker processes share with the process that started them, whether they were
    forked or spawned; a copy by other means of pickling has its own."""

    def __init__(self, value: int) -> None:
        from multiprocessing.sharedctypes import RawValue

        self._cell: Any = RawValue("q", value)

    @property
    def value(self) -> int:
        """The number."""
        return int(self._cell.value)

    @value.setter
    def value(self, value: int) -> None:
        self._cell.value = value

    def __reduce__(self) -> tuple[Any, ...]:
        from multiprocessing.context import get_spawning_popen

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


def register_with_torch() -> None:
    """Makes `IterableDataset` one of PyTorch's, where PyTorch is installed: its loader asks."""
    if importlib.util.find_spec("torch") is not None:
        from torch.utils.data import IterableDataset as Base  # pyright: ignore

        if not issubclass(IterableDataset, Base):
            # its metaclass is that of abstract classes
            Base.register(IterableDataset)  # pyright: ignore


def tensor(array: NDArray[Any]) -> Any:
    """An array as a tensor of PyTorch where it is loaded."""
    torch: Any = sys.modules.get("torch")
    return array if torch is None else torch.from_numpy(array)


def generate(dataset: Dataset, ranges: Sequence[tuple[int, int]]) -> Iterator[Any]:
    """The samples of ranges of indices, for `datasets`."""
    for start, end in ranges:
        for index in range(start, end):
            yield dataset[index]


def needed(module: str, extra: str) -> Any:
    """A module that an extra of the package brings."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ReelError(f"this needs the module {module}: pip install 'reel[{extra}]' ({error})") from error


def check_choice(name: str, value: str, choices: Sequence[str]) -> None:
    """Refuses a value that is not among the choices."""
    if value not in choices:
        raise ReelError(f"unknown {name}='{value}': choose {', '.join(choices[:-1])} or {choices[-1]}")


__all__ = ["Dataset", "IterableDataset", "collate"]
