"""What is being done now: a bar on a terminal, a line now and then in a log."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

ERR = Console(stderr=True, markup=False, emoji=False)
APART = 10.0  # seconds between lines in a log


@contextmanager
def progress(what: str, total: float | None = None) -> Iterator[Callable[..., None]]:
    """Show on stderr what is being done and for how long already, on a terminal also how much of it: how long it will take is not known.

    The function handed out takes what is done so far (None: not known) and, when that changes, what is being done.
    """
    if not ERR.is_terminal:
        yield _lines(what)
        return
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=ERR, transient=True) as bar:
        task = bar.add_task(what, total=total)
        yield lambda done=None, now="": bar.update(task, completed=done, description=f"{what}: {now}" if now else None)


def _lines(what: str) -> Callable[..., None]:
    """Return a function that prints what is being done, at most once in `APART` seconds."""
    begun = said = time.monotonic()

    def tell(done: float | None = None, now: str = "") -> None:
        nonlocal said
        if time.monotonic() - said >= APART:
            said = time.monotonic()
            ERR.print(f"{what}{f': {now}' if now else ''} ({said - begun:.0f} s)", soft_wrap=True, highlight=False)

    return tell
