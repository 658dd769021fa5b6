"""Kills of what answers calls, for `kills.py`: `reel serve`, `reel mcp` and `reel record`. Every agent keeps what it was answered,
and afterwards its traces have to hold that, in order."""

import contextlib
import json
import pathlib
import shutil
import signal
import subprocess
import sys
import threading
import time

from faults_kit import Player, exact, steps
from harness import REEL, Agent, Server, reel, until

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent.parent / "proxy"))
from instant import Instant  # noqa: E402
from kit import HELLO, Recorder, Sse  # noqa: E402

#: So many kills share a folder.
KILLS_PER_FOLDER = 12
#: What an agent is given to see that its server is gone.
GONE_S = 60
#: The longest wait for a sign of life, before a process is killed without one.
BUSY_S = 15


class Lost(AssertionError):
    """A violation, with the figures of its kill."""

    def __init__(self, message, **found):
        super().__init__(message)
        self.found = found


class Scene:
    """A scenario. `kill(seed, draw)` gives the figures of one kill, or raises. `quick`: with little to prepare."""

    def __init__(self, folder, quick):
        self.folder, self.quick = folder, quick
        self.folder.mkdir(parents=True)

    def kill(self, seed, draw):
        raise NotImplementedError

    def close(self):
        """Ends what still runs."""

    def abandon(self, kept):
        """Ends what runs and puts the files aside; where."""
        self.close()
        self.folder.rename(kept)
        return kept


class Moment:
    """The moment of a kill, drawn: while the process starts, when it is seen to finish a file, or after a random time."""

    def __init__(self, draw, start_s, work_s):
        kind = draw.random()
        self.starting, self.finishing = kind < 0.15, 0.15 <= kind < 0.4
        self.after_s = draw.uniform(0.0, start_s if self.starting else work_s)
        # A busy machine takes its time for the first answer: most moments are counted from there.
        self.from_first_answer = draw.random() < 0.8

    def wait(self, folder, answered):
        """Waits for it in a folder of traces; `answered` says whether a call was."""
        if self.from_first_answer:
            until(answered, BUSY_S, 0.002)
        if self.finishing:
            # A file gets its name a few milliseconds after this is there.
            until(lambda: any(folder.glob("*.tmp")), BUSY_S, 0.0005)
            time.sleep(self.after_s / 500)
        else:
            time.sleep(self.after_s)

    def figures(self):
        return {"starting": int(self.starting), "finishing": int(self.finishing)}


class Traces:
    """A folder of traces over many kills: what was finished stays as it is, byte for byte."""

    def __init__(self, folder):
        self.folder, self.finished, self.lost_before = folder, {}, set()

    def names(self):
        return sorted(path.stem for path in self.folder.glob("*.mcap"))

    def parts(self):
        return {path.name for path in self.folder.glob("*.mcap.part")}

    def look(self):
        """Takes down what is finished; it has to be as it was."""
        fresh = []
        for path in sorted(self.folder.glob("*.mcap")):
            content = path.read_bytes()
            if path.name not in self.finished:
                fresh.append(path)
            assert self.finished.setdefault(path.name, content) == content, f"{path.name}, a finished trace, changed"
        gone = [name for name in self.finished if not (self.folder / name).exists()]
        assert not gone, f"finished traces are gone: {gone}"
        return fresh

    def recover(self):
        """`reel trace recover`. Nothing is lost but calls that were under way; parts that were empty hold nothing."""
        if not self.folder.exists() or not (self.parts() or self.names()):
            return
        code, out, err = reel("trace", "recover", "--json", self.folder)
        assert code in (0, 3), f"recover: {code} {out[-500:]}{err[-500:]}"
        for report in map(json.loads, out.splitlines()):
            # What was said before is no news: a part stays as evidence.
            for text in () if report["reported"] else report["lost"]:
                assert "was under way" in text or report["restored"] == "nothing", f"more is lost than what was under way: {report}"

    def settled(self, fresh):
        """After recovery: doctor content, no other files, parts only of what was lost in part. The fresh traces that hold something,
        and how many parts are left."""
        if not self.folder.exists():
            return [], 0
        traces = [path for path in fresh if not nothing_restored(path)]
        if traces:
            code, out, err = reel("trace", "doctor", *traces)
            assert code == 0, f"doctor: {code} {out[-2000:]}{err[-500:]}"
        others = [path.name for path in self.folder.iterdir() if not path.name.endswith((".mcap", ".mcap.part"))]
        assert not others, f"left over: {others}"
        left = self.parts() - self.lost_before
        self.lost_before |= left
        if left:
            # Once more: it says what was lost before, and changes nothing.
            code, out, err = reel("trace", "recover", "--json", *(self.folder / name for name in sorted(left)))
            assert code == 0, f"parts that are no evidence: {code} {out[-1000:]}{err[-500:]}"
            for report in map(json.loads, out.splitlines()):
                assert report["lost"], f"a part of which nothing is lost is still there: {report}"
        return traces, len(left)


