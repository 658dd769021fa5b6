"""Datasets over queries: samples, orders, splits and resuming, without PyTorch."""

from __future__ import annotations

import inspect
import os
import pickle
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import reel
from reel import data
from reel.data import Dataset, IterableDataset, _iterable
from reel.data._orders import shuffled_keys
from reel.data._rows import ends_with_order

STEPS = "SELECT episode_id, step, policy, tool, text, reward FROM steps"


def keys(samples: Any) -> list[tuple[str, int]]:
    """Which samples these are."""
    return [(sample["episode_id"], sample["step"]) for sample in samples]


def halved(sample: data.Sample) -> int:
    """A transform that can be pickled."""
    return sample["step"] // 2


# --- samples


def test_samples_have_columns_digest_and_verdict(store: reel.Store, played: Path) -> None:
    dataset = store.dataset(STEPS)
    count = store.sql("SELECT count(*) AS n FROM steps").rows()[0]["n"]
    assert len(dataset) == count == len(list(dataset))
    assert dataset.fields == [*dataset.columns, "verdict", "digest"] == list(dataset[0])
    digests = {reel.open(path).id: reel.open(path).digest for path in played.glob("*.mcap")}
    for sample in dataset:
        assert sample["digest"] == digests[sample["episode_id"]] and sample["verdict"] == "unverified"
    assert keys(dataset) == sorted(keys(dataset)), "without ORDER BY rows come by episode and step"
    assert dataset[-1] == dataset[count - 1] and dataset.__getitems__([1, -1]) == [dataset[1], dataset[-1]]
    with pytest.raises(IndexError, match=f"no sample {count}: there are {count}, from 0"):
        dataset[count]
    assert dataset[0:2] == [dataset[0], dataset[1]] and dataset[-1::-2][:1] == [dataset[-1]] and dataset[5:2] == []
    with pytest.raises(TypeError):
        dataset["tool"]  # type: ignore[call-overload]


def test_values_are_those_of_the_trace(store: reel.Store, played: Path) -> None:
    dataset = store.dataset("SELECT * FROM steps JOIN (SELECT episode_id, seed FROM episodes) USING (episode_id)")
    path = sorted(played.glob("*.mcap"))[0]
    episode = reel.open(path)
    mine = [sample for sample in dataset if sample["episode_id"] == episode.id]
    assert len(mine) == len(episode)
    for sample, step in zip(mine, episode.steps, strict=True):
        assert sample["call_name"] == step.tool and sample["text"] == step.text
        assert sample["reward"] == pytest.approx(step.reward) and sample["error_code"] == step.error
        assert [term["component"] for term in sample["terms"]] == [term["component"] for term in step.record["reward"]]
        assert sample["seed"] == 0 and isinstance(sample["seed"], int)


def test_seeds_are_integers_of_64_bits(store: reel.Store) -> None:
    query = """
        SELECT CAST(18446744073709551615 AS DECIMAL(20, 0)) AS largest, CAST(1.5 AS DECIMAL(5, 2)) AS half,
          CAST(NULL AS DECIMAL(20, 0)) AS none, DATE '2024-02-03' AS day, 'text' AS text"""
    sample = store.dataset(query)[0]
    assert sample == {"largest": 2**64 - 1, "half": 1.5, "none": None, "day": "2024-02-03", "text": "text"}


def test_order_by_is_kept_and_other_orders_are_defined(store: reel.Store) -> None:
    backwards = store.dataset(f"{STEPS} WHERE tool <> 'order by' ORDER BY reward DESC, episode_id, step")
    rewards = [sample["reward"] for sample in backwards]
    assert rewards == sorted(rewards, reverse=True) != [sample["reward"] for sample in store.dataset(STEPS)]
    assert store.dataset(STEPS).fingerprint == store.dataset(f"SELECT * FROM ({STEPS} ORDER BY reward)").fingerprint
    assert ends_with_order("SELECT 1 -- ( \nORDER\n BY x")
    for inner in ("SELECT * FROM (SELECT 1 ORDER BY 1)", "SELECT ' order by ' AS \"order by\" -- order by", "SELECT sum(x) OVER (ORDER BY y)"):
        assert not ends_with_order(inner)


