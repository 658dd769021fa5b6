"""Answers every named query again, in plain Python over the rows of the Delta tables, and compares with Reel's answers.

check_queries.py STORE OUT: STORE is a folder of tables, OUT holds <name>.json for each named query: a list of objects.
Prints a line a query; ends with 1 at any difference, and names query, row, column and both values. Needs `deltalake`,
`pyarrow` and `numpy`. The answers are in `independent/` and share nothing with the SQL: patterns of steps are regular
expressions over one letter a step, statistics are written out.
"""
import json
import math
import os
import sys

from independent import dialogue, failures, results, spending, tasks  # noqa: F401 (each adds its answers)
from independent.rows import ANSWERS

OUT = sys.argv[2]


def equal(one, other):
    if isinstance(one, bool) or isinstance(other, bool) or one is None or other is None:
        return one is other
    if isinstance(one, (int, float)) and isinstance(other, (int, float)):
        return math.isclose(one, other, rel_tol=1e-9, abs_tol=1e-12)
    return one == other


def difference(found, expected):
    """What is different first, or nothing."""
    for number, (row, wanted) in enumerate(zip(found, expected)):
        if list(row) != list(wanted):
            return f"row {number}: columns {list(row)}, expected {list(wanted)}"
        for column in wanted:
            if not equal(row[column], wanted[column]):
                return f"row {number}, column {column}: {row[column]!r}, expected {wanted[column]!r}"
    if len(found) != len(expected):
        return f"{len(found)} rows, expected {len(expected)}"
    return None


def main():
    asked = {name.removesuffix(".json") for name in os.listdir(OUT) if name.endswith(".json")}
    wrong = sorted(f"{name}: no independent answer" for name in asked - set(ANSWERS))
    wrong += sorted(f"{name}: no {name}.json" for name in set(ANSWERS) - asked)
    for name in sorted(asked & set(ANSWERS)):
        with open(os.path.join(OUT, f"{name}.json"), encoding="utf-8") as file:
            found = json.load(file)
        problem = difference(found, ANSWERS[name]())
        print(f"{name}: {problem or f'{len(found)} rows agree'}")
        if problem:
            wrong.append(f"{name}: {problem}")
    for line in wrong:
        print(line, file=sys.stderr)
    sys.exit(1 if wrong else 0)


main()
