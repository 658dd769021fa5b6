"""The command line as functions: in a process of its own, so that Ctrl-C and a killed kernel leave
what they would leave of the command."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Mapping
from typing import Any

from ._program import environment, program
from ._reel import ReelError

Argument = str | os.PathLike[str] | int | float | bool | None | list[Any] | tuple[Any, ...]


def flags(options: Mapping[str, Argument]) -> list[str]:
    """Keyword arguments as options of the command line: `max_rows=5` is `--max-rows 5`, True is a
    flag alone, lists repeat the option, None and False leave it out."""
    words: list[str] = []
    for name, value in options.items():
        option = "--" + name.strip("_").replace("_", "-")
        values: Any = value if isinstance(value, (list, tuple)) else [value]
        for each in values:
            if each is True:
                words.append(option)
            elif each is not None and each is not False:
                words += [option, str(each)]
    return words


def command(*words: str | os.PathLike[str], **options: Argument) -> str:
    """Runs `reel` with these words and options, and returns what it prints.

    Args:
        words: subcommands and positional arguments, e.g. `"task", "generate"`.
        options: options of the command, e.g. `count=8` for `--count 8`.

    Raises:
        ReelError: the command failed; the text is what it printed to standard error.
    """
    said = subprocess.run(
        [*program(), *(os.fspath(word) for word in words), *flags(options)],
        env=environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    # 3: done, but something was left out, which standard error names
    if said.returncode not in (0, 3):
        raise ReelError(said.stderr.strip().removeprefix("reel: ") or f"exit code {said.returncode}")
    return said.stdout


def command_json(*words: str | os.PathLike[str], **options: Argument) -> Any:
    """As `command` with `--json`, parsed: a value, or a list where there are several lines."""
    text = command(*words, json=True, **options)
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        return [json.loads(line) for line in text.splitlines() if line.strip()]
