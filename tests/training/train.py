"""Training from scratch: loss on the answer only, AdamW, one cycle of the learning rate."""

import functools
import time

import jax
import jax.numpy as jnp
import numpy

import model
from tokenizer import ANSWER, BEGIN, END, PAD

TOKENS_A_BATCH = 4096
STEP = 64


def sequence(tokenizer, prompt, answer):
    """Token ids, and how many of them are given."""
    given = [BEGIN, *tokenizer.ids(prompt), ANSWER]
    return given + tokenizer.ids(answer) + [END], len(given)


def up(length):
    return -(-length // STEP) * STEP


def padded(sequences, rows):
    """Sequences that end together, as one array."""
    tokens = numpy.full((rows, up(max(map(len, sequences)))), PAD, numpy.int32)
    for row, ids in enumerate(sequences):
        tokens[row, -len(ids) :] = ids
    return tokens


def batches(sequences, draw):
    """Batches of like lengths, in random order, and the length of the longest answer, rounded up."""
    tail = up(max(len(ids) - given for ids, given in sequences))
    widths, chunks = {}, []
    for index in draw.permutation(len(sequences)):
        ids = sequences[index][0]
        widths.setdefault(up(len(ids)), []).append(ids)
    for width, members in sorted(widths.items()):
        rows = max(1, TOKENS_A_BATCH // width)
        chunks += [(members[start : start + rows], rows) for start in range(0, len(members), rows)]
    for index in draw.permutation(len(chunks)):
        members, rows = chunks[index]
        yield padded(members, rows), tail


@functools.partial(jax.jit, static_argnames=("tail", "config"), donate_argnums=(0, 1))
def update(parameters, moments, tokens, tail, step, rate, config):
    """One step of AdamW with the gradient's norm cut at one."""
    value, slopes = jax.value_and_grad(model.loss)(parameters, tokens, tail, config)
    length = jnp.sqrt(sum(jnp.sum(slope**2) for slope in jax.tree.leaves(slopes)))
    slopes = jax.tree.map(lambda slope: slope / jnp.maximum(1, length), slopes)
    first = jax.tree.map(lambda moment, slope: 0.9 * moment + 0.1 * slope, moments[0], slopes)
    second = jax.tree.map(lambda moment, slope: 0.98 * moment + 0.02 * slope**2, moments[1], slopes)
    move = lambda parameter, one, two: parameter - rate * (
        one / (1 - 0.9**step) / (jnp.sqrt(two / (1 - 0.98**step)) + 1e-8) + 0.01 * (parameter.ndim > 1) * parameter
    )
    return jax.tree.map(move, parameters, first, second), (first, second), value


def train(config, sequences, epochs, seed, rate=3e-3, say=print):
    """The trained parameters and the mean loss of each epoch."""
    parameters = model.initialise(config, seed)
    moments = (jax.tree.map(jnp.zeros_like, parameters), jax.tree.map(jnp.zeros_like, parameters))
    draw = numpy.random.default_rng(seed)
    total = epochs * sum(1 for _ in batches(sequences, numpy.random.default_rng(seed)))
    step, losses, began = 0, [], time.perf_counter()
    for epoch in range(epochs):
        values = []
        for tokens, tail in batches(sequences, draw):
            step += 1
            now = rate * min(step / (0.05 * total + 1), (total - step) / (0.95 * total) + 0.02)
            parameters, moments, value = update(parameters, moments, tokens, tail, jnp.float32(step), jnp.float32(now), config)
            values.append(value)
        losses.append(float(numpy.mean(values)))
        say(f"  epoch {epoch + 1:2} of {epochs}: loss {losses[-1]:.4f}, {time.perf_counter() - began:.0f} s")
    return parameters, losses
