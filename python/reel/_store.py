"""Stores of tables, and questions in SQL."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, Literal, overload

from . import _reel
from ._arguments import whole
from ._command import Argument, command_json
from ._reel import ReelError, Stream
from ._simulation import plain
from ._types import PathLike, Record

if TYPE_CHECKING:
    import polars


class Table:
    """The answer to a question: columns of Arrow, in memory.

    Polars, pandas, PyArrow and DuckDB take it over without a copy, by Arrow's PyCapsule interface:
    `polars.DataFrame(answer)`, `pyarrow.table(answer)`, `duckdb.sql("FROM answer")`.
    """

    def __init__(self, native: _reel.Table) -> None:
        self._native = native

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
        return self._native.__arrow_c_stream__(requested_schema)

    def __arrow_c_schema__(self) -> object:
        return self._native.__arrow_c_schema__()

    @property
    def columns(self) -> list[str]:
        """Names of the columns."""
        return self._native.columns

    @property
    def schema(self) -> dict[str, str]:
        """The Arrow type of each column, as Arrow's Rust library writes it: `Int32`, `Utf8View` (text),
        `List(...)`. `to_polars().schema` and `to_pyarrow().schema` have those of the libraries."""
        return dict(self._native.schema())

    @property
    def nbytes(self) -> int:
        """Bytes of the columns in memory."""
        return self._native.nbytes

    def __len__(self) -> int:
        return len(self._native)

    def __iter__(self) -> Iterator[Record]:
        return iter(self.rows())

    def rows(self, start: int = 0, end: int | None = None) -> list[Record]:
        """Rows as dictionaries. Whole decimals (counts, seeds of 64 bits) are `int`, those with a
        fraction `float`; times are text.

        Args:
            start: the first row; negative ones count from the end, as in slices.
            end: the row after the last one; None: the end.

        Raises:
            ReelError: two columns have one name.
        """
        first, last, _ = slice(start, end).indices(len(self))
        return self._native.rows(first, last)

    def to_polars(self) -> polars.DataFrame:
        """As a Polars DataFrame."""
        import polars

        return polars.DataFrame(self)

    def to_pandas(self) -> Any:
        """As a pandas DataFrame (by PyArrow)."""
        return self.to_pyarrow().to_pandas()

    def to_pyarrow(self) -> Any:
        """As a PyArrow table."""
        import importlib

        return importlib.import_module("pyarrow").table(self)

    def __repr__(self) -> str:
        return str(self._native)

    def _repr_html_(self) -> str:
        from ._display import table_html

        return table_html(self)


def parameter(name: str, value: Any) -> str:
    """A value of a question as text, which the question casts to the type it is compared with."""
    value = plain(value)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (str, int)):
        return str(value)
    if isinstance(value, float) and math.isfinite(value):
        return repr(value)
    raise ReelError(f"parameter {name} is {value!r:.100}; give a text, a finite number, True or False")


class Store:
    """A store of tables, made by `Store.ingest` or `reel ingest`.

    Args:
        location: a folder, or a URL of a bucket.
        version: an earlier version of it; None: the newest whenever a question is asked.
    """

    def __init__(self, location: PathLike, version: int | None = None) -> None:
        self._native = _reel.Store(os.fspath(location), None if version is None else whole("version", version))

    @classmethod
    def ingest(
        cls, traces: PathLike | Iterable[PathLike], location: PathLike, **options: Argument
    ) -> Store:
        """Reads traces into a store, which is made if it is not there. What was read before is not
        read again. Options are those of `reel ingest`."""
        from ._episode import trace_paths

        given = [traces] if isinstance(traces, (str, os.PathLike)) else list(traces)
        paths: list[PathLike] = []
        for path in given:
            paths += [path] if os.path.exists(path) or "://" in os.fspath(path) else trace_paths(path)
        report = command_json("ingest", *paths, store=location, **options)
        if refused := report.get("quarantined"):
            first = ": ".join(refused[0])
            warnings.warn(f"{len(refused)} traces were not read (table quarantine), {first}", stacklevel=2)
        return cls(location)

    @property
    def location(self) -> str:
        """Where it lies."""
        return self._native.location

    @property
    def version(self) -> int:
        """The version that questions see now."""
        return self._native.version()

    @overload
    def sql(
        self,
        query: str,
        *,
        parameters: Mapping[str, Any] | None = None,
        memory: int = 1 << 30,
        timeout: float | None = None,
        stream: Literal[False] = False,
    ) -> Table: ...
    @overload
    def sql(
        self,
        query: str,
        *,
        parameters: Mapping[str, Any] | None = None,
        memory: int = 1 << 30,
        timeout: float | None = None,
        stream: Literal[True],
    ) -> Stream: ...
    def sql(
        self,
        query: str,
        *,
        parameters: Mapping[str, Any] | None = None,
        memory: int = 1 << 30,
        timeout: float | None = None,
        stream: bool = False,
    ) -> Table | Stream:
        """Asks a question in SQL, read-only.

        Args:
            query: the question; docs/query.md has the tables and functions.
            parameters: values of its `$parameters`: texts, numbers, True or False. A missing value is
                written in the question, as `IS NULL`.
            memory: bytes that sorts, joins and aggregations may take before they spill to disk.
            timeout: seconds after which it is stopped; None: never.
            stream: whether the answer comes batch by batch, as it is taken; then it is taken once.

        Raises:
            ReelError: the question is wrong or exceeds a limit.
            ArgumentError: `memory` is negative.
            KeyboardInterrupt: Ctrl-C stops the question, too.
        """
        memory = whole("memory", memory)
        values = {name: parameter(name, value) for name, value in (parameters or {}).items()}
        if stream:
            return self._native.stream(query, values, memory, timeout)
        return Table(self._native.sql(query, values, memory, timeout))

    def named(self, name: str, **parameters: Any) -> Table:
        """Asks one of the questions that come with Reel, e.g. `benchmark`, `failures`; `reel query
        --list` lists them."""
        query, defaults = _reel.named_query(name)
        return self.sql(query, parameters={**defaults, **parameters})

    def tables(self) -> list[str]:
        """Names of the tables and views."""
        rows = self.sql("SELECT table_name FROM information_schema.tables WHERE table_schema = 'public' ORDER BY 1").rows()
        return [row["table_name"] for row in rows]

    def scan(self, table: str = "steps") -> polars.LazyFrame:
        """A table as a Polars LazyFrame: projection, predicate and slice are pushed down into the
        query, so that only the columns and row groups that are wanted are read."""
        from .polars import scan_store

        return scan_store(self, table)

    def dataset(self, query: str, **options: Any) -> Any:
        """The rows of a question as samples for training (`reel.data.Dataset`)."""
        from .data import Dataset

        return Dataset(self, query, **options)

    def __repr__(self) -> str:
        return f"<Store {self.location}, version {self.version}>"


def export_sft(
    store: PathLike | Store, out: PathLike, *, format: str = "trl", **options: Argument
) -> Record:
    """Writes a training set for supervised fine-tuning: `reel export sft`.

    Args:
        store: the store, or its location.
        out: the folder to write, empty or of the same export broken off.
        format: `trl`, `ms-swift`, `llama-factory`, `qwen-vl`, ... (docs/datasets.md).
        options: further options of the command, e.g. `validation=0.05`.

    Returns:
        The report: examples in each split, refused episodes with reasons, token counts.
    """
    location = store.location if isinstance(store, Store) else store
    return command_json("export", "sft", store=location, out=out, format=format, **options)


def export_rl(store: PathLike | Store, out: PathLike, **options: Argument) -> Record:
    """Writes rows for reinforcement learning: `reel export rl`."""
    location = store.location if isinstance(store, Store) else store
    return command_json("export", "rl", store=location, out=out, **options)


__all__ = ["Store", "Table", "export_rl", "export_sft"]
