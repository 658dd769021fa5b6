"""Writes the report of a loop, `report.html`, `report.svg` and `report.json`, from what `prove.sh` left in a folder, and prints its tables.

    python report.py loop-data --reel reel
"""

import argparse
import collections.abc
import dataclasses
import html
import json
import math
import pathlib
import resource
import typing

import evaluate
import rollouts

POLICIES = {
    "untrained": "random weights, 10 tokens an answer", "blind": "SFT, images replaced by zeros", "seeing": "SFT", "learned": "SFT, then GSPO",
    "seeing-sampled": "SFT, temperature 1", "learned-sampled": "SFT, then GSPO, temperature 1",
}
PAIRS = [("seeing", "untrained"), ("seeing", "blind"), ("learned", "seeing"), ("learned-sampled", "seeing-sampled")]
Json = dict[str, typing.Any]


def wilson(hits: int, count: int) -> tuple[float, float]:
    """The 95% interval of a share."""
    z, share = 1.959964, hits / count
    middle, spread = share + z * z / (2 * count), z * math.sqrt(share * (1 - share) / count + z * z / (4 * count * count))
    return (middle - spread) / (1 + z * z / count), (middle + spread) / (1 + z * z / count)


class Page:
    """A report as HTML in one file, and its tables as text."""

    def __init__(self, title: str) -> None:
        style = "body{font:15px sans-serif;max-width:60em;margin:2em auto;padding:0 1em}td,th{padding:.2em .8em;text-align:left;border-bottom:1px solid #ddd}pre{overflow-x:auto}"
        self.html = [f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}</title><style>{style}</style><h1>{title}</h1>']
        self.text: list[str] = []

    def heading(self, title: str) -> None:
        self.html.append(f"<h2>{html.escape(title)}</h2>")
        self.text.append(f"\n{title}\n")

    def table(self, head: collections.abc.Sequence[str], rows: collections.abc.Iterable[collections.abc.Sequence[object]]) -> None:
        cells = [list(head), *([str(cell) for cell in row] for row in rows)]
        line = lambda kind, row: "<tr>" + "".join(f"<{kind}>{html.escape(cell)}</{kind}>" for cell in row) + "</tr>"
        self.html.append("<table>" + line("th", cells[0]) + "".join(line("td", row) for row in cells[1:]) + "</table>")
        widths = [max(len(row[column]) for row in cells) for column in range(len(head))]
        self.text += ["  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip() for row in cells]

    def preformatted(self, text: str) -> None:
        self.html.append(f"<pre>{html.escape(text)}</pre>")
        self.text.append(text)

    def picture(self, drawn: "Picture") -> None:
        self.html.append(drawn.svg())


WIDTH, HEIGHT = 640, 240


@dataclasses.dataclass(frozen=True)
class Picture:
    """A drawing as wide as the page."""

    body: str
    height: int = HEIGHT

    def svg(self) -> str:
        head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {self.height}" width="{WIDTH}" font-family="sans-serif" font-size="12">'
        return f'{head}<rect width="{WIDTH}" height="{self.height}" fill="#fff"/>{self.body}</svg>'

    def above(self, other: "Picture") -> "Picture":
        return Picture(f'{self.body}<g transform="translate(0 {self.height})">{other.body}</g>', self.height + other.height)


def curve(title: str, values: list[float]) -> Picture:
    """A line over the steps of a training."""
    left, top, bottom = 56, 34, 28
    low, high = min([0.0, *values]), max(values) or 1.0
    x = lambda step: left + (WIDTH - left - 16) * (step / max(1, len(values) - 1))
    y = lambda value: HEIGHT - bottom - (HEIGHT - bottom - top) * (value - low) / ((high - low) or 1.0)
    parts = [f'<text x="{left}" y="18" font-weight="bold">{html.escape(title)}</text>']
    for value in (low, (low + high) / 2, high):
        parts.append(f'<line x1="{left}" x2="{WIDTH - 16}" y1="{y(value):.1f}" y2="{y(value):.1f}" stroke="#ccc"/>')
        parts.append(f'<text x="{left - 6}" y="{y(value) + 4:.1f}" text-anchor="end">{value:.3g}</text>')
    for step in (1, len(values)):
        parts.append(f'<text x="{x(step - 1):.1f}" y="{HEIGHT - 8}" text-anchor="middle">{step}</text>')
    points = " ".join(f"{x(step):.1f},{y(value):.1f}" for step, value in enumerate(values))
    parts.append(f'<polyline points="{points}" fill="none" stroke="#1f6feb" stroke-width="2"/>')
    return Picture("".join(parts))


def bars(title: str, shares: list[tuple[str, int, int]]) -> Picture:
    """A bar for each (name, hits, count), with its 95% interval."""
    left, top, row = 250, 30, 26
    x = lambda share: left + (WIDTH - left - 70) * share / most
    most = max(wilson(hits, count)[1] for _, hits, count in shares) or 1.0
    parts = [f'<text x="8" y="18" font-weight="bold">{html.escape(title)}</text>']
    for place, (name, hits, count) in enumerate(shares):
        y, (low, high) = top + row * place, wilson(hits, count)
        parts.append(f'<text x="{left - 8}" y="{y + 15}" text-anchor="end">{html.escape(name)}</text>')
        parts.append(f'<rect x="{left}" y="{y + 3}" width="{x(hits / count) - left:.1f}" height="16" fill="#9cc2f5"/>')
        parts.append(f'<line x1="{x(low):.1f}" x2="{x(high):.1f}" y1="{y + 11}" y2="{y + 11}" stroke="#1f3a63" stroke-width="2"/>')
        parts.append(f'<text x="{x(high) + 8:.1f}" y="{y + 15}">{hits / count:.1%}</text>')
    return Picture("".join(parts), top + row * len(shares) + 8)


def smooth(values: list[float], span: int = 5) -> list[float]:
    """The mean of the last values."""
    return [sum(values[max(0, index - span + 1) : index + 1]) / len(values[max(0, index - span + 1) : index + 1]) for index in range(len(values))]


def policies(played: dict[str, dict]) -> list[list[object]]:
    """A row for each policy."""
    rows = []
    for name, episodes in played.items():
        count, wins = len(episodes), sum(bool(row["success"]) for row in episodes.values())
        low, high = wilson(wins, count)
        mean = lambda field: sum(row[field] or 0 for row in episodes.values()) / count
        rows.append([
            name, POLICIES[name], count, f"{wins / count:.1%} [{low:.1%}, {high:.1%}]", f"{mean('completion'):.1%}", f"{mean('total_reward'):.2f}",
            f"{mean('length'):.1f}",
        ])
    return rows


def comparison(name: str, found: Json) -> list[object]:
    """A row for a pair."""
    percent = lambda value: f"{100 * value:+.1f}"
    interval = lambda field: f"[{percent(found[field][0])}, {percent(found[field][1])}]"
    return [
        name, found["episodes"], f"{percent(found['success_difference'])} {interval('success_interval')}", f"{found['flips'][0]} : {found['flips'][1]}",
        f"{found['mcnemar_p']:.2g}", f"{percent(found['completion_difference'])} {interval('completion_interval')}", f"{found['completion_p']:.2g}",
    ]


def throughput(steps: list[Json]) -> Json:
    """Rollouts a minute, and how the time is shared."""
    total = lambda get: sum(get(step) for step in steps)
    wall = total(lambda step: step["seconds"]["play"]["wall"])
    model, reel = (total(lambda step: step["seconds"]["play"][name]) for name in ("model", "reel"))
    whole = wall + total(lambda step: step["seconds"]["export"] + step["seconds"]["learn"] + step["seconds"]["check"])
    return {
        "rollouts_a_minute": 60 * total(lambda step: step["episodes"]) / wall, "decisions_a_second": total(lambda step: step["decisions"]) / wall,
        "cpu_share_model": model / (model + reel), "cpu_share_reel": reel / (model + reel),
        "wall_share_play": wall / whole, "wall_share_learn": total(lambda step: step["seconds"]["learn"]) / whole,
        "wall_share_export_and_replay": total(lambda step: step["seconds"]["export"]) / whole, "wall_share_check": total(lambda step: step["seconds"]["check"]) / whole,
    }


def executed_share(reel: str, training: pathlib.Path, step: Json) -> float:
    """The share of CPU that simulator and frames had in the play of a step: what a replay of its rollouts, which needs no model, takes of it."""
    children = lambda: sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])
    began = children()
    rollouts.run([reel, "replay", str(training / "rollouts" / f"step_{step['step']:03}" / "traces"), "--jobs", "1"])
    return (children() - began) / (step["seconds"]["play"]["model"] + step["seconds"]["play"]["reel"])


