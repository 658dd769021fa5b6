"""Polars: stores and traces as LazyFrames, and functions on sequences of steps as expressions.

Importing `reel` makes the namespace known: `pl.col("steps").reel.match("^ !ask* pick")` is true for
episodes whose steps match a pattern (docs/query.md), of a store's `episodes` table.
"""

from __future__ import annotations

import importlib.util
import io
import json
import math
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import _reel
from ._types import PathLike

if TYPE_CHECKING:
    import polars as pl

    from ._store import Store


def scan_store(store: Store, table: str = "steps") -> pl.LazyFrame:
    """A table or view of a store as a LazyFrame, read when it is collected: only the columns, row
    groups and rows that the query wants."""
    import polars as pl
    from polars.io.plugins import register_io_source

    name = '"' + table.replace('"', '""') + '"'

    def schema() -> pl.Schema:
        empty = store.sql(f"SELECT * FROM {name} LIMIT 0")
        return pl.DataFrame(empty).schema

    def source(
        columns: list[str] | None,
        predicate: pl.Expr | None,
        n_rows: int | None,
        batch_size: int | None,  # noqa: ARG001
    ) -> Iterator[pl.DataFrame]:
        wanted = "*" if columns is None else ", ".join(map(quoted, columns))
        conditions, whole = (["TRUE"], True) if predicate is None else conjuncts(predicate)
        if predicate is not None and n_rows is not None:
            # Polars takes the first rows and filters them
            conditions, whole = ["TRUE"], False
        if predicate is not None and columns is not None:
            # what Polars has to check itself, it has to see
            hidden = [column for column in predicate.meta.root_names() if column not in columns]
            if not whole and hidden:
                wanted += ", " + ", ".join(map(quoted, hidden))
        limit = f" LIMIT {n_rows}" if n_rows is not None else ""
        sql = f"SELECT {wanted} FROM {name} WHERE {' AND '.join(conditions or ['TRUE'])}{limit}"
        left = n_rows
        for batch in store.sql(sql, stream=True):
            frame = pl.DataFrame(batch)
            if left is not None:
                frame = frame.head(left)
                left -= len(frame)
            if predicate is not None and not whole:
                frame = frame.filter(predicate)
                frame = frame.select(columns) if columns is not None else frame
            yield frame
            if left == 0:
                return

    return register_io_source(source, schema=schema, explain_name=f"REEL {table}")


def scan_traces(
    paths: PathLike | Iterable[PathLike], table: str = "steps", *, store: PathLike | None = None
) -> pl.LazyFrame:
    """The tables of trace files as a LazyFrame, without a store of one's own.

    Args:
        paths: files, folders and glob patterns (`"*.mcap"`).
        table: `steps`, `episodes` or another table or view.
        store: folder to keep what was read; None: one that goes with the process. New traces alone
            are read the next time.
    """
    from ._store import Store

    if store is not None:
        return scan_store(Store.ingest(paths, store), table)
    folder = _scratch(paths)
    return scan_store(Store.ingest(paths, folder), table)


_scratches: dict[str, tempfile.TemporaryDirectory[str]] = {}


def _scratch(paths: PathLike | Iterable[PathLike]) -> str:
    """A store of this process for these traces."""
    from ._episode import trace_paths

    key = "\n".join(map(str, trace_paths(paths)))
    if key not in _scratches:
        _scratches[key] = tempfile.TemporaryDirectory(prefix="reel-store-")
    return str(Path(_scratches[key].name) / "store")


# --- predicates of Polars as conditions of SQL


def quoted(name: str) -> str:
    """A column's name as SQL writes it."""
    return '"' + name.replace('"', '""') + '"'


class Untranslatable(Exception):
    """A part of a predicate that stays with Polars."""


def conjuncts(predicate: pl.Expr) -> tuple[list[str], bool]:
    """The parts of a predicate, joined by AND, that SQL can check, and whether these are all."""
    tree = json.loads(predicate.meta.serialize(format="json"))
    found: list[str] = []
    whole = True
    parts = [tree]
    while parts:
        part = parts.pop()
        match part:
            case {"BinaryExpr": {"left": left, "op": "And" | "LogicalAnd", "right": right}}:
                parts += [right, left]
            case _:
                try:
                    found.append(condition(part))
                except Untranslatable:
                    whole = False
    return found, whole


COMPARISONS = {"Eq": "=", "NotEq": "<>", "Lt": "<", "LtEq": "<=", "Gt": ">", "GtEq": ">="}


