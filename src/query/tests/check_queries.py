"""Answers every named query again, by DuckDB over the Parquet files of the Delta tables, and compares with Reel's answers.

check_queries.py STORE OUT: STORE is a folder of tables, OUT holds <name>.json for each named query: a list of objects.
Prints a line a query; ends with 1 at any difference, and names query, row, column and both values. Needs `duckdb`,
`deltalake` (which files a table is made of) and `numpy`.

The answers are in `independent/*.sql`, a table `answer.<name>` each, written from what `queries/*.sql` and
`schemas/tables.md` say in words. They share no text and no function with Reel's SQL: patterns of steps are regular
expressions over one letter a step, statistics are written out. One thing is Python: the resampling of `policy_comparison` with
Reel's generator, `independent/bootstrap.py`, which DuckDB calls as a function.
"""
import json
import math
import sys
from pathlib import Path

import arro3.core
import duckdb
from deltalake import DeltaTable

from independent.bootstrap import bootstrap

TABLES = ["episodes", "tasks", "scenes", "rescored", "quarantine", "classes", "blame", "answer_labels"]
SQL = ["words", "dialogue", "results", "failures", "tasks", "spending"]


def answered(store):
    """A database with the tables of the store, and the answers in its schema `answer`."""
    database = duckdb.connect()
    for name in TABLES:
        table = DeltaTable(store / name)
        if files := table.file_uris():
            database.read_parquet(files).create(name)
        else:
            database.from_arrow(arro3.core.Table.from_batches([], schema=table.schema().to_arrow())).create(name)
    database.create_function("bootstrap", bootstrap, ["DOUBLE[]", "BIGINT", "BIGINT"], "DOUBLE[]")
    database.execute("CREATE SCHEMA answer")
    for name in SQL:
        database.execute((Path(__file__).parent / "independent" / f"{name}.sql").read_text(encoding="utf-8"))
    return database


def equal(one, other):
    if isinstance(one, bool) or isinstance(other, bool) or one is None or other is None:
        return one is other
    if isinstance(one, (int, float)) and isinstance(other, (int, float)):
        return math.isclose(one, other, rel_tol=1e-9, abs_tol=1e-12)
    return one == other


def difference(found, columns, expected):
    """What is different first, or nothing."""
    for number, (row, wanted) in enumerate(zip(found, expected)):
        if list(row) != columns:
            return f"row {number}: columns {list(row)}, expected {columns}"
        for column, value in zip(columns, wanted):
            if not equal(row[column], value):
                return f"row {number}, column {column}: {row[column]!r}, expected {value!r}"
    if len(found) != len(expected):
        return f"{len(found)} rows, expected {len(expected)}"
    return None


def main(store, out):
    database = answered(store)
    answers = {name for (name,) in database.sql("SELECT table_name FROM duckdb_tables() WHERE schema_name = 'answer'").fetchall()}
    asked = {path.stem for path in out.glob("*.json")}
    wrong = sorted(f"{name}: no independent answer" for name in asked - answers)
    wrong += sorted(f"{name}: no {name}.json" for name in answers - asked)
    for name in sorted(asked & answers):
        found = json.loads((out / f"{name}.json").read_text(encoding="utf-8"))
        answer = database.table(f"answer.{name}")
        problem = difference(found, answer.columns, answer.fetchall())
        print(f"{name}: {problem or f'{len(found)} rows agree'}")
        if problem:
            wrong.append(f"{name}: {problem}")
    for line in wrong:
        print(line, file=sys.stderr)
    sys.exit(1 if wrong else 0)


main(Path(sys.argv[1]), Path(sys.argv[2]))
