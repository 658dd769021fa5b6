"""The same questions to pyarrow, NumPy and DuckDB: prints one JSON object.

check_profile.py OLD.parquet NEW.parquet
"""

import json
import sys

import duckdb
import numpy as np
import pyarrow.parquet as pq

OLD, NEW = sys.argv[1:3]


def numbers(values):
    """Quantiles by the inverted distribution function, as exact ones are defined."""
    values = np.asarray(values, dtype=float)
    shares = [0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99]
    return {
        "min": float(values.min()),
        "max": float(values.max()),
        "mean": float(values.mean()),
        "deviation": float(values.std()),
        "quantiles": [float(np.quantile(values, share, method="inverted_cdf")) for share in shares],
    }


def column(table, name, length=None):
    values = table.column(name).to_pylist()
    known = [value for value in values if value is not None]
    answer = {"nulls": len(values) - len(known)}
    if length is None:
        answer["distinct"] = len(set(known))
        answer["numbers"] = numbers(known)
    else:
        answer["lengths"] = numbers([length(value) for value in known])
    return answer


def profile(path):
    table = pq.read_table(path)
    rows = [json.dumps(row, sort_keys=True) for row in table.to_pylist()]
    answers = [
        [len(turn["content"]) for turn in turns if turn["role"] == "assistant"]
        for turns in table.column("messages").to_pylist()
    ]
    return {
        "rows": table.num_rows,
        "repeated": len(rows) - len(set(rows)),
        "columns": {
            "id": column(table, "id"),
            "score": column(table, "score"),
            "text": column(table, "text", len),
            "messages": column(table, "messages", len),
        },
        "answers": numbers([len(lengths) for lengths in answers]),
        "answer_characters": numbers([length for lengths in answers for length in lengths]),
    }


def shares(counts):
    counts = np.asarray(counts, dtype=float)
    return (counts + 0.5) / (counts.sum() + 0.5 * len(counts)), counts / counts.sum()


def distance(old, new):
    old, new = zip(*[pair for pair in zip(old, new) if pair != (0, 0)])
    (p, raw_p), (q, raw_q) = shares(old), shares(new)
    middle = (raw_p + raw_q) / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        terms = [np.where(raw > 0, raw * np.log2(raw / middle), 0).sum() for raw in (raw_p, raw_q)]
    return {"psi": float(((p - q) * np.log(p / q)).sum()), "js": float(sum(terms) / 2)}


def drift_of_numbers(name):
    sides = [pq.read_table(path).column(name).to_pylist() for path in (OLD, NEW)]
    known = [np.array([value for value in side if value is not None], dtype=float) for side in sides]
    tenths = [np.quantile(known[0], tenth / 10, method="inverted_cdf") for tenth in range(1, 10)]
    edges = np.unique(tenths)
    counts = []
    for side, values in zip(sides, known):
        bins = np.searchsorted(edges, values, side="left")
        counts.append([len(side) - len(values), *np.bincount(bins, minlength=len(edges) + 1)])
    return distance(*counts)


def drift_of_values(name):
    sides = [pq.read_table(path).column(name).to_pylist() for path in (OLD, NEW)]
    values = sorted({value for side in sides for value in side if value is not None})
    return distance(*[[side.count(value) for value in [None, *values]] for side in sides])


def rows():
    query = """
        with o as (select to_json(t) as row, count(*) as n from read_parquet($old) t group by 1),
             m as (select to_json(t) as row, count(*) as n from read_parquet($new) t group by 1)
        select sum(least(coalesce(o.n, 0), coalesce(m.n, 0))),
               sum(greatest(coalesce(o.n, 0) - coalesce(m.n, 0), 0)),
               sum(greatest(coalesce(m.n, 0) - coalesce(o.n, 0), 0))
        from o full join m using (row)
    """
    found = duckdb.execute(query, {"old": OLD, "new": NEW}).fetchone()
    return dict(zip(["unchanged", "removed", "added"], map(int, found)))


def joins():
    def count(how):
        query = f"select count(*) from read_parquet($old) o {how} join read_parquet($new) n on o.id = n.id"
        return duckdb.execute(query, {"old": OLD, "new": NEW}).fetchone()[0]

    return {how: count(how) for how in ["inner", "left", "semi", "anti"]}


print(
    json.dumps(
        {
            "profile": profile(OLD),
            "drift": {
                "id": drift_of_numbers("id"),
                "score": drift_of_numbers("score"),
                "tool": drift_of_values("tool"),
            },
            "rows": rows(),
            "joins": joins(),
        }
    )
)
