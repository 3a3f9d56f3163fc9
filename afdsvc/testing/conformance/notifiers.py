"""Notifiers: settings are checked at the start, not at the first alarm."""

from __future__ import annotations

from typing import Any

from afdsvc.testing.conformance.named import settings_check, settings_of


def opens_to_something_that_can_be_called(thing: Any) -> None:
    """With its ``example`` settings it opens without telling anybody anything."""
    assert callable(thing.open(settings_of(thing))), "open() returned nothing that can be called"


CHECKS = (settings_check(lambda thing, settings: thing.open(settings)), opens_to_something_that_can_be_called)
