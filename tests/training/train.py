"""Training from scratch: loss on the answers only, AdamW, a learning rate that is held and then falls."""

import dataclasses
import functools
import itertools
import pickle
import time

import jax
import jax.numpy as jnp
import numpy

import model
from tokenizer import ANSWER, BEGIN, END, PAD

TOKENS_A_BATCH = 2048
STEP = 128
REPORT = 50
WARM = 50


def sequences(tokenizer, examples):
    """One sequence of token ids for each episode: what was given, the answer, what was given, the answer, and so on."""
    for _, steps in itertools.groupby(examples, lambda one: one.episode):
        ids = [BEGIN]
        for one in steps:
            ids += [*tokenizer.ids(one.given), ANSWER, *tokenizer.ids(one.answer), END]
        yield ids


def up(length):
    return -(-length // STEP) * STEP


def padded(some, rows):
    """Sequences as one array, padding at their ends."""
    tokens = numpy.full((rows, up(max(map(len, some)))), PAD, numpy.int32)
    for row, ids in enumerate(some):
        tokens[row, : len(ids)] = ids
    return tokens


def batches(some, draw):
    """Batches of like lengths, in random order."""
    widths, chunks = {}, []
    for index in draw.permutation(len(some)):
        widths.setdefault(up(len(some[index])), []).append(some[index])
    for width, members in sorted(widths.items()):
        rows = max(1, TOKENS_A_BATCH // width)
        chunks += [(members[start : start + rows], rows) for start in range(0, len(members), rows)]
    for index in draw.permutation(len(chunks)):
        yield padded(*chunks[index])


@functools.partial(jax.jit, static_argnames=("config",), donate_argnums=(0, 1))
def update(parameters, moments, tokens, step, rate, config):
    """One step of AdamW with the gradient's norm cut at one."""
    value, slopes = jax.value_and_grad(model.loss)(parameters, tokens, config)
    length = jnp.sqrt(sum(jnp.sum(slope**2) for slope in jax.tree.leaves(slopes)))
    slopes = jax.tree.map(lambda slope: slope / jnp.maximum(1, length), slopes)
    first = jax.tree.map(lambda moment, slope: 0.9 * moment + 0.1 * slope, moments[0], slopes)
    second = jax.tree.map(lambda moment, slope: 0.98 * moment + 0.02 * slope**2, moments[1], slopes)
    move = lambda parameter, one, two: parameter - rate * (
        one / (1 - 0.9**step) / (jnp.sqrt(two / (1 - 0.98**step)) + 1e-8) + 0.01 * (parameter.ndim > 1) * parameter
    )
    return jax.tree.map(move, parameters, first, second), (first, second), value


def kept(path, config):
    """Parameters, moments, step and losses of a training that was broken off; None where there is none of this shape."""
    if path is None or not path.exists():
        return None
    at = pickle.loads(path.read_bytes())
    return at["state"] if at["config"] == dataclasses.asdict(config) else None


def keep(path, config, *state):
    if path is not None:
        part = path.with_suffix(".part")
        part.write_bytes(pickle.dumps({"config": dataclasses.asdict(config), "state": jax.tree.map(numpy.asarray, state)}))
        part.rename(path)


def train(config, told, updates, seed, rate=3e-3, checkpoint=None, say=print):
    """The trained parameters and the mean loss of each REPORT updates; goes on from the checkpoint, if there is one.

    `told` gives the sequences of one epoch, by a random generator.
    """
    parameters = model.initialise(config, seed)
    moments = (jax.tree.map(jnp.zeros_like, parameters), jax.tree.map(jnp.zeros_like, parameters))
    began, done, losses = time.perf_counter(), 0, []
    found = kept(checkpoint, config)
    if found:
        parameters, moments, done, losses = found
        done, losses = int(done), [float(loss) for loss in losses]
        say(f"  goes on after update {done}: {checkpoint}")
    values = []
    for step, tokens in enumerate(itertools.islice(endless(told, seed), updates), 1):
        if step <= done:
            continue
        now = rate * min(1, step / WARM, (updates - step) / (0.4 * updates) + 0.02)
        parameters, moments, value = update(parameters, moments, tokens, jnp.float32(step), jnp.float32(now), config)
        values.append(value)
        if step % REPORT == 0 or step == updates:
            losses.append(float(numpy.mean(values)))
            values = []
            keep(checkpoint, config, parameters, moments, step, losses)
            say(f"  update {step:4} of {updates}: loss {losses[-1]:.4f}, {time.perf_counter() - began:.0f} s")
    return parameters, losses


def endless(told, seed):
    """Batches, epoch after epoch."""
    draw = numpy.random.default_rng(seed)
    while True:
        yield from batches(told(draw), draw)
