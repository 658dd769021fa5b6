"""A scheduler and executors on machines of their own, with traces and tables in an S3-compatible store: whether they answer as
one machine does, what they do when machines die, and how they grow.

  cluster.py --reel BINARY --work DIR [--traces N] [results|faults|bad-store|scaling ...]
"""

import argparse
import csv
import io
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

from machines import Machines

HERE = Path(__file__).parent
SCHEDULER_PORT, EXECUTOR_PORT, S3_PORT, DOOR_PORT = 50050, 50051, 5566, 5567
EXECUTORS = ["one", "two", "three", "four"]
POLICIES = ["oracle", "planner", "wrong-object", "no-ask", "oscillating"]


class Lab:
    """A bucket with traces and tables, a scheduler and some executors."""

    def __init__(self, options):
        self.reel, self.work = options.reel, options.work
        self.machines = Machines(["scheduler", *EXECUTORS])
        self.scheduler = f"{self.machines.address['scheduler']}:{SCHEDULER_PORT}"
        self.logs = self.work / "logs"
        self.logs.mkdir(parents=True, exist_ok=True)
        self.failures = []
        self.services = []
        self._serve([str(self.machines.here), str(S3_PORT)])
        self._serve([str(self.machines.here), str(DOOR_PORT), f"{self.machines.here}:{S3_PORT}"])

    def _serve(self, arguments):
        command = [sys.executable, str(HERE / "s3.py"), *arguments]
        log = open(self.logs / "s3.log", "ab")
        service = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True)
        self.services.append(service)
        if service.stdout.readline().strip() != "ready":
            sys.exit(f"the S3-compatible store does not start: see {self.logs}/s3.log")

    def environment(self, name, port=S3_PORT):
        """What a process knows of the store; each machine has a cache of its own."""
        return {
            **os.environ,
            "AWS_ENDPOINT_URL": f"http://{self.machines.here}:{port}",
            "AWS_ACCESS_KEY_ID": "test",
            "AWS_SECRET_ACCESS_KEY": "test",
            "AWS_REGION": "us-east-1",
            "AWS_ALLOW_HTTP": "true",
            "REEL_BUCKET_CACHE": str(self.work / f"cache-{name}"),
        }

    def start_scheduler(self, patience=10):
        address = self.machines.address["scheduler"]
        command = [self.reel, "cluster", "scheduler", "--listen", f"{address}:{SCHEDULER_PORT}", "--patience", str(patience)]
        self.machines.start("scheduler", command, self.logs / "scheduler.log", env=self.environment("scheduler"))
        self.wait(address, SCHEDULER_PORT)

    def start_executor(self, name, threads=1, port=S3_PORT):
        address = self.machines.address[name]
        command = [self.reel, "cluster", "executor", "--scheduler", self.scheduler, "--listen", f"{address}:{EXECUTOR_PORT}"]
        command += ["--threads", str(threads), "--traces", f"s3://reel/traces,{self.work}/traces"]
        self.machines.start(name, command, self.logs / f"{name}.log", env=self.environment(name, port))
        self.wait(address, EXECUTOR_PORT)

    def stop(self):
        for name in ["scheduler", *EXECUTORS]:
            self.machines.kill(name)

    def close(self):
        self.machines.close()
        for service in self.services:
            service.kill()

    @staticmethod
    def wait(host, port, seconds=30):
        import socket

        end = time.monotonic() + seconds
        while True:
            try:
                socket.create_connection((host, port), 1).close()
                return
            except OSError:
                if time.monotonic() > end:
                    sys.exit(f"nobody listens at {host}:{port}")
                time.sleep(0.1)

    def command(self, *arguments, cluster=False):
        return [self.reel, *map(str, arguments), *(["--cluster", self.scheduler] if cluster else [])]

    def run(self, *arguments, cluster=False, port=S3_PORT, name="client"):
        """Exit code, standard output, standard error."""
        command = self.command(*arguments, cluster=cluster)
        done = subprocess.run(command, capture_output=True, text=True, env=self.environment(name, port))
        return done.returncode, done.stdout, done.stderr

    def must(self, *arguments, **options):
        code, out, err = self.run(*arguments, **options)
        if code:
            sys.exit(f"reel {' '.join(map(str, arguments))}: exit code {code}: {err}")
        return out

    def cpu(self, name):
        """Seconds of CPU that the processes of a machine used."""
        ticks = 0
        for process in self.machines.processes.get(name, []):
            for pid in subprocess.run(["pgrep", "-g", str(process.pid)], capture_output=True, text=True).stdout.split():
                fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
                ticks += int(fields[11]) + int(fields[12])
        return ticks / os.sysconf("SC_CLK_TCK")

    def check(self, what, held, told=""):
        print(f"{'ok    ' if held else 'FAILED'}  {what}{'' if held else f': {told}'}", flush=True)
        if not held:
            self.failures.append(what)

    def record(self, count):
        """So many episodes of five policies, in the bucket; and two files that are broken, in a folder of this machine."""
        traces = self.work / "traces"
        if not traces.exists():
            part = self.work / "traces.part"
            shutil.rmtree(part, ignore_errors=True)
            self.must("task", "draw", "--count", math.ceil(count / len(POLICIES)), "--out", self.work / "tasks")
            for policy in POLICIES:
                self.must("run", "--tasks", self.work / "tasks", "--policy", policy, "--out", part, "--no-images")
            part.rename(traces)
        broken = self.work / "traces" / "broken"
        if not broken.exists():
            broken.mkdir()
            some = sorted(traces.glob("*.mcap"))[:2]
            shutil.copy(some[0], broken / "torn.mcap")
            os.truncate(broken / "torn.mcap", some[0].stat().st_size // 2)
            damaged = bytearray(some[1].read_bytes())
            damaged[len(damaged) // 2] ^= 1
            (broken / "damaged.mcap").write_bytes(damaged)
        for trace in sorted(traces.glob("*.mcap"))[count:]:
            trace.unlink()
        return traces


def cells(text):
    return [[cell for cell in row] for row in csv.reader(io.StringIO(text))]


def same(one, other):
    """Whether tables are equal; sums of floats depend on the order of their parts in the last bits."""
    if len(one) != len(other):
        return False

    def equal(left, right):
        if left == right:
            return True
        try:
            return math.isclose(float(left), float(right), rel_tol=1e-9, abs_tol=1e-12)
        except ValueError:
            return False

    return all(len(a) == len(b) and all(map(equal, a, b)) for a, b in zip(one, other))


def figures_of(rescored):
    """What a rescoring says of itself, without the store's version."""
    if rescored[0]:
        return None
    figures = {name: figure for name, figure in json.loads(rescored[1])["report"].items() if name != "version"}
    # the two stores hold the episodes in other orders
    return {**figures, "mean_total": round(figures["mean_total"], 9)}


def results(lab, count):
    """Acceptance: the same results as local runs, of every command."""
    lab.record(count)
    lab.start_scheduler()
    for name in EXECUTORS[:3]:
        lab.start_executor(name)
    where = "network namespaces" if lab.machines.apart else "processes of this machine"
    print(f"scheduler and three executors in {where}, {count} episodes in an S3-compatible store")
    out = lab.must("trace", "copy", lab.work / "traces", "s3://reel/traces")
    print(f"        reel trace copy: {out.strip()}")
    out = lab.must("trace", "copy", lab.work / "traces", "s3://reel/traces")
    lab.check("a second copy sends nothing", out.startswith("0 copied"), out)

    begin = time.monotonic()
    alone = lab.run("ingest", "s3://reel/traces", "--store", "s3://reel/alone", "--json")
    middle = time.monotonic()
    together = lab.run("ingest", "s3://reel/traces", "--store", "s3://reel/store", "--json", cluster=True)
    print(f"        ingest: alone {middle - begin:.1f} s, by the cluster {time.monotonic() - middle:.1f} s")
    figures = [json.loads(run[1]) if run[1] else {} for run in (alone, together)]
    [figure.pop("version", None) for figure in figures]
    lab.check("ingest: same figures, same files in quarantine, same exit code", figures[0] == figures[1] and alone[0] == together[0] == 3, [alone, together])
    lab.check("ingest: every episode once", figures[1].get("added") == count, figures[1])
    again = json.loads(lab.run("ingest", "s3://reel/traces", "--store", "s3://reel/store", "--json", cluster=True)[1])
    lab.check("ingest: a second one adds nothing", again["added"] == 0 and again["unchanged"] == count, again)

    # what some of the named queries want to be there
    store = ["--store", "s3://reel/store"]
    rescored = lab.run("store", "reward", *store, "--preset", "real-repo", "--json", cluster=True)
    local = lab.run("taxonomy", *store, "--json", "--dry-run")
    there = lab.run("taxonomy", *store, "--json", cluster=True)
    lab.check("taxonomy: same classes", sorted(local[1].splitlines()) == sorted(there[1].splitlines()) and local[0] == there[0] == 0 and local[1], there)
    local = lab.run("blame", "--store", "s3://reel/alone", "--no-alternatives", "--json")
    there = lab.run("blame", *store, "--no-alternatives", "--json", cluster=True)
    lab.check("blame: same causes", sorted(local[1].splitlines()) == sorted(there[1].splitlines()) and local[0] == there[0] and local[1], there[2])

    for what in [["--check"], ["--diff", "paper", "real-repo", "--json"], ["--diff", "paper", "real-repo"]]:
        local, there = lab.run("store", "reward", *store, *what), lab.run("store", "reward", *store, *what, cluster=True)
        lab.check(f"reward {' '.join(what)}: same", local[:2] == there[:2] and local[1], there)
    local = lab.run("store", "reward", "--store", "s3://reel/alone", "--preset", "real-repo", "--json")
    lab.check("reward --preset: same figures", figures_of(local) == figures_of(rescored) is not None, (local, rescored))

    named = [line.split()[0] for line in lab.must("query", "--list").splitlines()]
    wrong, took = [], [0.0, 0.0]
    for name in named:
        begin = time.monotonic()
        local = lab.run("query", *store, "--named", name, "--format", "csv")
        middle = time.monotonic()
        there = lab.run("query", *store, "--named", name, "--format", "csv", cluster=True)
        took = [took[0] + middle - begin, took[1] + time.monotonic() - middle]
        if local[0] != there[0] or not same(cells(local[1]), cells(there[1])):
            wrong.append((name, there[2].strip()[:300] or there[1][:300]))
    lab.check(f"named queries: same answers, all {len(named)}", not wrong, wrong)
    print(f"        {len(named)} named queries: alone {took[0]:.1f} s, by the cluster {took[1]:.1f} s")

    sql = "SELECT episode_id, replay(trace).verdict AS verdict, replay(trace).digest AS digest FROM episodes ORDER BY episode_id"
    begin = time.monotonic()
    local = lab.run("query", *store, sql, "--format", "csv", "--timeout", 3600)
    middle = time.monotonic()
    there = lab.run("query", *store, sql, "--format", "csv", "--timeout", 3600, cluster=True)
    print(f"        replay(trace) in SQL: alone {middle - begin:.1f} s, by the cluster {time.monotonic() - middle:.1f} s")
    exact = there[1].count(",exact,")
    lab.check(f"replay(trace) over {count} episodes in the bucket: {exact} exact, same rows", local[1] == there[1] and exact == count, there[2][-500:])
    for sql in [
        "SELECT cause, count(*) AS n FROM (SELECT blame(trace).cause AS cause FROM episodes) GROUP BY cause ORDER BY cause",
        "SELECT episode_id, reward(trace, 'real-repo').total_reward AS r FROM episodes ORDER BY episode_id LIMIT 50",
        "SELECT count(*) AS n FROM episodes WHERE false",
        "SELECT * FROM (SELECT 1 AS one) WHERE one = 2",
    ]:
        local, there = lab.run("query", *store, sql, "--format", "csv"), lab.run("query", *store, sql, "--format", "csv", cluster=True)
        lab.check(f"{sql[:60]}: same", local[0] == there[0] == 0 and same(cells(local[1]), cells(there[1])), there)
    for sql in ["SELECT nonsense FROM episodes", "DROP TABLE episodes", "SELECT replay('/etc/passwd').verdict"]:
        local, there = lab.run("query", *store, sql), lab.run("query", *store, sql, cluster=True)
        lab.check(f"{sql}: refused in both", local[0] == there[0] == 2, (local, there))

    traces = lab.work / "traces"
    counted = []
    for name, place in (("there", "s3://reel/traces"), ("here", traces)):
        lab.run("ingest", place, "--store", lab.work / f"store-{name}")
        lab.must("export", "sft", "--store", lab.work / f"store-{name}", "--out", lab.work / f"dataset-{name}", "--format", "trl")
        manifest = json.loads((lab.work / f"dataset-{name}" / "manifest.json").read_text())
        images = sorted(entry["blake3"] for entry in manifest["files"] if "images/" in entry["path"])
        counted.append((manifest["counts"], images))
    lab.check("export of traces in the bucket: same examples and images, verified by replay", counted[0] == counted[1] and counted[0][1], counted)
    for arguments in [["replay", traces, "--json"], ["replay", traces / "broken"], ["replay", traces / "broken", "--outcomes"], ["blame", traces, "--no-alternatives", "--json"]]:
        begin = time.monotonic()
        local = lab.run(*arguments)
        middle = time.monotonic()
        there = lab.run(*arguments, cluster=True)
        took = f"alone {middle - begin:.1f} s, by the cluster {time.monotonic() - middle:.1f} s"
        lab.check(f"reel {arguments[0]} {' '.join(arguments[2:])}: same output and exit code {local[0]}; {took}", local[:2] == there[:2], (local[0], there[0], there[2][-500:]))
    forbidden = lab.run("replay", lab.work / "tasks", cluster=True)
    lab.check("no traces, no work: said so", forbidden[0] == 2 and "no .mcap" in forbidden[2], forbidden)
    shutil.copytree(traces / "broken", lab.work / "elsewhere", dirs_exist_ok=True)
    forbidden = lab.run("replay", lab.work / "elsewhere", cluster=True)
    lab.check("executors open only their folders", forbidden[0] == 2 and "may not open" in forbidden[2], forbidden)
    lab.stop()
    nobody = lab.run("replay", traces, cluster=True)
    lab.check("no scheduler: a clear message", nobody[0] == 2 and "no scheduler answers" in nobody[2], nobody)


def faults(lab, count):
    """Acceptance: node failure and a bad store."""
    traces = lab.record(count)
    expected = lab.run("replay", traces, "--json")
    lab.must("trace", "copy", traces, "s3://reel/traces")

    def trouble(what, seconds, trouble):
        """Replays while something happens after some seconds, and compares."""
        lab.start_scheduler(patience=6)
        for name in EXECUTORS[:3]:
            lab.start_executor(name)
        begin = time.monotonic()
        with open(lab.logs / "client.log", "wb") as log:
            client = subprocess.Popen(lab.command("replay", traces, "--json", cluster=True), stdout=subprocess.PIPE, stderr=log, text=True, env=lab.environment("client"))
            time.sleep(seconds)
            early = client.poll()
            trouble()
            out, _ = client.communicate()
        held = early is None and (client.returncode, out) == expected[:2]
        told = f"ended before: {early}, exit code {client.returncode}, {len(out.splitlines())} of {len(expected[1].splitlines())} lines, {(lab.logs / 'client.log').read_text()[-500:]}"
        lab.check(f"{what}: same verdicts, each once, after {time.monotonic() - begin:.0f} s", held, told)

    trouble("an executor killed midway", 4, lambda: lab.machines.kill("two"))
    lab.stop()
    trouble("two executors killed midway, one after the other", 3, lambda: (lab.machines.kill("two"), time.sleep(3), lab.machines.kill("three")))
    lab.stop()

    def restart():
        lab.machines.kill("scheduler")
        time.sleep(2)
        lab.start_scheduler(patience=6)

    trouble("the scheduler killed midway and started again", 4, restart)

    sql = "SELECT count(*) AS n, sum(CASE WHEN replay(trace).verdict = 'exact' THEN 1 ELSE 0 END) AS exact FROM episodes"
    lab.must("ingest", *sorted(traces.glob("*.mcap")), "--store", lab.work / "store")
    asked = lab.command("query", sql, "--store", lab.work / "store", "--format", "csv", "--timeout", 600, cluster=True)
    client = subprocess.Popen(asked, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=lab.environment("client"))
    time.sleep(3)
    lab.machines.kill("scheduler")
    out, err = client.communicate()
    lab.check("a question whose scheduler dies fails with a message", client.returncode == 2 and err.startswith("reel:") and " went away " in err and "tonic" not in err, (client.returncode, err))
    print(f"        it says: {err.strip()[:200]}")
    lab.start_scheduler(patience=6)
    again = lab.run("query", sql, "--store", lab.work / "store", "--format", "csv", "--timeout", 600, cluster=True)
    lab.check("asked again, it is answered", again[1].splitlines()[1:] == [f"{count},{count}"], again)

    # executors that know no verdict yet
    for name in EXECUTORS[:3]:
        lab.machines.kill(name)
        lab.start_executor(name)
    client = subprocess.Popen(asked, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=lab.environment("client"))
    time.sleep(3)
    client.send_signal(signal.SIGINT)
    _, err = client.communicate()
    time.sleep(3)
    spent = [lab.cpu(name) for name in EXECUTORS[:3]]
    time.sleep(3)
    idle = max(after - before for after, before in zip([lab.cpu(name) for name in EXECUTORS[:3]], spent))
    lab.check(f"Ctrl-C ends a question here and there: exit code {client.returncode}, executors then used {idle:.2f} s of CPU in 3 s", client.returncode == 130 and idle < 0.5, err)
    for name in EXECUTORS[:3]:
        lab.machines.kill(name)
    begin = time.monotonic()
    nobody = lab.run("query", "SELECT count(*) FROM episodes", "--store", lab.work / "store", "--timeout", 120, cluster=True)
    lab.check(f"no executor left: a message after {time.monotonic() - begin:.0f} s", nobody[0] == 2, nobody)
    print(f"        it says: {nobody[2].strip()[:200]}")
    lab.stop()



def bad_store(lab, count):
    """Acceptance: a store that is slow and fails now and then, for everybody."""
    traces = lab.record(count)
    lab.must("trace", "copy", traces, "s3://reel/traces")
    sql = "SELECT count(*) AS n, sum(CASE WHEN replay(trace).verdict = 'exact' THEN 1 ELSE 0 END) AS exact FROM episodes"
    lab.start_scheduler()
    for name in EXECUTORS[:3]:
        lab.start_executor(name, port=DOOR_PORT)
    begin = time.monotonic()
    report = lab.run("ingest", "s3://reel/traces", "--store", "s3://reel/shaky", "--json", cluster=True, port=DOOR_PORT, name="shaky")
    added = json.loads(report[1])["added"] if report[1] else report
    lab.check(f"ingest from and into a bad store: {added} episodes after {time.monotonic() - begin:.0f} s", added == count, report)
    rows = lab.run("query", "SELECT count(*) AS n, count(DISTINCT episode_id) AS d FROM episodes", "--store", "s3://reel/shaky", "--format", "csv")
    lab.check("nothing is there twice", rows[1].splitlines()[1:] == [f"{count},{count}"], rows)
    begin = time.monotonic()
    verdicts = lab.run("query", sql, "--store", "s3://reel/shaky", "--format", "csv", "--timeout", 600, cluster=True, port=DOOR_PORT, name="shaky")
    lab.check(f"replay(trace) from a bad store, after {time.monotonic() - begin:.0f} s", verdicts[1].splitlines()[1:] == [f"{count},{count}"], verdicts)
    lab.stop()


def scaling(lab, count):
    """Acceptance: 1, 2 and 4 executors of one thread on the same replay, beside a local run with one."""
    traces = lab.record(count)
    cores = os.cpu_count()
    files = sorted(traces.glob("*.mcap"))
    begin = time.monotonic()
    lab.must("replay", *files, "--jobs", 1)
    alone = time.monotonic() - begin
    print(f"replay of {len(files)} episodes on {cores} cores")
    print(f"{'':24} {'seconds':>8} {'speedup':>8} {'efficiency':>10} {'of the cores':>13}")
    print(f"{'local, one thread':24} {alone:8.1f}")
    first = None
    for executors in (1, 2, 4):
        lab.start_scheduler()
        for name in EXECUTORS[:executors]:
            lab.start_executor(name)
        time.sleep(1)
        begin = time.monotonic()
        lab.must("replay", *files, cluster=True)
        took = time.monotonic() - begin
        lab.stop()
        first = first or took
        speedup = first / took
        print(f"{f'{executors} executors of 1 thread':24} {took:8.1f} {speedup:8.2f} {speedup / executors:9.0%} {speedup / min(executors, cores):12.0%}", flush=True)
        if executors == 1:
            print(f"{'':24} overhead against the local run: {took / alone - 1:+.1%}")
        if executors == 2:
            lab.check("two executors do it in at most 0.65 of the time of one", took <= 0.65 * first or cores < 2, took / first)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--reel", required=True)
    parser.add_argument("--work", required=True, type=Path)
    parser.add_argument("--traces", type=int, default=1000)
    parser.add_argument("parts", nargs="*", default=[], help="results, faults, bad-store, scaling; without any, all")
    options = parser.parse_args()
    options.work = options.work.absolute()
    parts = {"results": results, "faults": faults, "bad-store": bad_store, "scaling": scaling}
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("told to end"))
    lab = Lab(options)
    try:
        for name in options.parts or parts:
            print(f"== {name}", flush=True)
            parts[name](lab, options.traces)
    finally:
        lab.close()
    if lab.failures:
        sys.exit(f"{len(lab.failures)} checks failed")


if __name__ == "__main__":
    main()
