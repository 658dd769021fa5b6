"""Lets the oracle take over episodes of a policy where they went wrong, so that a policy learns to go on from its own mistakes (DAgger, Ross
et al. 2011).

    python takeover.py played/student --reel reel --out takeovers
    reel dataset annotate takeovers && python notes.py --reel reel takeovers
    reel ingest takeovers --store store && reel export sft --store store --annotations notes ...

An oracle alone never sees what a policy runs into: a search at the wrong place that finds nothing, a call that fails, an answer that cannot be
read. Nor does it misjudge: the first place it comes to is the right one in half of its episodes, so to count visits seems to pay. Each takeover is
a branch (`reel branch`): the policy's calls up to one that failed, or with it, or up to a wrong verdict on where it has come, then the oracle's.
`notes.py` writes notes for the oracle's decisions only, so no decision of the policy is learned.
"""

import argparse
import concurrent.futures
import json
import pathlib
import random
import typing

import rollouts

SEARCHES = ("show_object_by_category", "gaze_at")  # whoever takes over after one searches again, which nothing seen explains


def failures(steps: list[dict[str, typing.Any]]) -> list[int]:
    """The calls that fail, and those after them."""
    failed = [step["outcome"].get("error") is not None or not step.get("tool") for step in steps]
    searched = lambda index: steps[index - 1].get("tool") in SEARCHES and not failed[index - 1]
    return [index for index in range(1, len(steps)) if (failed[index] or failed[index - 1]) and not searched(index)]


def misjudged(task: dict[str, typing.Any], steps: list[dict[str, typing.Any]]) -> list[int]:
    """The calls that search or place where the task does not want it, and those that leave where it does."""
    found = []
    for index in range(1, len(steps)):
        last = steps[index - 1]
        if last.get("tool") != "nav_to" or last["outcome"].get("error") is not None:
            continue
        wanted = task["dest"] if last.get("held") else task["src"]
        stays = steps[index].get("tool") in ("place", *SEARCHES)
        if stays != (last["input"]["call"]["arguments"].get("receptacle_name") == wanted):
            found.append(index)
    return found


def take_over(reel: str, trace: pathlib.Path, most: int, out: pathlib.Path) -> int:
    """Branches an episode at its first failure, at others, and at wrong verdicts; gives the number of branches."""
    shown = json.loads(rollouts.run([reel, "show", "--json", str(trace)]))
    failed, wrong = failures(shown["steps"]), misjudged(shown["task"], shown["steps"])
    rng = random.Random(trace.name)
    draw = lambda some: rng.sample(some, min(most - 1, len(some)))
    chosen = sorted({*failed[:1], *draw(failed), *draw(wrong)})
    for index in chosen:
        path = out / f"{trace.stem}--at-{index}.mcap"
        if not path.exists():
            rollouts.run([reel, "branch", str(trace), "--at", str(index), "--policy", "oracle", "--out", str(path)])
    return len(chosen)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("traces", type=pathlib.Path)
    parser.add_argument("--out", required=True, type=pathlib.Path)
    parser.add_argument("--most", type=int, default=3, help="takeovers of an episode after failures; one fewer at wrong verdicts")
    parser.add_argument("--reel", default="reel", help="the binary")
    parser.add_argument("--jobs", type=int, default=2)
    chosen = parser.parse_args()
    chosen.out.mkdir(parents=True, exist_ok=True)
    traces = sorted(chosen.traces.rglob("*.mcap"))
    with concurrent.futures.ThreadPoolExecutor(chosen.jobs) as pool:
        counts = list(pool.map(lambda trace: take_over(chosen.reel, trace, chosen.most, chosen.out), traces))
    print(f"{sum(counts)} takeovers of {sum(count > 0 for count in counts)} of {len(traces)} episodes")


if __name__ == "__main__":
    main()
