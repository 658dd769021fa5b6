"""Asks of the rollouts of one training what a training under another reward would have learned; nothing is played.

    python ablate.py gspo --preset real-trainer --reel reel                     # from the traces
    python ablate.py gspo --preset real-trainer --trained gspo-real-trainer     # and whether it came true in a training under that preset

Rewards are computed again from the traces, and with them returns and advantages of the same groups. `rank` is the mean over groups of Spearman's
correlation of the advantages. A step that makes answers likelier by their advantage changes a behaviour by its covariance with the advantage within
groups, so the other reward should lead to more of what varies more with its advantages. That is the forecast, a rule of thumb: GSPO also divides by
the length of an episode, and behaviours share weights. A second training with the same seed has the same tasks at each step, so the two differ in
pairs of rollouts of a task. The first half of the steps that both have gives the forecast, the second half is compared, with a bootstrap interval
over tasks; where it holds 0, nothing is decided.
"""

import argparse
import collections
import dataclasses
import json
import math
import pathlib
import typing

import evaluate
import rollouts

BEHAVIOURS = {
    "success": "CAST(e.success AS INT)", "completion": "e.completion", "calls": "e.length",
    "questions": "(SELECT count(*) FROM steps s WHERE s.episode_id = e.episode_id AND s.tool = 'ask')",
    "failed calls": "(SELECT count(*) FROM steps s WHERE s.episode_id = e.episode_id AND s.error_code IS NOT NULL)",
}
ROUNDING = 1e-9  # advantages nearer to 0 than this have no sign
Json = dict[str, typing.Any]
Groups = dict[str, dict[str, float]]  # advantages by group and episode


def advantages(reel: str, store: pathlib.Path, objective: Json, preset: str | None) -> Groups:
    """Advantages of a step's rollouts by group and episode, under a preset or as recorded."""
    told = rollouts.gspo(reel, store, {**objective, "new": objective["old"], "reference": None, "beta": 0.0, "preset": preset})
    found: Groups = collections.defaultdict(dict)
    for one in told["sequences"]:
        found[one["group"]][one["episode_id"]] = one["advantage"]
    return found


@dataclasses.dataclass(frozen=True)
class Did:
    """What an episode did."""

    task: str
    values: dict[str, float]


def behaviour(reel: str, store: pathlib.Path) -> dict[str, Did]:
    """What each episode of a store did."""
    columns = ", ".join(f'{expression} AS "{name}"' for name, expression in BEHAVIOURS.items())
    told = rollouts.run([reel, "query", "--store", str(store), "--json", f"SELECT e.episode_id, e.task_id, {columns} FROM episodes e"])
    return {row["episode_id"]: Did(row["task_id"], {name: float(row[name] or 0) for name in BEHAVIOURS}) for row in json.loads(told)}


def ranks(values: list[float]) -> list[float]:
    """Ranks from 1; equal values share the mean of theirs."""
    ordered = sorted(values)
    return [ordered.index(value) + (ordered.count(value) + 1) / 2 for value in values]


def correlation(one: list[float], other: list[float]) -> float | None:
    """Pearson's; `None` if one of them does not vary."""
    spread = math.sqrt(covariance(one, one) * covariance(other, other))
    return covariance(one, other) / spread if spread > 1e-12 else None


def covariance(one: list[float], other: list[float]) -> float:
    mean, mean_other = sum(one) / len(one), sum(other) / len(other)
    return sum((a - mean) * (b - mean_other) for a, b in zip(one, other)) / len(one)


def mean(values: list[float]) -> float:
    return sum(values) / len(values) if values else math.nan


def forecast(steps: list[tuple[Groups, Groups, dict[str, Did]]]) -> Json:
    """Rank correlation of the advantages of two rewards, and the covariance of each behaviour with both, over the groups of some steps."""
    correlations, flipped, count = list[float](), 0, 0
    covariances: dict[str, tuple[list[float], list[float]]] = {name: ([], []) for name in BEHAVIOURS}
    for recorded, other, did in steps:
        for group, known in recorded.items():
            episodes = sorted(known.keys() & other.get(group, {}).keys())
            if len(episodes) < 2:
                continue
            one, two = [known[name] for name in episodes], [other[group][name] for name in episodes]
            found = correlation(ranks(one), ranks(two))
            correlations += [found] if found is not None else []
            flipped += sum(a * b < 0 and min(abs(a), abs(b)) > ROUNDING for a, b in zip(one, two))
            count += len(episodes)
            for name, (first, second) in covariances.items():
                values = [did[episode].values[name] for episode in episodes]
                first.append(covariance(one, values))
                second.append(covariance(two, values))
    return {
        "groups": len(covariances["success"][0]), "groups_ranked": len(correlations), "rollouts": count, "rank": mean(correlations), "signs_flipped": flipped / max(1, count),
        "behaviours": {name: {"recorded": mean(first), "other": mean(second)} for name, (first, second) in covariances.items()},
    }


def by_task(step: dict[str, Did], name: str) -> dict[str, float]:
    """The mean of a behaviour over the rollouts of each task."""
    values: dict[str, list[float]] = collections.defaultdict(list)
    for one in step.values():
        values[one.task].append(one.values[name])
    return {task: mean(some) for task, some in values.items()}


def came_true(behaviours: Json, recorded: list[dict[str, Did]], trained: list[dict[str, Did]]) -> None:
    """Adds to a forecast what a training under the other reward did more of, in some steps with the same tasks."""
    for name, one in behaviours.items():
        pairs = [(by_task(base, name), by_task(other, name)) for base, other in zip(recorded, trained)]
        differences = [other[task] - base[task] for base, other in pairs for task in sorted(base.keys() & other.keys())]
        one["difference"], one["interval"] = mean(differences), evaluate.interval(differences, [str(place) for place in range(len(differences))])
        more = one["other"] - one["recorded"]
        decided = more and (one["interval"][0] > 0 or one["interval"][1] < 0)
        one["held"] = more * one["difference"] > 0 if decided else None  # nothing was forecast, or nothing is decided


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("training", type=pathlib.Path, help="folder of gspo.py")
    parser.add_argument("--preset", required=True, help="the other reward, as `reel dataset gspo --preset` names it")
    parser.add_argument("--trained", type=pathlib.Path, help="folder of a training under it")
    parser.add_argument("--out", type=pathlib.Path, help="write the figures into this file too")
    parser.add_argument("--reel", default="reel", help="the binary")
    chosen = parser.parse_args()
    objective = json.loads((chosen.training / "training.json").read_text())["objective"]
    stores = lambda folder: [folder / json.loads(line)["store"] for line in (folder / "steps.jsonl").read_text().splitlines()]
    did = lambda folder: [behaviour(chosen.reel, store) for store in stores(folder)]
    recorded = did(chosen.training)
    steps = [
        (advantages(chosen.reel, store, objective, objective["preset"]), advantages(chosen.reel, store, objective, chosen.preset), known)
        for store, known in zip(stores(chosen.training), recorded)
    ]
    told: Json = {"preset": chosen.preset, **forecast(steps)}
    if chosen.trained:
        trained = did(chosen.trained)
        both = min(len(recorded), len(trained))
        if both < 2:
            raise SystemExit(f"{chosen.training} and {chosen.trained} share {both} steps; a forecast and its check need one each at least")
        half = both // 2
        told["behaviours"], told["steps_of_forecast"], told["steps_compared"] = forecast(steps[:half])["behaviours"], half, both - half
        came_true(told["behaviours"], recorded[half:both], trained[half:both])
    print(json.dumps(told, indent=1))
    if chosen.out:
        chosen.out.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
