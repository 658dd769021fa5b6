"""Tables of a million rows: what crosses into Polars is not copied, and a filter reads its row groups only."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import polars as pl
import pytest

import reel
from reel._command import command

linux = pytest.mark.skipif(sys.platform != "linux", reason="memory and bytes are read from /proc")


def resident() -> int:
    """Bytes of anonymous memory of this process."""
    text = Path("/proc/self/status").read_text()
    found = re.search(r"RssAnon:\s+(\d+) kB", text)
    assert found is not None
    return int(found[1]) * 1024


def bytes_read() -> int:
    """Bytes that this process asked the system for."""
    return int(Path("/proc/self/io").read_text().split()[1])


@linux
def test_a_million_rows_reach_polars_without_a_copy(tmp_path: Path) -> None:
    store = tmp_path / "store"
    command("store", "synthesize", episodes=100_000, store=store)
    table = reel.Store(store).sql("SELECT episode_id, policy, step, tool, reward FROM steps")
    assert len(table) > 1_000_000
    before = resident()
    frame = pl.DataFrame(table)
    grown = resident() - before
    size = frame.estimated_size()
    print(f"{len(frame)} rows, {size >> 20} MiB, {grown >> 20} MiB more memory")
    assert frame.shape == (len(table), 5)
    assert size > 30 << 20 and grown < size / 4


@linux
def test_a_filter_on_the_policy_reads_only_its_row_groups(tmp_path: Path) -> None:
    tasks = reel.Tasks.generate(24, tmp_path / "tasks", seed=11)
    for policy in ("oracle", "planner"):
        reel.run(tasks, policy, out=tmp_path / policy, images=False)
        store = reel.Store.ingest(tmp_path / policy, tmp_path / "store")

    def read(policy: str) -> int:
        before = bytes_read()
        found = store.scan("steps").filter(pl.col("policy") == policy).collect()
        assert found["policy"].unique().to_list() == ([] if policy == "nobody" else [policy])
        return bytes_read() - before

    read("nobody")  # loads modules
    # whatever is asked, the log of the store and the ends of its files are read
    always, oracle, planner = (read(policy) for policy in ("nobody", "oracle", "planner"))
    before = bytes_read()
    assert set(store.scan("steps").collect()["policy"]) == {"oracle", "planner"}
    both = bytes_read() - before
    print(f"bytes read: {always} for none, {oracle} and {planner} for one policy, {both} for both")
    assert min(oracle, planner) > always + 20_000
    assert oracle + planner - 2 * always == pytest.approx(both - always, rel=0.05)
