"""What was hidden in a field trial: the part that is sealed."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


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
