"""How a field trial is staged: the family, the laws, whether the excitation repeats."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from afdsvc.errors import BadInput
from afdsvc.trial.field.catalogue import FAMILIES, LAWS


@dataclass(frozen=True, slots=True)
class FieldOptions:
    """Settings of one field trial: a family, the names of the hidden laws (none: nothing is hidden), kind of excitation."""

    family: str
    laws: tuple[str, ...] = ()
    repeating: bool = False

    def __post_init__(self) -> None:
        if self.family not in FAMILIES:
            raise BadInput(f"option family is '{self.family}'; expected one of {', '.join(FAMILIES)}")
        for law in self.laws:
            if law not in LAWS:
                raise BadInput(f"option laws names '{law}'; expected names from the catalogue")

    def as_json(self) -> dict[str, Any]:
        """Return the options as plain values."""
        return {"family": self.family, "laws": list(self.laws), "repeating": self.repeating}
