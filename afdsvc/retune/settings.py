"""Settings of the design of Q and of its proof."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from afdsvc.errors import BadInput


@dataclass(frozen=True, slots=True)
class RetuneSettings:
    """Each number with its unit and meaning."""

    #: Severities of the interval that are models of the design, both ends included.
    models: int = 5
    #: Weight of the healthy machine among the models: the doubt in the diagnosis. It keeps Q stable with a margin.
    doubt: float = 0.01
    #: Share of the running loop's cost below which a reduction is called nothing.
    worthwhile: float = 0.02
    #: Share of the reduction that a lower order of Q may lose.
    order_loss: float = 0.02
    #: Share of the running loop's stability margin ``1 - max|z|`` that every loop with Q keeps.
    margin_kept: float = 0.25
    #: Largest sensitivity ``|(I - G K)^-1|`` of a damaged loop with Q, unless the loop without Q has a larger one.
    sensitivity: float = 6.0
    #: The same where the diagnosis is wrong, a margin for the time until Q is taken back: the first with which Q reaches ``enough``, else the first.
    sensitivity_if_wrong: tuple[float, ...] = (12.0, 24.0, 48.0)
    #: Share of the possible reduction below which a larger sensitivity is accepted where the diagnosis is wrong, and the sheet says what limits Q.
    enough: float = 0.9
    #: Iterations of the search over the models.
    iterations: int = 300
    #: Times [s] of a change of the gain, the first that is smooth is taken; 0 is one sample.
    switch_seconds: tuple[float, ...] = (0.0, 0.01, 0.03, 0.1, 0.3, 1.0)
    #: Largest standard deviation of a signal during the switch, relative to the larger of those before and after it.
    bump: float = 1.2
    #: Noise peaks in standard deviations that must fit below the limits: exceeded with probability 4e-8 per sample.
    noise_peak: float = 5.5
    #: Time [s] over which a rig measures its cost with Q, and how many times the predicted one it may be.
    promise_seconds: float = 2.0
    promise_slack: float = 1.5
    #: Rectangles of severity and gain that a stability proof may take.
    rectangles: int = 400


RETUNE = RetuneSettings()


def stated(settings: Mapping[str, Any]) -> RetuneSettings:
    """Return the settings with those that are stated by name; others are not for it. Raises `BadInput` for a value of another kind.

    >>> stated({"models": 3, "sensitivity_if_wrong": 12}).sensitivity_if_wrong
    (12,)
    """
    known = {f.name: settings[f.name] for f in fields(RETUNE) if f.name in settings}
    for name, value in known.items():
        usual = getattr(RETUNE, name)
        many = isinstance(usual, tuple) and isinstance(value, list | tuple)
        numbers: Any = (value or [None]) if many else [value]
        kind, least = ("whole number", 1) if isinstance(usual, int) else ("number", 0)
        if not all(_number(x) and x >= least and (kind == "number" or x == int(x)) for x in numbers):
            raise BadInput(f"retune.settings.{name} is {value!r}; expected {'a number or a list of numbers' if isinstance(usual, tuple) else f'a {kind}'} of at least {least}")
        known[name] = tuple(numbers) if isinstance(usual, tuple) else value
    return replace(RETUNE, **known)


def _number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
