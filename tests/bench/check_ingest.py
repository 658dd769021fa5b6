"""Compares the rows of `ingest_python.py` with those of a store that `reel ingest` made of the same traces.

Every column of `episodes`, `tasks`, `scenes` and `quarantine`, nested ones included, bit for bit (zero and minus zero
differ), in any order of rows. Left out: the time a file was last written, the words of a quarantine's reason, and the column
`settles` of the steps and how queries were matched, which need an understanding of words that the script does not have.

  check_ingest.py STORE DIR

Needs PyPI deltalake and pyarrow.
"""

import argparse
import sys
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from deltalake import DeltaTable

KEYS = {"episodes": "episode_id", "tasks": "task_digest", "scenes": "scene_digest", "quarantine": "trace"}
NOT_READ_AGAIN = {
    f"episodes.steps.{name}" for name in ("settles", "refused_replies", "match_source", "match_categories", "query_known")
}
LEFT_OUT = {"episodes": ["trace_modified_ns"], "quarantine": ["reason"]}


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("store", type=Path)
    parser.add_argument("dir", type=Path, help="where ingest_python.py wrote")
    options = parser.parse_args()
    differing = [line for table in KEYS for line in compare(table, options.store, options.dir)]
    for line in differing:
        print(line)
    sys.exit(bool(differing))


def compare(table, store, folder):
    """What differs, a line each."""
    files = DeltaTable(store / table).file_uris()
    schema = pq.read_schema(next(folder.glob(f"{table}-*.parquet")))
    ours = pa.concat_tables([pq.read_table(file) for file in files]) if files else schema.empty_table()
    theirs = pa.concat_tables(pq.read_table(file) for file in sorted(folder.glob(f"{table}-*.parquet")))
    ours, theirs = (rows.sort_by(KEYS[table]) for rows in (ours, theirs))
    if not ours[KEYS[table]].equals(theirs[KEYS[table]]):
        return [f"{table}: {len(ours)} and {len(theirs)} rows of different keys"]
    if files and not ours.schema.equals(theirs.schema):
        return [f"{table}: the schemas differ:\n{ours.schema}\n{theirs.schema}"]
    differing = []
    values = 0
    for name in [name for name in schema.names if name not in LEFT_OUT.get(table, [])]:
        mine, other = (rows[name].combine_chunks() for rows in (ours, theirs))
        checked, wrong = leaves(f"{table}.{name}", mine, other)
        values += checked
        differing += wrong
    print(f"{table}: {len(ours)} rows, {values} values compared")
    return differing


def leaves(path, mine, other):
    """How many values were compared, and the columns without lists and structs that differ."""
    if len(mine) != len(other) or not mine.is_null().equals(other.is_null()):
        return len(mine), [f"{path}: differs in length or nulls"]
    if pa.types.is_list(mine.type):
        if not pc.list_value_length(mine).equals(pc.list_value_length(other)):
            return len(mine), [f"{path}: differs in the lengths of lists"]
        return leaves(path, mine.flatten(), other.flatten())
    if pa.types.is_struct(mine.type):
        fields = [field.name for field in mine.type if f"{path}.{field.name}" not in NOT_READ_AGAIN]
        parts = [leaves(f"{path}.{name}", mine.field(name), other.field(name)) for name in fields]
        return sum(checked for checked, _ in parts), [line for _, lines in parts for line in lines]
    if pa.types.is_float64(mine.type):
        mine, other = (column.fill_null(0.0).view(pa.int64()) for column in (mine, other))
    if mine.equals(other):
        return len(mine), []
    unequal = pc.fill_null(pc.not_equal(mine, other), False)
    first = pc.index(unequal, True).as_py()
    return len(mine), [f"{path}: {pc.sum(unequal)} of {len(mine)} differ, first {mine[first]} and {other[first]}"]


if __name__ == "__main__":
    main()
