"""A transformer that reads text and one image and writes text, small enough to train on a CPU.

Three things let it copy names that it never saw (tests/training/model.py measured them). The prompt is read in both directions, so a name
knows what is said of it later. Keys and values also look one token back. The output is a mixture of the vocabulary and of a pointer into
the context (See et al. 2017, pointer-generator networks). The image becomes a grid of tokens in the prompt.
"""

import dataclasses

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
    """Rotary positions of [batch, heads, time, size]."""
    left, right = x.chunk(2, -1)
    return torch.cat([left * cosine - right * sine, left * sine + right * cosine], -1)


def angles(positions: Tensor, size: int) -> tuple[Tensor, Tensor]:
    """Cosine and sine [batch, 1, time, size / 2] of positions [batch, time]."""
    rates = 10_000.0 ** (-torch.arange(size // 2, dtype=torch.float32) / (size // 2))
    turned = positions[:, None, :, None].float() * rates
    return turned.cos(), turned.sin()


class Memory:
    """What a block keeps of the tokens so far: keys and values [batch, heads, room, size], and the last normed input."""

    def __init__(self, config: Config, batch: int, room: int) -> None:
        shape = (batch, config.heads, room, config.width // config.heads)
        self.key, self.value, self.length = torch.zeros(shape), torch.zeros(shape), 0
        self.last = torch.zeros(batch, 1, config.width)

    def extend(self, key: Tensor, value: Tensor, last: Tensor) -> tuple[Tensor, Tensor]:
        """Takes in further tokens; gives the keys and values of all."""
        end = self.length + key.shape[2]
        self.key[:, :, self.length : end], self.value[:, :, self.length : end] = key, value
        self.length, self.last = end, last
        return self.key[:, :, :end], self.value[:, :, :end]

    def keep(self, rows: Tensor) -> None:
        """Forgets all other sequences."""
        self.key, self.value, self.last = self.key[rows], self.value[rows], self.last[rows]


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

    def forward(self, x: Tensor, visible: Tensor, turn: tuple[Tensor, Tensor], memory: Memory | None = None) -> tuple[Tensor, Tensor]:
        """The output and the normed input. With a memory these are further tokens of its sequences."""
        batch, time, width = x.shape
        split = lambda y: y.view(batch, time, self.heads, width // self.heads).transpose(1, 2)
        normed = self.norm_attention(x)
        first = torch.zeros_like(normed[:, :1]) if memory is None else memory.last
        before = torch.cat([first, normed[:, :-1]], 1)
        step = before - normed
        query = rotate(split(self.query(normed)), *turn)
        key = rotate(split(self.key(normed + step * self.back[0])), *turn)
        value = split(self.value(normed + step * self.back[1]))
        if memory is not None:
            key, value = memory.extend(key, value, normed[:, -1:])
        # Written out: with the fused kernel of PyTorch 2.11 an update takes a fifth more CPU time.
        scores = (query * query.shape[-1] ** -0.5) @ key.transpose(-1, -2)
        seen = scores.masked_fill(~visible[:, None], -1e4).softmax(-1).to(value.dtype) @ value
        x = x + self.out(seen.transpose(1, 2).reshape(batch, time, width))
        return x + self.down(functional.relu(self.up(self.norm_mlp(x))).square()), normed


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
        """Embeddings of [batch, time]. `features` [some, tokens, width] stand in the order of the rows that have image tokens."""
        x = self.embedding[tokens] * self.config.width**0.5
        places = tokens == IMAGE
        x = x * ~places[..., None]
        if features is not None and not self.config.blind:
            x = x.masked_scatter(places[..., None], self.encoder(features).to(x.dtype))
        return x

    def read(self, tokens: Tensor, features: Tensor | None, prompts: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Hidden states, keys of the pointer, and what each position sees, of sequences padded at the end with prompts of these lengths."""
        time = tokens.shape[1]
        columns = torch.arange(time)
        visible = (columns[None, :] <= columns[:, None])[None] | (columns[None, None, :] < prompts[:, None, None])
        x, turn = self.embed(tokens, features), angles(columns[None], self.config.width // self.config.heads)
        normed = x
        for block in self.blocks:
            x, normed = block(x, visible, turn)
        before = functional.pad(normed, (0, 0, 1, 0))[:, :-1]
        return self.norm(x), self.pointer_key(normed + (before - normed) * self.pointer_back), visible

    def mixture(self, hidden: Tensor, keys: Tensor, visible: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Log-softmax over the vocabulary, where the pointer looks, and how much it counts, at some positions [batch, some]."""
        scores = self.pointer_query(hidden) @ keys.transpose(1, 2) * self.config.width**-0.5
        where = scores.float().masked_fill(~visible, -1e9).softmax(-1)
        return (hidden @ self.embedding.T).float().log_softmax(-1), where, torch.sigmoid(self.gate(hidden).float())

    def logprobs(self, tokens: Tensor, features: Tensor | None, prompts: Tensor, ends: Tensor) -> tuple[Tensor, Tensor]:
        """Log-probabilities [batch, longest answer] of the answer tokens, and which of these places are real.

        Row `b` has its answer at `prompts[b]` to `ends[b] - 1`, the last one being the end token.
        """
        hidden, keys, visible = self.read(tokens, features, prompts)
        longest = int((ends - prompts).max())
        at = prompts[:, None] - 1 + torch.arange(longest)[None]
        real = at < ends[:, None] - 1
        at = at.clamp(max=tokens.shape[1] - 2)
        chosen = hidden.gather(1, at[..., None].expand(-1, -1, hidden.shape[-1]))
        targets = tokens.gather(1, at + 1)
        pointed = visible.gather(1, at[..., None].expand(-1, -1, tokens.shape[1])) & (tokens != IMAGE)[:, None]
        written, where, share = self.mixture(chosen, keys, pointed)
        copied = (where * (tokens[:, None] == targets[..., None])).sum(-1)
        likely = written.gather(-1, targets[..., None])[..., 0].exp()
        return torch.log(share[..., 0] * copied + (1 - share[..., 0]) * likely + EPSILON).clamp(max=0), real


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
