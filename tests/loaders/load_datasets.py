"""Hugging Face datasets, versions 3 and 5: rows, features, images."""

import json

import datasets
from common import MANIFEST, check_image, check_provenance, check_total, shards, splits

format = MANIFEST["format"]
rows = images = 0
column = "image" if format in {"qwen-vl"} else "images"
for split, promised in splits().items():
    kind = "parquet" if format == "parquet" else "json"
    loaded = datasets.load_dataset(kind, data_files={split: shards(split)}, split=split)
    assert len(loaded) == promised, (split, len(loaded), promised)
    if column in loaded.column_names and kind == "json":
        many = datasets.List if hasattr(datasets, "List") else datasets.Sequence
        loaded = loaded.cast_column(column, many(datasets.Image()))
    for row in loaded:
        rows += 1
        frames = row.get(column) or []
        images += len(frames)
        for frame in frames:
            check_image(frame)
        if kind == "json":
            check_provenance(row)
            rest = json.dumps({key: value for key, value in row.items() if key != column})
            tags = rest.count('"type": "image"') if format == "trl" else rest.count("<image>")
            assert tags == len(frames), (tags, len(frames))
check_total(rows, images)
