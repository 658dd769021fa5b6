"""Measures `reel ingest` beside the Python script of the same work and a loop that only decodes; then its memory as traces
become more. CPU seconds of the whole process for ours, of the work without imports for Python's; median of three.

  ingest.py TRACES --reel BINARY --decode BINARY --copies BINARY --work DIR [--traces-max N]
"""

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
RUNS = 3


def run(command):
    """CPU seconds and peak memory of a process."""
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(child.pid, 0)
    if status:
        sys.exit(f"failed: {' '.join(map(str, command))}")
    return used.ru_utime + used.ru_stime, used.ru_maxrss * 1024


def ours(reel, traces, store):
    cpu = []
    for _ in range(RUNS):
        shutil.rmtree(store, ignore_errors=True)
        seconds, peak = run([reel, "ingest", traces, "--store", store])
        cpu.append(seconds)
    return statistics.median(cpu), peak


def python(traces, out, reader):
    cpu = []
    for _ in range(RUNS):
        shutil.rmtree(out, ignore_errors=True)
        files = sorted(map(str, traces.glob("*.mcap")))
        command = [sys.executable, HERE / "ingest_python.py", *files, "--out", out, "--reader", reader]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        cpu.append(json.loads(done.stdout)["cpu_s"])
    return statistics.median(cpu)


def decode(binary, traces):
    files = sorted(map(str, traces.glob("*.mcap")))
    runs = [json.loads(subprocess.run([binary, *files], capture_output=True, text=True, check=True).stdout) for _ in range(RUNS)]
    return statistics.median(run["cpu_s"] for run in runs)


def copies(binary, traces, folder, count):
    """So many traces of different episodes, made from a few."""
    shutil.rmtree(folder, ignore_errors=True)
    files = sorted(map(str, traces.glob("*.mcap")))
    subprocess.run([binary, folder, str(count), *files], check=True)
    return folder


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("traces", type=Path)
    parser.add_argument("--reel", required=True)
    parser.add_argument("--decode", required=True)
    parser.add_argument("--copies", required=True)
    parser.add_argument("--work", required=True, type=Path)
    parser.add_argument("--traces-max", type=int, default=50_000)
    options = parser.parse_args()
    count = len(list(options.traces.glob("*.mcap")))
    store = options.work / "ingest-store"
    cpu, _ = ours(options.reel, options.traces, store)
    print(f"{count} traces, ms of CPU a trace")
    print(f"  reel ingest                          {1e3 * cpu / count:7.3f}")
    for reader, name in (("library", "PyPI mcap + protobuf + pyarrow"), ("fast", "the same, records by hand")):
        seconds = python(options.traces, options.work / "ingest-python", reader)
        print(f"  {name:36} {1e3 * seconds / count:7.3f}  {seconds / cpu:6.2f} times reel's")
    seconds = decode(options.decode, options.traces)
    print(f"  decoding alone, in Rust              {1e3 * seconds / count:7.3f}  {seconds / cpu:6.2f} times reel's")
    for size in [number for number in (1_000, 10_000, 50_000) if number <= options.traces_max]:
        folder = copies(options.copies, options.traces, options.work / "ingest-copies", size)
        shutil.rmtree(store, ignore_errors=True)
        seconds, peak = run([options.reel, "ingest", folder, "--store", store])
        print(f"  {size:6} traces: {seconds:7.1f} s of CPU, peak {peak / 2**20:6.0f} MB")


if __name__ == "__main__":
    main()
