"""Serves a checkpoint on the OpenAI protocol (`/v1/chat/completions`), so that `reel bench --agent real-agent` plays it.

    python server.py checkpoint --port 8100 &
    reel bench --tasks tasks --agent real-agent --endpoint http://127.0.0.1:8100/v1 --model small --out played

Requests that come together are answered in one batch. Without a `seed` the order of requests decides what is drawn; with one, equal
prompts get equal draws. Log-probabilities are those at temperature 1. `"return_tokens_as_token_ids": true` names tokens by their ids, as
vLLM does, so that a trainer scores exactly the tokens that were drawn.
"""

import argparse
import base64
import binascii
import contextlib
import dataclasses
import hashlib
import http.server
import json
import pathlib
import queue
import threading
import time
import typing

import numpy

import checkpoint
import data
import generate
import images
from model import Policy
from tokenizer import Tokenizer

READ = {
    "model", "messages", "temperature", "seed", "max_tokens", "max_completion_tokens", "logprobs", "top_logprobs", "n", "stream",
    "return_tokens_as_token_ids", "user",
}
FIXED = {"n": 1, "stream": False, "top_logprobs": 0}
CONTEXT = 4096
BODY = 32 << 20


class Refusal(Exception):
    """A request that cannot be answered."""

    def __init__(self, status: int, message: str) -> None:
        super().__init__(message)
        self.status = status


@dataclasses.dataclass
class Waiting:
    """A question in the queue, and where its answer goes."""

    question: generate.Question
    done: threading.Event
    answer: generate.Answer | None = None
    error: str | None = None


class Writer:
    """Answers questions from a queue, in some threads, each as many at once as wait and fit."""

    def __init__(self, policy: Policy, tokenizer: Tokenizer, most: int, threads: int, log: pathlib.Path | None) -> None:
        self.policy, self.tokenizer, self.most = policy, tokenizer, most
        self.waiting: queue.Queue[Waiting] = queue.Queue()
        self.drawn, self.lock = 0, threading.Lock()
        self.log = log.open("a", encoding="utf-8") if log else None
        for _ in range(threads):
            threading.Thread(target=self.work, daemon=True).start()

    def work(self) -> None:
        while True:
            some = [self.waiting.get()]
            time.sleep(0.003)
            with contextlib.suppress(queue.Empty):  # another thread may take the last one
                while len(some) < self.most:
                    some.append(self.waiting.get_nowait())
            began = time.monotonic()
            try:
                for one, answer in zip(some, generate.answers(self.policy, [one.question for one in some])):
                    one.answer = answer
            except Exception as error:  # one bad batch must not end the server
                for one in some:
                    one.error = f"{type(error).__name__}: {error}"
            self.note({"batch": len(some), "seconds": time.monotonic() - began, "tokens": [len(one.answer.tokens) if one.answer else 0 for one in some]})
            for one in some:
                one.done.set()

    def note(self, line: dict[str, typing.Any]) -> None:
        if self.log:
            with self.lock:
                self.log.write(json.dumps(line) + "\n")
                self.log.flush()

    def ask(self, question: generate.Question) -> generate.Answer:
        one = Waiting(question, threading.Event())
        self.waiting.put(one)
        one.done.wait()
        if one.answer is None:
            raise Refusal(500, one.error or "no answer")
        return one.answer

    def fresh_seed(self) -> int:
        with self.lock:
            self.drawn += 1
            return -self.drawn


def read_prompt(messages: typing.Any) -> tuple[str, numpy.ndarray | None]:
    """Text and pixels of a request with one user message. Fails with `Refusal` on anything else."""
    if not isinstance(messages, list) or len(messages) != 1 or messages[0].get("role") != "user":
        raise Refusal(400, "`messages` must be one message of role `user`: the model reads single turns (reel bench --agent real-agent)")
    content = messages[0].get("content")
    parts = [{"type": "text", "text": content}] if isinstance(content, str) else content
    if not isinstance(parts, list):
        raise Refusal(400, "`content` must be a text or a list of parts")
    texts, pixels = [], []
    for part in parts:
        match part:
            case {"type": "text", "text": str(text)}:
                texts.append(text)
            case {"type": "image_url", "image_url": {"url": str(url)}}:
                pixels.append(read_image(url))
            case _:
                raise Refusal(400, "a part of `content` is neither `text` nor `image_url`")
    text = "".join(texts)
    if text.count(data.MARK) != len(pixels) or len(pixels) > 1:
        raise Refusal(400, f"the text has {text.count(data.MARK)} times `{data.MARK}` and the message {len(pixels)} images; the model reads one at most")
    return text, pixels[0] if pixels else None


def read_image(url: str) -> numpy.ndarray:
    head, comma, body = url.partition(",")
    if not comma or not head.startswith("data:image/") or not head.endswith(";base64"):
        raise Refusal(400, "an image must be a data URL, `data:image/png;base64,...`; the server fetches none")
    try:
        return images.decode(base64.b64decode(body, validate=True))
    except (binascii.Error, ValueError) as error:
        raise Refusal(400, f"the image cannot be read: {error}") from error


def number(request: dict[str, typing.Any], name: str, default: float, least: float, most: float, kind: type = float) -> typing.Any:
    value = request.get(name, default)
    value = default if value is None else value
    if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value <= most or kind(value) != value:
        raise Refusal(400, f"`{name}` must be a number from {least} to {most}")
    return kind(value)