def test_parameters_transform_and_pickle(store: reel.Store) -> None:
    chosen = store.dataset(f"{STEPS} WHERE policy = $policy", parameters={"policy": "oracle"}, transform=halved)
    assert 0 < len(chosen) < len(store.dataset(STEPS)) and set(chosen) == {step // 2 for step in range(max(chosen) * 2 + 2)}
    again = pickle.loads(pickle.dumps(chosen))
    assert list(again) == list(chosen) and again.fingerprint == chosen.fingerprint and repr(again) == repr(chosen)


def test_a_store_that_grows_changes_no_dataset(played: Path, tmp_path: Path) -> None:
    one, *others = sorted(played.glob("*.mcap"))
    store = reel.Store.ingest(one, tmp_path / "store")
    dataset = store.dataset(STEPS, images="auto")
    before, version = list(map(str, dataset)), dataset.version
    reel.Store.ingest(others, tmp_path / "store")
    assert list(map(str, pickle.loads(pickle.dumps(dataset)))) == before
    assert store.version > version == dataset.version and len(store.dataset(STEPS)) > len(dataset)
    pinned = Dataset(reel.Store(tmp_path / "store", version), STEPS)
    assert pinned.fingerprint == dataset.fingerprint


def test_rows_without_episodes_and_no_rows(store: reel.Store) -> None:
    counts = store.dataset("SELECT policy, count(*) AS n FROM steps GROUP BY policy")
    assert counts.fields == ["policy", "n"] and [sample["policy"] for sample in counts] == ["oracle", "wrong-receptacle"]
    empty = store.dataset(f"{STEPS} WHERE step > 1000", images="auto")
    assert len(empty) == 0 == len(list(empty.iterable(batch_size=4)))


# --- frames and verdicts


def test_frames_are_decoded_or_rendered(store: reel.Store, played: Path) -> None:
    query = "SELECT episode_id, step FROM steps WHERE policy = 'oracle' AND step < 4"
    recorded = store.dataset(query, images="recorded", open_traces=2)
    rendered = store.dataset(query, images="rendered")
    after = store.dataset(query, images="auto", frame_at="result")
    episodes = {episode.id: episode for episode in map(reel.open, played.glob("*oracle*.mcap"))}
    for index, sample in enumerate(recorded):
        episode, step = episodes[sample["episode_id"]], sample["step"]
        assert sample["frame"].shape == (480, 640, 3) and sample["frame"].dtype == np.uint8
        seen = [image for call, image in episode.frames if call is None or call < step][-1]
        assert np.array_equal(sample["frame"], seen)
        assert np.array_equal(rendered[index]["frame"], seen)
        result, expected = after[index]["frame"], episode.frame(step)
        assert (result is None) == (expected is None) and (result is None or np.array_equal(result, expected))
    assert len(recorded._traces) == 2  # pyright: ignore[reportPrivateUsage]
    lean = store.dataset("SELECT episode_id, step FROM steps WHERE policy = 'wrong-receptacle' AND step = 2", images="recorded")
    with pytest.raises(reel.ReelError, match=r"wrong-receptacle.*images='auto'"):
        lean[0]
    assert store.dataset(lean.query, images="auto")[0]["frame"].shape == (480, 640, 3)
    first = store.dataset("SELECT episode_id, -1 AS step FROM episodes", images="auto", frame_at="result")
    assert first[0]["frame"].shape == (480, 640, 3)


def test_verdicts_are_replayed_on_demand_or_at_once(store: reel.Store) -> None:
    dataset = store.dataset(STEPS, verify="replay", images="none")
    assert dataset.verdicts == {"unverified": 8}
    assert dataset[0]["verdict"] == "exact" and dataset.verdicts == {"exact": 1, "unverified": 7}
    assert dataset.verify(progress=False) == {"exact": 8} and {sample["verdict"] for sample in dataset} == {"exact"}
    assert "verdict" not in store.dataset(STEPS, verify="off")[0]


def test_verdicts_of_the_store_are_used(played: Path, tmp_path: Path) -> None:
    store = reel.Store.ingest(played.glob("*oracle*.mcap"), tmp_path / "store")
    reel.export_sft(store, tmp_path / "sft")
    assert store.dataset(STEPS).verdicts == {"exact": 4}


def test_a_trace_that_changed_is_refused(tasks: reel.Tasks, tmp_path: Path) -> None:
    folder = tmp_path / "traces"
    reel.run(tasks[:1], "oracle", out=folder, images=False)
    dataset = reel.Store.ingest(folder, tmp_path / "store").dataset(STEPS, images="auto")
    (path,) = folder.glob("*.mcap")
    reel.run(tasks[1:2], "oracle", out=tmp_path / "other", images=False)
    os.replace(next((tmp_path / "other").glob("*.mcap")), path)
    with pytest.raises(reel.ReelError, match=r"changed since its ingest.*reel ingest"):
        dataset[0]
    with pytest.raises(reel.ReelError, match="changed since its ingest"):
        dataset.verify(progress=False)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"images": "all"}, "unknown images='all': choose none, recorded, rendered or auto"),
        ({"verify": "no"}, "choose stored, replay or off"),
        ({"open_traces": 0}, "open_traces=0"),
    ],
)
def test_options_are_checked(store: reel.Store, options: dict[str, Any], message: str) -> None:
    with pytest.raises(reel.ReelError, match=message):
        store.dataset(STEPS, **options)


