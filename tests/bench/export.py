"""Measures `reel export sft` beside the Python script of the same work: traces recorded with pictures and without into rows
without pictures, and into rows with them; then its memory as traces become more. Before that the rows of both are compared.

The script reads traces, and so does `reel ingest`; what the export reads is the store that ingest filled. Both ratios are
printed: of the export alone, and of ingest and export together. Neither replays; what the first export of a trace replays to
verify it stands on a line of its own, as no script can do it.

Examples a CPU second, of the least of five runs; of every process, its start and a single trace are taken off.

  export.py --full TRACES --lean TRACES --reel BINARY --work DIR [--copies BINARY] [--traces-max N] [--check]
"""

import argparse
import json
import shutil
import subprocess
import sys
from io import BytesIO
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image, ImageChops, ImageStat

from ingest import HERE, RUNS, copies, run

# Traces whose rows are compared.
COMPARED = 60
# What only a store knows.
LEFT_OUT = ("preset_digest", "table_version")
# Two ways to scale a picture differ by so much of 255, on average.
MEAN_DIFFERENCE_MAX = 0.5
# Of the script: who goes through the records, and how rows become a dataset.
SCRIPTS = (
    ("library", "generator", "PyPI mcap + Dataset.from_generator"),
    ("library", "columns", "PyPI mcap + Dataset of Arrow columns"),
    ("fast", "columns", "the same, records by hand"),
)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--full", required=True, type=Path, help="folder of traces with pictures")
    parser.add_argument("--lean", required=True, type=Path, help="folder of traces without")
    parser.add_argument("--reel", required=True)
    parser.add_argument("--work", required=True, type=Path)
    parser.add_argument("--copies", help="example trace_copies; without it memory is not measured")
    parser.add_argument("--traces-max", type=int, default=50_000)
    parser.add_argument("--check", action="store_true", help="only compare the rows")
    options = parser.parse_args()
    bench = Bench(options.reel, options.work)
    full, lean = (sorted(map(str, folder.glob("*.mcap"))) for folder in (options.full, options.lean))
    kinds = (("recorded with pictures", full, False), ("recorded without", lean, False), ("recorded with pictures", full, True))
    for name, traces, images in kinds:
        bench.check(name, traces, images)
    if options.check:
        return
    for name, traces, images in kinds:
        bench.compare(name, traces, images)
    if options.copies:
        print("memory of reel export sft")
        for size in [number for number in (1_000, 10_000, 50_000) if number <= options.traces_max]:
            bench.memory(copies(options.copies, lean, options.work / "export-copies", size), size)


class Bench:
    """Runs both, in a folder."""

    def __init__(self, reel, work):
        self.reel, self.work = reel, work
        self.store, self.out, self.python_out = (work / name for name in ("export-store", "export", "export-python"))

    def check(self, name, traces, images):
        """Ends the program where a row of the script is not the row of the export."""
        traces = traces[:: -(-len(traces) // COMPARED)]
        self.ingest(traces)
        self.export(images, "--no-replay", "--allow-unverified")
        ours = rows(self.out)
        for reader, build, _ in scripts(images):
            self.script(traces, reader, build, images)
            theirs = rows(self.python_out)
            if not ours or [row["example"] for row in ours] != [row["example"] for row in theirs]:
                sys.exit(f"{name}: {len(ours)} and {len(theirs)} rows, none or others")
            for mine, other in zip(ours, theirs):
                differing = [column for column in mine if mine[column] != other[column] and column not in (*LEFT_OUT, "images")]
                pictures = zip(mine["images"], other["images"], strict=True)
                if differing or len(mine["images"]) != images or not all(alike(*pair) for pair in pictures):
                    sys.exit(f"{name}: example {mine['example']} differs: {', '.join(differing) or 'pictures'}")
        shown = "rows with pictures" if images else "rows without"
        print(f"traces {name}, {shown}: {len(ours)} rows of {len(traces)} traces are the same", flush=True)

    def compare(self, name, traces, images):
        """Prints what both make of the traces; each figure is of all traces, and of one."""
        alone, together, first, counts = [], [], [], []
        one = [next(trace for trace in traces if "--oracle--" in trace)]
        for some in (traces, one):
            self.ingest(some)
            first.append(self.export(images))
            alone.append(least(lambda: self.export(images, "--no-replay")))
            together.append(least(lambda: self.ingest(some) + self.export(images, "--no-replay", "--allow-unverified")))
            manifest = json.loads((self.out / "manifest.json").read_text())
            counts.append(sum(manifest["counts"]["splits"].values()))

        def rate(seconds):
            return (counts[0] - counts[1]) / (seconds[0] - seconds[1])

        def show(told, rate, *more):
            print(f"  {told:40} {rate:9.0f}", *more, flush=True)

        with_pictures = "with pictures" if images else "without pictures"
        print(f"{len(traces)} traces {name}, {counts[0]} rows {with_pictures}: examples a CPU second")
        show("reel export sft", rate(alone))
        show("reel ingest, then reel export sft", rate(together))
        for reader, build, told in scripts(images):
            theirs = rate([least(lambda: self.script(some, reader, build, images)) for some in (traces, one)])
            ratios = f"reel: {rate(alone) / theirs:.1f} times it, with ingest {rate(together) / theirs:.1f} times"
            show(told, theirs, ratios)
        show("verifying by replay, at the first export", rate([a - b for a, b in zip(first, alone)]))

    def memory(self, folder, size):
        self.ingest([folder])
        seconds, peak = self.export_run(False, "--no-replay", "--allow-unverified")
        print(f"  {size:6} traces: {seconds:7.1f} s of CPU, peak {peak / 2**20:6.0f} MB", flush=True)

    def ingest(self, traces):
        """CPU seconds of an ingest into an empty store."""
        shutil.rmtree(self.store, ignore_errors=True)
        return run([self.reel, "ingest", *traces, "--store", self.store])[0]

    def export(self, images, *more):
        """CPU seconds of an export into an empty folder."""
        return self.export_run(images, *more)[0]

    def export_run(self, images, *more):
        shutil.rmtree(self.out, ignore_errors=True)
        pictures = "png" if images else "none"
        how = ["--format", "parquet", "--words", "recorded", "--images", pictures, *more]
        return run([self.reel, "export", "sft", "--store", self.store, "--out", self.out, *how])

    def script(self, traces, reader, build, images):
        """CPU seconds of the script, without its imports."""
        shutil.rmtree(self.python_out, ignore_errors=True)
        command = [sys.executable, HERE / "export_python.py", *traces, "--out", self.python_out]
        command += ["--reader", reader, "--build", build, *["--images"] * images]
        return json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)["cpu_s"]


def scripts(images):
    """With pictures the ways of the script differ by little, and one stands for all."""
    return SCRIPTS[1:2] if images else SCRIPTS


def least(work):
    return min(work() for _ in range(RUNS))


def rows(folder):
    tables = [pq.read_table(file) for file in sorted(folder.rglob("*.parquet"))]
    return sorted(pa.concat_tables(tables).to_pylist(), key=lambda row: row["example"])


def alike(mine, other):
    """Whether two pictures are of one size, and nearly of one content."""
    mine, other = (Image.open(BytesIO(picture["bytes"])) for picture in (mine, other))
    return mine.size == other.size and max(ImageStat.Stat(ImageChops.difference(mine, other)).mean) <= MEAN_DIFFERENCE_MAX


if __name__ == "__main__":
    main()
