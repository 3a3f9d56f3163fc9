"""Progress in a notebook: a bar that is replaced while it moves and gone at the end."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def notebook_progress(what: str) -> Iterator[Callable[..., None]]:
    """Show below the cell what is being done, how much of it and for how long already; outside a notebook nothing.

    The function handed out takes the share done (None: not known) and what is being done, as that of `afdsvc.present.terminal.progress`.
    """
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    if not hasattr(shell, "kernel"):  # plain Python, or IPython in a terminal
        yield lambda done=None, now="": None
        return
    from IPython.display import display

    began = time.monotonic()

    def shown(done: float | None = None, now: str = "") -> dict[str, str]:
        words = f"{what}: {now}" if now else what
        value = "" if done is None else f' value="{done:.3f}"'
        return {"text/html": f'<progress aria-label="{what}"{value}></progress> {words}, {time.monotonic() - began:.0f} s', "text/plain": words}

    handle = display(shown(), raw=True, display_id=True)  # type: ignore[no-untyped-call]
    try:
        yield lambda done=None, now="": handle.update(shown(done, now), raw=True)
    finally:
        handle.update({"text/html": "", "text/plain": ""}, raw=True)
