"""The command `reel`, to be started again."""

from __future__ import annotations

import os
import sys
import sysconfig


def program() -> list[str]:
    """The command that runs `reel`: the installed script, else this package as a module."""
    script = os.path.join(sysconfig.get_path("scripts"), "reel")
    return [script] if os.access(script, os.X_OK) else [sys.executable, "-m", "reel"]


def environment() -> dict[str, str]:
    """The environment to run it in: this package is found wherever the process stands."""
    here = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    paths = [here, *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
