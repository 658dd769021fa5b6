"""What notebooks show: episodes, explanations, tables and failure flows as HTML.

Every display stands alone: no network, no library, one scoped style sheet. Texts of traces and
tables are untrusted, so all of them go through `escaped`; the script of an episode is a constant that
moves elements and parses no text.
"""

from __future__ import annotations

import base64
import html
import importlib.util
import json
import os
import re
import secrets
import struct
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from ._reel import ReelError
from ._types import Image

if TYPE_CHECKING:
    from ._episode import Comparison, Episode, Explanation, Step, Verdict
    from ._store import Store, Table

Record = dict[str, Any]

BYTES_MAX = 1_400_000
"""Largest size of the images in one display, bytes of base64."""
STEPS_MAX = 400
TEXT_MAX = 2_000
TRANSCRIPT_MAX = 200_000
RENDERED_MAX = 16
"""Images that are rendered again for the strip of a trace without images."""


# --- texts


def escaped(text: object, length_max: int = TEXT_MAX) -> str:
    """Text for HTML, in elements and in quoted attributes; cut if it is too long. Control
    characters are replaced."""
    words = str(text)
    if len(words) > length_max:
        words = words[: length_max - 1] + "…"
    words = re.sub(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f\ud800-\udfff\u202a-\u202e\u2066-\u2069]", "�", words)
    return html.escape(words, quote=True)


def signed(value: float) -> str:
    """A reward: with its sign, two decimals."""
    return f"{value:+.2f}".replace("-", "−")


def words_of(name: object) -> str:
    """A name of the tables as words: `missing_ask` is `missing ask`."""
    return escaped(str(name).replace("_", " "))


def tag(text: str, kind: str = "") -> str:
    """A label; `text` is HTML."""
    return f'<span class="tag {kind}">{text}</span>'


