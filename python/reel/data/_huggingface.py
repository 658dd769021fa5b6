"""Samples as a dataset of Hugging Face's `datasets`."""

from __future__ import annotations

import hashlib
import importlib
import inspect
import json
import os
import re
from collections.abc import Iterator, Sequence
from decimal import Decimal
from typing import TYPE_CHECKING, Any

import numpy as np

from .._reel import SIM_VERSION, ReelError
from .._store import Store
from .._types import PathLike

if TYPE_CHECKING:
    from ._dataset import Dataset


def to_hf(
    dataset: Dataset, *, streaming: bool, cache_dir: PathLike | None, num_proc: int | None, shards: int
) -> Any:
    """The samples as a dataset of `datasets` (`Dataset.to_hf`, which documents the arguments)."""
    datasets = needed("datasets", "datasets")
    if not len(dataset):
        raise ReelError("the query gives no rows: nothing to make a dataset of")
    if dataset.images != "none":
        needed("PIL", "datasets")
    features = None if dataset.transform is not None else features_of(dataset, datasets)
    parts = min(len(dataset), shards if streaming else num_proc or 1)
    bounds = np.linspace(0, len(dataset), parts + 1).astype(int).tolist()
    arguments: dict[str, Any] = {"dataset": dataset, "ranges": list(zip(bounds[:-1], bounds[1:], strict=True))}
    if streaming:
        return datasets.IterableDataset.from_generator(generate, features=features, gen_kwargs=arguments)
    if features is not None:
        kinds = {name: str(getattr(kind, "dtype", "")) for name, kind in features.items()}
        # a tuple: `datasets` splits lists among processes
        arguments["wide"] = tuple(name for name, kind in kinds.items() if kind.startswith("decimal"))
    made = datasets.Dataset.from_generator
    # older versions hash the arguments, which is slower
    known = "fingerprint" in inspect.signature(made).parameters
    return made(
        generate,
        features=features,
        gen_kwargs=arguments,
        cache_dir=None if cache_dir is None else os.fspath(cache_dir),
        num_proc=num_proc,
        **({"fingerprint": cache_key(dataset, datasets)} if known else {}),
    )


def cache_key(dataset: Dataset, datasets: Any) -> str:
    """What the samples depend on, as a digest."""
    transform = None if dataset.transform is None else datasets.fingerprint.Hasher.hash(dataset.transform)
    parts = [
        dataset.location, dataset.version, dataset.query, dataset.parameters, dataset.fingerprint, dataset.images, dataset.frame_at,
        dataset.verify_mode, dataset._episodes.digests, dataset._episodes.verdicts, SIM_VERSION, transform,
    ]  # fmt: skip
    return hashlib.blake2b(json.dumps(parts).encode(), digest_size=16).hexdigest()


def features_of(dataset: Dataset, datasets: Any) -> Any:
    """Types of the samples, from those of the columns."""
    pa = needed("pyarrow", "datasets")
    batches = Store(dataset.location, dataset.version).sql(dataset.query, parameters=dataset.parameters, stream=True)
    fields = [(field.name, plain_type(pa, field.type)) for field in pa.schema(batches)]
    features = datasets.Features.from_arrow_schema(pa.schema(fields))
    for name in dataset._added():
        features[name] = datasets.Image() if name == "frame" else datasets.Value("string")
    return features


def plain_type(pa: Any, kind: Any) -> Any:
    """The Arrow type that a column of samples has in `datasets`: times are text, decimals with a
    fraction floats. A whole decimal is the integer that holds all of its digits; one of 20 digits is a
    `u64` of Reel (a seed); one of more stays a decimal. `pa` is PyArrow."""
    types = pa.types
    if types.is_list(kind) or types.is_large_list(kind):
        return pa.list_(plain_type(pa, kind.value_type))
    if types.is_struct(kind):
        return pa.struct([(field.name, plain_type(pa, field.type)) for field in kind])
    if types.is_decimal(kind):
        if kind.scale:
            return pa.float64()
        return pa.int64() if kind.precision < 19 else pa.uint64() if kind.precision == 20 else kind
    if types.is_dictionary(kind):
        return plain_type(pa, kind.value_type)
    if re.search("string|utf8|date|time|duration|interval", str(kind)):
        return pa.string()
    return kind


def generate(dataset: Dataset, ranges: Sequence[tuple[int, int]], wide: tuple[str, ...] = ()) -> Iterator[Any]:
    """The samples of ranges of indices, for `datasets`. Integers of `wide` columns come as decimals, because
    PyArrow infers no type for an integer beyond 63 bits; they are stored as the column's type."""
    for start, end in ranges:
        for index in range(start, end):
            sample = dataset[index]
            for name in wide:
                sample[name] = None if sample[name] is None else Decimal(sample[name])
            yield sample


def needed(module: str, extra: str) -> Any:
    """A module that an extra of the package brings."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ReelError(f"this needs the module {module}: pip install 'reel[{extra}]' ({error})") from error


__all__ = ["to_hf"]
