"""Measures `reel export sft` beside the Python script of the same work: traces recorded with frames and without into rows
without frames, and into rows with them; then its memory as traces become more. Before that the rows of both are compared.

The script verifies the traces it reads, refuses privileged text, counts tokens and writes a manifest, as the export does; what
it does less is told in `export_python.py`. What it takes without all that stands beside it (`unchecked`).

The script reads traces, and so does `reel ingest`; what the export reads is the store that ingest filled. Both ratios are
printed: of the export alone, and of ingest and export together. Neither replays; what the first export of a trace replays to
verify it stands on a line of its own, as no script can do it.

Examples a CPU second, of the least of five runs; of every process, its start and a single trace are taken off.

  export.py --full TRACES --lean TRACES --reel BINARY --work DIR [--copies BINARY] [--traces-max N] [--check]
"""

import argparse
import base64
import json
import re
import shutil
import subprocess
import sys
from io import BytesIO
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image, ImageChops, ImageStat

import export_checks
from ingest import HERE, RUNS, copies, run

# Traces whose rows are compared.
COMPARED = 60
# Where rows need no verdict.
UNVERIFIED = ("--no-replay", "--allow-unverified")
# What only a store knows.
LEFT_OUT = ("preset_digest", "table_version")
# Two ways to scale an image differ by so much of 255, on average.
MEAN_DIFFERENCE_MAX = 0.5
# What the script's manifest tells as ours does.
COUNTED = (("counts", "examples"), ("counts", "families"), ("counts", "tools"), ("counts", "policies"), ("excluded",)) + tuple(
    ("tokens", part) for part in ("examples", "text", "longest", "over", "histogram")
)
ALONE, TOGETHER = "reel export sft", "reel ingest, then reel export sft"
# Ways of the script: who goes through the records, how rows become a dataset, and whether it does the same as the export.
SCRIPTS = (
    ("PyPI mcap + Dataset.from_generator", ("library", "generator")),
    ("PyPI mcap + Dataset of Arrow columns", ("library", "columns")),
    ("the latter, records by hand", ("fast", "columns")),
    ("the first, unchecked", ("library", "generator", "--unchecked")),
    ("the second, unchecked", ("library", "columns", "--unchecked")),
)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--full", required=True, type=Path, help="folder of traces with images")
    parser.add_argument("--lean", required=True, type=Path, help="folder of traces without")
    parser.add_argument("--reel", required=True)
    parser.add_argument("--work", required=True, type=Path)
    parser.add_argument("--copies", help="example trace_copies; without it memory is not measured")
    parser.add_argument("--traces-max", type=int, default=50_000)
    parser.add_argument("--check", action="store_true", help="only compare the rows")
    options = parser.parse_args()
    bench = Bench(options.reel, options.work)
    full, lean = (sorted(map(str, folder.glob("*.mcap")), key=in_order) for folder in (options.full, options.lean))
    check_leaks()
    kinds = (("recorded with images", full, False), ("recorded without", lean, False), ("recorded with images", full, True))
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


def in_order(trace):
    """By name, those of the policy that succeeds first."""
    return "--oracle--" not in trace, trace


