"""What every plugin object holds, and notifiers: settings are checked at the start, not at the first alarm."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

from afdsvc.errors import BadInput

NONSENSE = "no_such_setting_ever"


def is_named(thing: Any) -> None:
    """Has a name of small letters, digits and _, and a summary of one line."""
    name, summary = getattr(thing, "name", None), getattr(thing, "summary", None)
    assert re.fullmatch(r"[a-z][a-z0-9_]*", str(name)), f"name is {name!r}; expected small letters, digits, _"
    assert len(str(summary or "").splitlines()) == 1, f"summary is {summary!r}; expected one line"


def settings_of(thing: Any) -> Mapping[str, Any]:
    """Return the settings to try a plugin with: its own ``example`` where it has one."""
    return getattr(thing, "example", None) or {}


def settings_check(use: Callable[[Any, dict[str, Any]], Any]) -> Callable[[Any], None]:
    """Return the check that an unknown setting is refused by name; ``use`` hands settings to the plugin object."""

    def refuses_unknown_settings(thing: Any) -> None:
        """Refuses an unknown setting by name."""
        try:
            use(thing, {**settings_of(thing), NONSENSE: 1})
        except BadInput as refusal:
            said = str(refusal)
        else:
            raise AssertionError("an unknown setting was ignored; expected BadInput that names it")
        assert NONSENSE in said, f"the refusal of an unknown setting does not name it: {said}"

    return refuses_unknown_settings



def opens_to_something_that_can_be_called(thing: Any) -> None:
    """With its ``example`` settings it opens without telling anybody anything."""
    assert callable(thing.open(settings_of(thing))), "open() returned nothing that can be called"


NOTIFIERS = (settings_check(lambda thing, settings: thing.open(settings)), opens_to_something_that_can_be_called)
