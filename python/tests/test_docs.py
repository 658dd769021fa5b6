"""The Python of the guides runs as it stands."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
PAGES = [page for page in ("python.md", "python-data.md", "environments.md", "notebooks.md") if (DOCS / page).exists()]


def blocks(page: Path) -> list[str]:
    """The Python blocks of a page; not those after a comment `<!-- test: skip ... -->`."""
    text = page.read_text()
    found = re.findall(r"(<!-- test: skip[^>]*-->\n)?```python\n(.*?)```", text, flags=re.DOTALL)
    return [code for skipped, code in found if not skipped]


@pytest.mark.parametrize("name", PAGES)
def test_the_guide_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    found = blocks(DOCS / name)
    assert found
    for code in found:
        exec(compile(code, name, "exec"), names)
