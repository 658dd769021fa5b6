"""Failures as flows from task family to class to sub-class."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .style import DARK, LIGHT, escaped, view, words_of

if TYPE_CHECKING:
    from .._store import Store

CLASSES = ("Object Confusion", "Key Action Missing", "Lost Memory", "Other")
NOT_CLASSIFIED = "not classified"


@dataclass(frozen=True)
class Flow:
    """Failed episodes of one family with one class and sub-class."""

    family: str
    class_name: str
    sub_class: str
    episodes: int


class Sankey:
    """Failures as flows from family to class to sub-class. Displays in notebooks; `save` writes the
    SVG.

    `reel.sankey` makes one from a store.
    """

    def __init__(self, flows: Sequence[Flow], episodes: int, successes: int, title: str = "Why do they fail?") -> None:
        self.flows = list(flows)
        """The flows, the largest first."""
        self.episodes = episodes
        """All episodes, failed or not."""
        self.successes = successes
        self.title = title

    @property
    def failures(self) -> int:
        """Failed episodes."""
        return sum(flow.episodes for flow in self.flows)

    def svg(self) -> str:
        """The diagram as an SVG document: no scripts, counts as tooltips, light and dark."""
        return sankey_svg(self)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes the SVG to a file."""
        target = Path(path)
        target.write_text(self.svg(), encoding="utf-8")
        return target

    def __repr__(self) -> str:
        classes: dict[str, int] = {}
        for flow in self.flows:
            classes[flow.class_name] = classes.get(flow.class_name, 0) + flow.episodes
        listed = ", ".join(f"{name} {count}" for name, count in sorted(classes.items(), key=lambda item: -item[1]))
        return f"<Sankey: {self.failures} failures in {self.episodes} episodes{': ' + listed if listed else ''}>"

    def _repr_html_(self) -> str:
        share = f" ({self.failures / self.episodes:.0%})" if self.episodes else ""
        head = (
            f"<h3>{escaped(self.title)}</h3><p class=\"soft\">{self.failures:,} failures in {self.episodes:,} "
            f"episodes{share}, {self.successes:,} successes</p>"
        )
        if not self.flows:
            return view(head, "sankey")
        hint = ""
        if all(flow.class_name == NOT_CLASSIFIED for flow in self.flows):
            hint = '<p class="soft">No failure is classified yet: <code>reel taxonomy --store STORE</code> does it.</p>'
        return view(f"{head}{sankey_svg(self, within_page=True)}{hint}", "sankey")


def sankey(
    store: Store | str | os.PathLike[str],
    *,
    policy: str | None = None,
    where: str = "TRUE",
    title: str = "Why do they fail?",
) -> Sankey:
    """The failed episodes of a store as flows from task family to class to sub-class.

    The classes are those of `reel taxonomy`; failures that it has not seen are `not classified`.

    Args:
        store: the store, or its location.
        policy: of one policy alone; None: of all.
        where: a condition in SQL on the table `episodes`.
        title: the heading.
    """
    from .._store import Store

    asked = store if isinstance(store, Store) else Store(store)
    chosen = f"SELECT * FROM episodes WHERE ({where}) AND ($policy = '' OR policy = $policy)"
    parameters = {"policy": policy or ""}
    flows = asked.sql(
        f"""
        SELECT
          coalesce(e.family, 'no family') AS family, coalesce(c.class, '{NOT_CLASSIFIED}') AS class,
          coalesce(c.sub_class, '') AS sub_class, count(*) AS episodes
        FROM ({chosen}) e
        LEFT JOIN classes c ON c.episode_id = e.episode_id AND c.trace_digest = e.trace_digest
        WHERE NOT e.success
        GROUP BY 1, 2, 3 ORDER BY episodes DESC, 1, 2, 3""",
        parameters=parameters,
    ).rows()
    totals = asked.sql(
        f"SELECT count(*) AS episodes, count(*) FILTER (WHERE success) AS successes FROM ({chosen})", parameters=parameters
    ).rows()[0]
    found = [Flow(row["family"], row["class"], row["sub_class"], row["episodes"]) for row in flows]
    return Sankey(found, totals["episodes"], totals["successes"], title)


WIDTH, COLUMN, GAP, LABEL = 1000, 14, 10, 16
SUB_CLASSES_MAX = 24


def class_color(name: str) -> str:
    """The colour of a class, as in the dashboards."""
    return f"var(--c{CLASSES.index(name) + 1 if name in CLASSES else 0})" if name != "Other" else "var(--c5)"


