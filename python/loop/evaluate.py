"""Plays a checkpoint over tasks with `reel bench`, and compares two that were played.

    python evaluate.py play checkpoint --reel reel --tasks held-out --out played/seeing
    python evaluate.py play checkpoint --reel reel --tasks held-out --out played/seeing --max-minutes 20   # further options go to reel bench
    python evaluate.py compare played/seeing played/blind --reel reel

Differences are paired by task and seed: success with the exact test of McNemar, completion with a sign-flip test, both over episodes. Their
intervals are by bootstrap over homes, which episodes share.
"""

import argparse
import collections
import dataclasses
import json
import math
import pathlib
import random
import typing

import checkpoint
import play
import rollouts
import server

DRAWS = 10_000


def played(chosen: argparse.Namespace) -> play.Spent:
    """Serves the checkpoint while `reel bench` plays it."""
    log = chosen.out.with_suffix(".requests.jsonl")
    log.parent.mkdir(parents=True, exist_ok=True)
    with server.Server(*checkpoint.load(chosen.checkpoint), play.NAME, 0, chosen.batch, chosen.threads, log) as served:
        served.begin()
        what = play.Play(
            chosen.reel, chosen.tasks, chosen.out, chosen.temperature, chosen.seed, chosen.repeat, chosen.max_tokens, chosen.jobs, chosen.logprobs,
            tuple(chosen.bench),
        )
        spent = play.bench(served, what)
        served.shutdown()
    return spent


def episodes(reel: str, traces: pathlib.Path) -> dict[tuple[str, int], dict[str, typing.Any]]:
    """Success and completion by task and seed, from a store of the traces."""
    store = traces.with_suffix(".store")
    rollouts.run([reel, "ingest", str(traces), "--store", str(store)])
    query = "SELECT task_id, seed, scene_id, family, success, completion, total_reward, length FROM episodes ORDER BY task_id, seed"
    said = json.loads(rollouts.run([reel, "query", "--store", str(store), "--json", query]))
    return {(row["task_id"], row["seed"]): row for row in said}


def interval(differences: list[float], groups: list[str], seed: int = 0) -> tuple[float, float]:
    """The 95% interval of the mean, by bootstrap over groups of differences that may depend on each other."""
    members: dict[str, list[float]] = collections.defaultdict(list)
    for difference, group in zip(differences, groups):
        members[group].append(difference)
    sums, rng = [(sum(some), len(some)) for some in members.values()], random.Random(seed)

    def mean() -> float:
        total, count = map(sum, zip(*rng.choices(sums, k=len(sums))))
        return total / count

    means = sorted(mean() for _ in range(DRAWS))
    return means[int(0.025 * DRAWS)], means[int(0.975 * DRAWS) - 1]


def mcnemar(better: int, worse: int) -> float:
    """Two-sided exact probability of flips at least as uneven."""
    flips = better + worse
    if flips == 0:
        return 1.0
    tail = sum(math.comb(flips, hits) for hits in range(min(better, worse) + 1)) / 2**flips
    return min(1.0, 2 * tail)


def sign_flip(differences: list[float], seed: int = 0) -> float:
    """Two-sided probability of a mean at least as large where the sign of each difference is a coin's."""
    rng, real = random.Random(seed), [difference for difference in differences if difference]
    if not real:
        return 1.0
    least = abs(sum(real)) - 1e-12
    hits = sum(abs(sum(difference if rng.random() < 0.5 else -difference for difference in real)) >= least for _ in range(DRAWS))
    return (hits + 1) / (DRAWS + 1)


def compare(one: dict[tuple[str, int], dict[str, typing.Any]], other: dict[tuple[str, int], dict[str, typing.Any]]) -> dict[str, typing.Any]:
    """The first against the second, over the episodes that both played."""
    shared = sorted(one.keys() & other.keys())
    if not shared:
        raise SystemExit("the two share no task and seed; play the same tasks with the same --seed")
    gains = [int(one[key]["success"]) - int(other[key]["success"]) for key in shared]
    homes = [one[key]["scene_id"] for key in shared]
    completion = [one[key]["completion"] - other[key]["completion"] for key in shared]
    mean = lambda values: sum(values) / len(shared)
    return {
        "episodes": len(shared),
        "success": [mean([int(side[key]["success"]) for key in shared]) for side in (one, other)],
        "completion": [mean([side[key]["completion"] for key in shared]) for side in (one, other)],
        "success_difference": mean(gains), "success_interval": interval([float(gain) for gain in gains], homes),
        "flips": [gains.count(1), gains.count(-1)], "mcnemar_p": mcnemar(gains.count(1), gains.count(-1)),
        "completion_difference": mean(completion), "completion_interval": interval(completion, homes), "completion_p": sign_flip(completion),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    player = commands.add_parser("play", help="play a checkpoint")
    player.add_argument("checkpoint", type=pathlib.Path)
    player.add_argument("--tasks", required=True, type=pathlib.Path)
    player.add_argument("--out", required=True, type=pathlib.Path)
    player.add_argument("--temperature", type=float, default=0.0)
    player.add_argument("--seed", type=int, default=0)
    player.add_argument("--repeat", type=int, default=1)
    player.add_argument("--max-tokens", type=int, default=100)
    player.add_argument("--jobs", type=int, default=16)
    player.add_argument("--batch", type=int, default=8, help="most requests in a batch")
    player.add_argument("--threads", type=int, default=1, help="batches at a time")
    player.add_argument("--logprobs", action="store_true", help="record the tokens and their log-probabilities")
    comparer = commands.add_parser("compare", help="compare two that were played")
    comparer.add_argument("played", nargs=2, type=pathlib.Path)
    for one in (player, comparer):
        one.add_argument("--reel", default="reel", help="the binary")
    chosen, further = parser.parse_known_args()
    if further and chosen.command != "play":
        parser.error(f"unrecognized arguments: {' '.join(further)}")
    chosen.bench = further
    if chosen.command == "play":
        spent = played(chosen)
        found = episodes(chosen.reel, chosen.out)
        mean = lambda field: sum(float(row[field]) for row in found.values()) / len(found)
        means = {field: mean(field) for field in ("success", "completion", "total_reward", "length")}
        print(json.dumps({"episodes": len(found), **means, "seconds": dataclasses.asdict(spent)}))
    else:
        print(json.dumps(compare(*(episodes(chosen.reel, played) for played in chosen.played)), indent=1))


if __name__ == "__main__":
    main()
