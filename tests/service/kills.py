"""Kills at random moments over `reel serve`, `mcp`, `record`, `ingest`, `export` and a cluster, and what must be there afterwards:
every answered call in its trace, every table whole, every export byte for byte that of an undisturbed one.

  kills.py [--kills N] [--seed S] [--only NAME] [--quick]

The command is $REEL. Kill number n has the seed S + n, which draws the scenario, the load and the moment: a failure prints the
command that repeats it. A kill is SIGKILL, or of a process that is just starting, or of one that is seen to finish a file.
`--quick` is the short form of `make test`."""

import argparse
import collections
import os
import pathlib
import random
import shutil
import signal
import sys
import tempfile
import time
import traceback

from kills_calls import Mcp, Record, Serve
from kills_tables import Cluster, Export, Ingest

SCENES = {"serve": Serve, "mcp": Mcp, "record": Record, "ingest": Ingest, "export": Export, "cluster": Cluster}
#: Whose turn a seed is: twelve in a row have every scenario, the ones with calls most often.
TURNS = ["serve", "mcp", "record", "ingest", "export", "cluster", "serve", "record", "mcp", "ingest", "serve", "export"]
#: The columns of the table at the end, and the width of each.
COLUMNS = {
    "kills": 6, "starting": 9, "finishing": 10, "acknowledged": 13, "lost": 5, "tables": 7, "torn": 5, "left over": 10, "slowest recovery": 17,
}


class Tally(collections.Counter):
    """What a scenario came to."""

    def add(self, found):
        self["kills"] += 1
        slowest = max(self["slowest recovery"], found.pop("slowest recovery", 0.0))
        self.update(found)
        self["slowest recovery"] = slowest

    def row(self, name):
        cells = [f"{self[column]:.1f} s" if column == "slowest recovery" else str(self[column]) for column in COLUMNS]
        return f"{name:8}" + "".join(f"{cell:>{width}}" for cell, width in zip(cells, COLUMNS.values()))


def table(tallies):
    """What happened, by scenario."""
    total = Tally()
    for tally in tallies.values():
        slowest = max(total["slowest recovery"], tally["slowest recovery"])
        total.update(tally)
        total["slowest recovery"] = slowest
    head = f"{'':8}" + "".join(f"{column:>{width}}" for column, width in COLUMNS.items())
    return "\n".join([head, *(tally.row(name) for name, tally in tallies.items()), total.row("all")])


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--kills", type=int, help="how many (1000; with --quick 12)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first kill")
    parser.add_argument("--only", choices=SCENES, help="this scenario alone")
    parser.add_argument("--quick", action="store_true", help="the short form")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="begin no kill after so long")
    options = parser.parse_args()
    kills = options.kills or (12 if options.quick else 1000)
    work = pathlib.Path(tempfile.mkdtemp(prefix="reel-kills-")).resolve()
    # Whoever ends this ends what it started.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("told to end"))
    scenes, tallies, violations, begun = {}, {}, 0, time.monotonic()
    try:
        for seed in range(options.seed, options.seed + kills):
            if time.monotonic() - begun > 60 * options.minutes:
                print(f"{seed - options.seed} of {kills} kills in {options.minutes:g} minutes, then no more")
                break
            name = options.only or TURNS[seed % len(TURNS)]
            if name not in scenes:
                scenes[name] = SCENES[name](work / name, options.quick)
                tallies.setdefault(name, Tally())
            try:
                tallies[name].add(scenes[name].kill(seed, random.Random(seed)))
            except Exception as error:  # a failed check, or whatever kept it from being made
                violations += 1
                tallies[name].add(getattr(error, "found", {}))
                kept = scenes.pop(name).abandon(work / f"violation-{seed}")
                print(f"VIOLATION in {name}: {type(error).__name__}: {error}", flush=True)
                print(f"  repeat: tests/service/kills.py --seed {seed} --kills 1 --only {name}; its files: {kept}", flush=True)
                traceback.print_exc()
            number = seed - options.seed + 1
            if number % (4 if options.quick else 20) == 0 or number == kills:
                print(f"  {number} kills, {violations} violations, {time.monotonic() - begun:.0f} s", flush=True)
    finally:
        for scene in scenes.values():
            scene.close()
    print(table(tallies))
    print(f"{sum(tally['kills'] for tally in tallies.values())} kills from seed {options.seed} in {time.monotonic() - begun:.0f} s, {violations} violations")
    if violations:
        sys.exit(1)
    shutil.rmtree(work, ignore_errors=True)


if __name__ == "__main__":
    os.environ.setdefault("PYTHONDONTWRITEBYTECODE", "1")
    main()
