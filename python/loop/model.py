"""A transformer that reads text and one image and writes text, small enough to train on a CPU.

Three things let it copy names that it never saw (tests/training/model.py measured them). The prompt is read in both directions, so a name
knows what is said of it later. Keys and values also look one token back. The output is a mixture of the vocabulary and of a pointer into
the context (See et al. 2017, pointer-generator networks). The image becomes a grid of tokens in the prompt.
"""

import dataclasses
import itertools
from collections.abc import Sequence

import numpy
import torch
from torch import Tensor, nn
from torch.nn import functional

from tokenizer import IMAGE

EPSILON = 1e-9


@dataclasses.dataclass(frozen=True)
class Config:
    """The shape of a model. `blind` feeds zeros in place of the image tokens and leaves everything else equal."""

    vocabulary: int
    width: int = 256
    layers: int = 5
    heads: int = 4
    image_height: int = 480  # pixels
    image_width: int = 640  # pixels
    channels: tuple[int, int, int] = (48, 64, 128)
    blind: bool = False

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of image tokens: a sixty-fourth of the pixels each."""
        return -(-self.image_height // 64), -(-self.image_width // 64)

    @property
    def image_tokens(self) -> int:
        return self.grid[0] * self.grid[1]


class Norm(nn.Module):
    """Root mean square norm."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.scale = nn.Parameter(torch.ones(width))

    def forward(self, x: Tensor) -> Tensor:
        return x * torch.rsqrt(x.square().mean(-1, keepdim=True) + 1e-6) * self.scale


class ResidualBlock(nn.Module):
    """Two convolutions with a skip connection."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        convolution = lambda: nn.Conv2d(channels, channels, 3, padding=1, bias=False)
        self.first, self.first_norm = convolution(), nn.BatchNorm2d(channels)
        self.second, self.second_norm = convolution(), nn.BatchNorm2d(channels)

    def forward(self, x: Tensor) -> Tensor:
        inner = functional.relu(self.first_norm(self.first(x)))
        return functional.relu(x + self.second_norm(self.second(inner)))


class ImageEncoder(nn.Module):
    """Features of an image, and features as tokens.

    The stem reads patches of 4 x 4 pixels, then 2 x 2 of these: thin handles and small objects keep their detail, and later layers are cheap.
    `pretrain.py` trains the convolutions; a policy keeps them as they are (paper: the vision encoder is frozen) and learns to read them.
    """

    def __init__(self, config: Config) -> None:
        super().__init__()
        one, two, three = config.channels
        stage = lambda inputs, outputs: nn.Sequential(
            nn.Conv2d(inputs, outputs, 3, stride=2, padding=1, bias=False), nn.BatchNorm2d(outputs), nn.ReLU()
        )
        patches = lambda inputs, outputs, size: [nn.Conv2d(inputs, outputs, size, stride=size, bias=False), nn.BatchNorm2d(outputs), nn.ReLU()]
        self.stem = nn.Sequential(*patches(3, one // 2, 4), *patches(one // 2, one, 2))
        self.cells = nn.Sequential(stage(one, two), ResidualBlock(two), stage(two, three), ResidualBlock(three))
        self.last = stage(three, config.width)
        self.out = nn.Linear(config.width, config.width)
        self.position = nn.Parameter(torch.randn(config.image_tokens, config.width) * 0.3)
        self.train()

    def train(self, mode: bool = True) -> "ImageEncoder":
        """Keeps the statistics of the norms as they are."""
        return super().train(False)

    def grids(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """Features of cells of 32 and of 64 pixels of images [batch, 3, height, width] in 0..1: [batch, channels, rows, columns]."""
        cells = self.cells(self.stem((image - 0.45) * 4))
        return cells, self.last(cells)

    @torch.no_grad()
    def features(self, pixels: numpy.ndarray) -> Tensor:
        """What a policy keeps of an image [height, width, 3] of bytes: [tokens, width]. One at a time, so that no image depends on others."""
        image = torch.from_numpy(pixels).permute(2, 0, 1)[None].float() / 255
        return self.grids(image.contiguous(memory_format=torch.channels_last))[1][0].flatten(1).T.contiguous()

    def forward(self, features: Tensor) -> Tensor:
        """Features [batch, tokens, width] as tokens of the policy."""
        return self.out(features) + self.position


def rotate(x: Tensor, cosine: Tensor, sine: Tensor) -> Tensor:
    """Rotary positions of [..., time, size]."""
    left, right = x.chunk(2, -1)
    return torch.cat([left * cosine - right * sine, left * sine + right * cosine], -1)


def angles(positions: Tensor, size: int) -> tuple[Tensor, Tensor]:
    """Cosine and sine [..., 1, time, size / 2] of positions [..., time]: the same for all heads."""
    rates = 10_000.0 ** (-torch.arange(size // 2, dtype=torch.float32) / (size // 2))
    turned = positions[..., None, :, None].float() * rates
    return turned.cos(), turned.sin()


def attention(query: Tensor, key: Tensor, value: Tensor, visible: Tensor | None = None) -> Tensor:
    """What queries [..., some, size] find. Written out: PyTorch's fused kernel takes twice the time of a gradient on a CPU."""
    scores = (query * query.shape[-1] ** -0.5) @ key.transpose(-1, -2)
    if visible is not None:
        scores = scores.masked_fill(~visible, -1e4)
    return scores.softmax(-1).to(value.dtype) @ value


