"""Attributes that every plugin object has."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from afdsvc.errors import BadInput

NONSENSE = "no_such_setting_ever"


def is_named(thing: Any) -> None:
    """Has a name of small letters, digits and _, and a summary of one line."""
    name, summary = getattr(thing, "name", None), getattr(thing, "summary", None)
    assert re.fullmatch(r"[a-z][a-z0-9_]*", str(name)), f"name is {name!r}; expected small letters, digits, _"
    assert len(str(summary or "").splitlines()) == 1, f"summary is {summary!r}; expected one line"


def refuses_nonsense(design: Callable[[dict[str, Any]], Any], settings: dict[str, Any] | None = None) -> None:
    """Assert that an unknown setting is refused by name."""
    try:
        design({**(settings or {}), NONSENSE: 1})
    except BadInput as refusal:
        said = str(refusal)
    else:
        raise AssertionError("an unknown setting was ignored; expected BadInput that names it")
    assert NONSENSE in said, f"the refusal of an unknown setting does not name it: {said}"
