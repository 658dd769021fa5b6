"""Schemathesis against a server with tokens, for openapi.py: tells it which names exist and runs it. Reads what was
answered from a file that openapi_hooks.py writes; which answers are right, the caller knows."""

import json
import os
import pathlib
import subprocess
import sys
import threading

from harness import Agent

VERSION = "4.32.5"
HOOKS = pathlib.Path(__file__).resolve().parent / "openapi_hooks.py"
SPARE = [f"spare-{number}" for number in range(50)]

# A server whose questions are not waited for.
CONFIG = """
[play]
ask = "rest"
ask_timeout_s = 2

[limits]
sql_timeout_s = 10
"""


def keep_asking(server, token, task, stop):
    """An agent in the fuzzed server that asks one question after the other."""
    while not stop.is_set():
        try:
            agent = Agent(server, worker="asker", headers={"authorization": f"Bearer {token}"})
            agent.call("finish_with_id", task_id=task)
            while not stop.is_set() and not agent.call("ask", question="Which one?").get("isError"):
                pass
        except (OSError, RuntimeError, ValueError):
            # Its session is closed now and then.
            pass
        stop.wait(0.2)


def settings(folder, episodes, token):
    """What Schemathesis is to do: the names that exist, and which checks do not fit."""
    def values(*texts):
        return json.dumps([str(text) for text in texts])

    names = {
        "path.trace": values(*(episode["trace"] for episode in episodes), "damaged"),
        "path.episode": values(*(episode["episode_id"] for episode in episodes)),
        "query.episode": values(*(episode["episode_id"] for episode in episodes)),
        "body.episode": values(*(episode["episode_id"] for episode in episodes)),
        "body.task_id": values(*{episode["task_id"] for episode in episodes}),
        "query.family": values("FDP", "FODP", "FDO", "SUL"),
        "query.camera": values("head", "top-down", "follow:target"),
        "query.preset": values("paper", "real-repo"),
        "header.range": values("bytes=0-9", "bytes=-5", "bytes=99999999-"),
        "path.step": values("start", 0, 1, "2.png"),
        "path.name": values("overview", "ends", "benchmark", "quarantined"),
        "path.session": values("w-asker"),
        "path.id": json.dumps([1, 2, 3]),
        "body.sql": values("SELECT count(*) FROM episodes", "SELECT * FROM episodes", "SHOW TABLES"),
        "body.class": values("Other", "Lost Memory"),
        "body.policy": values("oracle", "planner"),
        "body.at": json.dumps([0, 1, 2]),
    }
    lines = [
        # Several workers are threads, in which Python 3.11 fails now and then.
        "workers = 1", "request-timeout = 30", "continue-on-failure = true", 'suppress-health-check = ["all"]',
        f"hooks = {json.dumps(str(HOOKS))}",
        "[auth.openapi.token]", f"bearer = {json.dumps(token)}",
        "[generation]", 'database = "none"',
        "[checks.not_a_server_error]", 'expected-statuses = ["2xx", "3xx", "4xx", 503, 507]',
        # 422: it is as the document says, and cannot be done.
        "[checks.positive_data_acceptance]", 'expected-statuses = ["2xx", 403, 404, 409, 416, 422, 429, 503]',
    ]
    for number, listed in enumerate(names.values()):
        lines += [f"[dictionaries.names{number}]", f"values = {listed}"]
    lines += ["[dictionaries.spare]", f"values = {values(*SPARE)}", "[parameters]"]
    lines += [f'"{name}" = {{ dictionary = "names{number}", probability = 0.7 }}' for number, name in enumerate(names)]
    spare = 'parameters = { "path.trace" = { dictionary = "spare", probability = 0.5 } }'
    more_than_a_schema_says = ["[operations.checks.positive_data_acceptance]", 'expected-statuses = ["2xx", "4xx", 503]']
    for which, more in {
        "name = 'PUT /api/traces/{trace}'": [spare],
        "name = 'DELETE /api/traces/{trace}'": [spare],
        # A stopped job can be looked at, and a closed session opens with its agent's next call.
        "path-regex = '^/api/(jobs|sessions)/'": ["[operations.checks.use_after_free]", "enabled = false"],
        # It may go on for long.
        "path = '/api/jobs/{id}/events'": ["request-timeout = 3", "max-stream-events = 3"],
        # Names in a list, and a camera that goes with a place.
        "name = 'POST /api/jobs'": more_than_a_schema_says,
        "name = 'GET /api/traces/{trace}/frames/{step}'": more_than_a_schema_says,
    }.items():
        lines += ["[[operations]]", f"include-{which}", *more]
    (folder / "schemathesis.toml").write_text("\n".join(lines) + "\n")


def fuzz(python, folder, server, document, made, episodes, seconds, seed):
    """Every answer of a server to Schemathesis (method, path, status), and what was wrong, if anything was."""
    settings(folder, episodes, made["admin"])
    (folder / "openapi.json").write_text(json.dumps(document))
    answers, log = folder / "answers", folder / "schemathesis.log"
    answers.touch()
    stop = threading.Event()
    asking = threading.Thread(target=keep_asking, args=(server, made["actor"], episodes[0]["task_id"], stop), daemon=True)
    asking.start()
    names = ":".join(episode["trace"] for episode in episodes)
    trace = folder / "data" / "traces" / f"{episodes[-1]['trace']}.mcap"
    environment = {**os.environ, "REEL_ANSWERS": str(answers), "REEL_KEEP": names, "REEL_TRACE": str(trace)}
    command = [python, "-m", "schemathesis.cli", "run", "openapi.json", "--url", server.url, "--no-color"]
    command += ["--max-time", str(seconds), "--seed", str(seed)]
    with open(log, "w") as output:
        try:
            limit = seconds + 180
            code = subprocess.run(command, cwd=folder, env=environment, stdout=output, stderr=output, timeout=limit).returncode
        except subprocess.TimeoutExpired:
            code = "no end in time"
    stop.set()
    if code != 0:
        print(log.read_text(), file=sys.stderr)
    wrong = f"schemathesis ended with {code}, and said above why; --seed {seed} does it again" if code != 0 else None
    lines = (line.split() for line in answers.read_text().splitlines())
    return [(method, path, int(status)) for method, path, status in lines], wrong