class Bench:
    """Runs both, in a folder."""

    def __init__(self, reel, work):
        self.reel, self.work = reel, work
        self.store, self.out, self.python_out = (work / name for name in ("export-store", "export", "export-python"))

    def check(self, name, traces, images):
        """Ends the program where a row of the script is not the row of the export."""
        traces = traces[:: -(-len(traces) // COMPARED)]
        self.ingest(traces)
        self.export(images, *UNVERIFIED)
        ours = rows(self.out)
        manifest = json.loads((self.out / "manifest.json").read_text())
        for told, way in scripts(images):
            self.script(traces, way, images)
            theirs = rows(self.python_out)
            # the script counts no tokens of images
            if "--unchecked" not in way and not images:
                other = json.loads((self.python_out / "manifest.json").read_text())
                differing = [path for path in COUNTED if at(manifest, path) != at(other, path)]
                if differing:
                    sys.exit(f"{name}, {told}: the manifests differ in {differing}")
            if not ours or [row["example"] for row in ours] != [row["example"] for row in theirs]:
                sys.exit(f"{name}: {len(ours)} and {len(theirs)} rows, none or others")
            for mine, other in zip(ours, theirs):
                differing = [column for column in mine if mine[column] != other[column] and column not in (*LEFT_OUT, "images")]
                frames = zip(mine["images"], other["images"], strict=True)
                # the first decision of an episode shows no image
                expected = images and mine["call"] > 0
                if differing or len(mine["images"]) != expected or not all(alike(*pair) for pair in frames):
                    sys.exit(f"{name}: example {mine['example']} differs: {', '.join(differing) or 'images'}")
        shown = "rows with images" if images else "rows without"
        print(f"traces {name}, {shown}: {len(ours)} rows of {len(traces)} traces are the same", flush=True)

    def compare(self, name, traces, images):
        """Prints what both make of the traces; each figure is of all traces, and of one that succeeded, whose is taken off."""
        counts, seconds, first = [], [], []
        for some in (traces, traces[:1]):
            self.ingest(some)
            first.append(self.export(images))
            works = {ALONE: lambda: self.export(images, *UNVERIFIED)}
            works[TOGETHER] = lambda some=some: self.ingest(some) + self.export(images, *UNVERIFIED)
            works |= {told: lambda some=some, way=way: self.script(some, way, images) for told, way in scripts(images)}
            seconds.append(least(works))
            manifest = json.loads((self.out / "manifest.json").read_text())
            counts.append(sum(manifest["counts"]["splits"].values()))

        def rate(all_, one):
            return (counts[0] - counts[1]) / (all_ - one)

        rates = {told: rate(*(part[told] for part in seconds)) for told in seconds[0]}
        with_frames = "with images" if images else "without images"
        print(f"{len(traces)} traces {name}, {counts[0]} rows {with_frames}: examples a CPU second")
        for told, theirs in rates.items():
            ratios = f"reel: {rates[ALONE] / theirs:.1f} times it, with ingest {rates[TOGETHER] / theirs:.1f} times"
            print(f"  {told:40} {theirs:9.0f} {'' if told in (ALONE, TOGETHER) else ratios}", flush=True)
        replayed = rate(*(first[at] - seconds[at][ALONE] for at in (0, 1)))
        print(f"  {'verifying by replay, at the first export':40} {replayed:9.0f}", flush=True)

    def memory(self, folder, size):
        self.ingest([folder])
        seconds, peak = self.export_run(False, *UNVERIFIED)
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
        frames = "png" if images else "none"
        how = ["--format", "parquet", "--annotations", "recorded", "--images", frames, *more]
        return run([self.reel, "export", "sft", "--store", self.store, "--out", self.out, *how])

    def script(self, traces, way, images):
        """CPU seconds of the script, without its imports."""
        reader, build, *more = way
        shutil.rmtree(self.python_out, ignore_errors=True)
        command = [sys.executable, HERE / "export_python.py", *traces, "--out", self.python_out]
        command += ["--reader", reader, "--build", build, *more, *["--images"] * images]
        return json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)["cpu_s"]


def scripts(images):
    """With images the ways of the script differ by little, and one stands for all."""
    return SCRIPTS[1:2] if images else SCRIPTS


def at(manifest, path):
    for part in path:
        manifest = manifest[part]
    return manifest


def check_leaks():
    """Ends the program where the script misses privileged text that our tests plant, or finds some in clean text."""
    source = (HERE.parents[1] / "src/dataset/tests/dataset/leaks.rs").read_text()
    literal = r'"((?:[^"\\]|\\.)*)"'
    planted = re.findall(rf"\(\s*\w+,\s*{literal},?\s*\)", source[source.index("fn planted") : source.index("let hidden")])
    clean = re.findall(rf"^ +{literal},$", source[source.index("fn clean_texts") : source.index("for text in texts")], re.MULTILINE)
    words = ("vase_03_on_shelf_1_at_home_0001", "vase_03", "_01cace88a48c", "FDO/home_0001")
    phrase = "Move the tall blue vase from the oak shelf to the glass table."
    secrets = export_checks.Secrets([*words, phrase], ["shelf_1", "table_2", "refrigerator_1", "lamp_on_stand_1"])
    for texts, expected in ((planted, True), (clean, False)):
        for text in (json.loads(f'"{text}"') for text in texts):
            hidden = base64.b64encode(f"It says so: {text}".encode()).decode(), text.replace("_", "%5F"), json.dumps({"History": text})
            for form in (text, *hidden):
                if export_checks.privileged(form, secrets) != expected:
                    sys.exit(f"the script {'misses' if expected else 'complains of'} {form!r}")
    print(f"the script finds {len(planted)} kinds of privileged text and lets {len(clean)} clean ones pass")


def least(works):
    """CPU seconds of each work: the least of several runs, which take turns, as the machine is not always as fast."""
    rounds = [{told: work() for told, work in works.items()} for _ in range(RUNS)]
    return {told: min(seconds[told] for seconds in rounds) for told in works}


def rows(folder):
    tables = [pq.read_table(file) for file in sorted(folder.rglob("*.parquet"))]
    return sorted(pa.concat_tables(tables).to_pylist(), key=lambda row: row["example"])


def alike(mine, other):
    """Whether two images are of one size, and nearly of one content."""
    mine, other = (Image.open(BytesIO(frame["bytes"])) for frame in (mine, other))
    return mine.size == other.size and max(ImageStat.Stat(ImageChops.difference(mine, other)).mean) <= MEAN_DIFFERENCE_MAX


if __name__ == "__main__":
    main()