def nothing_restored(path):
    """Whether a file says that nothing of its recording could be read."""
    code, out, _ = reel("trace", "doctor", path)
    return code == 0 and "no part of the recording" in out


class Playing(Player):
    """Plays as a worker, in episodes of random length, until its server is gone."""

    def __init__(self, server, worker, draw):
        super().__init__(server, worker, pause=draw.choice([0.0, 0.0, 0.01]))
        self.lengths = [draw.randint(0, 8) for _ in range(400)]

    def run(self):
        try:
            agent = Agent(self.server, worker=self.worker)
            for length in self.lengths:
                arguments = {"n": self.answered}
                begun = "Task:" in agent.say("finish", **arguments)
                if self.episodes:
                    self.episodes[-1].append(("finish", arguments, None))
                self.answered += 1
                assert begun, "every task was played"
                self.episodes.append([])
                for number in range(length):
                    self.call(agent, self.TOOLS[(self.answered + number) % len(self.TOOLS)])
        except Exception as error:
            self.error = error

    def acknowledged(self):
        return sum(map(len, self.episodes))


class Serve(Scene):
    """Agents at a server, which is killed; then the next start, or `reel trace recover` before it, restores."""

    def __init__(self, folder, quick):
        super().__init__(folder, quick)
        self.server, self.kills, self.traces = None, 0, None

    def start(self):
        self.server = Server("--run", "kills", *self.images, data=self.data)

    def kill(self, seed, draw):
        if self.kills % KILLS_PER_FOLDER == 0:
            self.close()
            self.data = self.folder / f"data-{self.kills}"
            self.images = [] if draw.random() < 0.3 else ["--no-images"]
            self.traces = Traces(self.data / "traces")
        self.kills += 1
        moment, found = Moment(draw, 0.3, 1.5), []
        if moment.starting:
            self.close()
            self.data.mkdir(exist_ok=True)
            with open(self.data / "serve.log", "a") as log:
                command = [REEL, "serve", "--listen", "127.0.0.1:0", "--data", self.data, "--run", "kills"]
                process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=log)
            time.sleep(moment.after_s)
            process.kill()
            process.wait()
        else:
            if self.server is None:
                self.start()
            found = [Playing(self.server, f"s{seed}a{number}", draw) for number in range(draw.randint(1, 6))]
            for player in found:
                player.start()
            moment.wait(self.traces.folder, lambda: any(player.acknowledged() for player in found))
            self.server.process.kill()
            self.close()
            for player in found:
                player.join(GONE_S)
                assert player.error, "an agent did not notice that its server is gone"
        self.traces.look()
        begun = time.monotonic()
        if draw.random() < 0.5:
            self.traces.recover()
        acknowledged = sum(player.acknowledged() for player in found)
        self.start()
        listed = self.server.json("GET", "/api/traces?limit=1000")[1]["traces"]
        took = time.monotonic() - begun
        names = sorted({trace["trace"] for trace in listed if not trace["recording"]})
        fresh = self.traces.look()
        try:
            for player in found:
                player.compare("kills", names, lambda name: self.server.json("GET", f"/api/traces/{name}/steps")[1])
        except AssertionError as error:
            raise Lost(str(error), acknowledged=acknowledged, lost=1) from error
        whole, left = self.traces.settled(fresh)
        if whole:
            exact(*draw.sample(whole, min(2, len(whole))))
        return {**moment.figures(), "acknowledged": acknowledged, "lost": 0, "left over": left, "slowest recovery": took}

    def close(self):
        if self.server:
            self.server.stop(signal.SIGKILL)
            self.server = None


