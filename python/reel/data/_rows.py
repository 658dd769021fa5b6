"""Rows of a query, kept in memory as bytes."""

from __future__ import annotations

import hashlib
import marshal
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from .._reel import ReelError
from .._store import Store
from ._orders import Indices


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
            check_names(columns)
            rows = [tuple(map(record.get, columns)) for record in batch.rows(0, len(batch))]
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


def check_names(columns: tuple[str, ...]) -> None:
    """Refuses columns of one name: a sample is a dictionary, which holds one of them."""
    twice = [name for name, count in Counter(columns).items() if count > 1]
    if twice:
        raise ReelError(
            f"the query gives {columns.count(twice[0])} columns `{twice[0]}`, and a sample holds one; name them: "
            f"`a.{twice[0]} AS first_{twice[0]}, b.{twice[0]} AS second_{twice[0]}`"
        )


def sort_key(row: tuple[Any, ...], episode: int | None, step: int | None) -> tuple[str, int]:
    """Where a row belongs: by episode and step; a missing one comes first."""
    named = None if episode is None else row[episode]
    number = None if step is None else row[step]
    return (named if isinstance(named, str) else "", number if isinstance(number, int) else -2)


def ends_with_order(query: str) -> bool:
    """Whether a query orders its rows: ORDER BY outside of parentheses, texts and comments."""
    text = re.sub(r"--[^\n]*|/\*.*?\*/|'(?:[^']|'')*'|\"(?:[^\"]|\"\")*\"", " x ", query, flags=re.DOTALL)
    inner = None
    while inner != text:
        inner, text = text, re.sub(r"\([^()]*\)", " x ", text)
    return re.search(r"\border\s+by\b", text, re.IGNORECASE) is not None


__all__ = ["PackedRows", "ends_with_order"]