def condition(tree: Any) -> str:
    """A predicate as SQL that is true for exactly the same rows."""
    match tree:
        case {"BinaryExpr": {"left": left, "op": "And" | "LogicalAnd", "right": right}}:
            return f"({condition(left)} AND {condition(right)})"
        case {"BinaryExpr": {"left": left, "op": "Or" | "LogicalOr", "right": right}}:
            return f"({condition(left)} OR {condition(right)})"
        case {"BinaryExpr": {"left": left, "op": op, "right": right}} if op in COMPARISONS:
            return f"({operand(left)} {COMPARISONS[op]} {operand(right)})"
        case {"Function": {"input": [of], "function": {"Boolean": "Not"}}}:
            return f"(NOT {condition(of)})"
        case {"Function": {"input": [of], "function": {"Boolean": "IsNull"}}}:
            return f"({operand(of)} IS NULL)"
        case {"Function": {"input": [of], "function": {"Boolean": "IsNotNull"}}}:
            return f"({operand(of)} IS NOT NULL)"
        case {"Function": {"input": [of, among], "function": {"Boolean": {"IsIn": {"nulls_equal": False}}}}}:
            values = [literal(value) for value in constant(among)]
            return f"({operand(of)} IN ({', '.join(values)}))" if values else "FALSE"
        case {"Function": {"input": [of, start], "function": {"StringExpr": "StartsWith"}}}:
            return f"starts_with({operand(of)}, {literal(constant(start))})"
        case {"Column": str()}:
            return operand(tree)
        case _:
            raise Untranslatable


def operand(tree: Any) -> str:
    """A column or a constant as SQL."""
    match tree:
        case {"Column": str(name)}:
            return quoted(name)
        case {"Literal": _}:
            return literal(constant(tree))
        case _:
            raise Untranslatable


def constant(tree: Any) -> Any:
    """The value of a constant."""
    import polars as pl

    if not (isinstance(tree, dict) and "Literal" in tree):
        raise Untranslatable
    try:
        series = pl.select(pl.Expr.deserialize(io.StringIO(json.dumps(tree)), format="json")).to_series()
    except pl.exceptions.ComputeError as error:  # JSON has neither infinity nor NaN
        raise Untranslatable from error
    value = series.to_list()
    return value[0] if len(value) == 1 else value


def literal(value: Any) -> str:
    """A constant as SQL writes it; only types that compare in SQL as in Polars."""
    match value:
        case bool():
            return "TRUE" if value else "FALSE"
        case int():
            return str(value)
        case float() if math.isfinite(value):
            return repr(value)
        case str() if "\0" not in value:
            return "'" + value.replace("'", "''") + "'"
        case _:
            raise Untranslatable


# --- functions on sequences of steps


def _library() -> Path:
    """The library that holds the functions, which Polars calls itself."""
    return Path(str(_reel.__file__))


class StepsNamespace:
    """Functions on a column of steps (list of records), as in SQL (docs/query.md)."""

    def __init__(self, steps: pl.Expr) -> None:
        self._steps = steps

    def _call(self, function: str, text: str | None = None) -> pl.Expr:
        import polars as pl
        from polars.plugins import register_plugin_function

        # the text is one value beside a column, so that rows are not independent arguments
        arguments: Sequence[pl.Expr] = [self._steps] if text is None else [self._steps, pl.lit(text)]
        return register_plugin_function(
            plugin_path=_library(),
            function_name=function,
            args=arguments,
            is_elementwise=True,
            use_abs_path=True,
        )

    def match(self, pattern: str) -> pl.Expr:
        """Whether a pattern matches anywhere, e.g. `"^ !ask* pick[not goal_object]"`. Boolean."""
        return self._call("sequence_match", pattern)

    def count(self, pattern: str) -> pl.Expr:
        """How many times a pattern matches without overlap. Int64."""
        return self._call("sequence_count", pattern)

    def find(self, pattern: str) -> pl.Expr:
        """The first match: struct(first, last), calls from 0; null if there is none."""
        return self._call("sequence_find", pattern)

    def first_step(self, condition: str) -> pl.Expr:
        """The first call that fits a condition, e.g. `"pick[goal_object]"`. Int32; null if none."""
        return self._call("first_step", condition)

    def prevailing_tail(self, condition: str) -> pl.Expr:
        """The stretch up to the end in which calls that fit outnumber the others by most."""
        return self._call("prevailing_tail", condition)

    def oscillation(self) -> pl.Expr:
        """The longest run of `nav_to` back and forth between two receptacles."""
        return self._call("oscillation")

    def values(self, column: str) -> pl.Expr:
        """A column of the steps as a list of numbers."""
        return self._call("step_values", column)

    def texts(self, column: str) -> pl.Expr:
        """A column of the steps as a list of texts."""
        return self._call("step_texts", column)


def register() -> None:
    """Makes the namespace `reel` known to Polars."""
    import polars as pl

    pl.api.register_expr_namespace("reel")(StepsNamespace)


# Whoever has Polars gets the namespace with `import reel`, but only once Polars is there.
if importlib.util.find_spec("polars") is not None:
    register()

__all__ = ["StepsNamespace", "scan_store", "scan_traces"]
