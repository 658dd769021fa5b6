"""Progress of long work, as a bar in terminals and notebooks."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import contextmanager

from tqdm.auto import tqdm


@contextmanager
def bar(total: int, what: str, show: bool | None) -> Generator[Callable[[int], None] | None]:
    """A function to call with the number of items that are done; None if no bar is shown.

    `show` None shows a bar where there is more than one item and somebody looks: a terminal or a
    notebook.
    """
    if show is False or (show is None and total < 2):
        yield None
        return
    with tqdm(total=total, desc=what, unit="", leave=False, disable=False if show else None) as shown:

        def tell(done: int) -> None:
            shown.update(done)

        yield tell
