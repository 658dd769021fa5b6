"""The Python of the guides runs as it stands."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
PAGES = ["python.md", "python-data.md", "notebooks.md", "environments.md", "../README.md"]
# what needs PyTorch, datasets or a trainer is run by the tests of `long`
TRAINERS = re.compile(r"^\s*(from|import) (trl|verifiers|torch)\b|DataLoader|to_hf", re.MULTILINE)


@pytest.mark.parametrize("name", PAGES)
def test_the_guide_runs(name: str, played: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    if name in ("python-data.md", "notebooks.md"):
        # these two begin with traces that are there
        shutil.copytree(played, "traces")
        shutil.copy(next(played.glob("*oracle*")), "episode.mcap")
    names: dict[str, object] = {}
    blocks = re.findall(r"^```python\n(.*?)^```", (DOCS / name).read_text(), flags=re.DOTALL | re.MULTILINE)
    assert blocks
    for code in blocks:
        block = compile(code, name, "exec")
        if not TRAINERS.search(code):
            exec(block, names)
