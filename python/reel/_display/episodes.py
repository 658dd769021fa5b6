"""An episode: its facts, the contact strip of all calls, and the panel that scrubs through them."""

from __future__ import annotations

import secrets
from typing import TYPE_CHECKING, cast

from .._types import Record
from .images import data_uris, frames_of
from .style import escaped, packaged, signed, tag, view, words_of

if TYPE_CHECKING:
    from .._episode import Episode, Step

STEPS_MAX = 400
TRANSCRIPT_MAX = 200_000


def outcome_tag(episode: Episode) -> str:
    """How an episode ended, as a label."""
    if episode.success is None:
        return tag("broken off", "bad")
    return tag("✓ success", "good") if episode.success else tag("✕ failure", "bad")


def facts(episode: Episode) -> str:
    """Outcome, task, policy and seed in a line."""
    header = episode.header
    items = [outcome_tag(episode)]
    if episode.end:
        items.append(tag(words_of(episode.end["reason"])))
    items.append(f"<span>{escaped(header['task_id'])}</span>")
    items.append(f'<span><span class="soft">policy</span> {escaped(header["policy"]["name"])}</span>')
    items.append(f'<span><span class="soft">seed</span> {escaped(header["seed"])}</span>')
    if header.get("parent"):
        items.append(f'<span class="soft">branch at call {escaped(header["parent"]["call"])}</span>')
    return f'<div class="facts">{"".join(items)}</div>'


def numbers(episode: Episode) -> str:
    """The metrics of an episode."""
    metrics = cast("Record", (episode.end or {}).get("metrics") or {})
    values = [("Reward", f"{episode.total_reward:.2f}".replace("-", "−"))]
    if "completion" in metrics:
        values.append(("CR", f"{metrics['completion']:.0%}"))
    if metrics.get("spl") is not None:
        values.append(("SPL", f"{metrics['spl']:.2f}"))
    values.append(("Calls", str(len(episode))))
    if "asks" in metrics:
        values.append(("Asked", str(metrics["asks"])))
    cells = "".join(f"<div><dt>{name}</dt><dd>{escaped(value)}</dd></div>" for name, value in values)
    return f'<dl class="numbers">{cells}</dl>'


def reward_html(value: float) -> str:
    """A reward, coloured; empty if it is about zero."""
    if abs(value) < 0.005:
        return ""
    return f'<span class="reward {"bad" if value < 0 else "good"}">{signed(value)}</span>'


def answer_html(step: Step) -> str:
    """What the agent was answered."""
    reply = step.record.get("reply")
    if reply and not step.error:
        return f'<div class="answer">{escaped(reply["text"])} <span class="soft">({escaped(reply["source"])})</span></div>'
    text = step.text.strip()
    if step.error:
        return f'<div class="answer bad">✕ <b>{escaped(step.error)}</b>: {escaped(text)}</div>'
    return f'<div class="answer soft">{escaped(text)}</div>'


def more_html(step: Step) -> str:
    """What the agent said with a call, what changed, and the reward terms."""
    said = cast("Record", step.record["input"].get("policy") or {})
    lines: list[tuple[str, str]] = [
        (name.capitalize(), escaped(said[name])) for name in ("reasoning", "history", "plan") if said.get(name)
    ]
    terms = [
        f'<b class="{"bad" if term["value"] < 0 else "good"}">{signed(term["value"])}</b> '
        f"{escaped(term['component'])}, {escaped(term.get('reason', ''))}"
        for term in step.record["reward"]
    ]
    if terms:
        lines.append(("Reward", "\n".join(terms)))
    if not lines:
        return ""
    cells = "".join(f"<dt>{name}</dt><dd>{value}</dd>" for name, value in lines)
    return f'<div class="more"><dl>{cells}</dl></div>'


def about_step(step: Step, mark: str = "", more: bool = True) -> str:
    """Call, answer and reward of a step; `more` adds what the agent said. `mark` is HTML."""
    return (
        f'<div class="about"><div class="line"><span class="soft">call {step.index}</span>{reward_html(step.reward)}</div>'
        f'<div class="call"><code>{escaped(step.call, 300)}</code></div>{answer_html(step)}{mark}{more_html(step) if more else ""}</div>'
    )


def about_start(episode: Episode) -> str:
    """What holds before the first call: the task."""
    task = episode.task
    pairs = [("Target", "target"), ("From", "src"), ("To", "dest")]
    cells = "".join(f"<dt>{name}</dt><dd>{escaped(task[key])}</dd>" for name, key in pairs if task.get(key))
    more = f'<div class="more"><dl>{cells}</dl></div>' if cells else ""
    return (
        '<div class="about"><div class="line"><span class="soft">start</span></div>'
        f'<div class="answer soft">before the first call</div>{more}</div>'
    )


def strip(episode: Episode, decisive: int | None = None) -> str:
    """The contact strip: an image and a text for each call."""
    count = min(len(episode), STEPS_MAX)
    images = data_uris(frames_of(episode, range(-1, count)))
    items: list[str] = []

    def item(call: int, kind: str, about: str) -> None:
        address = images.get(call)
        image = f'<img alt="call {call}" src="{address}">' if address else '<div class="blank">no new image</div>'
        items.append(f'<li data-call="{call}" class="{kind}">{image}{about}</li>')

    item(-1, "start", about_start(episode))
    for step in episode.steps[:count]:
        mark = '<div class="bad">◆ decisive</div>' if step.index == decisive else ""
        kind = ("failed" if step.error else "") + (" decisive" if step.index == decisive else "")
        item(step.index, kind.strip(), about_step(step, mark))
    if len(episode) > count:
        items.append(f'<li class="start"><div class="about">and {len(episode) - count} more calls</div></li>')
    return f'<ol class="strip">{"".join(items)}</ol>'


# The panel copies nodes of the strip, so no text of a trace is ever parsed as HTML again.
SCRIPT = packaged("panel.js")

STAGE = (
    '<div class="stage" hidden><div class="seen"><img alt=""><span hidden></span></div><div class="now" aria-live="polite"></div>'
    '<div class="clock"><button type="button" aria-label="one call back">‹</button>'
    '<input type="range" min="0" max="1" value="0" aria-label="call"><button type="button" aria-label="one call on">›</button>'
    "<output></output></div></div>"
)


def episode_html(episode: Episode) -> str:
    """An episode: header, scrubber, contact strip and transcript. Without scripts the strip has
    everything that the scrubber shows."""
    name = f"reel-{secrets.token_hex(6)}"
    transcript = escaped(episode.transcript(), TRANSCRIPT_MAX)
    content = (
        f'<div class="top"><h3>{escaped(episode.instruction)}</h3>{numbers(episode)}</div>{facts(episode)}'
        f"{STAGE}{strip(episode)}<details><summary>Transcript</summary><pre>{transcript}</pre></details>"
        f"<script>{SCRIPT.replace('NAME', name)}</script>"
    )
    return view(content, "episode", name)


__all__ = ["STEPS_MAX", "about_step", "episode_html", "facts", "numbers", "outcome_tag", "reward_html"]
