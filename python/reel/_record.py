"""Recording any MCP tool server: the proxy `reel record` in a process of its own."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from pathlib import Path

from ._command import Argument, flags
from ._episode import Episode, open, trace_paths
from ._program import environment, program
from ._reel import ReelError
from ._types import PathLike


def _end_with_the_parent() -> None:
    """Asks Linux to end this process with the one that started it, so that a killed kernel leaves
    no recorder behind."""
    if sys.platform == "linux":
        import ctypes

        set_parent_death_signal = 1
        ctypes.CDLL(None).prctl(set_parent_death_signal, signal.SIGINT)


class Recorder:
    """A proxy between agents and a tool server that records their episodes. Agents connect to `url`.

    As a context manager it is closed at the end of the block.
    """

    def __init__(self, process: subprocess.Popen[str], url: str, out: Path) -> None:
        self._process = process
        self.url = url
        """Where agents connect."""
        self.out = out
        """Folder of the traces."""
        self._said = threading.Thread(target=self._drain, daemon=True)
        self._said.start()

    def _drain(self) -> None:
        # a full pipe would stop the recorder
        assert self._process.stdout is not None
        for _ in self._process.stdout:
            pass

    def episodes(self) -> list[Episode]:
        """The episodes that are finished."""
        return [open(path) for path in trace_paths(self.out)] if any(self.out.rglob("*.mcap")) else []

    def close(self) -> None:
        """Ends the recording; what runs is finished as broken off."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            try:
                self._process.wait(timeout=30)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def check_upstream(upstream: str | Sequence[str]) -> None:
    """Refuses a server that cannot be started: the recorder starts it when an agent connects."""
    if isinstance(upstream, str):
        if any(letter.isspace() for letter in upstream):
            raise ReelError(
                f"a server's URL has no spaces: '{upstream}'; give a command line as a list: {shlex.split(upstream)}"
            )
    elif not upstream:
        raise ReelError("the command line of the server is empty; give its program and its arguments")
    elif shutil.which(upstream[0]) is None:
        raise ReelError(
            f"no such program: {upstream[0]} (of the server's command line `{shlex.join(upstream)}`); install it, or "
            "give its path"
        )


def record(
    upstream: str | Sequence[str],
    out: PathLike = "traces-out",
    *,
    listen: str = "127.0.0.1:0",
    **options: Argument,
) -> Recorder:
    """Records what agents do with any MCP tool server: a proxy that forwards every byte and writes a
    trace for each episode. A call is on disk before it is forwarded, its result before the agent
    gets it.

    Args:
        upstream: the server's URL (`http://robot:8000/mcp`), or the command line of one that speaks
            over standard input and output.
        out: folder for the traces.
        listen: where agents connect; port 0 takes a free one.
        options: further options of `reel record`, e.g. `mapping="robot.toml"`, `tasks="tasks"`.

    Returns:
        The running recorder: agents connect to its `url`.

    Raises:
        ReelError: the command of the server is missing, or the recorder cannot start. Nothing is written
            then.
    """
    check_upstream(upstream)
    words = [*program(), "record", "--out", os.fspath(out), "--listen", listen, *flags(options)]
    if isinstance(upstream, str):
        words += ["--upstream", upstream]
    else:
        words += ["--stdio", "--", *upstream]
    process = subprocess.Popen(
        words,
        env=environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        preexec_fn=_end_with_the_parent,  # noqa: PLW1509
    )
    assert process.stdout is not None
    said: list[str] = []
    for line in process.stdout:
        said.append(line)
        if found := re.search(r"http://\S+", line):
            return Recorder(process, found[0].rstrip(".,;)"), Path(out))
    process.wait()
    raise ReelError("".join(said).strip().removeprefix("reel: ") or f"{shlex.join(words)} ended")


__all__ = ["Recorder", "record"]
