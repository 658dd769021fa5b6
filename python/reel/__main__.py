"""The command `reel`, which the package carries."""

from __future__ import annotations

import os
import signal
import sys

from ._program import environment, executable


def main() -> None:
    """Runs the command line and ends the process with its exit code."""
    from ._reel import main as run

    # The command starts itself again for work that must be killable (SQL of strangers).
    os.environ.update(environment())
    os.environ.setdefault("REEL_PROGRAM", executable())
    # Python would only note Ctrl-C and wait for the command to come back.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    sys.exit(run(["reel", *sys.argv[1:]]))


if __name__ == "__main__":
    main()
