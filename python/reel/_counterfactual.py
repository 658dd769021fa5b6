"""Other futures of a recorded episode: forks, what explains a failure, and comparisons."""

from __future__ import annotations

from typing import TYPE_CHECKING

from . import _reel
from ._arguments import place_in_group
from ._simulation import Call, Simulation, as_call, recording
from ._types import PathLike, Record

if TYPE_CHECKING:
    from ._episode import Episode, Step


class Fork:
    """The state of a recorded episode before one of its calls."""

    def __init__(self, episode: Episode, point: _reel.ForkPoint) -> None:
        self.episode = episode
        self._point = point

    @property
    def call(self) -> int:
        """The first call that may differ."""
        return self._point.calls

    def play(
        self,
        *,
        policy: str = "python",
        record: PathLike | None = None,
        images: bool = True,
        group: tuple[str, int] | None = None,
    ) -> Simulation:
        """An episode that went as the recorded one up to here, to go on with.

        Args:
            policy: name of who decides from now on, for the trace.
            record: the trace to write; None: it is not recorded.
            images: whether images are rendered (and recorded). Without them it takes a third of the
                time; everything else is the same.
            group: prompt group and index in it, for the trace.
        """
        to = None if record is None else recording(record, images)
        place = place_in_group(group)
        return Simulation(self._point.open(policy=policy, group=place, images=images, record=to), record)

    def __repr__(self) -> str:
        return f"<Fork before call {self.call} of {self.episode.path.name}>"


class Explanation:
    """Why an episode failed: its decisive step, and a future that was better."""

    def __init__(self, episode: Episode, record: Record) -> None:
        self.episode = episode
        self.record = record

    @property
    def _decisive(self) -> Record:
        return self.record.get("decisive") or {}

    @property
    def decisive(self) -> Step | None:
        """The decision after which a competent agent would no longer have succeeded as cheaply; None
        if no single one decided."""
        found = self._decisive
        return self.episode.steps[int(found["step"])] if found else None

    @property
    def cause(self) -> str | None:
        """The class of the mistake."""
        return self._decisive.get("cause")

    @property
    def why(self) -> str | None:
        """The explanation in words."""
        return self._decisive.get("explanation")

    @property
    def advised_call(self) -> Call | None:
        """The call that would have been better: tool and arguments, as `Episode.branch` and
        `Simulation.step` take them; None if there is none."""
        advised = self._decisive.get("advised_call")
        return as_call(advised) if advised else None

    @property
    def better(self) -> Episode | None:
        """The future that was played instead, if one was found and kept."""
        from ._episode import open

        found: Record = self.record.get("alternative") or {}
        return open(found["trace"]) if found.get("trace") else None

    def __repr__(self) -> str:
        if self.decisive is None:
            return f"<Explanation of {self.episode.path.name}: no decisive step>"
        return f"<Explanation: call {self.decisive.index} {self.decisive.call}: {self.why}>"

    def _repr_html_(self) -> str:
        from ._display import explanation_html

        return explanation_html(self)


class Comparison:
    """Two episodes of one task, call by call."""

    def __init__(self, a: Episode, b: Episode, record: Record) -> None:
        self.a = a
        self.b = b
        self.record = record

    @property
    def calls(self) -> list[Record]:
        """Pairs of calls from the first difference on: `a`, `b`, `same_call`, `same_outcome`."""
        return self.record["rows"]

    @property
    def first_difference(self) -> int | None:
        """Index of the first call that differs, in itself or in what came of it."""
        return self.record["same_calls"] if self.calls else None

    def __repr__(self) -> str:
        first = self.first_difference
        where = "no call differs" if first is None else f"the first difference is at call {first}"
        return f"<Comparison of {self.a.path.name} and {self.b.path.name}: {where}>"

    def _repr_html_(self) -> str:
        from ._display import comparison_html

        return comparison_html(self)


__all__ = ["Comparison", "Explanation", "Fork"]