class Sequences:
    """Whole sequences, one behind the other. A prompt is read in both directions, the answer after it from left to right.

    Each looks at itself alone: nothing is padded, and a sequence's scores fit into the cache of a CPU, so a gradient takes half the time of one
    over a padded batch.
    """

    def __init__(self, prompts: list[int], lengths: list[int]) -> None:
        self.prompts, self.lengths = prompts, lengths
        self.starts = torch.tensor([0, *itertools.accumulate(lengths[:-1])])
        self.positions = torch.cat([torch.arange(length) for length in lengths])

    def before(self, normed: Tensor) -> Tensor:
        """The token before each; zeros before the first of a sequence."""
        return functional.pad(normed, (0, 0, 1, 0))[:-1].index_fill(0, self.starts, 0.0)

    def attend(self, query: Tensor, key: Tensor, value: Tensor) -> Tensor:
        found = []
        parts = (whole.split(self.lengths, 1) for whole in (query, key, value))
        for prompt, length, query, key, value in zip(self.prompts, self.lengths, *parts):
            found.append(attention(query[:, :prompt], key[:, :prompt], value[:, :prompt]))
            if length > prompt:
                found.append(attention(query[:, prompt:], key, value, rising(prompt + 1, length - prompt, length)))
        return torch.cat(found, 1)


def rising(first: int, rows: int, columns: int) -> Tensor:
    """Row 0 sees the `first` columns, each further row one more: [rows, columns]."""
    return torch.arange(columns) < first + torch.arange(rows)[:, None]


class Memory:
    """What a block keeps of sequences that go on token by token: keys and values [batch, heads, room, size], and the last normed input.

    Sequences end at the same column; `start` is where each begins.
    """

    def __init__(self, read: list[tuple[Tensor, Tensor, Tensor]], further: int) -> None:
        """Of keys, values [heads, time, size] and normed inputs [time, width] of each sequence, with room for further tokens."""
        self.length = max(key.shape[1] for key, _, _ in read)
        self.start = torch.tensor([self.length - key.shape[1] for key, _, _ in read])
        heads, _, size = read[0][0].shape
        shape = (len(read), heads, self.length + further, size)
        self.key, self.value = torch.zeros(shape), torch.zeros(shape)
        for row, (key, value, _) in enumerate(read):
            self.key[row, :, self.start[row] : self.length] = key
            self.value[row, :, self.start[row] : self.length] = value
        self.last = torch.stack([normed[-1:] for _, _, normed in read])

    def before(self, normed: Tensor) -> Tensor:
        before, self.last = self.last, normed
        return before

    def attend(self, query: Tensor, key: Tensor, value: Tensor) -> Tensor:
        end = self.length + 1
        self.key[:, :, self.length : end], self.value[:, :, self.length : end] = key, value
        self.length = end
        visible = torch.arange(end) >= self.start[:, None, None, None]
        return attention(query, self.key[:, :, :end], self.value[:, :, :end], visible)

    def keep(self, rows: Tensor) -> None:
        """Forgets all other sequences."""
        self.key, self.value, self.last, self.start = self.key[rows], self.value[rows], self.last[rows], self.start[rows]


class Block(nn.Module):
    """Attention and a feed-forward layer with squared ReLU."""

    def __init__(self, config: Config) -> None:
        super().__init__()
        width, self.heads = config.width, config.heads
        self.norm_attention, self.norm_mlp = Norm(width), Norm(width)
        self.back = nn.Parameter(torch.full((2, width), 0.5))  # share of the token before in keys and values
        self.query, self.key = nn.Linear(width, width, bias=False), nn.Linear(width, width, bias=False)
        self.value, self.out = nn.Linear(width, width, bias=False), nn.Linear(width, width, bias=False)
        self.up, self.down = nn.Linear(width, 4 * width, bias=False), nn.Linear(4 * width, width, bias=False)
        for linear in (self.query, self.key, self.value, self.up):
            nn.init.normal_(linear.weight, std=width**-0.5)
        nn.init.normal_(self.out.weight, std=(2 * config.layers * width) ** -0.5)
        nn.init.normal_(self.down.weight, std=(2 * config.layers * 4 * width) ** -0.5)

    def forward(self, x: Tensor, turn: tuple[Tensor, Tensor], context: Sequences | Memory) -> tuple[Tensor, Tensor, Tensor]:
        """The output, the normed input, and how the token before differs from it, of tokens [..., time, width]."""
        split = lambda y: y.unflatten(-1, (self.heads, -1)).transpose(-3, -2)
        normed = self.norm_attention(x)
        step = context.before(normed) - normed
        query = rotate(split(self.query(normed)), *turn)
        key = rotate(split(self.key(normed + step * self.back[0])), *turn)
        value = split(self.value(normed + step * self.back[1]))
        seen = context.attend(query, key, value)
        x = x + self.out(seen.transpose(-3, -2).flatten(-2))
        return x + self.down(functional.relu(self.up(self.norm_mlp(x))).square()), normed, step