def sankey_svg(diagram: Sankey, within_page: bool = False) -> str:
    """The flows as SVG. Within a page it takes the colours of the page."""
    flows = diagram.flows
    counts: dict[tuple[str, str], int] = {}
    for flow in flows:
        key = (flow.class_name, flow.sub_class)
        counts[key] = counts.get(key, 0) + flow.episodes
    largest = sorted(counts, key=lambda key: (-counts[key], key))[:SUB_CLASSES_MAX]
    merged = [
        flow if (flow.class_name, flow.sub_class) in largest else Flow(flow.family, flow.class_name, "others", flow.episodes)
        for flow in flows
    ]
    order = {name: index for index, name in enumerate(CLASSES)}
    size: list[dict[Any, int]] = [{}, {}, {}]
    for flow in merged:
        for part, key in enumerate((flow.family, flow.class_name, (flow.class_name, flow.sub_class))):
            size[part][key] = size[part].get(key, 0) + flow.episodes
    columns: list[list[Any]] = [
        sorted(size[0]),
        sorted(size[1], key=lambda name: (order.get(name, len(order)), name)),
        sorted(size[2], key=lambda key: (order.get(key[0], len(order)), key[0], -size[2][key], key[1])),
    ]
    total = max(1, sum(size[1].values()))
    most = max((len(column) for column in columns), default=1)
    height = max(220.0, most * (LABEL + GAP) + 40.0)
    unit = (height - 20 - (most - 1) * GAP) / total
    lefts = (10.0, 400.0, 760.0)
    tops: list[dict[Any, float]] = []
    for part, column in enumerate(columns):
        # small nodes keep room for their label
        rooms = [max(size[part][key] * unit, 2.0) for key in column]
        spaces = [max(room, LABEL) for room in rooms]
        spare = max(0.0, height - 20 - sum(spaces) - GAP * (len(column) - 1))
        y = 10 + spare / 2
        placed: dict[Any, float] = {}
        for key, room, space in zip(column, rooms, spaces, strict=True):
            placed[key] = y + (space - room) / 2
            y += space + GAP
        tops.append(placed)
        height = max(height, y + 10 - GAP)

    links: dict[tuple[int, Any, Any, str], int] = {}
    for flow in merged:
        sub = (flow.class_name, flow.sub_class)
        for key in ((0, flow.family, flow.class_name, flow.class_name), (1, flow.class_name, sub, flow.class_name)):
            links[key] = links.get(key, 0) + flow.episodes
    leaving: dict[tuple[int, Any], float] = {}
    arriving: dict[tuple[int, Any], float] = {}
    shapes: list[str] = []
    rank = [{key: index for index, key in enumerate(column)} for column in columns]
    for part, source, target, class_name in sorted(links, key=lambda key: (key[0], rank[key[0]][key[1]], rank[key[0] + 1][key[2]])):
        count = links[part, source, target, class_name]
        thick = max(count * unit, 1.0)
        y0 = tops[part][source] + leaving.get((part, source), 0.0)
        y1 = tops[part + 1][target] + arriving.get((part + 1, target), 0.0)
        leaving[part, source] = leaving.get((part, source), 0.0) + thick
        arriving[part + 1, target] = arriving.get((part + 1, target), 0.0) + thick
        x0, x1 = lefts[part] + COLUMN, lefts[part + 1]
        middle = (x0 + x1) / 2
        path = (
            f"M{x0:g} {y0:.1f}C{middle:g} {y0:.1f} {middle:g} {y1:.1f} {x1:g} {y1:.1f}"
            f"V{y1 + thick:.1f}C{middle:g} {y1 + thick:.1f} {middle:g} {y0 + thick:.1f} {x0:g} {y0 + thick:.1f}Z"
        )
        shown = target[1] if part == 1 else target
        tip = f"{words_of(source)} → {words_of(shown or NOT_CLASSIFIED)}: {count}"
        shapes.append(f'<path d="{path}" fill="{class_color(class_name)}" fill-opacity=".38"><title>{tip}</title></path>')
    for part, column in enumerate(columns):
        for key in column:
            count = size[part][key]
            y, room = tops[part][key], max(count * unit, 2.0)
            color = "var(--soft)" if part == 0 else class_color(key if part == 1 else key[0])
            shown = words_of(key if part < 2 else key[1] or NOT_CLASSIFIED)
            shapes.append(
                f'<rect x="{lefts[part]:g}" y="{y:.1f}" width="{COLUMN}" height="{room:.1f}" rx="2" fill="{color}">'
                f"<title>{shown}: {count}</title></rect>"
                f'<text x="{lefts[part] + COLUMN + 8:g}" y="{y + room / 2 + 4.5:.1f}" font-size="13" stroke="var(--paper)" '
                f'stroke-width="3" stroke-opacity=".75" paint-order="stroke" stroke-linejoin="round">{shown}'
                f'<tspan dx="7" fill="var(--soft)">{count:,}</tspan></text>'
            )
    words = f"{diagram.failures} failures in {diagram.episodes} episodes by family, class and sub-class"
    style = "" if within_page else f"<style>svg{{{LIGHT}}}@media (prefers-color-scheme:dark){{svg{{{DARK}}}}}</style>"
    back = "" if within_page else '<rect width="100%" height="100%" fill="var(--paper)"/>'
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height:.0f}" role="img" fill="var(--ink)" '
        'font-family="system-ui, \'Segoe UI\', \'DejaVu Sans\', sans-serif">'
        f"<title>{escaped(diagram.title)}</title><desc>{words}</desc>{style}{back}{''.join(shapes)}</svg>"
    )


__all__ = ["Flow", "Sankey", "sankey"]
