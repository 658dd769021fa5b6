"""A decoder-only transformer of half a million parameters, in plain JAX.

Two things let so small a model copy names it never saw from little text. Keys and values look one token back as well (a
causal convolution of width two). And the output is a mixture of the vocabulary and of a pointer into the context
(See et al. 2017, pointer-generator networks).
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp

from tokenizer import ANSWER, END, PAD


@dataclasses.dataclass(frozen=True)
class Config:
    vocabulary: int
    width: int = 128
    layers: int = 2
    heads: int = 2


def initialise(config, seed):
    """Parameters; equal seeds give equal ones."""
    keys = iter(jax.random.split(jax.random.key(seed), 3 + 5 * config.layers))
    width = config.width
    draw = lambda rows, columns, scale=1.0: jax.random.normal(next(keys), (rows, columns)) * (scale * rows**-0.5)
    deep = (2 * config.layers) ** -0.5
    block = lambda: {
        "norm_attention": jnp.ones(width),
        "norm_mlp": jnp.ones(width),
        "back": jnp.full((2, width), 0.5),  # how much of keys and values is the token before
        "query": draw(width, width),
        "key_value": draw(width, 2 * width),
        "out": draw(width, width, deep),
        "up": draw(width, 4 * width),
        "down": draw(4 * width, width, deep),
    }
    embedding = jax.random.normal(next(keys), (config.vocabulary, width)) * width**-0.5
    pointer = {"query": draw(width, width), "key": draw(width, width), "back": jnp.full(width, 0.5), "gate": jnp.zeros(width)}
    return {"embedding": embedding, "norm": jnp.ones(width), "pointer": pointer, "blocks": [block() for _ in range(config.layers)]}


def count(parameters):
    return sum(leaf.size for leaf in jax.tree.leaves(parameters))


def norm(x, scale):
    return x * jax.lax.rsqrt(jnp.mean(x * x, -1, keepdims=True) + 1e-6) * scale


def rotate(x, positions):
    """Rotary positions; x is [batch, time, heads, size]."""
    half = x.shape[-1] // 2
    angles = positions[:, :, None, None] * 10_000.0 ** (-jnp.arange(half) / half)
    left, right = x[..., :half], x[..., half:]
    return jnp.concatenate([left * jnp.cos(angles) - right * jnp.sin(angles), left * jnp.sin(angles) + right * jnp.cos(angles)], -1)


def queries_keys_values(block, x, before, positions, heads):
    """Of normed inputs `x` and those one token `before`, each [batch, time, heads, size]."""
    split = lambda y: y.reshape(*y.shape[:2], heads, -1)
    weight_key, weight_value = jnp.split(block["key_value"], 2, axis=1)
    mixed = [x + (before - x) * share for share in block["back"]]
    return rotate(split(x @ block["query"]), positions), rotate(split(mixed[0] @ weight_key), positions), split(mixed[1] @ weight_value)


def attend(query, key, value, visible):
    """`visible` is [batch or 1, 1, time of the query, time of the key]."""
    scores = jnp.einsum("bqhd,bkhd->bhqk", query, key) * query.shape[-1] ** -0.5
    weights = jax.nn.softmax(jnp.where(visible, scores, -1e9), -1)
    return jnp.einsum("bhqk,bkhd->bqhd", weights, value).reshape(*query.shape[:2], -1)


def finish_block(block, x, attended):
    x = x + attended @ block["out"]
    return x + jax.nn.gelu(norm(x, block["norm_mlp"]) @ block["up"]) @ block["down"]


def pointer_keys(pointer, normed, before):
    return (normed + (before - normed) * pointer["back"]) @ pointer["key"]


def log_probabilities(parameters, hidden, keys, tokens, visible):
    """Of the next token, [batch, time, vocabulary]: from the vocabulary, or copied from where the pointer looks."""
    pointer, size = parameters["pointer"], hidden.shape[-1]
    scores = jnp.einsum("bqd,bkd->bqk", hidden @ pointer["query"], keys) * size**-0.5
    looks = jax.nn.softmax(jnp.where(visible, scores, -1e9), -1)
    copied = jnp.einsum("bqk,bkv->bqv", looks, jax.nn.one_hot(tokens, len(parameters["embedding"])))
    share = jax.nn.sigmoid(hidden @ pointer["gate"])[..., None]
    return jnp.log(share * copied + (1 - share) * jax.nn.softmax(hidden @ parameters["embedding"].T, -1) + 1e-9)


def forward(parameters, tokens, tail, config):
    """Log-probabilities after the last `tail` positions; keys, values and last inputs of each block; keys of the pointer.

    Sequences end together: what is shorter begins with padding. Nothing before the tail has a loss, so the last block
    computes only keys and values there.
    """
    time = tokens.shape[1]
    positions = jnp.arange(time)[None]
    visible = jnp.tril(jnp.ones((time, time), bool))[None, None] & (tokens != PAD)[:, None, None]
    x, kept = parameters["embedding"][tokens] * config.width**0.5, []
    for number, block in enumerate(parameters["blocks"]):
        normed = norm(x, block["norm_attention"])
        before = jnp.pad(normed, ((0, 0), (1, 0), (0, 0)))[:, :-1]
        query, key, value = queries_keys_values(block, normed, before, positions, config.heads)
        kept.append((key, value, normed[:, -1]))
        if number == config.layers - 1:
            keys = pointer_keys(parameters["pointer"], normed, before)
            x, query, visible = x[:, -tail:], query[:, -tail:], visible[:, :, -tail:]
        x = finish_block(block, x, attend(query, key, value, visible))
    return log_probabilities(parameters, norm(x, parameters["norm"]), keys, tokens, visible[:, 0]), kept, keys


def loss(parameters, tokens, tail, config):
    """Mean cross-entropy of the last `tail` tokens after `ANSWER`."""
    logarithms, *_ = forward(parameters, tokens[:, :-1], tail, config)
    targets = tokens[:, -logarithms.shape[1] :]
    answers = jnp.cumsum(tokens == ANSWER, 1)[:, -logarithms.shape[1] - 1 : -1] > 0
    of_target = jnp.take_along_axis(logarithms, targets[..., None], -1)[..., 0]
    return -jnp.sum(of_target * answers) / jnp.sum(answers)


@functools.partial(jax.jit, static_argnames=("config", "most"))
def generate(parameters, tokens, config, most):
    """Greedy continuations, [batch, most]; sequences stop at `END`, and what follows it means nothing."""
    rows, time = tokens.shape
    logarithms, kept, pointed = forward(parameters, tokens, 1, config)
    room = lambda kept: jnp.pad(kept, ((0, 0), (0, most), *((0, 0),) * (kept.ndim - 2)))
    cache = [(room(key), room(value), normed) for key, value, normed in kept]
    choose = lambda logarithms: jnp.argmax(logarithms[:, 0], -1).astype(tokens.dtype)
    steps = jnp.arange(time + most)

    def step(state):
        index, token, cache, pointed, text, done, out = state
        out, position = out.at[:, index].set(token), time + index
        text = text.at[:, position].set(token)
        x = parameters["embedding"][token][:, None] * config.width**0.5
        visible = ((room(tokens) != PAD) | ((steps >= time) & (steps <= position)))[:, None, None]
        after = []
        for block, (keys, values, before) in zip(parameters["blocks"], cache):
            normed = norm(x, block["norm_attention"])
            here = jnp.full((rows, 1), position)
            query, key, value = queries_keys_values(block, normed, before[:, None], here, config.heads)
            keys, values = keys.at[:, position].set(key[:, 0]), values.at[:, position].set(value[:, 0])
            x = finish_block(block, x, attend(query, keys, values, visible))
            after.append((keys, values, normed[:, 0]))
        pointed = pointed.at[:, position].set(pointer_keys(parameters["pointer"], normed, before[:, None])[:, 0])
        logarithms = log_probabilities(parameters, norm(x, parameters["norm"]), pointed, text, visible[:, 0])
        return index + 1, choose(logarithms), after, pointed, text, done | (token == END), out

    start = (0, choose(logarithms), cache, room(pointed), room(tokens), jnp.zeros(rows, bool), jnp.full((rows, most), END, tokens.dtype))
    return jax.lax.while_loop(lambda state: (state[0] < most) & ~jnp.all(state[-2]), step, start)[-1]