class Policy(nn.Module):
    """The whole model."""

    def __init__(self, config: Config) -> None:
        super().__init__()
        width = config.width
        self.config = config
        self.embedding = nn.Parameter(torch.randn(config.vocabulary, width) * width**-0.5)
        self.encoder = ImageEncoder(config)
        self.blocks = nn.ModuleList([Block(config) for _ in range(config.layers)])
        self.norm = Norm(width)
        self.pointer_query, self.pointer_key = nn.Linear(width, width, bias=False), nn.Linear(width, width, bias=False)
        self.pointer_back = nn.Parameter(torch.full((width,), 0.5))
        self.gate = nn.Linear(width, 1)
        for linear in (self.pointer_query, self.pointer_key):
            nn.init.normal_(linear.weight, std=width**-0.5)
        nn.init.zeros_(self.gate.weight)
        nn.init.zeros_(self.gate.bias)

    def embed(self, tokens: Tensor, features: Tensor | None) -> Tensor:
        """Embeddings of tokens. `features` [some, tokens, width] are those of the images, in the order of their tokens."""
        x = self.embedding[tokens] * self.config.width**0.5
        places = tokens == IMAGE
        x = x * ~places[..., None]
        if features is not None and not self.config.blind:
            x = x.masked_scatter(places[..., None], self.encoder(features).to(x.dtype))
        return x

    def read(self, tokens: Tensor, features: Tensor | None, positions: Tensor, contexts: Sequence[Sequences | Memory]) -> tuple[Tensor, Tensor]:
        """Hidden states and keys of the pointer. Each block has its context."""
        x, turn = self.embed(tokens, features), angles(positions, self.config.width // self.config.heads)
        normed = step = x
        for block, context in zip(self.blocks, contexts, strict=True):
            x, normed, step = block(x, turn, context)
        return self.norm(x), self.pointer_key(normed + step * self.pointer_back)

    def mixture(self, hidden: Tensor, keys: Tensor, visible: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Log-softmax over the vocabulary, where the pointer looks, and how much it counts, at some positions [..., some]."""
        scores = self.pointer_query(hidden) @ keys.transpose(-1, -2) * self.config.width**-0.5
        where = scores.float().masked_fill(~visible, -1e9).softmax(-1)
        return (hidden @ self.embedding.T).float().log_softmax(-1), where, torch.sigmoid(self.gate(hidden).float())

    def logprobs(self, tokens: Tensor, features: Tensor | None, sequences: Sequences) -> Tensor:
        """Log-probabilities of the answers' tokens, one answer behind the other. Each answer ends with the end token."""
        hidden, keys = self.read(tokens, features, sequences.positions, [sequences] * len(self.blocks))
        found = []
        parts = (whole.split(sequences.lengths) for whole in (tokens, hidden, keys))
        for prompt, length, own, states, pointed in zip(sequences.prompts, sequences.lengths, *parts):
            targets = own[prompt:, None]
            visible = rising(prompt, length - prompt, length) & (own != IMAGE)
            written, where, share = self.mixture(states[prompt - 1 : -1], pointed, visible)
            copied = (where * (own == targets)).sum(-1)
            likely = written.gather(-1, targets)[:, 0].exp()
            found.append(torch.log(share[:, 0] * copied + (1 - share[:, 0]) * likely + EPSILON))
        return torch.cat(found).clamp(max=0)


def multiplies_16_bits() -> bool:
    """Whether the processor multiplies in bfloat16. One that does not takes ten times as long for such products as for those in 32 bits."""
    known = torch.cpu.get_capabilities()
    return any(known.get(name, False) for name in ("avx512_bf16", "amx_bf16", "bf16"))


def products_in_16_bits(enabled: bool) -> torch.autocast:
    """Products of matrices in bfloat16, weights and all else in 32 bits. Without PyTorch's cache of casts: threads share it, and clear it for one another."""
    return torch.autocast("cpu", torch.bfloat16, enabled=enabled, cache_enabled=False)


def build(config: Config, seed: int) -> Policy:
    """A model; equal seeds give equal ones.

    An operation takes one thread: whole batches are shared between threads instead, which is faster on few cores, and no sum depends on them.
    """
    torch.set_num_threads(1)
    torch.use_deterministic_algorithms(True)
    torch.utils.deterministic.fill_uninitialized_memory = False  # nothing reads it
    torch.manual_seed(seed)
    return Policy(config).to(memory_format=torch.channels_last)


def count(model: nn.Module) -> int:
    """How many parameters a model has."""
    return sum(parameter.numel() for parameter in model.parameters())