class Pipe:
    """An agent at the standard input and output of a command, until that is gone. `episodes` holds what was answered, from one
    `finish` to the next."""

    def __init__(self, command, log, draw):
        with open(log, "a") as errors:
            self.process = subprocess.Popen([str(word) for word in command], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors)
        self.number, self.episodes = 0, []
        self.lengths = [draw.randint(0, 8) for _ in range(400)]
        self.thread = threading.Thread(target=self.play, daemon=True)
        self.thread.start()

    def play(self):
        with contextlib.suppress(OSError, ValueError, EOFError):
            self.rpc("initialize", HELLO)
            self.post({"jsonrpc": "2.0", "method": "notifications/initialized"})
            for length in self.lengths:
                if "Task:" not in self.call("finish", {}):
                    return  # every task was played
                self.episodes.append([])
                for _ in range(length):
                    number = self.number
                    arguments = {
                        "n": number, "question": f"asks {number}", "marker_id": number % 4, "target_category": "box",
                        "receptacle_name": Player.PLACES[number % 4],
                    }
                    self.call(Player.TOOLS[number % len(Player.TOOLS)], arguments)

    def post(self, message):
        self.process.stdin.write(json.dumps(message).encode() + b"\n")
        self.process.stdin.flush()

    def rpc(self, method, params):
        self.number += 1
        self.post({"jsonrpc": "2.0", "id": self.number, "method": method, "params": params})
        while line := self.process.stdout.readline():
            message = json.loads(line)
            if message.get("id") == self.number:
                return message
        raise EOFError

    def call(self, tool, arguments):
        answer = self.rpc("tools/call", {"name": tool, "arguments": arguments})
        texts = [item["text"] for item in answer["result"]["content"] if item["type"] == "text"]
        if self.episodes:
            # The words of a `finish` are those of the next episode.
            self.episodes[-1].append((tool, arguments, None if tool == "finish" else texts[0]))
        return texts[0]

    def acknowledged(self):
        return sum(map(len, self.episodes))

    def kill(self):
        self.process.kill()
        self.process.wait()
        self.thread.join(GONE_S)
        assert not self.thread.is_alive(), "an agent did not notice that its server is gone"
        with contextlib.suppress(OSError):
            self.process.stdin.close()
        self.process.stdout.close()


def heard(step):
    """Name, arguments and answer of a recorded step."""
    call, outcome = step["input"]["call"], step["outcome"]
    return call["name"], call["arguments"], outcome.get("text")


def same_calls(answered, recorded, surplus, who):
    """The recorded steps are the answered calls in their order, and at most so many more."""
    kept = [heard(step) for step in recorded[: len(answered)]]
    right = [
        (name, arguments, text if said is not None else None) == (wanted, given, said)
        for (name, arguments, text), (wanted, given, said) in zip(kept, answered)
    ]
    lost = len(answered) - sum(right)
    if lost or len(recorded) > len(answered) + surplus:
        wrong = right.index(False) if False in right else len(kept)
        message = f"{who}: {len(answered)} calls were answered, {len(recorded)} are recorded, the first that differs is {wrong}: "
        raise Lost(message + f"{answered[wrong : wrong + 1]}, recorded {kept[wrong : wrong + 1]}", acknowledged=len(answered), lost=lost)


class Mcp(Scene):
    """Agents at `reel mcp`, each a process with a run of its own; one is killed, or both."""

    def __init__(self, folder, quick):
        super().__init__(folder, quick)
        self.kills, self.pipes = 0, []

    def kill(self, seed, draw):
        if self.kills % KILLS_PER_FOLDER == 0:
            self.data = self.folder / f"data-{self.kills}"
            self.data.mkdir()
            self.traces = Traces(self.data / "traces")
        self.kills += 1
        moment = Moment(draw, 0.15, 1.0)
        runs = [f"m{seed}p{number}" for number in range(draw.randint(1, 2))]
        images = [] if draw.random() < 0.3 else ["--no-images"]
        log = self.folder / "mcp.log"
        self.pipes = [Pipe([REEL, "mcp", "--data", self.data, "--run", run, *images], log, draw) for run in runs]
        if moment.starting:
            time.sleep(moment.after_s)
        else:
            moment.wait(self.traces.folder, lambda: any(pipe.acknowledged() for pipe in self.pipes))
        for pipe in self.pipes:
            pipe.kill()
        answered = sum(pipe.acknowledged() for pipe in self.pipes)
        self.traces.look()
        begun = time.monotonic()
        self.traces.recover()
        took = time.monotonic() - begun
        fresh = self.traces.look()
        names = self.traces.names()
        for run, pipe in zip(runs, self.pipes):
            for number, calls in enumerate(pipe.episodes):
                place = [name for name in names if name.startswith(f"{run}--stdio--{number:04}--")]
                if len(place) != 1:
                    raise Lost(f"{run}, episode {number}: {len(place)} traces, {len(calls)} calls of it were answered", lost=len(calls))
                surplus = 1 if number == len(pipe.episodes) - 1 else 0
                same_calls(calls, steps(self.traces.folder / f"{place[0]}.mcap"), surplus, place[0])
        whole, left = self.traces.settled(fresh)
        if whole:
            exact(draw.choice(whole))
        self.pipes = []
        return {**moment.figures(), "acknowledged": answered, "lost": 0, "left over": left, "slowest recovery": took}

    def close(self):
        for pipe in self.pipes:
            pipe.process.kill()