# The colours of the dashboards (dashboards/src/app.css, palette.ts).
LIGHT = (
    "--paper:#fbfaf7;--card:#fff;--sunk:#f1efe9;--line:#dcd8ce;--ink:#1d2226;--soft:#565f66;--accent:#1f6660;"
    "--accent-sunk:#e0efed;--good:#2c6e37;--bad:#a8352b;--bad-sunk:#f9e6e3;--c0:#1f6660;--c1:#7aa6d6;--c2:#a8352b;"
    "--c3:#c99a2e;--c4:#7d6aa8;--c5:#7d868c;--scheme:light"
)
DARK = (
    "--paper:#14171a;--card:#1b1f23;--sunk:#101215;--line:#333a41;--ink:#e8e6e1;--soft:#a3abb2;--accent:#6fc3ba;"
    "--accent-sunk:#1d3330;--good:#7cc489;--bad:#ef8a80;--bad-sunk:#3a211f;--c0:#6fc3ba;--c1:#6f9fd6;--c2:#ef8a80;"
    "--c3:#e2b55b;--c4:#a998d6;--c5:#8d969c;--scheme:dark"
)
RULES = """
.reel-view{LIGHT}
@media (prefers-color-scheme:dark){.reel-view{DARK}}
[data-jp-theme-light="false"] .reel-view,.vscode-dark .reel-view,.vscode-high-contrast .reel-view,html[theme=dark] .reel-view,[data-theme=dark] .reel-view{DARK}
[data-jp-theme-light="true"] .reel-view,.vscode-light .reel-view,html[theme=light] .reel-view,[data-theme=light] .reel-view{LIGHT}
.reel-view{color-scheme:var(--scheme);font:14px/1.45 system-ui,"Segoe UI","Helvetica Neue","DejaVu Sans",sans-serif;color:var(--ink);background:var(--paper);border:1px solid var(--line);border-radius:8px;padding:12px;max-width:1100px;margin:2px 0;box-sizing:border-box}
.reel-view *{box-sizing:border-box}
.reel-view h3{font-size:16px;line-height:1.3;font-weight:600;margin:0;color:var(--ink)}
.reel-view h4{font-size:14px;font-weight:600;margin:0;color:var(--ink)}
.reel-view p{margin:0}
.reel-view code,.reel-view pre{font-family:ui-monospace,"SF Mono","Cascadia Mono","DejaVu Sans Mono",monospace;font-size:.9em;background:none;color:inherit;padding:0;border:0}
.reel-view .top{display:flex;gap:16px;justify-content:space-between;align-items:flex-start}
.reel-view .facts{display:flex;flex-wrap:wrap;gap:4px 10px;align-items:center;margin:6px 0 10px;font-size:13px}
.reel-view .numbers{display:flex;gap:16px;margin:0;flex:none}
.reel-view .numbers dt{font-size:11px;color:var(--soft);font-weight:400;margin:0;text-align:right}
.reel-view .numbers dd{margin:0;font-weight:600;text-align:right;font-variant-numeric:tabular-nums}
.reel-view .soft{color:var(--soft)}.reel-view .good{color:var(--good)}.reel-view .bad{color:var(--bad)}
.reel-view .tag{display:inline-block;padding:0 8px;border-radius:10px;background:var(--sunk);font-size:13px;white-space:nowrap}
.reel-view .tag.good{background:var(--accent-sunk)}.reel-view .tag.bad{background:var(--bad-sunk)}
.reel-view .stage{display:grid;grid-template-columns:minmax(0,480px) minmax(0,1fr);gap:12px;margin-bottom:10px}
.reel-view .stage[hidden]{display:none}
.reel-view .stage>.seen{position:relative;background:var(--sunk);border-radius:6px;overflow:hidden;aspect-ratio:4/3}
.reel-view .stage>.seen img{display:block;width:100%;height:100%;object-fit:contain;margin:0;max-width:none}
.reel-view .stage>.seen span{position:absolute;left:8px;bottom:8px;background:var(--card);color:var(--soft);border-radius:4px;padding:1px 6px;font-size:12px}
.reel-view .stage>.now{background:var(--card);border:1px solid var(--line);border-radius:6px;padding:10px 12px;overflow:auto;max-height:360px}
.reel-view .clock{grid-column:1/-1;display:flex;gap:8px;align-items:center}
.reel-view .clock input{flex:1;min-width:0;accent-color:var(--accent);margin:0}
.reel-view .clock output{min-width:80px;text-align:right;font-variant-numeric:tabular-nums;font-weight:600}
.reel-view button{font:inherit;color:var(--ink);background:var(--card);border:1px solid var(--line);border-radius:6px;padding:1px 10px;cursor:pointer}
.reel-view button:disabled{opacity:.5;cursor:default}
.reel-view .strip{list-style:none;display:flex;gap:8px;margin:0;padding:2px 2px 8px;overflow-x:auto}
.reel-view .strip>li{flex:0 0 148px;margin:0;background:var(--card);border:1px solid var(--line);border-top:3px solid var(--good);border-radius:6px;overflow:hidden}
.reel-view .strip>li.failed{border-top-color:var(--bad)}.reel-view .strip>li.start{border-top-color:var(--soft)}
.reel-view .strip>li.decisive{box-shadow:0 0 0 2px var(--bad)}
.reel-view .strip.live>li{cursor:pointer}
.reel-view .strip>li[aria-current]{outline:2px solid var(--accent);outline-offset:1px}
.reel-view .strip img,.reel-view .strip .blank{display:block;width:100%;aspect-ratio:4/3;object-fit:cover;margin:0;max-width:none;background:var(--sunk)}
.reel-view .strip .blank{display:grid;place-items:center;color:var(--soft);font-size:12px}
.reel-view .strip .about{padding:5px 7px 7px;font-size:12px;line-height:1.35}
.reel-view .strip .answer{display:-webkit-box;-webkit-line-clamp:3;-webkit-box-orient:vertical;overflow:hidden}
.reel-view .strip .call{display:-webkit-box;-webkit-line-clamp:2;-webkit-box-orient:vertical;overflow:hidden}
.reel-view .strip .more{display:none}
.reel-view .about .line{display:flex;justify-content:space-between;gap:8px}
.reel-view .about .call{font-weight:600;overflow-wrap:anywhere}
.reel-view .about .answer{white-space:pre-line;overflow-wrap:anywhere;margin-top:2px}
.reel-view .about .reward{font-variant-numeric:tabular-nums;white-space:nowrap}
.reel-view .now .line{font-size:13px}.reel-view .now .call{font-size:15px}
.reel-view .now .more dl,.reel-view .rows .more dl,.reel-view dl.more{display:grid;grid-template-columns:76px 1fr;gap:3px 10px;margin:8px 0 0;font-size:13px}
.reel-view .more dt{color:var(--soft);font-weight:400;margin:0}.reel-view .more dd{margin:0;overflow-wrap:anywhere;white-space:pre-line}
.reel-view details{margin-top:4px}.reel-view summary{cursor:pointer;color:var(--accent)}
.reel-view details pre{max-height:420px;overflow:auto;background:var(--sunk);border-radius:6px;padding:10px;margin:6px 0 0;white-space:pre-wrap;overflow-wrap:anywhere;line-height:1.4;font-size:12px}
.reel-view .pair{display:grid;grid-template-columns:repeat(2,minmax(0,1fr));gap:12px;margin-top:10px}
.reel-view .side{background:var(--card);border:1px solid var(--line);border-top:3px solid var(--bad);border-radius:6px;padding:10px 12px;min-width:0}
.reel-view .side.better{border-top-color:var(--good)}
.reel-view .rows{list-style:none;margin:8px 0 0;padding:0}
.reel-view .rows>li{display:grid;grid-template-columns:96px minmax(0,1fr);gap:10px;padding:6px 0;margin:0;border-top:1px solid var(--line);font-size:13px}
.reel-view .rows>li.first{grid-template-columns:minmax(0,1fr);border-top:0}
.reel-view .rows img,.reel-view .rows .blank{width:100%;aspect-ratio:4/3;object-fit:cover;border-radius:4px;margin:0;display:block;background:var(--sunk);max-width:none}
.reel-view .scroll{overflow-x:auto}
.reel-view table{border-collapse:collapse;font-size:13px;font-variant-numeric:tabular-nums;margin:0;background:none;border:0;color:inherit}
.reel-view table th,.reel-view table td{padding:4px 10px;border:0;border-bottom:1px solid var(--line);text-align:left;vertical-align:top;background:none;color:inherit;max-width:420px;overflow-wrap:break-word}
.reel-view table th{font-weight:600;white-space:nowrap}.reel-view table th small{display:block;font-weight:400;color:var(--soft)}
.reel-view table .number{text-align:right;white-space:nowrap}
.reel-view table tr.differs td{background:var(--bad-sunk)}
.reel-view svg{display:block;width:100%;height:auto}
@media (max-width:700px){.reel-view .stage,.reel-view .pair{grid-template-columns:minmax(0,1fr)}.reel-view .top{flex-wrap:wrap}}
@media print{.reel-view .strip{flex-wrap:wrap;overflow:visible}}
"""
STYLE = RULES.replace("{DARK}", f"{{{DARK}}}").replace("{LIGHT}", f"{{{LIGHT}}}").strip()
"""The style sheet: everything is scoped to `.reel-view`. Notebooks say in attributes and classes
whether they are light or dark; elsewhere the system says it."""


