"""Notifiers: settings are checked at the start, not at the first alarm."""

from __future__ import annotations

from typing import Any

from afdsvc.testing.conformance.controllers import settings_of
from afdsvc.testing.conformance.named import refuses_nonsense


def refuses_unknown_settings(thing: Any) -> None:
    """Refuses an unknown setting by name."""
    refuses_nonsense(thing.open, dict(settings_of(thing)))


def opens_to_something_that_can_be_called(thing: Any) -> None:
    """With its ``example`` settings it opens without telling anybody anything."""
    assert callable(thing.open(settings_of(thing))), "open() returned nothing that can be called"


CHECKS = (refuses_unknown_settings, opens_to_something_that_can_be_called)
