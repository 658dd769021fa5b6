"""How much later an agent has its result through `reel record` than without it: the same calls, in turns, on both connections to
the same server, in the same run. Prints medians, the median of the paired differences, and the ratio; asserts nothing.

    bench.py [--calls N]

Servers: `reel serve` with profile real-repo (a simulator that computes; each result holds an image), and one that answers at once
with a result that was kept: what the recorder adds stands out there.
"""

import argparse
import json
import pathlib
import statistics
import tempfile
import time

from instant import Instant
from kit import TLS, Http, Recorder, Server, Sse, Stdio, REEL, play, tasks, texts


def timed(agent, tool, arguments):
    begun = time.perf_counter()
    agent.call(tool, **arguments)
    return (time.perf_counter() - begun) * 1e3


def compare(name, direct, through, calls):
    return report(name, paired(direct, through, calls))


def paired(direct, through, calls):
    """Milliseconds of each call on both connections; who is first alternates."""
    pairs = []
    for index, (tool, arguments) in enumerate(calls):
        order = [direct, through] if index % 2 else [through, direct]
        took = {id(agent): timed(agent, tool, arguments) for agent in order}
        pairs.append((took[id(direct)], took[id(through)]))
    return pairs


def report(name, pairs):
    straight, recorded = (statistics.median(side) for side in zip(*pairs))
    added = statistics.median(there - here for here, there in pairs)
    tail = sorted(there - here for here, there in pairs)[int(len(pairs) * 0.95)]
    print(
        f"{name:<34} direct {straight:8.3f} ms  recorded {recorded:8.3f} ms  added, median {added:6.3f} ms  p95 {tail:6.3f} ms"
        f"  ratio {recorded / straight:5.2f}  ({len(pairs)} pairs)",
        flush=True,
    )
    return added


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--calls", type=int, default=300)
    count = parser.parse_args().calls
    with tempfile.TemporaryDirectory() as folder:
        made = tasks(pathlib.Path(folder) / "tasks")
        with Server("--tasks", made, "--profile", "real-repo") as server, Recorder(server.port) as recorder:
            kept = {}
            for name, kind in (("simulator, Streamable HTTP", Http), ("simulator, HTTP+SSE", Sse)):
                direct, through = kind(server.port), kind(recorder.port)
                tellings = [json.loads(texts(agent.call("finish"))[0]) for agent in (direct, through)]
                assert tellings[0]["task_id"] == tellings[1]["task_id"]
                source = tellings[0]["source_furniture"]
                begun = direct.rpc("tools/call", {"name": "navigate_to", "arguments": {"receptacle_name": source}})
                through.call("navigate_to", receptacle_name=source)
                kept = begun["result"]
                # Less than an episode has decisions, so that every call is one.
                compare(name, direct, through, [("highlight_receptacles", {})] * min(count, 27))
                direct.close()
                through.close()
        # The server beside itself: what TLS to it adds.
        secured = ["--tls-cert", TLS / "server.pem", "--tls-key", TLS / "server.key"]
        served = ["--tasks", made, "--profile", "real-repo"]
        with Server(*served) as plain, Server(*served, *secured, cafile=TLS / "ca.pem") as secure:
            with Recorder(plain.port) as http, Recorder(secure.port, trusting=TLS / "ca.pem") as https:
                agents = [Http(recorder.port) for recorder in (http, https)]
                pairs = []
                while len(pairs) < count:
                    for agent in agents:
                        agent.call("finish")
                    pairs += paired(*agents, [("highlight_receptacles", {})] * 27)
                added = report("recorded over http, then https", pairs)
                print(f"{'https adds to http':<34} {added:6.3f} ms, promised 1 ms", flush=True)
        with_image = kept
        without = {"content": [item for item in kept["content"] if item["type"] == "text"]}
        for label, result in (("image", with_image), ("text alone", without)):
            with Instant(result) as server, Recorder(server.port) as recorder:
                direct, through = Http(server.port), Http(recorder.port)
                compare(f"at once, {label}, Streamable HTTP", direct, through, [("highlight_receptacles", {})] * count)
                direct.wire.close()
                through.wire.close()
            with Instant(result) as server, Recorder(server.port, path="/sse") as recorder:
                direct, through = Sse(server.port), Sse(recorder.port)
                compare(f"at once, {label}, HTTP+SSE", direct, through, [("highlight_receptacles", {})] * count)
                direct.close()
                through.close()
            answers = pathlib.Path(folder) / "answer.json"
            answers.write_text(json.dumps(result))
            server = ["python3", str(pathlib.Path(__file__).with_name("instant.py")), str(answers)]
            direct = Stdio(server)
            through = Stdio([REEL, "record", "--out", pathlib.Path(folder) / "stdio", "--stdio", *server])
            compare(f"at once, {label}, stdio", direct, through, [("highlight_receptacles", {})] * count)
            direct.close()
            through.close()


main()