def complete(writer: Writer, name: str, request: typing.Any) -> dict[str, typing.Any]:
    """The body of an answer."""
    if not isinstance(request, dict):
        raise Refusal(400, "the body must be a JSON object")
    if request.get("model") != name:
        raise Refusal(404, f"there is no model {request.get('model')!r}; the model is {name!r}")
    for field, value in request.items():
        if field not in READ and value is not None:
            raise Refusal(400, f"`{field}` is not supported; supported are {', '.join(sorted(READ))}")
    for field, only in FIXED.items():
        if request.get(field, only) not in (only, None):
            raise Refusal(400, f"`{field}` must be {json.dumps(only)}")
    text, pixels = read_prompt(request.get("messages"))
    config, tokenizer = writer.policy.config, writer.tokenizer
    tokens = data.prompt_tokens(tokenizer, config, text)
    if len(tokens) > CONTEXT:
        raise Refusal(400, f"the prompt has {len(tokens)} tokens; the context is {CONTEXT}")
    longest = number(request, "max_tokens", request.get("max_completion_tokens") or 512, 1, 1 << 20, int)
    seed = number(request, "seed", 0, 0, 2**63 - 1, int) if request.get("seed") is not None else writer.fresh_seed()
    features = None if pixels is None or config.blind else writer.policy.encoder.features(pixels)
    question = generate.Question(tokens, features, number(request, "temperature", 1.0, 0, 10), min(longest, CONTEXT - len(tokens), 512), seed)
    answer = writer.ask(question)
    written = tokenizer.text(answer.tokens)
    writer.note({"prompt": text, "pixels": None if pixels is None else hash_of(pixels), "answer": written, "read": len(tokens), "written": len(answer.tokens)})
    choice: dict[str, typing.Any] = {
        "index": 0, "message": {"role": "assistant", "content": written}, "finish_reason": "stop" if answer.ended else "length",
    }
    if request.get("logprobs"):
        texts = tokenizer.deltas(answer.tokens)
        named = [f"token_id:{token}" for token in answer.tokens] if request.get("return_tokens_as_token_ids") else texts
        choice["logprobs"] = {"content": [
            {"token": name, "logprob": value, "bytes": list(text.encode()), "top_logprobs": []} for name, text, value in zip(named, texts, answer.logprobs)
        ]}
    usage = {"prompt_tokens": len(tokens), "completion_tokens": len(answer.tokens), "total_tokens": len(tokens) + len(answer.tokens)}
    return {"id": f"chatcmpl-{abs(seed)}", "object": "chat.completion", "created": int(time.time()), "model": name, "choices": [choice], "usage": usage}


def hash_of(pixels: numpy.ndarray) -> str:
    return hashlib.blake2b(pixels.tobytes(), digest_size=16).hexdigest()


def handler(writer: Writer, name: str) -> type[http.server.BaseHTTPRequestHandler]:
    """The HTTP side of a writer."""

    class Handler(http.server.BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def reply(self, status: int, body: dict[str, typing.Any]) -> None:
            text = json.dumps(body).encode()
            self.send_response(status)
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(text)))
            self.end_headers()
            self.wfile.write(text)

        def refuse(self, refusal: Refusal) -> None:
            kind = "invalid_request_error" if refusal.status < 500 else "server_error"
            self.reply(refusal.status, {"error": {"message": str(refusal), "type": kind, "param": None, "code": None}})

        def do_GET(self) -> None:
            if self.path == "/v1/models":
                self.reply(200, {"object": "list", "data": [{"id": name, "object": "model", "owned_by": "reel"}]})
            else:
                self.refuse(Refusal(404, f"there is no {self.path}; POST to /v1/chat/completions"))

        def do_POST(self) -> None:
            try:
                length = self.headers.get("Content-Length", "")
                if not length.isdigit():
                    raise Refusal(411, "the request has no Content-Length")
                if int(length) > BODY:
                    self.close_connection = True
                    raise Refusal(413, f"the body has {length} bytes; the most are {BODY}")
                body = self.rfile.read(int(length))
                if self.path != "/v1/chat/completions":
                    raise Refusal(404, f"there is no {self.path}; POST to /v1/chat/completions")
                try:
                    request = json.loads(body)
                except ValueError as error:
                    raise Refusal(400, f"the body is not JSON: {error}") from error
                self.reply(200, complete(writer, name, request))
            except Refusal as refusal:
                self.refuse(refusal)

        def log_message(self, format: str, *args: typing.Any) -> None:
            pass

    return Handler


class Server(http.server.ThreadingHTTPServer):
    """Listens on localhost from the start, and answers once `serve_forever` runs."""

    request_queue_size = 64
    daemon_threads = True

    def __init__(self, policy: Policy, tokenizer: Tokenizer, name: str, port: int, most: int, threads: int = 1, log: pathlib.Path | None = None) -> None:
        super().__init__(("127.0.0.1", port), handler(Writer(policy, tokenizer, most, threads, log), name))

    @property
    def endpoint(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/v1"

    def begin(self) -> None:
        """Answers in a thread of its own until `shutdown`."""
        threading.Thread(target=self.serve_forever, daemon=True).start()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", type=pathlib.Path)
    parser.add_argument("--port", type=int, default=8100)
    parser.add_argument("--model", default="small", help="the name that requests give")
    parser.add_argument("--batch", type=int, default=8, help="most requests in a batch; with 1 no answer depends on other requests")
    parser.add_argument("--log", type=pathlib.Path, help="a line for each request and batch")
    parser.add_argument("--threads", type=int, default=1, help="batches at a time")
    chosen = parser.parse_args()
    with Server(*checkpoint.load(chosen.checkpoint), chosen.model, chosen.port, chosen.batch, chosen.threads, chosen.log) as server:
        print(f"{server.endpoint} serves {chosen.model}", flush=True)
        server.serve_forever()


if __name__ == "__main__":
    main()
