"""Reinforcement learning with GSPO (paper, GSPO Objective) on rollouts that Reel plays, records, verifies and scores.

    python gspo.py seeing --tasks loop-data/train --out learned --steps 40
    python gspo.py --replay-step 7 --out learned         # a step again, from its weights and its traces: the same weights

A step plays groups of rollouts with the weights of that moment (`reel bench`), exports them as rows with their advantages (`reel export rl`,
which replays every episode and refuses one that is not exact), and updates the weights a few times, each time over groups of its own. What an
update scored stands in the traces afterwards: policies `new` (the weights before its update) and `ref` (the policy that training began with).
`reel dataset gspo` computes ratio, clip shares, KL and loss from the traces alone, and a step that differs from them is not kept. Rollouts are
drawn at temperature 1, at which their log-probabilities are. The KL is estimated by `k3` and differentiated as it stands, as trainers of GRPO do.

Log-probabilities are scored in 32 bits, as in the server. Gradients go through products in 16 bits, each token weighted by the derivative of
the objective at the scored values. `steps.jsonl` has a line for each step, `step_N/` the weights after it. What was broken off goes on.
"""

import argparse
import collections
import concurrent.futures
import dataclasses
import json
import math
import pathlib
import random
import shutil
import time
import typing

import torch

import checkpoint
import data
import model
import play
import rollouts
import server
from rollouts import Decision
from score import score
from tokenizer import Tokenizer

CLOSE = 1e-5  # how near the metrics of the traces must be


@dataclasses.dataclass(frozen=True)
class Options:
    """What a training is a function of, besides the first policy and the tasks."""

    seed: int = 0
    groups: int = 6  # tasks a step (paper: unique prompts a step)
    size: int = 8  # rollouts of a task (paper)
    updates: int = 3  # a step, each over groups of its own
    rate: float = 1e-4
    epsilon: float = 0.01  # below 1; the paper names none
    epsilon_high: float = 0.01
    beta: float = 0.04  # paper
    advantage: str = "paper"
    returns: str = "paper"
    preset: str = ""  # rewards; the recorded ones if empty
    max_tokens: int = 100  # the longest answer of the training set has 74
    tokens: int = 6144  # most tokens in a batch
    bf16: bool = True  # products of matrices in gradients in 16 bits (default: where the processor has them)

    def objective(self) -> dict[str, typing.Any]:
        """What `reel train log` reads: the objective in the names of `reel dataset gspo`."""
        return {
            "old": "old", "new": "new", "reference": "ref", "epsilon": self.epsilon, "epsilon_high": self.epsilon_high, "beta": self.beta,
            "returns": self.returns, "advantage": self.advantage, "group_size": self.size, "preset": self.preset or None,
        }


@dataclasses.dataclass(frozen=True)
class Metrics:
    """The objective over some rollouts, as `reel dataset gspo` defines it."""

    loss: float
    ratio: float  # mean
    low: float  # share of the rollouts clipped below
    high: float
    kl: float


def objective(decisions: list[Decision], new: list[list[float]], ref: list[list[float]], options: Options) -> tuple[list[list[float]], Metrics]:
    """The derivative of the loss by the log-probability of each token, and the metrics.

    A sequence is a rollout with all its decisions: `s = exp(mean(new - old))`; the loss is
    `-mean(min(s A, clip(s) A)) + beta * mean(KL)` with `KL = mean(exp(ref - new) - 1 - (ref - new))` over its tokens.
    """
    sequences: dict[str, list[int]] = collections.defaultdict(list)
    for index, one in enumerate(decisions):
        sequences[one.episode].append(index)
    weights: list[list[float]] = [[] for _ in decisions]
    surrogates, ratios, kls, low, high = [], [], [], 0, 0
    for members in sequences.values():
        length = sum(len(new[index]) for index in members)
        ratio = math.exp(math.fsum(one - other for index in members for one, other in zip(new[index], decisions[index].old)) / length)
        advantage = decisions[members[0]].advantage
        below, above = advantage < 0 and ratio < 1 - options.epsilon, advantage > 0 and ratio > 1 + options.epsilon_high
        held = min(max(ratio, 1 - options.epsilon), 1 + options.epsilon_high)
        surrogates.append(min(ratio * advantage, held * advantage))
        ratios.append(ratio)
        low, high = low + below, high + above
        pull = 0.0 if below or above else -ratio * advantage
        kl = 0.0
        for index in members:
            for one, other in zip(new[index], ref[index]):
                gap = math.exp(other - one)
                kl += gap - 1 - (other - one)
                weights[index].append((pull + options.beta * (1 - gap)) / (length * len(sequences)))
        kls.append(kl / length)
    mean = lambda values: math.fsum(values) / len(sequences)
    return weights, Metrics(-mean(surrogates) + options.beta * mean(kls), mean(ratios), low / len(sequences), high / len(sequences), mean(kls))


