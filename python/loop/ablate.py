"""Asks of the rollouts of one training what a training under another reward would have learned; nothing is played.

    python ablate.py gspo --preset real-trainer --reel reel                     # from the traces
    python ablate.py gspo --preset real-trainer --trained gspo-real-trainer     # and whether it came true in a training under that preset

Rewards are computed again from the traces, and with them returns and advantages of the same groups. `rank` is the mean over groups of Spearman's
correlation of the advantages. To first order, a step changes a behaviour by its covariance with the advantage within groups (policy gradient
theorem). So the other reward should lead to more of what varies more with its advantages: that is the forecast. A second training with the same
seed has the same tasks at each step, so the two differ in pairs; the later half of the steps is compared, with a bootstrap interval over steps.
"""

import argparse
import collections
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
Json = dict[str, typing.Any]
Groups = dict[str, dict[str, float]]  # advantages by group and episode


def advantages(reel: str, store: pathlib.Path, objective: Json, preset: str | None) -> Groups:
    """Advantages of a step's rollouts by group and episode, under a preset or as recorded."""
    command = [
        reel, "dataset", "gspo", "--store", str(store), "--new", objective["old"], "--returns", objective["returns"],
        "--advantage", objective["advantage"], "--group-size", str(objective["group_size"]), "--json",
    ]
    told = json.loads(rollouts.run([*command, *(["--preset", preset] if preset else [])]))
    found: Groups = collections.defaultdict(dict)
    for one in told["report"]["sequences"]:
        found[one["group"]][one["episode_id"]] = one["advantage"]
    return found


def behaviour(reel: str, store: pathlib.Path) -> dict[str, dict[str, float]]:
    """What each episode of a store did."""
    columns = ", ".join(f'{expression} AS "{name}"' for name, expression in BEHAVIOURS.items())
    told = rollouts.run([reel, "query", "--store", str(store), "--json", f"SELECT e.episode_id, {columns} FROM episodes e"])
    return {row["episode_id"]: {name: float(row[name] or 0) for name in BEHAVIOURS} for row in json.loads(told)}


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


def forecast(steps: list[tuple[Groups, Groups, dict[str, dict[str, float]]]]) -> Json:
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
            flipped += sum(a * b < 0 for a, b in zip(one, two))
            count += len(episodes)
            for name, (first, second) in covariances.items():
                values = [did[episode][name] for episode in episodes]
                first.append(covariance(one, values))
                second.append(covariance(two, values))
    return {
        "groups": len(covariances["success"][0]), "rollouts": count, "rank": mean(correlations), "signs_flipped": flipped / max(1, count),
        "behaviours": {name: {"recorded": mean(first), "other": mean(second)} for name, (first, second) in covariances.items()},
    }


def came_true(told: Json, recorded: list[Json], trained: list[Json]) -> None:
    """Adds what a training under the other reward did more of, at the same tasks, in the later half of the steps."""
    later = range(min(len(recorded), len(trained)) // 2, min(len(recorded), len(trained)))
    for name, one in told["behaviours"].items():
        differences = [trained[step][name] - recorded[step][name] for step in later]
        one["difference"], one["interval"] = mean(differences), evaluate.interval(differences)
        sign = (one["other"] - one["recorded"]) * one["difference"]
        one["held"] = sign > 0 if sign else None  # nothing was forecast, or nothing differs


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
    by_step = lambda some: [{name: mean([one[name] for one in step.values()]) for name in BEHAVIOURS} for step in some]
    recorded = did(chosen.training)
    told = forecast([
        (advantages(chosen.reel, store, objective, objective["preset"]), advantages(chosen.reel, store, objective, chosen.preset), known)
        for store, known in zip(stores(chosen.training), recorded)
    ])
    if chosen.trained:
        came_true(told, by_step(recorded), by_step(did(chosen.trained)))
    told["preset"] = chosen.preset
    print(json.dumps(told, indent=1))
    if chosen.out:
        chosen.out.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
