"""Writes answers token by token, several at once. Equal prompts with equal seeds get equal draws."""

import dataclasses
import hashlib
import random

import numpy
import torch
from torch import Tensor

import model
from model import Memory, Policy
from tokenizer import ANSWER, END, IMAGE, PAD


@dataclasses.dataclass
class Question:
    """A prompt to answer. `tokens` ends with the answer token; `features` are those of its image."""

    tokens: list[int]
    features: Tensor | None
    temperature: float
    longest: int
    seed: int


@dataclasses.dataclass
class Answer:
    """The tokens of an answer with their log-probabilities at temperature 1, the end token included if it was reached."""

    tokens: list[int]
    logprobs: list[float]

    @property
    def ended(self) -> bool:
        return bool(self.tokens) and self.tokens[-1] == END


def stream(question: Question) -> random.Random:
    """The random stream of a question: of its seed and its prompt."""
    key = f"{question.seed}/{question.tokens}".encode()
    return random.Random(hashlib.blake2b(key, digest_size=8).digest())


def draw(chances: numpy.ndarray, temperature: float, rng: random.Random) -> int:
    """A token by its probability; the likeliest at temperature 0."""
    if temperature == 0:
        return int(chances.argmax())
    sharper = (chances / chances.max()) ** (1 / temperature)
    total = numpy.cumsum(sharper)
    return int(min(numpy.searchsorted(total, rng.random() * total[-1], side="right"), len(chances) - 1))


@torch.inference_mode()
def answers(policy: Policy, questions: list[Question]) -> list[Answer]:
    """An answer for each question. Sequences stand right-aligned in the batch; once half of them are done, they are taken out."""
    batch, width = len(questions), max(len(question.tokens) for question in questions)
    size = policy.config.width // policy.config.heads
    tokens = torch.full((batch, width), PAD)
    for row, question in enumerate(questions):
        tokens[row, width - len(question.tokens) :] = torch.tensor(question.tokens)
    start = torch.tensor([width - len(question.tokens) for question in questions])
    shown = [question.features for question in questions if question.features is not None]

    columns = torch.arange(width)
    real = columns[None] >= start[:, None]
    # Padding sees itself, so that no row of scores is empty.
    visible = real[:, None] | torch.eye(width, dtype=torch.bool)[None]
    x = policy.embed(tokens, torch.stack(shown) if shown else None)
    turn = model.angles((columns[None] - start[:, None]).clamp(min=0), size)
    room = width + max(question.longest for question in questions)
    memories = [Memory(policy.config, batch, room) for _ in policy.blocks]
    normed = x
    for block, memory in zip(policy.blocks, memories):
        # Zeros stand before the first token, which looks back at them.
        x, normed = block(x * real[..., None], visible, turn, memory)
    before = torch.nn.functional.pad(normed, (0, 0, 1, 0))[:, :-1]
    keys = torch.zeros(batch, room, policy.config.width)
    keys[:, :width] = policy.pointer_key(normed + (before - normed) * policy.pointer_back)
    context, seen = torch.full((batch, room), PAD), torch.zeros(batch, room, dtype=torch.bool)
    context[:, :width], seen[:, :width] = tokens, real
    last_normed, hidden = normed[:, -1:], policy.norm(x[:, -1:])

    streams = [stream(question) for question in questions]
    found = [Answer([], []) for _ in questions]
    rows = list(range(batch))  # the question of each row
    open_rows = [True] * batch
    for now in range(width, room):
        written, where, share = policy.mixture(hidden, keys[:, :now], (seen & (context != IMAGE))[:, None, :now])
        chances = (1 - share[:, 0]) * written[:, 0].exp()
        chances = chances.scatter_add(1, context[:, :now], share[:, 0] * where[:, 0]).double().numpy()
        chances[:, [PAD, ANSWER, IMAGE]] = 0
        nexts = torch.full((len(rows), 1), PAD)
        for row, index in enumerate(rows):
            if not open_rows[row]:
                continue
            question, answer = questions[index], found[index]
            token = draw(chances[row], question.temperature, streams[index])
            answer.tokens.append(token)
            answer.logprobs.append(min(0.0, float(numpy.log(chances[row, token] + model.EPSILON))))
            open_rows[row] = token != END and len(answer.tokens) < question.longest
            nexts[row] = token
        if not any(open_rows):
            break
        if 2 * sum(open_rows) <= len(rows):
            kept = torch.tensor([row for row, is_open in enumerate(open_rows) if is_open])
            for memory in memories:
                memory.keep(kept)
            nexts, context, seen, keys, start, last_normed = (one[kept] for one in (nexts, context, seen, keys, start, last_normed))
            rows, open_rows = [rows[row] for row in kept.tolist()], [True] * len(kept)
        context[:, now], seen[:, now] = nexts[:, 0], True
        x = policy.embed(nexts, None)
        turn = model.angles((now - start)[:, None], size)
        for block, memory in zip(policy.blocks, memories):
            x, normed = block(x, seen[:, None, : now + 1], turn, memory)
        keys[:, now] = policy.pointer_key(normed + (last_normed - normed) * policy.pointer_back)[:, 0]
        last_normed, hidden = normed, policy.norm(x)
    return found
