"""Makes, compacts and asks stores of synthetic episodes, one after the other, and prints time and memory of every step; then the
benchmark table of the largest by third-party readers, from the files that the Delta log names.

  scale.py --reel BINARY --work DIR [--gib 8] EPISODES...
"""

import argparse
import csv
import io
import math
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).parent
QUESTIONS = ["benchmark", "failures", "funnel", "advantages"]


def measured(command):
    """Seconds of wall and CPU, most bytes of memory at a time, standard output."""
    with tempfile.TemporaryFile() as out:
        begin = time.monotonic()
        process = subprocess.Popen([str(word) for word in command], stdout=out)
        _, status, usage = os.wait4(process.pid, 0)
        wall = time.monotonic() - begin
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            sys.exit(f"{' '.join(map(str, command))}: exit code {process.returncode}")
        out.seek(0)
        return wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1024, out.read().decode()


def growth(reel, work, sizes, limit, traces):
    rows, most = {}, 0
    for size in sizes:
        store = work / f"store-{size}"
        steps = {}
        if not store.exists():
            part = work / f"store-{size}.part"
            shutil.rmtree(part, ignore_errors=True)
            steps["made"] = measured([reel, "store", "synthesize", "--episodes", size, "--store", part])
            steps["compacted"] = measured([reel, "store", "compact", "--store", part])
            measured([reel, "store", "vacuum", "--store", part, "--retention-hours", 0])
            part.rename(store)
        # into a copy whose files are the same: nothing else grows
        more = work / f"store-{size}.more"
        shutil.rmtree(more, ignore_errors=True)
        shutil.copytree(store, more, copy_function=os.link)
        steps["three traces"] = measured([reel, "ingest", *traces, "--store", more, "--json"])
        shutil.rmtree(more)
        for question in QUESTIONS:
            steps[question] = measured([reel, "query", "--store", store, "--file", HERE / "sql" / f"{question}.sql", "--format", "csv"])
        files = list((store / "episodes").glob("*.parquet"))
        print(f"{size:,} episodes: {sum(file.stat().st_size for file in files) / 1e6:,.0f} MB in {len(files)} files", flush=True)
        for step, (wall, cpu, memory, _) in steps.items():
            most = max(most, memory)
            before = rows.get((sizes[max(0, sizes.index(size) - 1)], step))
            grown = f"{wall / before[0]:6.1f} times" if before and size != sizes[0] else ""
            print(f"  {step:12} {wall:8.2f} s  {cpu:8.2f} s CPU  {memory / 2**20:8,.0f} MiB  {grown}", flush=True)
            rows[size, step] = (wall, cpu, memory)
    print(f"most memory at a time: {most / 2**30:.2f} GiB, allowed {limit}")
    return most <= limit * 2**30


def duckdb_table(files, sql):
    import duckdb

    connection = duckdb.connect()
    connection.execute("SET threads = 2")
    names = ", ".join(f"'{file}'" for file in files)
    connection.execute(f"CREATE VIEW episodes AS SELECT * FROM read_parquet([{names}])")
    return connection.execute(sql).fetchall()


def spark_table(files, sql):
    from pyspark.sql import SparkSession

    builder = SparkSession.builder.master("local[2]").config("spark.driver.memory", "3g").config("spark.ui.enabled", "false").config("spark.ui.showConsoleProgress", "false")
    spark = builder.config("spark.driver.host", "127.0.0.1").getOrCreate()
    spark.sparkContext.setLogLevel("OFF")
    spark.read.parquet(*files).createOrReplaceTempView("episodes")
    rows = [tuple(row) for row in spark.sql(sql).collect()]
    spark.stop()
    return rows


def same(one, other):
    def equal(left, right):
        return left == right or math.isclose(float(left), float(right), rel_tol=1e-6, abs_tol=1e-6)

    def row(cells):
        return [None if cell in ("", None) else str(cell) if index < 2 else float(cell) for index, cell in enumerate(cells)]

    one, other = sorted(map(row, one)), sorted(map(row, other))
    return len(one) == len(other) and all(len(a) == len(b) and all(map(equal, a, b)) for a, b in zip(one, other))


def others(reel, store):
    """Whether third-party readers give the same benchmark table."""
    from deltalake import DeltaTable

    sql = (HERE / "sql" / "benchmark.sql").read_text().split("\n", 1)[1]
    files = [path.removeprefix("file://") for path in DeltaTable(str(store / "episodes")).file_uris()]
    ours = list(csv.reader(io.StringIO(measured([reel, "query", "--store", store, "--file", HERE / "sql" / "benchmark.sql", "--format", "csv"])[3])))[1:]
    held = True
    for name, table in [("duckdb", duckdb_table), ("pyspark", spark_table)]:
        begin = time.monotonic()
        try:
            theirs = table(files, sql)
        except ImportError:
            print(f"skipped: {name} is not installed")
            continue
        equal = same(ours, theirs)
        held = held and equal
        print(f"{name}: {len(theirs)} rows of the benchmark table in {time.monotonic() - begin:.1f} s, {'equal' if equal else 'DIFFERENT'}")
        if not equal:
            print("  reel  ", ours[:2], "\n  theirs", theirs[:2])
    return held


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--reel", required=True)
    parser.add_argument("--work", required=True, type=Path)
    parser.add_argument("--gib", type=float, default=8)
    parser.add_argument("sizes", nargs="+", type=int)
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    traces = sorted((HERE.parents[1] / "traces" / "golden").glob("*.mcap"))[:3]
    within = growth(options.reel, options.work, options.sizes, options.gib, traces)
    held = others(options.reel, options.work / f"store-{options.sizes[-1]}")
    sys.exit(0 if within and held else 1)


if __name__ == "__main__":
    main()
