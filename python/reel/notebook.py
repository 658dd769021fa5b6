"""A player of episodes for Jupyter, VS Code, Marimo and Colab, on anywidget.

    from reel.notebook import EpisodePlayer

    player = EpisodePlayer(episode)
    player                      # shows it
    player.call                 # the call that is shown now; -1 before the first
    player.go(7)                # shows another

Unlike the display of an `Episode`, which holds small images of all calls, the player asks for each
image when it is shown, at full size; the kernel has to run.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ._display.episodes import STEPS_MAX
from ._display.images import encoded
from ._display.style import STYLE, packaged, signed
from ._reel import ReelError

try:
    import anywidget
    import traitlets
except ImportError as error:
    raise ReelError(f"reel.notebook needs anywidget: pip install 'reel[notebook]' ({error})") from error

if TYPE_CHECKING:
    from ._episode import Episode, Step


class EpisodePlayer(anywidget.AnyWidget):
    """An episode to scrub through.

    Args:
        episode: the episode.
        call: the call that is shown first; None: before the first one.
    """

    _esm = packaged("player.js")
    _css = STYLE
    title = traitlets.Unicode("").tag(sync=True)
    ending = traitlets.Unicode("").tag(sync=True)
    steps: Any = traitlets.List(traitlets.Dict()).tag(sync=True)
    call: Any = traitlets.Int(-1).tag(sync=True)
    """The call that is shown, from 0; -1 before the first. Observable:
    `player.observe(function, "call")`."""

    def __init__(self, episode: Episode, call: int | None = None) -> None:
        self._episode = episode
        header = episode.header
        super().__init__(
            title=episode.instruction,
            ending=f"{header['task_id']}, policy {header['policy']['name']}, seed {header['seed']}: "
            f"{episode._trace.ending()}",  # pyright: ignore[reportPrivateUsage]
            steps=[described(step) for step in episode.steps[:STEPS_MAX]],
        )
        self.on_msg(self._answer)  # pyright: ignore[reportUnknownMemberType]
        self.go(call)

    @property
    def episode(self) -> Episode:
        """The episode that is shown."""
        return self._episode

    @property
    def step(self) -> Step | None:
        """The step that is shown; None before the first."""
        return None if self.call < 0 else self._episode.steps[int(self.call)]

    def go(self, call: int | None) -> None:
        """Shows another call, from 0; None: before the first. Negative ones count from the end."""
        count = len(self.steps)
        at = -1 if call is None else call + count if call < 0 else call
        if not -1 <= at < count:
            raise ReelError(f"unknown call {call}: the episode has {count} calls, from 0")
        self.call = at

    def _answer(self, _widget: Any, content: Any, _buffers: Any) -> None:
        """Sends the image that the page asks for: that of the call, else the latest before it."""
        wanted = content.get("frame") if isinstance(content, dict) else None  # pyright: ignore
        if not isinstance(wanted, int) or not -1 <= wanted < len(self._episode):
            return
        try:
            for call in range(wanted, -2, -1):
                image = self._episode.frame(None if call < 0 else call)
                if image is not None:
                    kind, data = encoded(image, quality=88)
                    self._reply({"frame": wanted, "of": call, "type": kind}, [data])
                    return
        except ReelError:
            # a robot's episode without images, or one of another simulator version
            pass
        self._reply({"frame": wanted, "of": None, "type": ""}, [])

    def _reply(self, content: dict[str, Any], buffers: list[bytes]) -> None:
        self.send(content, buffers=buffers)  # pyright: ignore[reportUnknownMemberType]


def described(step: Step) -> dict[str, Any]:
    """What the page shows of a step, as plain values."""
    said: dict[str, Any] = step.record["input"].get("policy") or {}
    more = [[name.capitalize(), str(said[name])] for name in ("reasoning", "history", "plan") if said.get(name)]
    more += [[term["component"], f"{signed(term['value'])} {term.get('reason', '')}"] for term in step.record["reward"]]
    reply = step.record.get("reply")
    reward = step.reward
    return {
        "call": step.call,
        "text": (reply["text"] if reply and not step.error else step.text).strip(),
        "error": step.error or "",
        "reward": reward,
        "reward_text": "" if abs(reward) < 0.005 else signed(reward),
        "more": more,
    }


__all__ = ["EpisodePlayer"]
