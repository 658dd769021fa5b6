"""A decoder-only transformer of less than a million parameters, in plain JAX.

Three things let so small a model copy names it never saw from little text. What stands before the first answer is read in
both directions (a prefix language model), so that a name knows what is said of it later in its line. Keys and values look
one token back as well (a causal convolution of width two). And the output is a mixture of the vocabulary and of a pointer
into the context (See et al. 2017, pointer-generator networks).
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp

from tokenizer import ANSWER, END, PAD

CHUNK = 256


@dataclasses.dataclass(frozen=True)
class Config:
    vocabulary: int
    width: int = 128
    layers: int = 4
    heads: int = 4


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


def attend_chunks(query, key, value, visible):
    """As `attend`, without computing what lies behind a chunk of queries; nor is what stands there seen."""
    ends = range(CHUNK, query.shape[1] + CHUNK, CHUNK)
    chunks = [attend(query[:, end - CHUNK : end], key[:, :end], value[:, :end], visible[:, end - CHUNK : end, :end]) for end in ends]
    return jnp.concatenate(chunks, 1)


def attend(query, key, value, visible):
    """`visible` is [batch, time of the query, time of the key]."""
    scores = jnp.einsum("bqhd,bkhd->bhqk", query * query.shape[-1] ** -0.5, key)
    weights = jax.nn.softmax(jnp.where(visible[:, None], scores, -1e9), -1)
    return jnp.einsum("bhqk,bkhd->bqhd", weights, value).reshape(*query.shape[:2], -1)


def finish_block(block, x, attended):
    x = x + attended @ block["out"]
    return x + jnp.square(jax.nn.relu(norm(x, block["norm_mlp"]) @ block["up"])) @ block["down"]


def pointer_keys(pointer, normed, before):
    return (normed + (before - normed) * pointer["back"]) @ pointer["key"]


def looks(pointer, hidden, keys, visible):
    """Where the pointer looks, [batch, time of the query, time of the key], and how much it counts."""
    scores = jnp.einsum("bqd,bkd->bqk", hidden @ pointer["query"] * hidden.shape[-1] ** -0.5, keys)
    return jax.nn.softmax(jnp.where(visible, scores, -1e9), -1), jax.nn.sigmoid(hidden @ pointer["gate"])


def seen(tokens):
    """What each position sees: what stands before it, and all that stands before the first answer."""
    time = tokens.shape[1]
    given = (jnp.cumsum(tokens == ANSWER, 1) == 0) & (tokens != PAD)
    return jnp.tril(jnp.ones((time, time), bool))[None] | given[:, None]


def forward(parameters, tokens, config):
    """The last hidden states and the keys of the pointer. Padding stands at the end."""
    positions = jnp.arange(tokens.shape[1])[None]
    visible = seen(tokens)
    x = parameters["embedding"][tokens] * config.width**0.5
    for block in parameters["blocks"]:
        normed = norm(x, block["norm_attention"])
        before = jnp.pad(normed, ((0, 0), (1, 0), (0, 0)))[:, :-1]
        query, key, value = queries_keys_values(block, normed, before, positions, config.heads)
        x = finish_block(block, x, attend_chunks(query, key, value, visible))
    return norm(x, parameters["norm"]), pointer_keys(parameters["pointer"], normed, before)


def loss(parameters, tokens, config):
    """Mean cross-entropy of the answers: of what stands between `ANSWER` and `END`, and of `END`."""
    given, targets = tokens[:, :-1], tokens[:, 1:]
    hidden, keys = forward(parameters, given, config)
    where, share = looks(parameters["pointer"], hidden, keys, seen(given))
    copied = jnp.sum(where * (given[:, None] == targets[..., None]), -1)
    written = jnp.take_along_axis(jax.nn.softmax(hidden @ parameters["embedding"].T, -1), targets[..., None], -1)[..., 0]
    answers = jnp.cumsum(given == ANSWER, 1) > jnp.cumsum(given == END, 1)
    return -jnp.sum(jnp.log(share * copied + (1 - share) * written + 1e-9) * answers) / jnp.sum(answers)


def probabilities(parameters, tokens, config):
    """Of the next token after every position, given all tokens up to it: [batch, time, vocabulary]."""
    hidden, keys = forward(parameters, tokens, config)
    where, share = looks(parameters["pointer"], hidden, keys, seen(tokens))
    copied = where @ jax.nn.one_hot(tokens, len(parameters["embedding"]))
    return share[..., None] * copied + (1 - share[..., None]) * jax.nn.softmax(hidden @ parameters["embedding"].T, -1)


@functools.partial(jax.jit, static_argnames="config")
def likeliest(parameters, tokens, config):
    return jnp.argmax(probabilities(parameters, tokens, config), -1)
