"""Writes answers token by token, several at once. Equal prompts with equal seeds get equal draws."""

import dataclasses
import hashlib
import random

import numpy
import torch
from torch import Tensor

import model
from model import Memory, Policy, Sequences
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


class Prompt(Sequences):
    """One prompt, of which what blocks need later is kept: keys, values and normed inputs, by block."""

    def __init__(self, tokens: list[int]) -> None:
        super().__init__([len(tokens)], [len(tokens)])
        self.normed: list[Tensor] = []
        self.kept: list[tuple[Tensor, Tensor, Tensor]] = []

    def before(self, normed: Tensor) -> Tensor:
        self.normed.append(normed)
        return super().before(normed)

    def attend(self, query: Tensor, key: Tensor, value: Tensor) -> Tensor:
        self.kept.append((key, value, self.normed[-1]))
        return super().attend(query, key, value)


@torch.inference_mode()
def answers(policy: Policy, questions: list[Question]) -> list[Answer]:
    """An answer for each question. Prompts are read one by one, answers written at once; when half of them are done, these are taken out."""
    batch, width, further = len(questions), max(len(one.tokens) for one in questions), max(one.longest for one in questions)
    room = width + further
    prompts = [Prompt(one.tokens) for one in questions]
    context, keys = torch.full((batch, room), PAD), torch.zeros(batch, room, policy.config.width)
    last = []
    for row, (question, prompt) in enumerate(zip(questions, prompts)):
        tokens = torch.tensor(question.tokens)
        start = width - len(tokens)
        features = None if question.features is None else question.features[None]
        read, pointed = policy.read(tokens, features, prompt.positions, [prompt] * len(policy.blocks))
        context[row, start:width], keys[row, start:width] = tokens, pointed
        last.append(read[-1:])
    memories = [Memory(list(read), further) for read in zip(*(prompt.kept for prompt in prompts))]
    start, hidden = memories[0].start, torch.stack(last)

    streams = [stream(question) for question in questions]
    found = [Answer([], []) for _ in questions]
    rows = list(range(batch))  # the question of each row
    open_rows = [True] * batch
    for now in range(width, room):
        readable = (torch.arange(now) >= start[:, None]) & (context[:, :now] != IMAGE)
        written, where, share = policy.mixture(hidden, keys[:, :now], readable[:, None])
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
            nexts, context, keys, start = (one[kept] for one in (nexts, context, keys, start))
            rows, open_rows = [rows[row] for row in kept.tolist()], [True] * len(kept)
        context[:, now] = nexts[:, 0]
        hidden, pointed = policy.read(nexts, None, (now - start)[:, None], memories)
        keys[:, now] = pointed[:, 0]
    return found
