"""The style of all displays: colours, texts and the frame around them."""

from __future__ import annotations

import html
import re
from importlib.resources import files

TEXT_MAX = 2_000


def packaged(name: str) -> str:
    """A text file that comes with the package."""
    return (files("reel._display") / name).read_text(encoding="utf-8").strip()


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
COLORS = """
.reel-view{LIGHT}
@media (prefers-color-scheme:dark){.reel-view{DARK}}
[data-jp-theme-light="false"] .reel-view,.vscode-dark .reel-view,.vscode-high-contrast .reel-view,html[theme=dark] .reel-view,[data-theme=dark] .reel-view{DARK}
[data-jp-theme-light="true"] .reel-view,.vscode-light .reel-view,html[theme=light] .reel-view,[data-theme=light] .reel-view{LIGHT}
"""
STYLE = COLORS.replace("{DARK}", f"{{{DARK}}}").replace("{LIGHT}", f"{{{LIGHT}}}").lstrip() + packaged("style.css")
"""The style sheet: everything is scoped to `.reel-view`. Notebooks say in attributes and classes
whether they are light or dark; elsewhere the system says it."""


def view(content: str, kind: str, name: str | None = None) -> str:
    """A display with its style sheet. `content` is HTML."""
    id_attribute = f' id="{name}"' if name else ""
    return f'<div class="reel-view {kind}"{id_attribute}><style>{STYLE}</style>{content}</div>'


__all__ = ["DARK", "LIGHT", "STYLE", "escaped", "packaged", "signed", "tag", "view", "words_of"]
