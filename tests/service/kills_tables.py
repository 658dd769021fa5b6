"""Kills of what writes tables and data sets, for `kills.py`: `reel ingest` and what else changes a store, `reel export`, and the
parts of a cluster. Each version of a store that a reader can open is whole, and the next run ends as an undisturbed one."""

import contextlib
import hashlib
import json
import pathlib
import random
import shutil
import socket
import subprocess
import time

from harness import REEL, reel, until
from kills_calls import Lost, Scene

GOLDEN = pathlib.Path(__file__).resolve().parents[2] / "traces" / "golden"
#: Words of the libraries below, which say nothing to who asked.
RAW = ["tonic", "transport error", "h2 protocol", "hyper", "Grpc", "status: ", "panicked", "tcp connect error", "DataFusionError"]
#: Longest time until whoever asks a cluster has an answer or an error.
ANSWER_S = 60

#: What has to hold in every version, as figures of which both of a pair are equal.
WHOLE = """
SELECT (SELECT count(*) FROM episodes) AS episodes, (SELECT count(DISTINCT episode_id) FROM episodes) AS ids,
  (SELECT count(*) FROM episodes e JOIN tasks t ON t.task_digest = e.task_digest JOIN scenes s ON s.scene_digest = e.scene_digest
   WHERE array_length(e.steps) = e.length OR e.length = 0) AS joined,
  (SELECT count(*) FROM steps) AS steps, (SELECT coalesce(sum(length), 0) FROM episodes) AS lengths,
  (SELECT count(task_digest) FROM tasks) AS tasks, (SELECT count(DISTINCT task_digest) FROM tasks) AS task_digests,
  (SELECT count(scene_digest) FROM scenes) AS scenes, (SELECT count(DISTINCT scene_digest) FROM scenes) AS scene_digests,
  (SELECT count(class) FROM classes) AS classes,
  (SELECT count(*) FROM classes c JOIN episodes e ON e.episode_id = c.episode_id AND e.trace_digest = c.trace_digest) AS classed,
  (SELECT count(reason) FROM quarantine) AS bad, (SELECT count(preset) FROM rescored) AS rescored
"""
PAIRS = [("episodes", "ids"), ("episodes", "joined"), ("steps", "lengths"), ("tasks", "task_digests"), ("scenes", "scene_digests"), ("classes", "classed")]
#: The tables whose rows are compared, with what orders them.
TABLES = {
    "episodes": "episode_id", "tasks": "task_digest", "scenes": "scene_digest", "classes": "episode_id", "quarantine": "trace",
    "rescored": "episode_id, preset",
}


def must(*arguments, codes=(0,), cwd=None):
    """Standard output of a command that ends well."""
    done = subprocess.run([REEL, *map(str, arguments)], capture_output=True, text=True, cwd=cwd)
    assert done.returncode in codes, f"reel {' '.join(map(str, arguments))[:300]}: {done.returncode} {done.stdout[-300:]}{done.stderr[-900:]}"
    return done.stdout


def rows(store, table):
    return must("query", "--store", store, "--format", "csv", f"SELECT * FROM {table} ORDER BY {TABLES[table]}")


def figures(store, version=None):
    """The figures of a version of a store, which agree with each other."""
    at = ["--store-version", version] if version is not None else []
    (found,) = json.loads(must("query", "--store", store, "--json", WHOLE, *at))
    torn = [f"{one} {found[one]} and {other} {found[other]}" for one, other in PAIRS if found[one] != found[other]]
    if torn:
        raise Lost(f"version {version} of {store} is not whole: {torn}: {found}", torn=1)
    return found


def content(folder, without=()):
    """Every file of a folder with its digest. Table `verdicts` grows with every replay."""
    files = (path for path in folder.rglob("*") if path.is_file() and "verdicts" not in path.parts)
    names = {str(path.relative_to(folder)): hashlib.blake2b(path.read_bytes()).hexdigest() for path in files}
    return {name: digest for name, digest in names.items() if name not in without}


def differ(one, other):
    """The first names of which two folders hold different files."""
    return sorted(name for name in one.keys() | other.keys() if one.get(name) != other.get(name))[:8]


def unused(store):
    """Files of tables that no version of the store names."""
    logs = "".join(path.read_text(errors="replace") for path in store.glob("*/_delta_log/*.json"))
    return [str(path) for path in store.glob("*/*") if path.is_file() and path.name not in logs]


