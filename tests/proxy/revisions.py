"""`reel record` between agents and servers of newer revisions of the protocol, with the official SDK on both sides, and secrets that pass
through it: what is recorded is what the agent got, call by call, however the result came.

    revisions.py [TEST...]        REEL: the binary.
"""

import contextlib
import json
import os
import pathlib
import subprocess
import tempfile

from instant import Instant
from kit import REEL, Http, Recorder, Stdio, environment, main, reel, until

HERE = pathlib.Path(__file__).resolve().parent


@contextlib.contextmanager
def script(python, name):
    """A server of a revision as a process of its own; its port."""
    with subprocess.Popen([python, HERE / name, "serve"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as server:
        try:
            yield int(server.stdout.readline())
        finally:
            server.kill()


def recorded(trace):
    """Tools and texts of the steps of a trace."""
    code, out, error = reel("show", trace, "--json")
    assert code == 0, error
    return [(step["input"]["call"]["name"], step["outcome"]["text"]) for step in json.loads(out)["steps"]]


def through(package, name):
    """Plays the script of a revision through the recorder; what the agent got, and what is recorded."""
    python = environment(package)
    with script(python, name) as port, Recorder(port, "--json", path="/mcp/") as recorder:
        url = f"http://127.0.0.1:{recorder.port}/mcp/"
        done = subprocess.run([python, HERE / name, "play", url], capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stderr[-2000:]
        counts = json.loads(recorder.stop())
        assert not recorder.parts() and len(recorder.traces()) == 1, recorder.traces()
        assert counts["unanswered"] == 0 and counts["opaque_connections"] == 0, counts
        return list(map(json.loads, done.stdout.splitlines())), recorded(recorder.traces()[0])


def test_streams_that_are_resumed_and_tasks_of_2025_11_25():
    got, steps = through("mcp-1.30.0", "revision_2025_11_25.py")
    assert [text for _, text in steps] == got, (got, steps)
    assert [tool for tool, _ in steps] == ["plain", "polled", "asking", "long"] * 2, steps
    print(f"  {len(steps)} calls: {got[:4]}")


def test_requests_without_sessions_and_with_input_of_2026_07_28():
    got, steps = through("mcp-2.3.0", "revision_2026_07_28.py")
    assert [text for _, text in steps] == got, (got, steps)
    assert [tool for tool, _ in steps] == ["plain", "asking"] * 3, steps
    print(f"  {len(steps)} calls: {got[:2]}")


SECRETS = {"argument": "hf_argumentargumentarg", "result": "sk-resultresultresult", "variable": "opaque-of-environment", "command": "opaque-of-command"}


def written(folder, *more):
    """Everything that a recorder wrote: files, what `show` reads from them, and what it said."""
    shown = [reel("show", trace, "--json")[1] + reel("show", trace)[1] for trace in folder.glob("*.mcap")]
    names = [path.name for path in folder.iterdir()]
    return "\n".join([*shown, *names, *more]).encode() + b"".join(path.read_bytes() for path in folder.iterdir())


def test_no_secret_is_written():
    result = {"content": [{"type": "text", "text": json.dumps(list(SECRETS.values()))}], "structuredContent": {"token": SECRETS["result"]}}
    os.environ["ROBOT_TOKEN"] = SECRETS["variable"]
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        answer = folder / "answer.json"
        answer.write_text(json.dumps(result))
        server = ["env", f"API_KEY={SECRETS['command']}", "python3", HERE / "instant.py", answer]
        for redact, kept in (((), False), (("--redact", "none"), True)):
            out = folder / f"stdio-{kept}"
            agent = Stdio([REEL, "record", *redact, "--watch", "--out", out, "--stdio", "--", *server])
            assert SECRETS["result"] in json.dumps(agent.call("login", key={"hf": SECRETS["argument"]})), "the agent gets it as it came"
            agent.close()
            found = written(out, *(line.decode() for line in agent.errors))
            for name, secret in SECRETS.items():
                assert (secret.encode() in found) == kept, (name, kept)
            assert (b"[redacted:token#1]" in found) != kept
        # The recorder itself holds the variable, not the command of a server.
        with Instant(result) as instant, Recorder(instant.port, "--watch") as recorder:
            agent = Http(recorder.port)
            agent.call("login", key=SECRETS["argument"])
            agent.close()
            assert until(lambda: recorder.traces() and not recorder.parts())
            said = recorder.stop() + recorder.log.read_text()
            found = written(recorder.out, said)
            for name in ("argument", "result", "variable"):
                assert SECRETS[name].encode() not in found, name
            code, out, error = reel("show", recorder.traces()[0])
            assert code == 0 and "redacted" in out and " token" in out, out + error
    del os.environ["ROBOT_TOKEN"]


def test_a_rules_file():
    with tempfile.TemporaryDirectory() as folder, Instant({"content": [{"type": "text", "text": "ticket T-1234 is yours"}]}) as server:
        rules = pathlib.Path(folder) / "rules.toml"
        rules.write_text("keys = ['pin']\n[patterns]\nticket = 'T-[0-9]+'\n")
        with Recorder(server.port, "--redact", rules) as recorder:
            agent = Http(recorder.port)
            agent.call("open", pin=1234)
            agent.close()
            assert until(lambda: recorder.traces() and not recorder.parts())
            code, out, error = reel("show", recorder.traces()[0], "--json")
            assert code == 0, error
            whole = json.loads(out)
            assert whole["redacted"] == {"pin": 1, "ticket": 1}, whole["redacted"]
            assert whole["steps"][0]["outcome"]["text"] == "ticket [redacted:ticket#1] is yours"
            assert whole["header"]["policy"]["parameters"]["redaction"] == "built-in and file"
        rules.write_text("[patterns]\nticket = '('\n")
        code, _, error = reel("record", "--upstream", "http://127.0.0.1:1", "--out", folder, "--redact", rules)
        assert code == 2 and "line 2" in error, error


if __name__ == "__main__":
    main("test_", globals())
