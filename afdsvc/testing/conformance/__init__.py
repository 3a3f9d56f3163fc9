"""What a plugin must hold to be used: one list of checks per family, run by ``afdsvc plugins check`` and by a plugin's own tests.

In a plugin's tests::

    from afdsvc.testing.conformance import checks

    @pytest.mark.parametrize("check", checks("detectors"), ids=lambda c: c.__name__)
    def test_it_conforms(check):
        check(MyDetector())
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from afdsvc.errors import BadInput
from afdsvc.testing.conformance import controllers, detectors, drivers, faults, physics, retuners
from afdsvc.testing.conformance.named import NOTIFIERS, is_named

Check = Callable[[Any], None]
SUITES: dict[str, tuple[Check, ...]] = {
    "controllers": (is_named, *controllers.CHECKS),
    "detectors": (is_named, *detectors.CHECKS),
    "drivers": (is_named, *drivers.CHECKS),
    "faults": (is_named, *faults.CHECKS),
    "notifiers": (is_named, *NOTIFIERS),
    "physics": (is_named, *physics.CHECKS),
    "retuners": (is_named, *retuners.CHECKS),
}


@dataclass(frozen=True, slots=True)
class Result:
    """One check of one plugin object: what was asked, and why it does not hold ("" when it does)."""

    check: str
    asked: str
    failure: str


def checks(family: str) -> tuple[Check, ...]:
    """Return the checks of a family; each raises AssertionError with a sentence when it does not hold."""
    if family not in SUITES:
        raise BadInput(f"no plugin family '{family}'; there are {', '.join(SUITES)}")
    return SUITES[family]


def examine(family: str, thing: Any) -> list[Result]:
    """Run every check of a family on what a plugin hands out; what the plugin raises is a failure of that check alone."""
    return [Result(check.__name__, (check.__doc__ or "").strip(), _failure(check, thing)) for check in checks(family)]


def _failure(check: Check, thing: Any) -> str:
    try:
        check(thing)
    except AssertionError as error:
        return str(error).strip() or "does not hold"
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return ""
