"""Datasets in PyTorch's loaders, with worker processes."""

from __future__ import annotations

from typing import Any

import pytest

import reel
from reel import data

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'reel[torch]'")
from torch.utils.data import DataLoader  # noqa: E402
from torch.utils.data import IterableDataset as TorchIterable  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore:This DataLoader will create", "ignore:.*set_vital")
STEPS = "SELECT episode_id, step, tool, text, reward FROM steps"
WORKERS = [0, 1, 2, 3]


def loader(dataset: Any, workers: int, batch_size: int = 4, **options: Any) -> DataLoader[Any]:
    return DataLoader(dataset, batch_size=batch_size, num_workers=workers, collate_fn=data.collate, **options)


def ids(batches: Any) -> list[tuple[str, int]]:
    return [key for batch in batches for key in zip(batch["episode_id"], batch["step"].tolist(), strict=True)]


@pytest.fixture(scope="module")
def texts(store: reel.Store) -> data.Dataset:
    """Text samples in a shuffled order."""
    return store.dataset(STEPS, shuffle_seed=3)


@pytest.mark.parametrize(("workers", "context"), [(0, None), (1, "fork"), (2, "fork"), (3, "fork"), (2, "spawn")])
def test_every_number_of_workers_gives_one_order(texts: data.Dataset, workers: int, context: str | None) -> None:
    stream = texts.iterable(batch_size=4)
    assert isinstance(stream, TorchIterable)
    stream.set_epoch(1)
    expected = [(sample["episode_id"], sample["step"]) for sample in stream]
    assert sorted(expected) == sorted((sample["episode_id"], sample["step"]) for sample in texts)
    assert ids(loader(stream, workers, multiprocessing_context=context)) == expected
    # single samples, without batches
    one = texts.iterable()
    one.set_epoch(1)
    singles = DataLoader(one, batch_size=None, num_workers=workers, multiprocessing_context=context)
    assert [(sample["episode_id"], sample["step"]) for sample in singles] == expected
    mapped = loader(texts, workers, sampler=texts.order(1).tolist(), multiprocessing_context=context)
    assert ids(mapped) == expected


@pytest.mark.parametrize("context", ["fork", "spawn"])
def test_frames_are_made_in_workers(store: reel.Store, context: str) -> None:
    query = "SELECT episode_id, step, text FROM steps WHERE step BETWEEN 1 AND 2"
    dataset = store.dataset(query, images="auto", verify="replay", shuffle_seed=1)
    expected = [sample["frame"] for sample in dataset.iterable(batch_size=4)]
    unread = store.dataset(query, images="auto", verify="replay", shuffle_seed=1)
    batches = list(loader(unread.iterable(batch_size=4), 2, multiprocessing_context=context))
    frames = torch.cat([batch["frame"] for batch in batches])
    assert frames.shape == (16, 480, 640, 3) and frames.dtype == torch.uint8
    assert all((frame == torch.from_numpy(image)).all() for frame, image in zip(frames, expected, strict=True))
    assert {verdict for batch in batches for verdict in batch["verdict"]} == {"exact"}


def test_workers_that_persist_see_the_epoch(texts: data.Dataset) -> None:
    for context in ("fork", "spawn"):
        stream = texts.iterable(batch_size=4)
        batches = loader(stream, 2, persistent_workers=True, multiprocessing_context=context)
        orders: list[Any] = []
        for epoch in range(3):
            stream.set_epoch(epoch)
            orders.append(ids(batches))
            assert orders[-1] == [(sample["episode_id"], sample["step"]) for sample in stream]
        assert orders[0] != orders[1] != orders[2]


@pytest.mark.parametrize("workers", WORKERS)
@pytest.mark.parametrize("cut", [1, 5, 11])
def test_a_plain_loader_goes_on(texts: data.Dataset, workers: int, cut: int) -> None:
    stream = texts.iterable(batch_size=4)
    stream.set_epoch(2)
    expected = ids(loader(stream, workers))
    batches = iter(loader(stream, workers))
    seen = ids(next(batches) for _ in range(cut))
    state = stream.state_dict(batches=cut) if workers else stream.state_dict()
    for others in (0, 2):
        other = texts.iterable(batch_size=4)
        other.load_state_dict(state)
        assert seen + ids(loader(other, others)) == expected


@pytest.mark.parametrize("workers", WORKERS)
@pytest.mark.parametrize("cut", [0, 1, 5, 11])
def test_a_stateful_loader_goes_on(texts: data.Dataset, workers: int, cut: int) -> None:
    stateful = pytest.importorskip(
        "torchdata.stateful_dataloader", reason="torchdata is not installed: pip install 'reel[torch]'"
    )

    def made() -> Any:
        stream = texts.iterable(batch_size=4)
        stream.set_epoch(2)
        return stateful.StatefulDataLoader(stream, batch_size=4, num_workers=workers, collate_fn=data.collate)

    expected = ids(made())
    first = made()
    batches = iter(first)
    seen = ids(next(batches) for _ in range(cut))
    state = first.state_dict()
    second = made()
    second.load_state_dict(state)
    assert seen + ids(second) == expected


def test_a_model_learns_from_frames(store: reel.Store) -> None:
    """One batch of images that are rendered on demand is learned by heart."""
    dataset = store.dataset("SELECT episode_id, step, tool FROM steps", images="auto", shuffle_seed=1)
    tools = sorted({sample["tool"] for sample in store.dataset("SELECT tool FROM steps")})
    batch = next(iter(loader(dataset.iterable(batch_size=8), 0, batch_size=8)))
    small = batch["frame"].permute(0, 3, 1, 2).float()[:, :, ::16, ::16] / 255
    torch.manual_seed(0)
    model = torch.nn.Sequential(torch.nn.Flatten(), torch.nn.Linear(3 * 30 * 40, len(tools)))
    wanted = torch.tensor([tools.index(tool) for tool in batch["tool"]])
    optimizer = torch.optim.Adam(model.parameters(), lr=1e-3)
    losses: list[float] = []
    for _ in range(50):
        loss = torch.nn.functional.cross_entropy(model(small), wanted)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < losses[0] / 2
