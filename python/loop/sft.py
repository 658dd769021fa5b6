"""Supervised fine-tuning from scratch, loss on the answers only.

    python sft.py --set set --out seeing --updates 600
    python sft.py --set set --out blind --updates 600 --blind

Equal arguments give equal weights on one machine. A training that was broken off goes on where it stopped. `log.jsonl` gets a line for each
report.
"""

import argparse
import collections.abc
import dataclasses
import hashlib
import itertools
import json
import math
import pathlib
import random
import time

import torch
from torch import Tensor

import checkpoint
import data
import model
from tokenizer import Tokenizer

REPORT = 20  # updates between two lines of the log


@dataclasses.dataclass(frozen=True)
class Options:
    """What a training is a function of, besides the examples."""

    updates: int
    comparisons: float = 0.0  # share of the tokens of a batch that teaches to see and to compare
    seed: int = 0
    rate: float = 1e-3
    warmup: float = 0.05  # share of the updates
    decay: float = 0.3  # share of the updates in which the rate falls to a twentieth
    tokens: int = 6144  # most tokens in a batch
    bf16: bool = True  # products of matrices in 16 bits, weights in 32
    encoder: str = ""  # digest of the image encoder to begin with; a fresh one if empty


def rate(options: Options, update: int) -> float:
    """The learning rate of an update: it rises, is held, and falls."""
    rising = update / max(1, options.warmup * options.updates)
    left = (options.updates - update) / max(1, options.decay * options.updates)
    return options.rate * min(1.0, rising, 0.05 + 0.95 * left)


def optimizer(policy: model.Policy, options: Options) -> torch.optim.AdamW:
    matrices = [parameter for parameter in policy.parameters() if parameter.ndim > 1]
    vectors = [parameter for parameter in policy.parameters() if parameter.ndim <= 1]
    groups = [{"params": matrices, "weight_decay": 0.01}, {"params": vectors, "weight_decay": 0.0}]
    return torch.optim.AdamW(groups, lr=options.rate, betas=(0.9, 0.98))


def loss(policy: model.Policy, batch: data.Batch) -> Tensor:
    """The mean cross-entropy of the answers' tokens."""
    return -policy.logprobs(batch.tokens, batch.features, batch.sequences).mean()


def renamed(one: data.Example, rng: random.Random) -> data.Example:
    """Mostly with other names: every example has others in every epoch."""
    return data.renamed(one, rng) if rng.random() < 0.7 else one


def epochs(
    examples: list[data.Example], draw: collections.abc.Callable[[data.Example, random.Random], data.Example], tokenizer: Tokenizer,
    config: model.Config, seed: str, tokens: int,
) -> collections.abc.Iterator[list[data.Row]]:
    """Batches of at most `tokens` tokens without end, each epoch with examples drawn anew."""
    for number in itertools.count():
        rng = random.Random(f"{seed} {number}")
        rows = [data.row(tokenizer, config, draw(one, rng)) for one in examples]
        rng.shuffle(rows)
        yield from ([rows[index] for index in some] for some in data.batches(rows, tokens))


def planned(
    examples: list[data.Example], tokenizer: Tokenizer, config: model.Config, options: Options
) -> collections.abc.Iterator[list[data.Row]]:
    """The batches of a training: whole decisions, and with them comparisons from the start to the end."""
    short, share = data.Comparisons(examples), int(options.tokens * options.comparisons)
    decisions = epochs(examples, renamed, tokenizer, config, f"{options.seed}/decisions", options.tokens - share)
    if not share or not short.examples:
        return itertools.islice(decisions, options.updates)
    comparisons = epochs(short.examples, short.draw, tokenizer, config, f"{options.seed}/comparisons", share)
    return itertools.islice(map(list.__add__, decisions, comparisons), options.updates)