def sampling_difference(decisions: list[Decision], scores: list[list[float]]) -> float:
    """The largest difference of a rollout's mean log-probability between the server that drew it and these scores of the same weights."""
    gaps: dict[str, list[float]] = collections.defaultdict(list)
    for one, values in zip(decisions, scores):
        gaps[one.episode] += [new - old for new, old in zip(values, one.old)]
    return max(abs(math.fsum(values) / len(values)) for values in gaps.values())


class Learner:
    """The weights and their optimizer."""

    def __init__(self, policy: model.Policy, options: Options, threads: int = 1) -> None:
        self.policy, self.options, self.threads = policy, options, threads
        self.steps = torch.optim.AdamW(policy.parameters(), lr=options.rate, betas=(0.9, 0.98), weight_decay=0.0)

    def update(self, decisions: list[Decision], weights: list[list[float]], pictures: data.Pictures) -> float:
        """One step of the optimizer; gives the norm of the gradient. Batches are added in their order, whatever the number of threads."""
        parameters, rows = list(self.policy.parameters()), [one.row for one in decisions]

        def gradient(some: list[int]) -> tuple[torch.Tensor | None, ...]:
            batch = data.batch([rows[index] for index in some], pictures)
            with model.products_in_16_bits(self.options.bf16):
                found = self.policy.logprobs(batch.tokens, batch.features, batch.sequences)
            factors = torch.tensor([weight for index in some for weight in weights[index]])
            return torch.autograd.grad((found * factors).sum(), parameters, allow_unused=True)

        self.steps.zero_grad(set_to_none=True)
        with concurrent.futures.ThreadPoolExecutor(self.threads) as pool:
            for found in pool.map(gradient, data.batches(rows, self.options.tokens)):
                for parameter, part in zip(parameters, found):
                    if part is not None:
                        parameter.grad = part if parameter.grad is None else parameter.grad + part
        norm = torch.nn.utils.clip_grad_norm_(self.policy.parameters(), 1.0)
        self.steps.step()
        return float(norm)

    def learn(self, decisions: list[Decision], ref: model.Policy, pictures: data.Pictures) -> tuple[list[dict[str, typing.Any]], dict[str, list[list[float]]]]:
        """The updates of a step: a line for each, and by policy the log-probabilities of all decisions."""
        groups = sorted({one.group for one in decisions})
        random.Random(f"{self.options.seed}/order").shuffle(groups)
        share = -(-len(groups) // self.options.updates)
        lines, scores = [], {"new": [[] for _ in decisions], "ref": [[] for _ in decisions]}
        for start in range(0, len(groups), share):
            chosen = set(groups[start : start + share])
            places = [place for place, one in enumerate(decisions) if one.group in chosen]
            some = [decisions[place] for place in places]
            new, base = (score(policy, some, pictures, self.options.tokens, self.threads) for policy in (self.policy, ref))
            weights, metrics = objective(some, new, base, self.options)
            for place, one, other in zip(places, new, base):
                scores["new"][place], scores["ref"][place] = one, other
            norm = self.update(some, weights, pictures)
            lines.append({"groups": sorted(chosen), "episodes": len({one.episode for one in some}), **dataclasses.asdict(metrics), "gradient_norm": norm})
        return lines, scores


def save(folder: pathlib.Path, learner: Learner, tokenizer: Tokenizer) -> None:
    checkpoint.save(folder, learner.policy, tokenizer, {"optimizer": learner.steps.state_dict()})


def resume(folder: pathlib.Path, options: Options, threads: int) -> tuple[Learner, Tokenizer]:
    """The learner that `save` wrote."""
    policy, tokenizer = checkpoint.load(folder)
    learner = Learner(policy, options, threads)
    kept = checkpoint.training(folder)
    if kept:
        learner.steps.load_state_dict(kept["optimizer"])
    return learner, tokenizer


def compare(reel: str, store: pathlib.Path, lines: list[dict[str, typing.Any]], options: Options) -> float:
    """The largest difference between what the step used and what `reel dataset gspo` computes from the traces."""
    found = rollouts.figures(rollouts.gspo(reel, store, options.objective()))
    episodes = sum(line["episodes"] for line in lines)
    used = {name: math.fsum(line[name] * line["episodes"] for line in lines) / episodes for name in found}
    return max(abs(found[name] - used[name]) for name in found)


def step(number: int, learner: Learner, tokenizer: Tokenizer, ref: model.Policy, tasks: list[pathlib.Path], chosen: argparse.Namespace) -> dict[str, typing.Any]:
    """Rollouts, rows, updates, and the check against the traces."""
    options, before = learner.options, checkpoint.digest(learner.policy)
    here = chosen.out / "rollouts" / f"step_{number:03}"
    drawn = rollouts.tasks_of_step(tasks, number, options.groups, options.seed)
    began = time.monotonic()
    with server.Server(learner.policy, tokenizer, play.NAME, 0, chosen.batch, chosen.threads) as served:
        served.begin()
        what = play.Play(
            chosen.reel, rollouts.gather(drawn, here / "tasks"), here / "traces", 1.0, options.seed + 1000 * number, options.size,
            options.max_tokens, chosen.jobs, True, ("--run", f"{chosen.out.name}-step-{number}"),
        )
        spent = play.bench(served, what, quiet=True)
        served.shutdown()
    rows = rollouts.export(chosen.reel, here, options)
    exported = time.monotonic()
    decisions = rollouts.read(here / "rows", tokenizer, learner.policy.config)
    pictures = data.Pictures(learner.policy)
    lines, scores = learner.learn(decisions, ref, pictures)
    learned = time.monotonic()
    difference = sampling_difference([one for one in decisions if one.group in lines[0]["groups"]], [
        scores["new"][place] for place, one in enumerate(decisions) if one.group in lines[0]["groups"]
    ])
    rollouts.add_logprobs(chosen.reel, here, decisions, scores)
    apart = compare(chosen.reel, here / "store", lines, options)
    shutil.rmtree(here / "rows" / "images", ignore_errors=True)
    episodes = {one.episode: one for one in decisions}
    return {
        "step": number, "weights_before": before, "weights": checkpoint.digest(learner.policy), "store": str((here / "store").relative_to(chosen.out)), "tasks": [f"{path.parent.name}/{path.stem}" for path in drawn],
        "episodes": len(episodes), "decisions": len(decisions), "tokens": sum(len(one.row.answer) for one in decisions), "rows": rows,
        "success": sum(one.success for one in episodes.values()) / len(episodes), "return": sum(one.returned for one in episodes.values()) / len(episodes),
        "updates": lines, "sampled_to_scored": difference, "log_to_traces": apart,
        "seconds": {"play": dataclasses.asdict(spent), "export": exported - began - spent.wall, "learn": learned - exported, "check": time.monotonic() - learned},
    }


def train(chosen: argparse.Namespace, options: Options) -> None:
    """All steps that are not done."""
    chosen.out.mkdir(parents=True, exist_ok=True)
    about = chosen.out / "training.json"
    known = {"start": str(chosen.checkpoint), "tasks": str(chosen.tasks), "options": dataclasses.asdict(options), "objective": options.objective()}
    if about.exists() and json.loads(about.read_text()) != known:
        raise SystemExit(f"{chosen.out} holds a training with other options; name another folder or remove it")
    about.write_text(json.dumps(known, indent=1))
    if not (chosen.out / "step_000").exists():
        first, tokenizer = checkpoint.load(chosen.checkpoint)
        save(chosen.out / "step_000", Learner(first, options), tokenizer)
    log = chosen.out / "steps.jsonl"
    done = len(log.read_text().splitlines()) if log.exists() else 0
    learner, tokenizer = resume(chosen.out / f"step_{done:03}", options, chosen.threads)
    ref, _ = checkpoint.load(chosen.out / "step_000")
    tasks = rollouts.all_tasks(chosen.tasks)
    start = time.monotonic()
    while done < chosen.steps and (chosen.minutes is None or time.monotonic() - start < 60 * chosen.minutes):
        line = step(done + 1, learner, tokenizer, ref, tasks, chosen)
        if line["log_to_traces"] > CLOSE or line["sampled_to_scored"] > CLOSE:
            raise SystemExit(
                f"step {done + 1} is not kept: the traces do not give what the update used (log to traces {line['log_to_traces']}, sampled to scored {line['sampled_to_scored']})"
            )
        done += 1
        save(chosen.out / f"step_{done:03}", learner, tokenizer)
        with log.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
        seconds = {name: round(value if isinstance(value, float) else value["wall"], 1) for name, value in line["seconds"].items()}
        kl, clipped = (sum(update[name] for update in line["updates"]) / len(line["updates"]) for name in ("kl", "low"))
        print(
            f"step {done}: success {line['success']:.3f}, return {line['return']:.3f}, KL {kl:.4f}, clipped {clipped:.2f}, "
            f"log to traces {line['log_to_traces']:.1e}, {line['episodes']} episodes, seconds {json.dumps(seconds)}",
            flush=True,
        )


def replay_step(chosen: argparse.Namespace) -> None:
    """A step again, from its weights and its traces."""
    options = Options(**json.loads((chosen.out / "training.json").read_text())["options"])
    line = json.loads((chosen.out / "steps.jsonl").read_text().splitlines()[chosen.replay_step - 1])
    learner, tokenizer = resume(chosen.out / f"step_{chosen.replay_step - 1:03}", options, chosen.threads)
    ref, _ = checkpoint.load(chosen.out / "step_000")
    here = chosen.out / "rollouts" / f"step_{chosen.replay_step:03}"
    rollouts.export(chosen.reel, here, options)
    learner.learn(rollouts.read(here / "rows", tokenizer, learner.policy.config), ref, data.Pictures(learner.policy))
    shutil.rmtree(here / "rows" / "images", ignore_errors=True)
    found = checkpoint.digest(learner.policy)
    print(f"step {chosen.replay_step}: weights {found}, logged {line['weights']}: {'equal' if found == line['weights'] else 'DIFFERENT'}")
    if found != line["weights"]:
        raise SystemExit(1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", type=pathlib.Path, nargs="?", help="the policy to begin with")
    parser.add_argument("--tasks", type=pathlib.Path, help="folder of homes.sh with homes of training")
    parser.add_argument("--out", required=True, type=pathlib.Path)
    parser.add_argument("--steps", type=int, default=40)
    parser.add_argument("--minutes", type=float, help="start no further step after this time; the same command goes on")
    parser.add_argument("--replay-step", type=int, metavar="STEP", help="do this step again and compare the weights")
    parser.add_argument("--reel", default="reel", help="the binary")
    parser.add_argument("--jobs", type=int, default=24, help="episodes at a time")
    parser.add_argument("--batch", type=int, default=12, help="most requests in a batch")
    parser.add_argument("--threads", type=int, default=2, help="batches at a time")
    for field in dataclasses.fields(Options):
        if field.type is not bool:
            parser.add_argument(f"--{field.name.replace('_', '-')}", type=field.type, default=field.default)
    parser.add_argument("--fp32", action="store_true", help="gradients in 32 bits, also where the processor multiplies in 16")
    chosen = parser.parse_args()
    if chosen.replay_step:
        replay_step(chosen)
        return
    if not chosen.checkpoint or not chosen.tasks:
        parser.error("name the checkpoint to begin with, and --tasks")
    train(chosen, Options(**{field.name: getattr(chosen, field.name) for field in dataclasses.fields(Options) if field.type is not bool}, bf16=model.multiplies_16_bits() and not chosen.fp32))


if __name__ == "__main__":
    main()
