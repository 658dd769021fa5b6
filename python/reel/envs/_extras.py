"""Packages that only some environments need."""

from __future__ import annotations

from .._reel import ReelError


class MissingPackageError(ReelError, ImportError):
    """A package is missing; the text says how to install it."""


def missing(extra: str, error: ImportError) -> MissingPackageError:
    """The error for an environment whose package is missing.

    Args:
        extra: the extra of `reel` that installs it.
        error: what importing it raised.
    """
    module = error.name or str(error)
    return MissingPackageError(f"reel.envs.{extra}: the package '{module}' is missing; run: pip install 'reel[{extra}]'")


__all__ = ["MissingPackageError", "missing"]
