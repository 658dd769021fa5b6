"""The episodes that rows belong to: traces, digests and verdicts."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .._reel import SIM_VERSION
from ._rows import PackedRows

if TYPE_CHECKING:
    from .._store import Store

UNVERIFIED = "unverified"
"""The verdict of an episode without a replay."""


class EpisodeTable:
    """The episodes that rows belong to."""

    def __init__(self, known: bool, episode_of: NDArray[np.int32]) -> None:
        self.known = known
        """Whether rows name their episode."""
        self.episode_of = episode_of
        """Index of each row's episode in the lists; -1: none."""
        self.traces: list[str] = []
        self.digests: list[str] = []
        self.verdicts: list[str] = []

    @classmethod
    def read(cls, store: Store, rows: PackedRows) -> EpisodeTable:
        """Looks up the episodes of rows: trace, digest, and the verdict for this simulator version."""
        episode_of = np.full(len(rows), -1, dtype=np.int32)
        if "episode_id" not in rows.columns:
            return cls(False, episode_of)
        table = cls(True, episode_of)
        # one file may have been replayed twice: the worst finding counts
        sql = """
            SELECT e.episode_id, e.trace, e.trace_digest, v.verdict
            FROM episodes e
            LEFT JOIN (
              SELECT
                trace_digest,
                CASE
                  WHEN bool_and(verdict = 'exact') THEN 'exact'
                  WHEN bool_or(verdict = 'diverged') THEN 'diverged'
                  ELSE max(verdict)
                END AS verdict
              FROM verdicts
              -- samples may have frames: a replay that compared no colours does not settle them
              WHERE sim_version = CAST($sim_version AS INT) AND verdict NOT LIKE '%_without_rgb'
              GROUP BY trace_digest
            ) v ON v.trace_digest = e.trace_digest"""
        found = store.sql(sql, parameters={"sim_version": SIM_VERSION}).rows()
        by_id = {row["episode_id"]: row for row in found}
        indices: dict[str, int] = {}
        for at, episode_id in enumerate(rows.column("episode_id")):
            index = indices.get(episode_id)
            if index is None:
                row = by_id.get(episode_id)
                if row is None:
                    continue
                index = indices[episode_id] = len(table.traces)
                table.traces.append(row["trace"])
                table.digests.append(row["trace_digest"])
                table.verdicts.append(row.get("verdict") or UNVERIFIED)
            episode_of[at] = index
        return table


__all__ = ["UNVERIFIED", "EpisodeTable"]