def answer(message):
    """What the recorded server says of a call: something that no other call is told."""
    arguments = message["params"]["arguments"]
    return {"content": [{"type": "text", "text": f"moved {arguments.get('session')} {arguments.get('number', arguments.get('n'))}"}]}


class Listener(threading.Thread):
    """An agent over HTTP+SSE at a recorder, in sessions of random length. `sessions` holds how many calls of each were answered."""

    def __init__(self, port, name, draw):
        super().__init__(daemon=True)
        self.port, self.name_, self.sessions, self.wrong, self.ended = port, name, [], [], False
        self.lengths = [draw.randint(1, 25) for _ in range(400)]

    def run(self):
        with contextlib.suppress(OSError, ValueError, AssertionError):
            for count, length in enumerate(self.lengths):
                agent = Sse(self.port)
                self.sessions.append(0)
                for number in range(length):
                    name = f"{self.name_}.{count}"
                    said = agent.call("move", session=name, number=number)["result"]["content"][0]["text"]
                    if said != f"moved {name} {number}":
                        self.wrong.append(said)
                    self.sessions[-1] += 1
                agent.close()
        self.ended = True


class Record(Scene):
    """Agents at `reel record`, before a server that answers at once."""

    def __init__(self, folder, quick):
        super().__init__(folder, quick)
        self.server, self.kills, self.recorder = Instant(answer), 0, None

    def kill(self, seed, draw):
        if self.kills % KILLS_PER_FOLDER == 0:
            self.traces = Traces(self.folder / f"traces-{self.kills}")
        self.kills += 1
        moment, agents = Moment(draw, 0.15, 1.0), []
        if moment.starting:
            command = [REEL, "record", "--listen", "127.0.0.1:0", "--out", self.traces.folder, "--upstream", f"http://127.0.0.1:{self.server.port}/sse"]
            process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            time.sleep(moment.after_s)
            process.kill()
            process.wait()
        else:
            self.recorder = Recorder(self.server.port, "--run", f"r{seed}", out=self.traces.folder, path="/sse")
            agents = [Listener(self.recorder.port, f"r{seed}.{number}", draw) for number in range(draw.randint(1, 5))]
            for agent in agents:
                agent.start()
            moment.wait(self.traces.folder, lambda: any(sum(agent.sessions) for agent in agents))
            self.recorder.stop(signal.SIGKILL)
            for agent in agents:
                agent.join(GONE_S)
                assert agent.ended, "an agent did not notice that its recorder is gone"
        self.traces.look()
        begun = time.monotonic()
        self.traces.recover()
        took = time.monotonic() - begun
        fresh = self.traces.look()
        recorded = {}
        for path in self.traces.folder.glob(f"r{seed}--*.mcap"):
            if not nothing_restored(path):
                found = steps(path)
                recorded.setdefault(found[0]["input"]["call"]["arguments"]["session"] if found else path.name, []).append(found)
        acknowledged = 0
        for agent in agents:
            assert not agent.wrong, f"answers of somebody else: {agent.wrong[:2]}"
            for count, calls in enumerate(agent.sessions):
                name = f"{agent.name_}.{count}"
                acknowledged += calls
                wanted = [("move", {"session": name, "number": number}, f"moved {name} {number}") for number in range(calls)]
                if not calls and name not in recorded:
                    continue
                if len(recorded.get(name, [])) != 1:
                    raise Lost(f"session {name}: {len(recorded.get(name, []))} traces, {calls} calls were answered", lost=calls)
                surplus = 1 if count == len(agent.sessions) - 1 else 0
                same_calls(wanted, recorded[name][0], surplus, f"session {name}")
        _, left = self.traces.settled(fresh)
        if self.traces.folder.exists() and self.kills % KILLS_PER_FOLDER == 0:
            shutil.rmtree(self.traces.folder)
        return {**moment.figures(), "acknowledged": acknowledged, "lost": 0, "left over": left, "slowest recovery": took}

    def close(self):
        if self.recorder:
            self.recorder.stop(signal.SIGKILL)
        self.server.__exit__()
