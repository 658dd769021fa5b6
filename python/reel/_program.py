"""The command `reel`, to be started again."""

from __future__ import annotations

import atexit
import os
import shlex
import shutil
import sys
import sysconfig
import tempfile


def program() -> list[str]:
    """The command that runs `reel`: the installed script, else this package as a module."""
    script = os.path.join(sysconfig.get_path("scripts"), "reel")
    return [script] if os.access(script, os.X_OK) else [sys.executable, "-m", "reel"]


def executable() -> str:
    """One file that runs `reel`: the installed script, else one made for as long as this process lives."""
    command = program()
    if len(command) == 1:
        return command[0]
    folder = tempfile.mkdtemp(prefix="reel-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    path = os.path.join(folder, "reel")
    with open(path, "w", encoding="utf-8") as file:
        file.write(f'#!/bin/sh\nexec {shlex.join(command)} "$@"\n')
    os.chmod(path, 0o755)
    return path


def environment() -> dict[str, str]:
    """The environment to run it in: this package is found wherever the process stands."""
    here = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    paths = [here, *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
