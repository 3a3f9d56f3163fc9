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


@dataclass(frozen=True, slots=True)
class HiddenLaw:
    """One hidden law: the generator's name for it, site, parameters by name, the share of the held-out error it makes alone.

    ``accept`` are canonical names that are right, ``partial`` those that are defensible, ``words`` parts of further right names.
    """

    law: str
    site: str
    share: float
    parameters: dict[str, float]
    accept: tuple[str, ...]
    partial: tuple[str, ...]
    words: tuple[str, ...]

    @property
    def outside(self) -> bool:
        """Whether no canonical name is right."""
        return not self.accept


@dataclass(frozen=True, slots=True)
class FieldAnswer:
    """Everything that was hidden in a field trial.

    ``share`` is the share of the nominal model's held-out simulation error that the hidden laws make together, ``asked`` the one
    that was asked for. ``present`` are names of what the conditions bring along (coloured noise, an offset, constants beyond
    what is stated): to name them is not wrong. ``seed`` and ``options`` make the trial again.
    """

    family: str
    hidden: tuple[HiddenLaw, ...]
    asked: float
    share: float
    present: tuple[str, ...]
    conditions: dict[str, Any]
    seed: str
    options: dict[str, Any]

    @property
    def outside(self) -> bool:
        """Whether one of the hidden laws is outside of the vocabulary."""
        return any(h.outside for h in self.hidden)

    def as_json(self) -> dict[str, Any]:
        """Return the answer as plain values."""
        return asdict(self)

    @classmethod
    def from_json(cls, table: dict[str, Any]) -> FieldAnswer:
        """Return the answer from plain values."""
        names = ("accept", "partial", "words")
        hidden = tuple(HiddenLaw(**(h | {key: tuple(h[key]) for key in names})) for h in table["hidden"])
        return cls(**{**table, "hidden": hidden, "present": tuple(table["present"])})
