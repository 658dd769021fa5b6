"""The first rows of a table."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from .style import escaped, view

if TYPE_CHECKING:
    from .._store import Table

TABLE_ROWS_MAX = 50
TABLE_COLUMNS_MAX = 60
CELL_MAX = 200


def type_name(values: Iterable[Any]) -> str:
    """The type of a column, from the values that are shown; empty if they are mixed or all null."""
    kinds = {
        "boolean" if isinstance(value, bool)
        else "integer" if isinstance(value, int)
        else "float" if isinstance(value, float)
        else "text" if isinstance(value, str)
        else "list" if isinstance(value, (list, tuple))
        else "struct"
        for value in values
        if value is not None
    }  # fmt: skip
    if kinds == {"integer", "float"}:
        return "float"
    return kinds.pop() if len(kinds) == 1 else ""


def cell_html(value: Any) -> str:
    """A value of a table."""
    match value:
        case None:
            return '<span class="soft">null</span>'
        case bool():
            return "true" if value else "false"
        case float():
            return escaped(f"{value + 0.0:.6g}")
        case list() | dict() | tuple():
            return f"<code>{escaped(json.dumps(value, ensure_ascii=False, default=str), CELL_MAX)}</code>"
        case _:
            return escaped(value, CELL_MAX)


def table_html(table: Table) -> str:
    """The first rows of a table."""
    count = len(table)
    rows = table.rows(0, min(count, TABLE_ROWS_MAX))
    columns = table.columns[:TABLE_COLUMNS_MAX]
    types = {name: type_name(row.get(name) for row in rows) for name in columns}
    number = {name: ' class="number"' if types[name] in ("integer", "float") else "" for name in columns}
    heads = "".join(f"<th{number[name]}>{escaped(name, 80)}<small>{types[name]}</small></th>" for name in columns)
    lines = "".join(
        f"<tr>{''.join(f'<td{number[name]}>{cell_html(row.get(name))}</td>' for name in columns)}</tr>" for row in rows
    )
    left = len(table.columns) - len(columns)
    notes = [f"{count:,} row{'s' * (count != 1)}"]
    if count > len(rows):
        notes.append(f"the first {len(rows)} are shown")
    if left > 0:
        notes.append(f"{left} columns are not shown")
    body = f'<div class="scroll"><table><thead><tr>{heads}</tr></thead><tbody>{lines}</tbody></table></div>' if columns else ""
    return view(f'{body}<p class="soft" style="margin-top:6px">{"; ".join(notes)}</p>', "table")


__all__ = ["table_html"]