def test_queries_are_checked(store: reel.Store) -> None:
    with pytest.raises(reel.ReelError, match=r"needs the column step in the query"):
        store.dataset("SELECT episode_id FROM episodes", images="auto")
    with pytest.raises(reel.ReelError, match=r"`digest`.*AS my_digest"):
        store.dataset("SELECT episode_id, trace_digest AS digest FROM episodes")
    with pytest.raises(reel.ReelError, match="nonsense"):
        store.dataset("SELECT nonsense FROM steps")
    with pytest.raises(reel.ReelError, match=r"2 columns `step`, and a sample holds one.*`a.step AS first_step"):
        store.dataset("SELECT a.step, b.step FROM steps a JOIN steps b ON a.episode_id = b.episode_id")
    with pytest.raises(ValueError, match="jobs=-1: give an integer from 1 on"):
        store.dataset(STEPS).verify(jobs=-1)
    with pytest.raises(reel.ReelError, match="shuffle_window needs"):
        store.dataset("SELECT task_id FROM episodes").order(shuffle_seed=1, shuffle_window=2)


# --- orders


def test_orders_are_permutations_that_never_change(store: reel.Store) -> None:
    dataset = store.dataset(STEPS, shuffle_seed=7)
    first, second = dataset.order(0), dataset.order(1)
    assert sorted(first.tolist()) == list(range(len(dataset))) == sorted(second.tolist())
    assert first.tolist() != second.tolist() != dataset.order(1, shuffle_seed=8).tolist()
    # the same on every machine and with every NumPy
    assert np.argsort(shuffled_keys(10, 7, 0)).tolist() == [6, 5, 4, 8, 2, 1, 9, 7, 3, 0]
    assert store.dataset(STEPS).order(3).tolist() == list(range(len(dataset)))


def test_a_window_bounds_the_traces_that_are_open(store: reel.Store) -> None:
    dataset = store.dataset(STEPS, shuffle_seed=7)
    order = dataset.order(2, shuffle_window=3)
    assert sorted(order.tolist()) == list(range(len(dataset)))
    episodes = [key for key, _ in keys(dataset.__getitems__(order))]
    last = {episode: index for index, episode in enumerate(episodes)}
    first = {episode: episodes.index(episode) for episode in last}
    for index in range(len(episodes)):
        assert sum(first[episode] <= index <= last[episode] for episode in last) <= 3
    assert len(set(episodes[:20])) > 1, "samples of several episodes are mixed"


