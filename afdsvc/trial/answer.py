"""What was hidden: the part of a trial that is sealed."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class Hidden:
    """One hidden effect: canonical name, site, rho asked and measured, rho in closed loop, parameters by name.

    ``parameter`` names what changed when the physics is a parameter change, ``in_prior`` says by how many standard
    deviations of the stated uncertainty (None when its owner claims to know it exactly).
    """

    physics: str
    site: str
    rho_asked: float
    rho: float
    rho_loop: float
    parameters: dict[str, Any] = field(default_factory=dict)
    parameter: str = ""
    in_prior: float | None = None


@dataclass(frozen=True, slots=True)
class TrialAnswer:
    """Everything that was hidden in a trial.

    ``hidden`` are the effects in question (none: nothing is hidden), ``minor`` the dirt. ``seen`` is the effects' rms in each
    output over that output's noise. ``outside`` says that the physics is not in the vocabulary. ``seed`` (as the caller
    gave it) and ``options`` make the trial again.
    """

    machine: str
    hidden: tuple[Hidden, ...]
    minor: tuple[Hidden, ...]
    seen: dict[str, float]
    outside: bool
    seed: str
    options: dict[str, Any]

    @property
    def rho(self) -> float:
        """Largest rho among the hidden effects, 0 when there is none."""
        return max((h.rho for h in self.hidden), default=0.0)

    def as_json(self) -> dict[str, Any]:
        """Return the answer as plain values."""
        return asdict(self)

    @classmethod
    def from_json(cls, table: dict[str, Any]) -> TrialAnswer:
        """Return the answer from plain values."""
        listed = {key: tuple(Hidden(**h) for h in table[key]) for key in ("hidden", "minor")}
        return cls(**{**table, **listed})