def replayed(reel: str, training: pathlib.Path) -> int:
    """How many rollouts replay exactly, with the log-probabilities that training added to them. Fails if one does not."""
    traces = sorted(training.glob("rollouts/step_*/traces"))
    return sum(json.loads(line)["verdict"] == "exact" for line in rollouts.run([reel, "replay", "--json", *map(str, traces)]).splitlines())


def rewards_checked(reel: str, stores: list[pathlib.Path]) -> int:
    """How many stores hold rewards that are, recomputed, equal bit for bit. Fails on the first that differs."""
    for store in stores:
        rollouts.run([reel, "store", "reward", "--store", str(store), "--check"])
    return len(stores)


def other_reward(page: Page, ablated: Json) -> None:
    """What another reward would have led to, and did."""
    page.heading(f"Under the reward {ablated['preset']}")
    page.table(["", ""], [
        ["rank correlation of the advantages, mean over groups", f"{ablated['rank']:.2f}"],
        ["rollouts whose advantage changes its sign", f"{ablated['signs_flipped']:.1%}"],
        ["groups, and those whose advantages vary under both", f"{ablated['groups']}, {ablated['groups_ranked']}"],
    ])
    head = ["behaviour", "covariance with the advantage", "under the other reward"]
    rows = [[name, f"{one['recorded']:+.3f}", f"{one['other']:+.3f}"] for name, one in ablated["behaviours"].items()]
    if "steps_compared" in ablated:
        head += [f"trained under it: difference in {ablated['steps_compared']} steps", "95 %", "as forecast"]
        for row, one in zip(rows, ablated["behaviours"].values()):
            row += [f"{one['difference']:+.3f}", "[{:+.3f}, {:+.3f}]".format(*one["interval"]), {True: "yes", False: "no", None: "-"}[one["held"]]]
    page.table(head, rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--reel", default="reel", help="the binary")
    chosen = parser.parse_args()
    folder, reel = chosen.folder, chosen.reel
    played = {name: evaluate.episodes(reel, folder / "played" / name) for name in POLICIES if (folder / "played" / name).exists()}
    compared = {f"{one} - {other}": evaluate.compare(played[one], played[other]) for one, other in PAIRS if one in played and other in played}
    steps = [json.loads(line) for line in (folder / "gspo" / "steps.jsonl").read_text().splitlines()]
    stores = sorted((folder / "gspo" / "rollouts").glob("step_*/store"))
    log = json.loads(rollouts.run([reel, "train", "log", str(folder / "gspo"), "--json"]))
    changes = rollouts.run([reel, "train", "changes", str(folder / "played/seeing.store"), str(folder / "played/learned.store")])
    ablated = json.loads((folder / "ablated.json").read_text()) if (folder / "ablated.json").exists() else None
    report = {
        "ablation": ablated,
        "policies": {name: {"episodes": len(rows), "success": sum(bool(row["success"]) for row in rows.values())} for name, rows in played.items()},
        "comparisons": compared,
        "rollouts": {
            "steps": len(steps), "episodes": sum(step["episodes"] for step in steps), "replayed_exactly": replayed(reel, chosen.folder / "gspo"),
            "stores_with_rewards_equal_bit_for_bit": rewards_checked(reel, stores),
            "largest_difference_of_log_and_traces": max(step["apart"] for step in log["steps"]),
            "largest_difference_of_sampled_and_scored": max(step["sampled_to_scored"] for step in steps),
        },
        "throughput": {**throughput(steps), "cpu_share_simulator_and_frames": executed_share(reel, folder / "gspo", steps[-1])},
        "seconds": {path.name.removeprefix("done."): int(path.read_text()) for path in sorted(folder.glob("done.*"))},
        "steps": [{"success": step["success"], "return": step["return"]} for step in steps],
    }
    (folder / "report.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    page = Page("The learning loop")
    page.heading("Homes never seen")
    page.table(["policy", "", "episodes", "success (95 %, Wilson)", "completion", "reward", "decisions"], policies(played))
    page.table(
        ["paired", "episodes", "success, points", "won : lost", "p (McNemar)", "completion, points", "p (sign flip)"],
        [comparison(name, found) for name, found in compared.items()],
    )
    counts = [(POLICIES[name], sum(bool(row["success"]) for row in rows.values()), len(rows)) for name, rows in played.items()]
    pictures = [
        bars("success in homes never seen, 95 %", counts),
        curve("success of the rollouts of GSPO by step, mean of five", smooth([step["success"] for step in steps])),
        curve("return of the rollouts by step, mean of five", smooth([step["return"] for step in steps])),
        curve("KL from the SFT policy", [sum(update["kl"] for update in step["updates"]) / len(step["updates"]) for step in steps]),
    ]
    (folder / "report.svg").write_text(pictures[0].above(pictures[1]).svg() + "\n", encoding="utf-8")
    page.picture(pictures[0])
    page.heading("Rollouts of GSPO")
    for drawn in pictures[1:]:
        page.picture(drawn)
    page.table(["", ""], [*((name.replace("_", " "), value) for name, value in report["rollouts"].items()), *((name.replace("_", " "), f"{value:.3g}") for name, value in report["throughput"].items())])
    if ablated:
        other_reward(page, ablated)
    page.heading("What GSPO changed")
    page.preformatted(changes)
    page.heading("Seconds by stage")
    page.table(["stage", "seconds"], report["seconds"].items())
    (folder / "report.html").write_text("\n".join(page.html) + "\n", encoding="utf-8")
    print("\n".join(page.text))


if __name__ == "__main__":
    main()
