"""Explanations, verdicts and comparisons."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

from .._types import Record
from .episodes import STEPS_MAX, about_step, facts, numbers, outcome_tag, reward_html
from .images import data_uri, frames_of
from .style import escaped, tag, view, words_of

if TYPE_CHECKING:
    from .._episode import Comparison, Episode, Explanation, Verdict

ROWS_MAX = 10


def side(episode: Episode, first: int, title: str, kind: str, lead: str, before: bool) -> str:
    """The calls of an episode from one on. `title` and `lead` are HTML. Above them is the image that
    the agent had when it decided (`before`), or the first that it got then."""
    steps = list(episode.steps[first : first + ROWS_MAX])
    images = frames_of(episode, [step.index for step in steps])
    if before:
        found = ((call, image) for at in range(first - 1, -2, -1) for call, image in frames_of(episode, [at]).items())
        large, caption = next(found, None), f"seen before call {first}"
    else:
        large = next(iter(images.items()), None)
        caption = f"seen after call {large[0]}" if large else ""
    rows: list[str] = []
    if large is not None:
        address = data_uri(large[1], 2, 78)
        rows.append(f'<li class="first"><div><img alt="{caption}" src="{address}"><div class="soft">{caption}</div></div></li>')
    for step in steps:
        image = images.get(step.index)
        small = (
            f'<img alt="call {step.index}" src="{data_uri(image, 4, 72)}">' if image is not None else '<div class="blank"></div>'
        )
        rows.append(f"<li><div>{small}</div>{about_step(step, more=before and step.index == first)}</li>")
    left = len(episode) - first - len(steps)
    if left > 0:
        rows.append(f'<li><div></div><div class="soft">and {left} more call{"s" * (left > 1)}</div></li>')
    return (
        f'<div class="side {kind}"><div class="top"><h4>{title}</h4>{outcome_tag(episode)}</div>'
        f'<p>{lead}</p><ol class="rows">{"".join(rows)}</ol></div>'
    )


def explanation_html(explanation: Explanation) -> str:
    """Why an episode failed: its decisive step beside the better future from that step on."""
    episode = explanation.episode
    head = f'<div class="top"><h3>{escaped(episode.instruction)}</h3>{numbers(episode)}</div>{facts(episode)}'
    decisive = explanation.decisive
    if decisive is None:
        reason = (
            "The episode succeeded: no call decided against it." if episode.success
            else "No single call decided that the episode failed."
        )  # fmt: skip
        return view(f"{head}<p>{reason}</p>", "explanation")
    why = explanation.why or ""
    said = [f"{escaped(why[:1].upper() + why[1:]).rstrip('.')}."] if why else []
    if explanation.cause:
        said.append(f'<span class="soft">Cause: {words_of(explanation.cause)}.</span>')
    record = explanation.record
    if record.get("wasted_steps"):
        said.append(f'<span class="soft">{escaped(record["wasted_steps"])} calls were wasted.</span>')
    at = decisive.index
    sides = [side(episode, at, f"◆ Call {at} decided", "happened", " ".join(said), before=True)]
    better = explanation.better
    if better is not None:
        advised = better.steps[at].call if at < len(better) else ""
        alternative: Record = record.get("alternative") or {}
        who = alternative.get("policy") or better.header["policy"]["name"]
        lead = f"Better: <code>{escaped(advised, 300)}</code>. Policy {escaped(who)} plays from here."
        sides.append(side(better, at, "A better future", "better", lead, before=False))
    else:
        reason = record.get("no_alternative")
        text = f"No better future was kept{': ' + escaped(reason) if reason else '.'}"
        if explanation.advised_call is not None:
            name, arguments = explanation.advised_call
            values = ", ".join(f"{key}={value!r}" for key, value in arguments.items())
            text += f" Better: <code>{escaped(name)}({escaped(values, 300)})</code>."
        sides.append(f'<div class="side"><h4>A better future</h4><p class="soft">{text}</p></div>')
    return view(f'{head}<div class="pair">{"".join(sides)}</div>', "explanation")


def verdict_html(verdict: Verdict) -> str:
    """A verdict and its words."""
    label = tag(("✓ " if verdict.exact else "✕ ") + words_of(verdict.name), "good" if verdict.exact else "bad")
    return view(f'{label} <code style="white-space:pre-wrap">{escaped(verdict.text)}</code>', "verdict")


def comparison_html(comparison: Comparison) -> str:
    """Two episodes, call beside call from the first difference on; rows that differ are marked."""
    record = comparison.record
    same = int(record["same_calls"])
    pairs = cast("list[Record]", record["rows"])
    lines: list[str] = []

    def cell(call: Record | None) -> str:
        if not call:
            return '<td class="number soft">–</td><td></td><td></td>'
        error = f'<b>{escaped(call["error"])}</b>: ' if call.get("error") else ""
        kind = "bad" if error else "soft"
        answer = f'<div class="{kind}">{error}{escaped(call["text"].strip(), 300)}</div>'
        return (
            f'<td class="number soft">{call["call"]}</td><td><code>{escaped(call["call_text"], 300)}</code>{answer}</td>'
            f'<td class="number">{reward_html(call["reward"])}</td>'
        )

    for pair in pairs[:STEPS_MAX]:
        sign = "" if pair["same_call"] and pair["same_outcome"] else "≠ outcome" if pair["same_call"] else "≠"
        mark = "" if pair["same_call"] else ' class="differs"'
        lines.append(f'<tr{mark}>{cell(pair.get("a"))}<td class="soft" style="white-space:nowrap">{sign}</td>{cell(pair.get("b"))}</tr>')
    heads = "<th></th>".join(
        f"<th></th><th>{escaped(episode.path.name, 60)}<small>{outcome_tag(episode)}</small></th><th></th>"
        for episode in (comparison.a, comparison.b)
    )
    if not pairs:
        where = f"All {same} calls are the same."
    else:
        where = f"The first {same} calls are the same." if same else "The episodes differ from the first call on."
    table = f"<table><thead><tr>{heads}</tr></thead><tbody>{''.join(lines)}</tbody></table>"
    return view(f'<p>{where}</p><div class="scroll">{table if pairs else ""}</div>', "comparison")


__all__ = ["comparison_html", "explanation_html", "verdict_html"]
