"""Proves that training and playing read the same prompts, byte for byte and pixel for pixel.

    python prompts.py --reel reel --tasks tasks --set set --traces traces

A server answers each prompt of `reel bench --agent real-agent` with the answer of the exported row that has this prompt and this image, and
refuses any other prompt. An episode that ends in success was asked nothing but what the set holds, decision by decision. `--traces` are those
that the set was made from; exit code 1 if a prompt was not found, or an episode made other calls.
"""

import argparse
import collections
import http.server
import json
import pathlib
import subprocess
import sys
import tempfile
import threading

sys.path.insert(0, str(pathlib.Path(__file__).parents[1]))
import data
import images
import server


class Rows:
    """Answers by prompt and pixels, as the writer of the server."""

    def __init__(self, folder: pathlib.Path) -> None:
        self.answers: dict[tuple[str, str | None], collections.Counter[str]] = collections.defaultdict(collections.Counter)
        self.prompts: set[str] = set()
        for one in data.read(folder):
            pixels = server.hash_of(images.decode(one.image.read_bytes())) if one.image else None
            self.answers[one.prompt, pixels][one.answer] += 1
            self.prompts.add(one.prompt)
        self.asked, self.missing = 0, []
        self.lock = threading.Lock()

    def complete(self, request: dict) -> dict:
        text, pixels = server.read_prompt(request["messages"])
        known = self.answers.get((text, None if pixels is None else server.hash_of(pixels)))
        with self.lock:
            self.asked += 1
            if not known:
                self.missing.append({"prompt": text, "image_differs": text in self.prompts})
        if not known:
            raise server.Refusal(400, "the set has no row with this prompt and this image")
        message = {"role": "assistant", "content": known.most_common(1)[0][0]}
        return {"choices": [{"index": 0, "message": message, "finish_reason": "stop"}], "usage": {"prompt_tokens": 0, "completion_tokens": 0}}


def handler(rows: Rows) -> type[http.server.BaseHTTPRequestHandler]:
    class Handler(http.server.BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_POST(self) -> None:
            request = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            try:
                status, body = 200, rows.complete(request)
            except server.Refusal as refusal:
                status, body = refusal.status, {"error": {"message": str(refusal)}}
            text = json.dumps(body).encode()
            self.send_response(status)
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(text)))
            self.end_headers()
            self.wfile.write(text)

        def log_message(self, *_: object) -> None:
            pass

    return Handler


def calls(reel: str, folder: pathlib.Path) -> dict[str, list]:
    """The calls of each task's episode."""
    found = {}
    for trace in sorted(folder.rglob("*.mcap")):
        shown = json.loads(subprocess.run([reel, "show", "--json", str(trace)], check=True, capture_output=True, text=True).stdout)
        canonical = lambda step: (step.get("tool"), {name: str(value) for name, value in (step["input"]["call"]["arguments"] or {}).items()})
        found[shown["header"]["task_id"]] = [canonical(step) for step in shown["steps"]]
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reel", default="reel")
    parser.add_argument("--tasks", required=True, type=pathlib.Path)
    parser.add_argument("--set", required=True, type=pathlib.Path)
    parser.add_argument("--traces", required=True, type=pathlib.Path)
    chosen = parser.parse_args()
    rows = Rows(chosen.set)
    with tempfile.TemporaryDirectory() as folder, http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler(rows)) as served:
        threading.Thread(target=served.serve_forever, daemon=True).start()
        command = [
            chosen.reel, "bench", "--tasks", str(chosen.tasks), "--agent", "real-agent", "--model", "rows", "--jobs", "2",
            "--endpoint", f"http://127.0.0.1:{served.server_port}/v1", "--out", f"{folder}/played",
        ]
        status = subprocess.run(command).returncode
        played, recorded = calls(chosen.reel, pathlib.Path(folder) / "played"), calls(chosen.reel, chosen.traces)
        served.shutdown()
    other = [task for task, made in played.items() if made != recorded.get(task)]
    print(json.dumps({"prompts": rows.asked, "not_in_the_set": len(rows.missing), "episodes": len(played), "with_other_calls": other}))
    for one in rows.missing[:1]:
        print(json.dumps(one), file=sys.stderr)
    sys.exit(1 if rows.missing or other or status or not played else 0)


if __name__ == "__main__":
    main()