def view(content: str, kind: str, name: str | None = None) -> str:
    """A display with its style sheet. `content` is HTML."""
    id_attribute = f' id="{name}"' if name else ""
    return f'<div class="reel-view {kind}"{id_attribute}><style>{STYLE}</style>{content}</div>'


# --- images


def encoded(image: Image, reduce: int = 1, quality: int = 80) -> tuple[str, bytes]:
    """An image as a file and its type: JPEG by Pillow where it is installed, else PNG with five
    bits a channel.

    Args:
        image: height x width x 3, uint8, RGB.
        reduce: factor by which both sides get smaller.
        quality: of JPEG, 1 to 95.
    """
    if importlib.util.find_spec("PIL") is not None:
        import io

        from PIL import Image as Pillow

        pillow_image = Pillow.fromarray(image)
        if reduce > 1:
            pillow_image = pillow_image.reduce(reduce)
        out = io.BytesIO()
        pillow_image.save(out, "JPEG", quality=quality)
        return "image/jpeg", out.getvalue()
    return "image/png", png(reduced(image, reduce) & np.uint8(0xF8))


def reduced(image: Image, factor: int) -> Image:
    """An image with sides smaller by a factor: means of blocks."""
    if factor == 1:
        return image
    height, width = image.shape[0] // factor, image.shape[1] // factor
    blocks = image[: height * factor, : width * factor].reshape(height, factor, width, factor, 3)
    return blocks.mean(axis=(1, 3)).round().astype(np.uint8)


