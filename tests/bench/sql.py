"""Asks the four questions of `sql_duckdb.py` of `reel query` and of DuckDB, compares the answers, prints the ratios.

Both are asked once before, in a process of their own for each question, and measured when they are asked again: CPU time of
the question with its planning, and the most memory that the process ever had. DuckDB answers on the cheapest of its
variants. The last column is `reel query` as a whole, from the start of its process to the answer.

  sql.py STORE --work DIR --reel BINARY
"""

import argparse
import json
import re
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from sql_duckdb import QUERIES, in_own_process, prepare, same

HERE = Path(__file__).parent
# How users of each table would ask; the others read every field of the steps, or sort.
VARIANTS = {"benchmark": ["store"], "failures": ["lists", "ordered"], "funnel": ["lists", "ordered"], "advantages": ["lists", "grouped", "gathered"]}
RUNS = 10


def ours(reel, store, question):
    """The answer; CPU seconds of a question asked again, peak bytes, CPU seconds of a process that is asked once."""
    with tempfile.NamedTemporaryFile(suffix=".json") as out:
        command = [reel, "query", "--store", store, "--json", "--out", out.name, "--file", HERE / "sql" / f"{question}.sql"]
        told = subprocess.run([*command, "--timing", "--repeat", str(RUNS)], capture_output=True, text=True)
        if told.returncode:
            sys.exit(f"{question}: reel query failed: {told.stderr}")
        rows = [tuple(row.values()) for row in json.load(out)]
        again = re.search(r"again in .* wall, (.*) s CPU, (.*) MiB", told.stderr)
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(command, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    once = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return rows, float(again[1]), int(again[2]) << 20, once


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("store", type=Path)
    parser.add_argument("--work", required=True, type=Path)
    parser.add_argument("--reel", required=True)
    options = parser.parse_args()
    prepare(options.store, options.work)
    wrong = False
    print(f"{'question':12} {'reel CPU s':>10} {'DuckDB CPU s':>12} {'ratio':>6} {'reel MB':>8} {'DuckDB MB':>9} {'ratio':>6} {'process s':>9}  answers")
    for question in QUERIES:
        rows, cpu, peak, once = ours(options.reel, str(options.store), question)
        figures = {
            name: in_own_process(options.store, options.work, QUERIES[question][name])
            for name in VARIANTS[question]
        }
        best = min(figures, key=lambda name: figures[name]["cpu_s"])
        theirs = figures[best]
        equal = same(rows, [tuple(row) for row in theirs["answer"]])
        wrong = wrong or not equal
        memory = theirs["peak_rss_bytes"]
        print(
            f"{question:12} {cpu:10.2f} {theirs['cpu_s']:12.2f} {cpu / theirs['cpu_s']:6.2f} {peak / 2**20:8.0f}"
            f" {memory / 2**20:9.0f} {peak / memory:6.2f} {once:9.2f}  {'equal' if equal else 'DIFFER'} (DuckDB best: {best})"
        )
        if not equal:
            print("  reel  ", rows[:3], "\n  duckdb", theirs["answer"][:3])
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
