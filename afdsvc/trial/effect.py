"""One thing hidden in a recording, and the whole truth: constants of the plant and everything hidden."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from afdsvc.lti.statespace import Array
from afdsvc.trial.laws import scalar as c


@dataclass(frozen=True, slots=True, eq=False)
class Effect:
    """A kind of physics at a site. Severity s turns its parameters into ``base * s ** powers``.

    ``code`` chooses the law, ``at`` are the indices it acts on, ``states`` counts states of its own. ``names`` and ``units``
    describe the parameters; ``free`` are those a refit may move. Code CONSTANT multiplies the plant's constants ``shifts`` by
    (1 + base s) to the given power; code NOISE adds the run's coloured noise, times its parameter, to output ``at[0]``.
    """

    physics: str
    site: str
    code: int
    at: tuple[int, ...]
    base: tuple[float, ...]
    powers: tuple[float, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    free: tuple[int, ...] = (0,)
    states: int = 0
    severity: float = 1.0
    parameter: str = ""
    shifts: dict[int, float] = field(default_factory=dict)

    @property
    def values(self) -> Array:
        """Parameters at this severity."""
        return np.asarray(self.base) * self.severity ** np.asarray(self.powers)

    def scaled(self, severity: float) -> Effect:
        """Return the effect at another severity."""
        return replace(self, severity=severity)

    def with_values(self, values: Array) -> Effect:
        """Return the effect with these parameters, whatever its severity was."""
        return replace(self, base=tuple(float(v) for v in values), severity=1.0)

    def described(self) -> dict[str, Any]:
        """Return the parameters by name, with units, as the sealed answer keeps them."""
        pairs = zip(self.names, self.values, self.units, strict=True)
        return {name: {"value": float(value), "unit": unit} for name, value, unit in pairs}


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """Constants of the plant and what is hidden; ``minor`` effects are dirt that is no part of the question."""

    theta: Array
    effects: tuple[Effect, ...] = ()
    minor: tuple[Effect, ...] = ()

    def with_effects(self, *effects: Effect) -> Truth:
        """Return the same plant with other effects, dirt included as it was."""
        return replace(self, effects=effects)

    @property
    def everything(self) -> tuple[Effect, ...]:
        """Effects and dirt."""
        return (*self.effects, *self.minor)

    def constants(self) -> Array:
        """Return theta with every hidden change of a constant applied."""
        theta = self.theta.copy()
        for effect in self.everything:
            for i, power in effect.shifts.items():
                theta[i] *= (1.0 + effect.values[0]) ** power
        return theta


def law_tables(effects: tuple[Effect, ...]) -> tuple[Array, Array, Array, Array]:
    """Return codes, places, parameters and state offsets of the effects that are laws, for the compiled loop."""
    laws = [e for e in effects if e.code >= 0]
    at = np.zeros((len(laws), c.PLACES), dtype=np.int64)
    p = np.zeros((len(laws), c.PARAMETERS))
    for i, e in enumerate(laws):
        at[i, : len(e.at)] = e.at
        p[i, : len(e.base)] = e.values
    code = np.array([e.code for e in laws], dtype=np.int64)
    offset = np.concatenate([[0], np.cumsum([e.states for e in laws])]).astype(np.int64)
    return code, at, p, offset  # type: ignore[return-value]
