"""Samples by index: the rows of a query with frames and verdicts."""

from __future__ import annotations

import operator
import os
from collections import Counter, OrderedDict
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, SupportsIndex, overload

import numpy as np

from .._arguments import threads
from .._episode import Episode
from .._episode import open as open_trace
from .._progress import bar
from .._reel import ReelError
from .._store import Store
from .._types import Image, PathLike
from ._episodes import UNVERIFIED, EpisodeTable
from ._huggingface import to_hf
from ._iterable import IterableDataset, method_of
from ._options import IMAGES, MOMENTS, VERIFY, Images, Moment, Sample, Transform, Verify, check_choice
from ._orders import Indices, shuffled_keys
from ._rows import PackedRows


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

        Raises:
            ArgumentError: `jobs` is less than 1.
        """
        workers = threads(jobs)
        table = self._episodes
        unknown = [index for index, verdict in enumerate(table.verdicts) if verdict == UNVERIFIED]

        def replayed(index: int) -> str:
            return self._read(index).replay().name

        with bar(len(unknown), "replay", progress) as tell, ThreadPoolExecutor(workers) as pool:
            for index, verdict in zip(unknown, pool.map(replayed, unknown), strict=True):
                table.verdicts[index] = verdict
                if tell is not None:
                    tell(1)
        return self.verdicts

    # --- samples

    def __len__(self) -> int:
        return len(self._rows)

    @overload
    def __getitem__(self, index: SupportsIndex) -> Any: ...
    @overload
    def __getitem__(self, index: slice) -> list[Any]: ...
    def __getitem__(self, index: SupportsIndex | slice) -> Any:
        """A sample, or what the transform makes of it; of a slice, the list of its samples. Negative
        indices count from the end."""
        count = len(self._rows)
        if isinstance(index, slice):
            return [self._sample(at) for at in range(*index.indices(count))]
        at = operator.index(index)
        if at < 0:
            at += count
        if not 0 <= at < count:
            raise IndexError(f"no sample {operator.index(index)}: there are {count}, from 0")
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
        trace = episode._trace
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
        path, digest = self._episodes.traces[index], self._episodes.digests[index]
        episode = open_trace(path)
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

    iterable = method_of(IterableDataset)
    """The samples as a stream that is split over worker processes and ranks
    (`IterableDataset`, which documents the arguments)."""

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
        return to_hf(self, streaming=streaming, cache_dir=cache_dir, num_proc=num_proc, shards=shards)

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


__all__ = ["Dataset"]