class Killed:
    """A command that is killed after some seconds, unless it ends before; its exit code."""

    def __init__(self, *arguments, cwd, after_s):
        self.process = subprocess.Popen([REEL, *map(str, arguments)], cwd=cwd, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            self.process.wait(after_s)
        except subprocess.TimeoutExpired:
            self.process.kill()
        self.code = self.process.wait()


def took(*arguments, cwd, codes=(0,)):
    """Seconds that a command takes, undisturbed."""
    begun = time.monotonic()
    must(*arguments, cwd=cwd, codes=codes)
    return time.monotonic() - begun


class Ingest(Scene):
    """Commands that change a store, killed: the versions there are stay whole, and the same command ends as an undisturbed one."""

    def __init__(self, folder, quick):
        super().__init__(folder, quick)
        # Some episodes failed, one file is damaged, and one lies there twice.
        traces = sorted(GOLDEN.glob("*.mcap"))[: 8 if quick else 24]
        self.corpus, self.first = folder / "traces", folder / "first"
        self.corpus.mkdir()
        for path in traces:
            shutil.copy(path, self.corpus)
        damaged = bytearray(traces[0].read_bytes())
        damaged[len(damaged) // 2] ^= 1
        (self.corpus / "damaged.mcap").write_bytes(damaged)
        shutil.copy(traces[1], self.corpus / "twice.mcap")
        half = sorted(self.corpus.glob("*.mcap"))[::2]
        must("ingest", *half, "--store", self.first, codes=(0, 3))
        must("taxonomy", "--store", self.first)
        #: The commands, the store on which each begins (`full`: the one that the second ends with), and their exit codes.
        ingest, codes = ["ingest", self.corpus], (0, 3)
        self.work = {
            "ingest": (ingest, None, codes), "ingest of the rest": (ingest, self.first, codes),
            "histories": ([*ingest, "--check-histories"], self.first, codes), "taxonomy": (["taxonomy"], "full", (0,)),
            "reward": (["store", "reward", "--preset", "real-trainer"], "full", (0,)), "compact": (["store", "compact"], "full", (0,)),
        }
        self.undisturbed = {}

    def expected(self, name):
        """Seconds, figures and rows of the command when nobody disturbs it; and the store on which it begins."""
        if name not in self.undisturbed:
            command, base, codes = self.work[name]
            store = self.folder / f"undisturbed-{name.replace(' ', '-')}"
            if base == "full":
                base = self.expected("ingest of the rest")[3].parent / "undisturbed-ingest-of-the-rest"
            if base:
                shutil.copytree(base, store)
            seconds = took(*command, "--store", store, cwd=self.folder, codes=codes)
            self.undisturbed[name] = seconds, figures(store), {table: rows(store, table) for table in TABLES}, base or store
        return self.undisturbed[name]

    def kill(self, seed, draw):
        name = draw.choice(["ingest"] * 3 + ["ingest of the rest"] * 4 + ["histories", "taxonomy", "reward", "compact"])
        command, begins, codes = self.work[name]
        seconds, wanted, wanted_rows, base = self.expected(name)
        store = self.folder / "store"
        shutil.rmtree(store, ignore_errors=True)
        if begins:
            shutil.copytree(base, store)
        starting = draw.random() < 0.15
        before = len(versions(store))
        killed = Killed(*command, "--store", store, cwd=self.folder, after_s=draw.uniform(0.0, seconds * (0.2 if starting else 1.15)))
        assert killed.code in (-9, *codes), f"{name}: exit code {killed.code}"
        found, tables = {"starting": int(starting)}, 0
        there = versions(store)
        assert len(there) >= before, f"{name}: of {before} versions there are {len(there)}"
        for version in {*there[:2], draw.choice(there)} if there else ():
            figures(store, version)
            tables += len(TABLES)
        # What a killed one leaves beside the tables is there for `reel store vacuum`.
        left = len(unused(store)) if store.exists() else 0
        begun = time.monotonic()
        must(*command, "--store", store, cwd=self.folder, codes=codes)
        found["slowest recovery"] = time.monotonic() - begun
        now = figures(store)
        if now != wanted:
            raise Lost(f"{name}, once more, gives {now}, undisturbed {wanted}", torn=1)
        for table in {"episodes", *draw.sample(sorted(TABLES), 2)}:
            if rows(store, table) != wanted_rows[table]:
                raise Lost(f"{name}, once more: table {table} differs from an undisturbed one", torn=1)
            tables += 1
        return {**found, "tables": tables, "torn": 0, "left over": left}


def versions(store):
    """The versions of a store that a reader can open; none where it has not begun."""
    if not (store / "episodes" / "_delta_log" / "00000000000000000000.json").exists():
        return []
    return [json.loads(line)["version"] for line in must("store", "history", "--store", store, "--json").splitlines()]


class Export(Scene):
    """`reel export`, killed once or twice: the folder says that it is unfinished or is whole, and the same command ends it."""

    def __init__(self, folder, quick):
        super().__init__(folder, quick)
        traces = [path for path in sorted(GOLDEN.glob("*.mcap")) if "--oracle--0" in path.name or "--planner--1" in path.name][: 2 if quick else 3]
        assert traces, "no golden traces of competent play"
        self.home = folder / "work"
        self.home.mkdir()
        must("ingest", *traces, "--store", folder / "fresh")
        sft = ["export", "sft", "--store", "store", "--out", "out", "--max-pixels", 12544]
        rl = ["export", "rl", "--store", "store", "--out", "out", "--max-pixels", 12544]
        self.work = {
            "parquet": sft, "trl": [*sft, "--format", "trl"], "files": [*sft, "--format", "llama-factory", "--rows-per-file", 5],
            "array": [*sft, "--format", "qwen-vl", "--image-format", "none"], "rl": rl, "rl bare": [*rl, "--image-format", "none"],
        }
        self.undisturbed, self.verified = {}, folder / "fresh"

    def expected(self, name):
        """Seconds and files of the command when nobody disturbs it."""
        if name not in self.undisturbed:
            self.reset(self.folder / "fresh")
            begun = time.monotonic()
            self.code(must, self.work[name])
            self.undisturbed[name] = time.monotonic() - begun, content(self.home / "out")
            assert "manifest.json" in self.undisturbed[name][1], name
            if not self.undisturbed.keys() - {name}:
                self.verified = self.folder / "verified"
                shutil.copytree(self.home / "store", self.verified)
        return self.undisturbed[name]

    def code(self, run, command):
        """An export that leaves some decisions out ends with 3."""
        return run(*command, cwd=self.home, codes=(0, 3))

    def reset(self, base):
        for name in ("store", "out"):
            shutil.rmtree(self.home / name, ignore_errors=True)
        shutil.copytree(base, self.home / "store")

    def kill(self, seed, draw):
        name = draw.choice(sorted(self.work))
        command, out, (undisturbed, wanted) = self.work[name], self.home / "out", self.expected(name)
        self.reset(draw.choice([self.folder / "fresh", self.verified]))
        starting = draw.random() < 0.1
        for _ in range(draw.choice([1, 1, 2])):
            if draw.random() < 0.35:
                # When it is about to end: its files are being closed, card and manifest written.
                killed = self.at_the_end(command, draw)
            else:
                killed = Killed(*command, cwd=self.home, after_s=draw.uniform(0.0, undisturbed * (0.2 if starting else 1.1))).code
            assert killed in (-9, 0, 3), f"{name}: exit code {killed}"
            there = content(out) if out.exists() else {}
            if killed != -9 or there == wanted:
                break
            if "manifest.json" in there and not any(path.startswith(".") for path in there) and there != wanted:
                raise Lost(f"{name}: the folder looks finished and differs in {differ(there, wanted)}", torn=1)
        if there == wanted:
            return {"starting": int(starting), "tables": 1, "torn": 0, "left over": 0}
        begun = time.monotonic()
        self.code(must, command)
        seconds = time.monotonic() - begun
        now = content(out)
        left = [path for path in now if path.endswith((".part", ".tmp")) or pathlib.Path(path).name.startswith(".")]
        assert not left, f"{name}, once more, leaves {left}"
        if now != wanted:
            raise Lost(f"{name}, once more, differs from an undisturbed one in {differ(now, wanted)}", torn=1)
        return {"starting": int(starting), "tables": 1, "torn": 0, "left over": 0, "slowest recovery": seconds}

    def at_the_end(self, command, draw):
        """Kills it some milliseconds after its first file has its name, or its list of images is gone."""
        process = subprocess.Popen([REEL, *map(str, command)], cwd=self.home, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        out = self.home / "out"
        sign = draw.choice(["train/train-00000.*", "README.md", "manifest.json", "tasks.json"])
        gone = draw.random() < 0.5

        def ending():
            if process.poll() is not None:
                return True
            if gone:
                return (out / "train").exists() and not (out / ".export.jsonl").exists()
            return any(path.suffix != ".part" for path in out.glob(sign))

        until(ending, 120, 0.0003)
        time.sleep(draw.choice([0.0, draw.uniform(0.0, 0.004)]))
        process.kill()
        return process.wait()


def free(draw):
    """A port that nobody listens at, and its neighbour, below those that the system gives to connections: while a part is dead,
    none of theirs takes its place."""
    while True:
        port = draw.randrange(20000, 32000, 2)
        with contextlib.suppress(OSError), socket.socket() as listener, socket.socket() as neighbour:
            listener.bind(("127.0.0.1", port))
            neighbour.bind(("127.0.0.1", port + 1))
            return port


class Cluster(Scene):
    """A scheduler and two executors, of which one part is killed while a question runs, or who asks it."""

    QUESTIONS = {
        "replay in SQL": ["query", "--store", "store", "--format", "csv", "SELECT episode_id, replay(trace).digest AS digest, replay(trace).verdict AS verdict FROM episodes ORDER BY episode_id"],
        "steps": ["query", "--store", "store", "--format", "csv", "SELECT tool, count(*) AS n FROM steps GROUP BY tool ORDER BY tool"],
        "replay": ["replay", "traces", "--json"],
    }

    def __init__(self, folder, quick):
        super().__init__(folder, quick)
        self.processes, self.ports = {}, {name: free(random) for name in ("scheduler", "one", "two")}
        (folder / "traces").mkdir()
        for path in sorted(GOLDEN.glob("*.mcap"))[: 4 if quick else 8]:
            shutil.copy(path, folder / "traces")
        must("ingest", "traces", "--store", "store", cwd=folder)
        self.store = content(folder / "store")
        self.expected = {}
        for name, command in self.QUESTIONS.items():
            done = subprocess.run([REEL, *command], cwd=folder, capture_output=True, text=True)
            self.expected[name] = (done.returncode, done.stdout)
        for name in self.ports:
            self.start(name)

    def start(self, name):
        listen = f"127.0.0.1:{self.ports[name]}"
        if name == "scheduler":
            command = ["scheduler", "--listen", listen, "--executor-timeout", "10"]
        else:
            command = ["executor", "--scheduler", self.address(), "--listen", listen, "--jobs", "1", "--traces", self.folder / "traces"]
        with open(self.folder / f"{name}.log", "a") as log:
            self.processes[name] = subprocess.Popen([REEL, "cluster", *map(str, command)], cwd=self.folder, stdout=log, stderr=log)
        listens = until(lambda: answers(self.ports[name]) or self.processes[name].poll() is not None, 60, 0.02)
        assert listens and self.processes[name].poll() is None, f"{name} does not start: {(self.folder / f'{name}.log').read_text()[-800:]}"

    def address(self):
        return f"127.0.0.1:{self.ports['scheduler']}"

    def ask(self, question):
        command = [REEL, *self.QUESTIONS[question], "--cluster", self.address()]
        return subprocess.Popen(command, cwd=self.folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def heard(self, question, client, may_fail):
        """The answer is right, or where it may be an error, that says something."""
        try:
            out, err = client.communicate(timeout=ANSWER_S)
        except subprocess.TimeoutExpired:
            client.kill()
            client.communicate()
            raise Lost(f"{question}: no answer in {ANSWER_S} s") from None
        if (client.returncode, out) == self.expected[question]:
            return
        assert may_fail, f"{question}: {client.returncode} {out[-300:]} {err[-600:]}"
        if client.returncode == 0:
            raise Lost(f"{question}: answered {out[-600:]!r} in place of {self.expected[question][1][-600:]!r}")
        clear = client.returncode == 2 and err.startswith("reel:") and not any(raw in err for raw in RAW)
        assert clear, f"{question}: no clear error: {client.returncode} {err[-900:]}"

    def kill(self, seed, draw):
        question, who = draw.choice(sorted(self.QUESTIONS)), draw.choice(["scheduler", "one", "two", "both", "client"])
        client = self.ask(question)
        time.sleep(draw.uniform(0.0, 0.7))
        if who == "client":
            client.kill()
            client.communicate()
        else:
            for name in ("one", "two") if who == "both" else (who,):
                self.processes[name].kill()
                self.processes[name].wait()
            # Work on traces is done again for three minutes, which is long to wait for its error: who is gone comes back.
            if question == "replay" or who == "both" or draw.random() < 0.5:
                time.sleep(draw.uniform(0.0, 1.0))
                self.restart()
            self.heard(question, client, may_fail=True)
        begun = time.monotonic()
        self.restart()
        again = draw.choice(sorted(self.QUESTIONS))
        self.heard(again, self.ask(again), may_fail=False)
        seconds = time.monotonic() - begun
        now = content(self.folder / "store")
        if now != self.store:
            raise Lost(f"the store changed: {differ(now, self.store)}", torn=1)
        return {"tables": 1, "torn": 0, "left over": 0, "slowest recovery": seconds}

    def restart(self):
        for name, process in list(self.processes.items()):
            if process.poll() is not None:
                self.start(name)

    def close(self):
        for process in self.processes.values():
            process.kill()
            process.wait()


def answers(port):
    try:
        socket.create_connection(("127.0.0.1", port), 1).close()
        return True
    except OSError:
        return False
