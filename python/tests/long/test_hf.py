"""Datasets for Hugging Face `datasets`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import reel

datasets = pytest.importorskip("datasets", reason="datasets is not installed: pip install 'reel[datasets]'")
STEPS = "SELECT s.episode_id, s.step, s.tool, s.reward, s.success, s.terms, e.seed FROM steps s JOIN episodes e USING (episode_id)"
IMAGES = "SELECT episode_id, step, tool FROM steps WHERE step < 2"


def row(sample: dict[str, object]) -> dict[str, object]:
    return {key: value for key, value in sample.items() if key != "frame"}


def test_rows_types_and_cache(store: reel.Store, tmp_path: Path) -> None:
    dataset = store.dataset(STEPS)
    made = dataset.to_hf(cache_dir=tmp_path)
    assert list(made) == list(dataset)
    types = {name: feature.dtype for name, feature in made.features.items() if hasattr(feature, "dtype")}
    assert types["step"] == "int32" and types["reward"] == "float64" and types["success"] == "bool"
    assert types["digest"] == types["verdict"] == "string" and types["seed"] == "uint64"
    files = sorted(tmp_path.rglob("*.arrow"))
    again = store.dataset(STEPS).to_hf(cache_dir=tmp_path)
    assert sorted(tmp_path.rglob("*.arrow")) == files and list(again) == list(made), "the cache was used"
    store.dataset(f"{STEPS} WHERE s.step > 0").to_hf(cache_dir=tmp_path)
    assert len(list(tmp_path.rglob("*.arrow"))) > len(files), "another query is another dataset"


def test_whole_decimals_of_any_width(store: reel.Store, tmp_path: Path) -> None:
    query = """
        SELECT CAST(-3 AS DECIMAL(18, 0)) AS narrow, CAST(9223372036854775807 AS DECIMAL(20, 0)) AS seed,
          CAST('-99999999999999999999999' AS DECIMAL(38, 0)) AS wide, CAST(1.5 AS DECIMAL(5, 2)) AS half"""
    made = store.dataset(query).to_hf(cache_dir=tmp_path)
    types = {name: feature.dtype for name, feature in made.features.items()}
    assert types == {"narrow": "int64", "seed": "uint64", "wide": "decimal128(38, 0)", "half": "float64"}
    assert made[0] == {"narrow": -3, "seed": 2**63 - 1, "wide": -(10**23) + 1, "half": 1.5}


def test_frames_are_images(store: reel.Store, tmp_path: Path) -> None:
    dataset = store.dataset(IMAGES, images="auto")
    made = dataset.to_hf(cache_dir=tmp_path, num_proc=2)
    streamed = list(dataset.to_hf(streaming=True))
    assert len(made) == len(dataset) == len(streamed)
    for index, sample in enumerate(dataset):
        assert row(made[index]) == row(sample) == row(streamed[index])
        # PNG loses nothing
        assert np.array_equal(np.asarray(made[index]["frame"]), sample["frame"])
        assert np.array_equal(np.asarray(streamed[index]["frame"]), sample["frame"])


def test_a_stream_is_split_over_workers(store: reel.Store) -> None:
    pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'reel[torch]'")
    from torch.utils.data import DataLoader

    dataset = store.dataset(STEPS)
    stream = dataset.to_hf(streaming=True, shards=4)
    assert stream.num_shards == 4
    loaded = list(DataLoader(stream, batch_size=None, num_workers=2))
    assert sorted((sample["episode_id"], int(sample["step"])) for sample in loaded) == [
        (sample["episode_id"], sample["step"]) for sample in dataset
    ]


def test_transforms_and_empty_queries(store: reel.Store, tmp_path: Path) -> None:
    made = store.dataset(STEPS, transform=prompt).to_hf(cache_dir=tmp_path)
    assert made.column_names == ["prompt"] and made[0]["prompt"].startswith("0: ")
    with pytest.raises(reel.ReelError, match="gives no rows"):
        store.dataset("SELECT step FROM steps WHERE step > 1000").to_hf()


def prompt(sample: dict[str, object]) -> dict[str, str]:
    return {"prompt": f"{sample['step']}: {sample['tool']}"}
