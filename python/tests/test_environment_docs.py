"""The Python examples of docs/environments.md: those without a trainer run, the others compile."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("gymnasium")

PAGE = Path(__file__).parents[2] / "docs" / "environments.md"
BLOCKS = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)


def test_the_examples_run(tmp_path: Path) -> None:
    ran = 0
    for block in BLOCKS:
        compile(block, str(PAGE), "exec")
        if not re.search(r"from trl|verifiers", block):
            # the package of this test, from another folder
            paths = os.pathsep.join(os.path.abspath(path) for path in sys.path if path)
            ran_block = subprocess.run(
                [sys.executable, "-c", block], cwd=tmp_path, env={**os.environ, "PYTHONPATH": paths},
                capture_output=True, text=True,
            )  # fmt: skip
            assert ran_block.returncode == 0, f"{block}\n{ran_block.stderr}"
            ran += 1
    assert ran == 3
