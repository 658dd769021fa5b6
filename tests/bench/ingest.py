"""Measures `reel ingest` beside the Python script of the same work and a loop that only decodes, on traces with images (as
they are recorded by default) and without; then its memory as traces become more.

CPU time of the work, the least of five: of Python's process without its imports, of ours without what it takes to start and
to ingest a single trace.

  ingest.py --full TRACES --lean TRACES --reel BINARY --decode BINARY --copies BINARY --work DIR [--traces-max N]
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).parent
RUNS = 5


def run(command):
    """CPU seconds and peak memory of a process; what `wait4` tells of memory may be this process's, of which it is a fork."""
    child, peak = subprocess.Popen(command, stdout=subprocess.DEVNULL), 0
    while True:
        with open(f"/proc/{child.pid}/status") as file:
            peak = next((int(line.split()[1]) for line in file if line.startswith("VmHWM")), peak)
        pid, status, used = os.wait4(child.pid, os.WNOHANG)
        if pid:
            break
        time.sleep(0.002)
    if status:
        sys.exit(f"failed: {' '.join(map(str, command))}")
    return used.ru_utime + used.ru_stime, peak * 1024


def ours(reel, traces, store):
    """CPU seconds of an ingest."""
    cpu = []
    for _ in range(RUNS):
        shutil.rmtree(store, ignore_errors=True)
        cpu.append(run([reel, "ingest", *traces, "--store", store])[0])
    return min(cpu)


def python(traces, out, reader):
    cpu = []
    for _ in range(RUNS):
        shutil.rmtree(out, ignore_errors=True)
        command = [sys.executable, HERE / "ingest_python.py", *traces, "--out", out, "--reader", reader]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        cpu.append(json.loads(done.stdout)["cpu_s"])
    return min(cpu)


def decode(binary, traces):
    runs = [json.loads(subprocess.run([binary, *traces], capture_output=True, text=True, check=True).stdout) for _ in range(RUNS)]
    return min(run["cpu_s"] for run in runs)


def copies(binary, traces, folder, count):
    """So many traces of different episodes, made from a few."""
    shutil.rmtree(folder, ignore_errors=True)
    subprocess.run([binary, folder, str(count), *traces], check=True)
    return folder


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--full", required=True, type=Path, help="folder of traces with images")
    parser.add_argument("--lean", required=True, type=Path, help="folder of traces without")
    parser.add_argument("--reel", required=True)
    parser.add_argument("--decode", required=True)
    parser.add_argument("--copies", required=True)
    parser.add_argument("--work", required=True, type=Path)
    parser.add_argument("--traces-max", type=int, default=50_000)
    options = parser.parse_args()
    store = options.work / "ingest-store"
    for name, folder in (("with images", options.full), ("lean", options.lean)):
        traces = sorted(map(str, folder.glob("*.mcap")))
        start = ours(options.reel, traces[:1], store)
        compare(options, name, traces, ours(options.reel, traces, store) - start)
    lean = sorted(map(str, options.lean.glob("*.mcap")))
    for size in [number for number in (1_000, 10_000, 50_000) if number <= options.traces_max]:
        folder = copies(options.copies, lean, options.work / "ingest-copies", size)
        shutil.rmtree(store, ignore_errors=True)
        seconds, peak = run([options.reel, "ingest", folder, "--store", store])
        print(f"  {size:6} traces: {seconds:7.1f} s of CPU, peak {peak / 2**20:6.0f} MB", flush=True)


def compare(options, name, traces, cpu):
    count = len(traces)
    print(f"{count} traces, {name}: ms of CPU a trace")
    print(f"  reel ingest                          {1e3 * cpu / count:7.3f}")
    for reader, told in (("library", "PyPI mcap + protobuf + pyarrow"), ("fast", "the same, records by hand")):
        seconds = python(traces, options.work / "ingest-python", reader)
        print(f"  {told:36} {1e3 * seconds / count:7.3f}  {seconds / cpu:6.2f} times reel's")
    seconds = decode(options.decode, traces)
    print(f"  decoding alone, in Rust              {1e3 * seconds / count:7.3f}  {seconds / cpu:6.2f} times reel's", flush=True)


if __name__ == "__main__":
    main()