def train(
    examples: list[data.Example], config: model.Config, tokenizer: Tokenizer, options: Options, out: pathlib.Path, minutes: float | None = None,
    encoder: dict[str, Tensor] | None = None,
) -> model.Policy:
    """Trains to the last update or until the time is spent; keeps a checkpoint. `encoder` are weights of `pretrain.py`."""
    policy = model.build(config, options.seed).train()
    if encoder:
        policy.encoder.load_state_dict(encoder)
    steps, pictures = optimizer(policy, options), data.Pictures(policy)
    done = 0
    if kept := checkpoint.training(out):
        if kept["options"] != dataclasses.asdict(options):
            raise SystemExit(f"{out} holds a training with other options; name another folder or remove it")
        policy.load_state_dict(kept["weights"])
        steps.load_state_dict(kept["optimizer"])
        done = kept["updates"]
    save = lambda: checkpoint.save(out, policy, tokenizer, {"optimizer": steps.state_dict(), "updates": done, "options": dataclasses.asdict(options)})
    out.mkdir(parents=True, exist_ok=True)
    start = time.monotonic()
    recent: list[tuple[float, int, float]] = []
    with (out / "log.jsonl").open("a", encoding="utf-8") as log:
        for rows in itertools.islice(planned(examples, tokenizer, config, options), done, None):
            began = time.monotonic()
            for group in steps.param_groups:
                group["lr"] = rate(options, done)
            batch = data.batch(rows, pictures)
            with model.products_in_16_bits(options.bf16):
                value = loss(policy, batch)
            steps.zero_grad(set_to_none=True)
            value.backward()
            torch.nn.utils.clip_grad_norm_(policy.parameters(), 1.0)
            steps.step()
            done += 1
            recent.append((float(value.detach()), len(batch.tokens), time.monotonic() - began))
            spent = minutes is not None and time.monotonic() - start > 60 * minutes
            if done % REPORT == 0 or done == options.updates or spent:
                losses, tokens, seconds = zip(*recent)
                line = {
                    "update": done, "loss": sum(losses) / len(losses), "rate": rate(options, done - 1), "tokens": sum(tokens),
                    "seconds_an_update": sum(seconds) / len(seconds), "cpu_seconds": time.process_time(), "minutes": (time.monotonic() - start) / 60,
                }
                if not math.isfinite(line["loss"]):
                    raise SystemExit(f"the loss of update {done} is {line['loss']}; lower --rate")
                log.write(json.dumps(line) + "\n")
                log.flush()
                print(json.dumps(line), flush=True)
                recent.clear()
            if done % (2 * REPORT) == 0:
                save()
            if spent:
                break
    save()
    return policy


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--set", required=True, type=pathlib.Path, nargs="+", help="folders of `reel export sft --format ms-swift`; one named twice counts twice")
    parser.add_argument("--out", required=True, type=pathlib.Path, help="folder of the checkpoint")
    parser.add_argument("--updates", type=int, default=600, help="with 0 the checkpoint is the untrained policy")
    parser.add_argument("--encoder", type=pathlib.Path, help="image encoder of pretrain.py to begin with")
    parser.add_argument("--comparisons", type=float, default=0.0, help="share of each batch, below 1, on images and whether they show what is wanted")
    parser.add_argument("--minutes", type=float, help="stop after this time; the same command goes on")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rate", type=float, default=1e-3)
    parser.add_argument("--width", type=int, default=192)
    parser.add_argument("--layers", type=int, default=4)
    parser.add_argument("--tokens", type=int, default=6144, help="most tokens in a batch")
    parser.add_argument("--fp32", action="store_true", help="products of matrices in 32 bits, also where the processor has those in 16")
    parser.add_argument("--blind", action="store_true", help="the text-only twin: zeros in place of the image tokens")
    chosen = parser.parse_args()
    if not 0 <= chosen.comparisons < 1:
        parser.error(f"--comparisons {chosen.comparisons} is no share below 1")

    everything = [one for folder in chosen.set for one in data.read(folder)]
    examples = [one for one in everything if data.is_noted(one) and not data.contradicts_named_room(one)]
    tokenizer = Tokenizer.of([one.prompt for one in examples], [one.answer for one in examples])
    config = model.Config(len(tokenizer), width=chosen.width, layers=chosen.layers, blind=chosen.blind)
    encoder = torch.load(chosen.encoder, weights_only=True) if chosen.encoder else None
    name = hashlib.blake2b(chosen.encoder.read_bytes(), digest_size=16).hexdigest() if chosen.encoder else ""
    options = Options(chosen.updates, chosen.comparisons, chosen.seed, chosen.rate, tokens=chosen.tokens, bf16=model.multiplies_16_bits() and not chosen.fp32, encoder=name)
    rows = [data.row(tokenizer, config, one) for one in examples]
    mean = lambda counts: round(sum(counts) / len(rows), 1)
    prompts, answers = mean([len(one.prompt) for one in rows]), mean([len(one.answer) for one in rows])
    print(f"{len(rows)} examples of {len(everything)}; tokens: prompt {prompts}, answer {answers}, longest {max(map(len, rows))}; vocabulary {len(tokenizer)}", flush=True)
    policy = train(examples, config, tokenizer, options, chosen.out, chosen.minutes, encoder)
    print(f"{model.count(policy)} parameters, weights {checkpoint.digest(policy)} in {chosen.out}")


if __name__ == "__main__":
    main()
