"""Trains the small model of `prove.py`, serves it as an OpenAI-compatible endpoint, and runs a command that asks it.

    python3 play.py --sets set.jsonl ... --checkpoint training.pickle -- \\
        reel bench --agent function-calling --endpoint {endpoint} --model small --tasks tasks --out played

`{endpoint}` in the command becomes the address. The program ends with the command and with its exit status. A training that was broken
off goes on from the checkpoint. The endpoint answers `/v1/chat/completions` with one native call, written token by token at the
request's temperature. A conversation of the agent `function-calling` is the text of the export (`--style multi-turn`), so the model
reads what it was trained on: the task, the receptacles, calls and outcomes, no images.
"""

import argparse
import functools
import http.server
import json
import pathlib
import subprocess
import sys
import threading
import zlib

import jax
import jax.numpy as jnp
import numpy

import augment
import data
import model
import train
from tokenizer import ANSWER, BEGIN, END, Tokenizer

CONTEXT = 4096
PIECE = 64
LONGEST_ANSWER = 64
ATTEMPTS = 8


def empty(config):
    """What is kept of a conversation: keys and values of each block, and normed inputs, whose row 0 stands before the first token."""
    shape = (1, CONTEXT, config.heads, config.width // config.heads)
    block = lambda: {"normed": jnp.zeros((1, CONTEXT + 1, config.width)), "key": jnp.zeros(shape), "value": jnp.zeros(shape)}
    return {
        "tokens": jnp.zeros(CONTEXT, jnp.int32),
        "pointer": jnp.zeros((1, CONTEXT, config.width)),
        "blocks": [block() for _ in range(config.layers)],
    }


@functools.partial(jax.jit, static_argnames="config", donate_argnums=1)
def extend(parameters, memory, tokens, start, count, given, config):
    """`model.probabilities` of the token after `count` more tokens, and the memory with these; `start` tokens came before.

    `tokens` is [1, time], padded at its end. The first `given` tokens of the conversation are seen by all.
    """
    write = lambda kept, new, at: jax.lax.dynamic_update_slice_in_dim(kept, new, at, 1)
    positions = start + jnp.arange(tokens.shape[1])[None]
    columns = jnp.arange(CONTEXT)
    visible = (columns <= positions[..., None]) | (columns < given)
    x = parameters["embedding"][tokens] * config.width**0.5
    blocks = []
    for block, kept in zip(parameters["blocks"], memory["blocks"]):
        normed = model.norm(x, block["norm_attention"])
        rows = write(kept["normed"], normed, start + 1)
        before = jax.lax.dynamic_slice_in_dim(rows, start, tokens.shape[1], 1)
        query, key, value = model.queries_keys_values(block, normed, before, positions, config.heads)
        key, value = write(kept["key"], key, start), write(kept["value"], value, start)
        blocks.append({"normed": rows, "key": key, "value": value})
        x = model.finish_block(block, x, model.attend(query, key, value, visible))
    pointer = write(memory["pointer"], model.pointer_keys(parameters["pointer"], normed, before), start)
    said = jax.lax.dynamic_update_slice_in_dim(memory["tokens"], tokens[0], start, 0)
    hidden = jax.lax.dynamic_slice_in_dim(model.norm(x, parameters["norm"]), count - 1, 1, 1)
    where, share = model.looks(parameters["pointer"], hidden, pointer, jax.lax.dynamic_slice_in_dim(visible, count - 1, 1, 1))
    copied = jnp.zeros(len(parameters["embedding"])).at[said].add(where[0, 0])
    written = jax.nn.softmax(hidden[0, 0] @ parameters["embedding"].T)
    return share[0, 0] * copied + (1 - share[0, 0]) * written, {"tokens": said, "pointer": pointer, "blocks": blocks}


class Writer:
    """A trained model that goes on with conversations. Equal conversations get equal answers, in whatever order they come."""

    def __init__(self, parameters, config, tokenizer, forms):
        self.parameters, self.config, self.tokenizer, self.forms = parameters, config, tokenizer, forms
        self.lock = threading.Lock()
        self.kept = {}  # by the opening: the tokens of the conversation so far, and their memory

    def answer(self, turns, temperature):
        """The text after `turns`, which are (given, answer) with an empty last answer; also how many tokens were read and written.

        What is no call of a known form is drawn again, up to `ATTEMPTS` times, as endpoints with guided decoding do.
        """
        ids = [BEGIN]
        for given, answer in turns:
            ids += [*self.tokenizer.ids(given), ANSWER, *self.tokenizer.ids(answer), END]
        ids.pop()  # the last answer is not written yet
        if len(ids) + LONGEST_ANSWER + train.STEP > CONTEXT:
            return "", len(ids), 0
        draw = numpy.random.default_rng(zlib.crc32(numpy.array(ids, numpy.int32).tobytes()))
        count = 0
        for _ in range(ATTEMPTS if temperature else 1):
            with self.lock:
                written = self.write(ids, temperature, draw)
            text, count = self.tokenizer.text(written), count + len(written)
            action = data.parse(text)
            if action and form(action) in self.forms:
                break
        return text, len(ids), count

    def write(self, ids, temperature, draw):
        given = ids.index(ANSWER)
        before, memory = self.kept.pop(tuple(ids[:given]), ([], None))
        memory = memory or empty(self.config)
        # The last token is always read again: its probabilities are not kept.
        equal = next((at for at, (one, other) in enumerate(zip(before, ids)) if one != other), min(len(before), len(ids) - 1))
        start = equal if equal > given else 0
        new, written = ids[start:], []
        while len(written) < LONGEST_ANSWER:
            width = 1 if len(new) == 1 else -(-len(new) // PIECE) * PIECE
            tokens = numpy.zeros((1, width), numpy.int32)
            tokens[0, : len(new)] = new
            chances, memory = extend(self.parameters, memory, tokens, start, len(new), given, self.config)
            start += len(new)
            token = sample(numpy.asarray(chances, numpy.float64), temperature, draw)
            if token == END:
                break
            written.append(token)
            new = [token]
        self.kept[tuple(ids[:given])] = ([*ids, *written][:start], memory)
        return written


def form(action):
    """A call's tool with the names and types of its arguments."""
    return action["tool_name"], tuple(sorted((name, type(value).__name__) for name, value in action["args"].items()))


def sample(chances, temperature, draw):
    """A token; the likeliest at temperature 0."""
    if temperature == 0:
        return int(chances.argmax())
    sharper = (chances / chances.max()) ** (1 / temperature)
    return int(draw.choice(len(sharper), p=sharper / sharper.sum()))


def turns(messages):
    """A conversation of the agent `function-calling` as (given, answer), as `data.steps` reads an exported one; the last answer is empty."""
    result, told = [], []
    for message in messages:
        if message["role"] == "assistant":
            calls = [call["function"] for call in message.get("tool_calls") or []]
            written = [data.written({"tool_name": call["name"], "args": json.loads(call["arguments"])}) for call in calls]
            result.append(("\n".join(told), written[0] if written else data.plain(message["content"] or "")))
            told = []
        elif message["role"] != "system":
            text = data.plain(message["content"]).replace("Current view:", "").strip()
            if not result and not told:
                text = f"Task: {data.section(text, 'Task')}\n\nReceptacles:\n{data.section(text, 'Receptacles')}\n"
            told += [text] if text else []
    return [*result, ("\n".join(told), "")]


def handler(writer):
    """The HTTP side of a writer."""

    class Handler(http.server.BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_POST(self):
            request = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            text, read, written = writer.answer(turns(request["messages"]), request.get("temperature", 0))
            action, message = data.parse(text), {"role": "assistant", "content": text}
            if action:
                function = {"name": action["tool_name"], "arguments": json.dumps(action["args"])}
                message = {"role": "assistant", "content": "", "tool_calls": [{"id": f"call_{read}", "type": "function", "function": function}]}
            usage = {"prompt_tokens": read, "completion_tokens": written, "total_tokens": read + written}
            choice = {"index": 0, "message": message, "finish_reason": "tool_calls" if action else "stop"}
            body = json.dumps({"object": "chat.completion", "model": request["model"], "choices": [choice], "usage": usage}).encode()
            self.send_response(200)
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_):
            pass

    return Handler


def main():
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--sets", nargs="+", required=True, type=pathlib.Path, help="JSONL files of `reel export sft --format trl --style multi-turn`")
    options.add_argument("--updates", type=int, default=2400)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--checkpoint", type=pathlib.Path, help="where to keep the training, and to go on from")
    options.add_argument("command", nargs="+", help="what to run once the endpoint answers")
    options = options.parse_args()

    examples = data.read(options.sets)
    tokenizer = Tokenizer([f"{example.given}\n{example.answer}" for example in examples])
    config = model.Config(len(tokenizer))
    told = lambda draw: list(train.sequences(tokenizer, augment.retold(examples, draw)))
    say = lambda line: print(line, flush=True)
    parameters, _ = train.train(config, told, options.updates, options.seed, checkpoint=options.checkpoint, say=say)

    writer = Writer(jax.tree.map(jnp.asarray, parameters), config, tokenizer, {form(example.action) for example in examples})
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler(writer)) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        endpoint = f"http://127.0.0.1:{server.server_port}/v1"
        status = subprocess.run([part.replace("{endpoint}", endpoint) for part in options.command]).returncode
        server.shutdown()
    sys.exit(status)


if __name__ == "__main__":
    main()
