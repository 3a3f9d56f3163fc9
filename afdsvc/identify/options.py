"""Options of identification, with defaults; unknown ones are refused."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from numbers import Integral
from typing import Any

from afdsvc.errors import BadInput
from afdsvc.identify.methods.subspace import WEIGHTINGS
from afdsvc.identify.reduction import TRUNCATIONS

METHODS = ("auto", "hansen", "subspace", "pbsid", "pem", "output_error", "greybox", "indirect")


@dataclass(frozen=True, slots=True)
class IdentifyOptions:
    """Choices of `afdsvc.identify.identify`.

    ``method``: "hansen" identifies S and rebuilds the plant (excitation through alpha or a reference alike), "subspace"
    and "pbsid" the plant from u and y (the former in open loop only), "greybox" physical parameters from u and y,
    "indirect" the same through S; "pem" and "output_error" refine a start from PBSIDopt by prediction or simulation errors. "auto" is hansen when
    the controller is known; else method, horizon, feedthrough, order and noise model are chosen by samples left out (`cross_validation`).
    ``feedthrough`` says whether the plant may answer within a sample (None: chosen by "auto", yes for subspace, no for pbsid, pem and
    output_error: where feedback acts within a sample the two cannot be distinguished). ``screening`` False reports what `screen` finds instead of
    refusing it (None: refused where a controller is known). ``order`` (of S for hansen) and ``horizon`` are chosen from the data when None; ``reduce_to`` is the order of the
    plant handed back (None: that of the nominal model); ``reduction`` one of the truncations of `reduction`, "best" of
    them for the loop, or "refined": started from that and fitted to the recordings (`refinement`). ``norm`` belongs to
    indirect, ``starts`` and ``prior`` to greybox; ``process_states`` names states that process noise enters (None: the
    rates, where forces act). ``groups`` is the number of groups of the uncertainty (0: none).
    """

    method: str = "auto"
    order: int | None = None
    horizon: int | None = None
    weighting: str = "po-moesp"
    reduce_to: int | None = None
    reduction: str = "refined"
    norm: int = 2
    starts: int = 1
    prior: bool | None = None
    process_states: tuple[str, ...] | None = None
    free: tuple[str, ...] | None = None
    groups: int = 16
    cross_check: bool = True
    feedthrough: bool | None = None
    screening: bool | None = None

    def __post_init__(self) -> None:
        for name, known in (
            ("method", METHODS),
            ("weighting", WEIGHTINGS),
            ("reduction", ("refined", "best", *TRUNCATIONS)),
        ):
            if getattr(self, name) not in known:
                raise BadInput(f"option {name} = '{getattr(self, name)}'; expected one of {', '.join(known)}")
        for name in ("order", "horizon", "reduce_to"):
            value = getattr(self, name)
            if value is not None and (not isinstance(value, Integral) or value < 1):
                raise BadInput(f"option {name} = {value!r}; expected a whole number of at least 1")
        if self.norm not in (1, 2):
            raise BadInput(f"option norm = {self.norm}; expected 1 or 2")
        if self.groups != 0 and self.groups < 3:
            raise BadInput(f"option groups = {self.groups}; expected 0 (no uncertainty) or at least 3")

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> IdentifyOptions:
        """Return options from names and values; raises `BadInput` for a name that does not exist."""
        known = [f.name for f in fields(cls)]
        for name in settings:
            if name not in known:
                raise BadInput(f"identify has no option '{name}'; it has {', '.join(known)}")
        return cls(**settings)