def test_ranks_share_every_step(store: reel.Store) -> None:
    dataset = store.dataset(STEPS, shuffle_seed=1)
    whole = keys(dataset.iterable(batch_size=24))
    assert len(whole) == len(dataset)
    for ranks, size in ((2, 12), (3, 8), (4, 6)):
        streams = [dataset.iterable(batch_size=size, rank=rank, ranks=ranks) for rank in range(ranks)]
        parts = [keys(stream) for stream in streams]
        assert {len(part) for part in parts} == {len(dataset) // ranks} == {len(stream) for stream in streams}
        steps = range(0, len(parts[0]) // size * size, size)
        together = [key for step in steps for part in parts for key in part[step : step + size]]
        assert together == whole[: len(together)]
        kept = [keys(dataset.iterable(batch_size=size, rank=rank, ranks=ranks, uneven="keep")) for rank in range(ranks)]
        assert sorted(key for part in kept for key in part) == sorted(whole)


def test_ranks_come_from_the_environment(store: reel.Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RANK", "1")
    monkeypatch.setenv("WORLD_SIZE", "3")
    stream = store.dataset(STEPS).iterable()
    assert (stream.rank, stream.ranks) == (1, 3)
    with pytest.raises(reel.ReelError, match="rank and ranks, or neither"):
        store.dataset(STEPS).iterable(rank=1)
    with pytest.raises(reel.ReelError, match="there are 2 ranks"):
        store.dataset(STEPS).iterable(rank=2, ranks=2)


# --- workers and resuming, as PyTorch's loader does it but in this process


class Loader:
    """What PyTorch's `DataLoader` does with worker processes: batches from each in turn."""

    def __init__(self, stream: IterableDataset, batch_size: int, workers: int, monkeypatch: pytest.MonkeyPatch) -> None:
        self.copies = [pickle.loads(pickle.dumps(stream)) for _ in range(workers)]
        self.batch_size = batch_size
        self.monkeypatch = monkeypatch

    def as_worker(self, worker: int) -> None:
        self.monkeypatch.setattr(_iterable, "worker_of", lambda: (worker, len(self.copies)))

    def __iter__(self) -> Iterator[list[Any]]:
        iterators: list[Iterator[Any] | None] = []
        for worker, copy in enumerate(self.copies):
            self.as_worker(worker)
            iterators.append(iter(copy))
        while any(iterator is not None for iterator in iterators):
            for worker, iterator in enumerate(iterators):
                if iterator is None:
                    continue
                self.as_worker(worker)
                batch = [sample for _, sample in zip(range(self.batch_size), iterator, strict=False)]
                if batch:
                    yield batch
                if len(batch) < self.batch_size:
                    iterators[worker] = None

    def states(self) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = []
        for worker, copy in enumerate(self.copies):
            self.as_worker(worker)
            found.append(copy.state_dict())
        return found


@pytest.mark.parametrize("workers", [1, 2, 3, 5])
def test_any_number_of_workers_gives_one_order(store: reel.Store, monkeypatch: pytest.MonkeyPatch, workers: int) -> None:
    stream = store.dataset(STEPS, shuffle_seed=3).iterable(batch_size=4)
    stream.set_epoch(2)
    expected = keys(stream)
    loaded = [key for batch in Loader(stream, 4, workers, monkeypatch) for key in keys(batch)]
    assert loaded == expected


@pytest.mark.parametrize("workers", [2, 3])
def test_workers_go_on_where_they_were(store: reel.Store, monkeypatch: pytest.MonkeyPatch, workers: int) -> None:
    dataset = store.dataset(STEPS, shuffle_seed=3)
    stream = dataset.iterable(batch_size=4)
    expected = [keys(batch) for batch in Loader(stream, 4, workers, monkeypatch)]
    loader = Loader(stream, 4, workers, monkeypatch)
    batches = iter(loader)
    # whole rounds, after which the first worker is next
    seen = [keys(next(batches)) for _ in range(2 * workers)]
    states = loader.states()
    other = Loader(dataset.iterable(batch_size=4), 4, workers, monkeypatch)
    for worker, state in enumerate(states):
        other.as_worker(worker)
        other.copies[worker].load_state_dict(state)
    assert seen + [keys(batch) for batch in other] == expected
    monkeypatch.undo()
    with pytest.raises(reel.ReelError, match=f"worker 0 of {workers}, this is worker 0 of 1.*batches=N"):
        dataset.iterable(batch_size=4).load_state_dict(states[0])


@pytest.mark.parametrize("seen", [0, 1, 7, 30])
def test_one_process_goes_on_at_any_sample(store: reel.Store, seen: int) -> None:
    dataset = store.dataset(STEPS, shuffle_seed=3)
    stream = dataset.iterable(batch_size=4)
    stream.set_epoch(5)
    expected = keys(stream)
    samples = iter(stream)
    head = keys(next(samples) for _ in range(seen))
    state = pickle.loads(pickle.dumps(stream.state_dict()))
    other = dataset.iterable(batch_size=4)
    other.load_state_dict(state)
    # as a training loop does
    other.set_epoch(5)
    assert other.state_dict() | {"start": 0, "yielded": 0} == state | {"start": 0, "yielded": 0}
    middle = iter(other)
    head += keys(next(middle) for _ in range(3))
    third = dataset.iterable(batch_size=1)
    third.load_state_dict(other.state_dict())
    assert head + keys(third) == expected
    assert keys(third) == expected, "the next iteration is a whole one"
    third.load_state_dict(state)
    third.set_epoch(6)
    assert len(keys(third)) == len(expected), "another epoch begins at its start"


def test_batches_that_a_loader_took_are_a_place(store: reel.Store, monkeypatch: pytest.MonkeyPatch) -> None:
    dataset = store.dataset(STEPS, shuffle_seed=3)
    stream = dataset.iterable(batch_size=4)
    batches = iter(Loader(stream, 4, 3, monkeypatch))
    seen = [key for _ in range(5) for key in keys(next(batches))]
    monkeypatch.undo()
    other = dataset.iterable(batch_size=6)
    other.load_state_dict(stream.state_dict(batches=5))
    rest = [key for batch in Loader(other, 6, 2, monkeypatch) for key in keys(batch)]
    monkeypatch.undo()
    assert seen + rest == keys(stream)
    # counted on from there
    third = dataset.iterable(batch_size=6)
    third.load_state_dict(other.state_dict(batches=2))
    assert seen + rest[:12] + keys(third) == keys(stream)


def test_other_ranks_go_on_after_a_batch(store: reel.Store) -> None:
    dataset = store.dataset(STEPS, shuffle_seed=3)
    two = [dataset.iterable(batch_size=6, rank=rank, ranks=2) for rank in range(2)]
    iterators = [iter(stream) for stream in two]
    seen = [[next(iterator) for _ in range(12)] for iterator in iterators]
    together = [key for step in (0, 6) for part in seen for key in keys(part[step : step + 6])]
    one = dataset.iterable(batch_size=12)
    one.load_state_dict(two[1].state_dict())
    assert together + keys(one) == keys(dataset.iterable())
    next(iterators[0])
    with pytest.raises(reel.ReelError, match="middle of a batch"):
        one.load_state_dict(two[0].state_dict())


def test_states_of_other_samples_are_refused(store: reel.Store) -> None:
    state = store.dataset(STEPS, shuffle_seed=3).iterable().state_dict()
    for query, seed in ((STEPS, 4), (f"{STEPS} WHERE step > 0", 3)):
        with pytest.raises(reel.ReelError, match="another dataset"):
            store.dataset(query, shuffle_seed=seed).iterable().load_state_dict(state)


# --- batches, costs, imports


def test_batches_have_arrays_and_lists(store: reel.Store) -> None:
    dataset = store.dataset(STEPS, images="auto")
    batch = data.collate(dataset.__getitems__([0, 1]))
    assert batch["frame"].shape == (2, 480, 640, 3) and batch["reward"].shape == (2,)
    assert batch["text"] == [dataset[0]["text"], dataset[1]["text"]]
    assert data.collate([{"x": 1}, {"x": None}]) == {"x": [1, None]}


@pytest.mark.parametrize(
    ("values", "dtype"),
    [
        ([1, -(2**63)], np.int64),
        ([1, 2**64 - 1], np.uint64),
        ([1, 0.5], np.float64),
        ([2**53, 0.5], np.float64),
        ([True, False], np.bool_),
        # no type holds all of these
        ([-1, 2**64 - 1], None),
        ([1, 2**64], None),
        ([2**53 + 1, 0.5], None),
    ],
)
def test_batches_keep_the_values_of_numbers(values: list[Any], dtype: Any) -> None:
    batch = data.collate([{"x": value} for value in values])["x"]
    if dtype is None:
        assert batch == values
    else:
        assert np.asarray(batch).dtype == dtype and batch.tolist() == values


def test_a_stream_has_the_arguments_of_its_class(store: reel.Store) -> None:
    dataset = store.dataset(STEPS)
    names = list(inspect.signature(IterableDataset).parameters)
    assert names == ["dataset", *inspect.signature(dataset.iterable).parameters]
    assert dataset.iterable(batch_size=3).batch_size == 3 and "worker processes" in (dataset.iterable.__doc__ or "")


def test_text_samples_are_fast(store: reel.Store) -> None:
    """At least 20,000 text samples a second of CPU time on a core; docs/python-data.md has what was measured."""
    query = f"SELECT s.* FROM ({STEPS}) s CROSS JOIN (SELECT unnest(range(0, 100)) AS copy)"
    dataset = store.dataset(query, shuffle_seed=1)
    order = dataset.order()

    def rate(work: Any) -> float:
        # what the machine does besides does not count
        start = time.process_time()
        count = sum(1 for _ in work)
        return count / (time.process_time() - start)

    batches = (sample for at in range(0, len(order), 256) for sample in dataset.__getitems__(order[at : at + 256]))
    assert rate(batches) > 20_000
    # made before the clock runs: the first one imports PyTorch where it is installed
    stream = dataset.iterable(batch_size=256)
    assert rate(stream) > 20_000


def test_importing_reel_imports_no_libraries_of_training() -> None:
    code = "import sys, reel; print([name for name in ('torch', 'datasets', 'reel.data', 'PIL', 'anywidget') if name in sys.modules])"
    # in another process: this one may have imported them
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "[]"