def png(image: Image) -> bytes:
    """An RGB image as a PNG file."""
    height, width, _ = image.shape
    # filter 2: each line as the difference to the one above
    lines = np.empty((height, 1 + width * 3), dtype=np.uint8)
    lines[:, 0] = 2
    flat = image.reshape(height, width * 3)
    lines[0, 1:] = flat[0]
    lines[1:, 1:] = flat[1:] - flat[:-1]

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    packed = chunk(b"IDAT", zlib.compress(lines.tobytes(), 9))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + packed + chunk(b"IEND", b"")


def data_uri(image: Image, reduce: int, quality: int) -> str:
    """An image as an address that holds it."""
    kind, data = encoded(image, reduce, quality)
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


SIZES = ((2, 78), (4, 72), (5, 65), (8, 60))
"""Reductions and qualities that are tried, the best first."""


def data_uris(images: Mapping[int, Image], bytes_max: int = BYTES_MAX) -> dict[int, str]:
    """Images as addresses, as good as fit; if even the smallest do not fit, evenly spread ones."""
    keys = list(images)
    if not keys:
        return {}
    probe = keys[:: max(1, len(keys) // 4)]
    for reduce, quality in SIZES:
        estimate = sum(len(data_uri(images[key], reduce, quality)) for key in probe) / len(probe)
        if estimate * len(keys) > bytes_max * 1.1:
            continue
        made = {key: data_uri(image, reduce, quality) for key, image in images.items()}
        if sum(map(len, made.values())) <= bytes_max:
            return made
    reduce, quality = SIZES[-1]
    made = {key: data_uri(image, reduce, quality) for key, image in images.items()}
    count = len(keys)
    while sum(map(len, made.values())) > bytes_max:
        count = count * 3 // 4
        wanted = {keys[round(place * (len(keys) - 1) / max(count - 1, 1))] for place in range(count)}
        made = {key: address for key, address in made.items() if key in wanted}
    return made


def frames_of(episode: Episode, calls: Iterable[int]) -> dict[int, Image]:
    """The images that calls returned (-1: before the first), as far as there are any. Of traces
    without images only some are rendered; none if the episode cannot be executed again."""
    wanted = list(calls)
    if not episode._trace.image_count:  # pyright: ignore[reportPrivateUsage]
        wanted = wanted[:: max(1, -(-len(wanted) // RENDERED_MAX))]
    found: dict[int, Image] = {}
    for call in wanted:
        try:
            image = episode.frame(None if call < 0 else call)
        except ReelError:
            # a robot's episode, or one of another simulator version: its texts are shown
            if not episode._trace.image_count:  # pyright: ignore[reportPrivateUsage]
                return found
            continue
        if image is not None:
            found[call] = image
    return found


# --- parts of episodes


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
    metrics = cast(Record, (episode.end or {}).get("metrics") or {})
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
    said = cast(Record, step.record["input"].get("policy") or {})
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
SCRIPT = """
(function(){
var root=document.getElementById("NAME");
if(!root||root.dataset.ready)return;
root.dataset.ready="1";
var strip=root.querySelector(".strip"),stage=root.querySelector(".stage"),range=stage.querySelector("input"),
items=Array.prototype.slice.call(strip.querySelectorAll("li[data-call]")),buttons=stage.querySelectorAll("button"),
shown=stage.querySelector(".seen img"),note=stage.querySelector(".seen span"),now=stage.querySelector(".now"),place=stage.querySelector("output");
function show(at,scroll){
at=Math.max(0,Math.min(items.length-1,at));
var seen=at;
while(seen>0&&!items[seen].querySelector("img"))seen--;
var image=items[seen].querySelector("img");
if(image){shown.src=image.src;shown.alt=image.alt;}
shown.style.visibility=image?"visible":"hidden";
note.hidden=!!image&&seen===at;
note.textContent=image?"no new image: the latest one":"no image";
now.replaceChildren(items[at].querySelector(".about").cloneNode(true));
range.value=at;
place.textContent=at===0?"start":"call "+(at-1)+" of "+(items.length-1);
items.forEach(function(item,index){if(index===at)item.setAttribute("aria-current","step");else item.removeAttribute("aria-current");});
buttons[0].disabled=at===0;buttons[1].disabled=at===items.length-1;
if(scroll){var item=items[at],left=item.offsetLeft-strip.offsetLeft;
if(left<strip.scrollLeft||left+item.offsetWidth>strip.scrollLeft+strip.clientWidth)strip.scrollLeft=left-strip.clientWidth/2+item.offsetWidth/2;}
}
range.max=items.length-1;
range.addEventListener("input",function(){show(Number(range.value),true);});
buttons[0].addEventListener("click",function(){show(Number(range.value)-1,true);});
buttons[1].addEventListener("click",function(){show(Number(range.value)+1,true);});
items.forEach(function(item,index){item.addEventListener("click",function(){show(index,false);});});
strip.classList.add("live");stage.hidden=false;
show(Number(root.dataset.at||0),true);
})();
"""

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
        f"<script>{SCRIPT.replace('NAME', name).strip()}</script>"
    )
    return view(content, "episode", name)


# --- explanations, verdicts, comparisons

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
        advice = record["decisive"].get("advised_call")
        if advice:
            values = ", ".join(f"{key}={value!r}" for key, value in advice["arguments"].items())
            text += f" Better: <code>{escaped(advice['name'])}({escaped(values, 300)})</code>."
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


# --- tables

TABLE_ROWS_MAX = 50
TABLE_COLUMNS_MAX = 60
CELL_MAX = 200


def type_name(values: Iterable[Any]) -> str:
    """The type of a column, from the values that are shown; empty if they are mixed or all null."""
    kinds = {
        "boolean" if isinstance(value, bool)
        else "integer" if isinstance(value, int)
        else "float" if isinstance(value, float)
        else "text" if isinstance(value, str)
        else "list" if isinstance(value, (list, tuple))
        else "struct"
        for value in values
        if value is not None
    }  # fmt: skip
    if kinds == {"integer", "float"}:
        return "float"
    return kinds.pop() if len(kinds) == 1 else ""


def cell_html(value: Any) -> str:
    """A value of a table."""
    match value:
        case None:
            return '<span class="soft">null</span>'
        case bool():
            return "true" if value else "false"
        case float():
            return escaped(f"{value + 0.0:.6g}")
        case list() | dict() | tuple():
            return f"<code>{escaped(json.dumps(value, ensure_ascii=False, default=str), CELL_MAX)}</code>"
        case _:
            return escaped(value, CELL_MAX)


def table_html(table: Table) -> str:
    """The first rows of a table."""
    count = len(table)
    rows = table.rows(0, min(count, TABLE_ROWS_MAX))
    columns = table.columns[:TABLE_COLUMNS_MAX]
    types = {name: type_name(row.get(name) for row in rows) for name in columns}
    number = {name: ' class="number"' if types[name] in ("integer", "float") else "" for name in columns}
    heads = "".join(f"<th{number[name]}>{escaped(name, 80)}<small>{types[name]}</small></th>" for name in columns)
    lines = "".join(
        f"<tr>{''.join(f'<td{number[name]}>{cell_html(row.get(name))}</td>' for name in columns)}</tr>" for row in rows
    )
    left = len(table.columns) - len(columns)
    notes = [f"{count:,} row{'s' * (count != 1)}"]
    if count > len(rows):
        notes.append(f"the first {len(rows)} are shown")
    if left > 0:
        notes.append(f"{left} columns are not shown")
    body = f'<div class="scroll"><table><thead><tr>{heads}</tr></thead><tbody>{lines}</tbody></table></div>' if columns else ""
    return view(f'{body}<p class="soft" style="margin-top:6px">{"; ".join(notes)}</p>', "table")


# --- the flow of failures

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
    from ._store import Store

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


__all__ = [
    "Flow", "Sankey", "comparison_html", "episode_html", "explanation_html", "sankey", "table_html", "verdict_html",
]  # fmt: skip
