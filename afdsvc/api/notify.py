"""The contract of notifiers, which send alarm changes to people."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

Notify = Callable[[Mapping[str, Any]], None]


class NotifierDesign(Protocol):
    """What a notifier plugin hands out.

    ``open(settings)`` returns a function that is called with every change of an alarm, one after the other, in a thread of its
    own: ``{"event", "t_ns", "who", "why", "alarm": {...}}``. It may be slow and it may raise; it is then called again.
    """

    name: str
    summary: str

    def open(self, settings: Mapping[str, Any]) -> Notify:
        """Return the function; raises `BadInput` naming a setting that is unknown or wrong."""
        ...
