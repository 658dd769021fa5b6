"""What the tests share: tasks, traces and a store, made once."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

import reel

GOLDEN = Path(__file__).parents[2] / "traces" / "golden"
LONG = bool(os.environ.get("REEL_LONG"))


@pytest.fixture(scope="session")
def golden() -> Path:
    """Folder of traces that every build replays."""
    return GOLDEN


@pytest.fixture(scope="session")
def planner() -> reel.Episode:
    """A successful episode without images."""
    return reel.open(GOLDEN / "FDO_home_0002--planner--4.mcap")


@pytest.fixture(scope="session")
def tasks(tmp_path_factory: pytest.TempPathFactory) -> reel.Tasks:
    """Four tasks in built-in scenes."""
    return reel.Tasks.generate(4, tmp_path_factory.mktemp("tasks"), seed=5)


@pytest.fixture(scope="session")
def played(tasks: reel.Tasks, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of traces of a good and of a bad policy."""
    out = tmp_path_factory.mktemp("traces")
    reel.run(tasks, "oracle", out=out)
    reel.run(tasks, "wrong-receptacle", out=out, images=False)
    return out


@pytest.fixture(scope="session")
def store(played: Path, tmp_path_factory: pytest.TempPathFactory) -> reel.Store:
    """A store of these traces."""
    return reel.Store.ingest(played, tmp_path_factory.mktemp("store") / "store")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Names what was skipped in the form that the repository's tests collect (tests/skips.toml)."""
    for report in terminalreporter.stats.get("skipped", []):
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        need = "chromium" if "Chromium" in reason else "python"
        terminalreporter.write_line(f"skipped: {need}: {report.nodeid}: {reason}")
