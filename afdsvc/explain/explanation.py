"""What `explain` answers, as values: places, names, fit before and after, and everything a page or a new model needs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from afdsvc.explain.nominal import Nominal
from afdsvc.explain.objective import Point
from afdsvc.lti.statespace import Array, StateSpace

VERDICTS = ("consistent", "parameter_change", "omitted_physics", "unexplained", "insufficient_excitation")


@dataclass(frozen=True, slots=True)
class Located:
    """A place where simulation and recordings part: output, input path (or None), band [Hz], share of the residual's power.

    ``depends_on`` names what the residual follows ("amplitude", "velocity sign", "rotor angle", "time", ...), ``kind`` says
    whether it is "linear", "odd", "even" or "noise"; ``evidence`` is one sentence with the statistics.
    """

    output: str
    input: str | None
    band_hz: tuple[float, float]
    share_of_residual_power: float
    depends_on: tuple[str, ...] = ()
    evidence: str = ""
    kind: str = ""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A fitted parameter: value, standard deviation (None: not known) and unit."""

    value: float
    sd: float | None
    unit: str

    def json(self) -> dict[str, Any]:
        """Return it as plain values."""
        return {"value": number(self.value), "sd": number(self.sd), "unit": self.unit}


@dataclass(frozen=True, slots=True)
class Named:
    """A name for the gap or one of its look-alikes: physics, site, weight among its look-alikes, parameters, one sentence.

    ``effect`` counts the effects found (look-alikes of one effect share the number), ``share_of_gap`` is the part of the whole
    gap it closes; ``family`` the group of laws it belongs to; ``parameter`` what changed when it is a parameter change.
    """

    physics: str
    site: str
    weight: float
    parameters: Mapping[str, Estimate]
    sentence: str
    effect: int = 1
    share_of_gap: float = 1.0
    family: str = ""
    parameter: str = ""

    def json(self) -> dict[str, Any]:
        """Return it as plain values."""
        return {
            "physics": self.physics, "site": self.site, "weight": number(self.weight),
            "parameters": {name: p.json() for name, p in self.parameters.items()}, "sentence": self.sentence,
            "effect": self.effect, "share_of_gap": number(self.share_of_gap), "family": self.family,
        }


@dataclass(frozen=True, slots=True)
class Rejected:
    """A hypothesis that was fitted and lost: its error on the held-out recordings (ratio, all outputs) and why."""

    physics: str
    site: str
    heldout_nrmse: float
    why: str

    def json(self) -> dict[str, Any]:
        """Return it as plain values."""
        return {"physics": self.physics, "site": self.site, "heldout_nrmse": number(self.heldout_nrmse), "why": self.why}


@dataclass(frozen=True, slots=True)
class OutputFit:
    """One output on the held-out recordings: ``nrmse = |y - yhat| / |y - mean|`` before and after, and the noise's share of it.

    ``noise_floor_nrmse`` is None when the noise is not known apart from the model.
    """

    output: str
    before_nrmse: float
    after_nrmse: float
    noise_floor_nrmse: float | None

    def json(self) -> dict[str, Any]:
        """Return it as plain values; ``r2 = 1 - nrmse``."""
        both = {"before": self.before_nrmse, "after": self.after_nrmse}
        table: dict[str, Any] = {k: {"r2": number(1 - v), "nrmse": number(v)} for k, v in both.items()}
        return table | {"noise_floor_nrmse": number(self.noise_floor_nrmse)}


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """One recording beside both simulations: ``t (n,)`` s, ``measured``, ``before``, ``after`` ``(n, p)``.

    ``role`` is "train", "select" or "heldout". ``after`` is the improved model, ``before`` the nominal one.
    """

    name: str
    role: str
    t: Array
    measured: Array
    before: Array
    after: Array

    @property
    def residual_before(self) -> Array:
        """Measured less simulated with the nominal model, shape ``(n, p)``."""
        return self.measured - self.before

    @property
    def residual_after(self) -> Array:
        """Measured less simulated with the improved model, shape ``(n, p)``."""
        return self.measured - self.after


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """Power density of one output's residual on the held-out recordings: ``frequency (k,)`` Hz, densities in unit^2/Hz.

    ``noise`` is that of what does not repeat with the excitation; None when nothing repeats.
    """

    output: str
    frequency: Array
    measured: Array
    before: Array
    after: Array
    noise: Array | None


@dataclass(frozen=True, slots=True)
class Remainder:
    """What is left unexplained: its share of the gap, and what a free-form model of the residual would still gain.

    ``sentence`` says it for people; ``gain`` is the part of the remaining residual's power that the free-form model predicts
    on recordings it was not fitted to.
    """

    share_of_gap: float
    gain: float
    sentence: str

    def json(self) -> dict[str, Any]:
        """Return it as plain values."""
        return asdict(self)


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """The whole answer.

    ``simulated`` says how the fit's simulations were run: "from the inputs", "in closed loop" or "predicted" (corrected by the
    measurements, where the plant alone would drift away). ``whiteness_p`` is (before, after) on the held-out recordings.
    ``explained`` is the fraction of the gap that is closed with its standard deviation. ``nominal`` and ``point`` are the final
    model: nuisance parameters moved and effects with values, ``improved`` the same as matrices where it is linear (None
    otherwise). ``noise_floor`` is the noise's standard deviation per output (None: not known).
    """

    verdict: str
    located: tuple[Located, ...]
    named: tuple[Named, ...]
    rejected: tuple[Rejected, ...]
    fit: tuple[OutputFit, ...]
    heldout: tuple[str, ...]
    whiteness_p: tuple[float, float]
    simulated: str
    explained: tuple[float, float]
    check: tuple[str, ...]
    sentences: tuple[str, ...]
    next_experiment: Mapping[str, Any] | None
    remainder: Remainder | None
    noise_floor: tuple[float, ...] | None
    courses: tuple[Course, ...]
    spectra: tuple[Spectrum, ...]
    nominal: Nominal
    point: Point
    improved: StateSpace | None = None
    notes: Mapping[str, Any] = field(default_factory=dict)

    def json(self, model_path: str | None, report_path: str | None) -> dict[str, Any]:
        """Return the document of `explain --json`; the paths are those of the improved MODEL.toml and of the report."""
        floor = None if self.noise_floor is None else [number(v) for v in self.noise_floor]
        return {
            "verdict": self.verdict,
            "located": [_place(p) for p in self.located],
            "named": [n.json() for n in self.named],
            "rejected": [r.json() for r in self.rejected],
            "fit": self._fit(),
            "model": model_path,
            "report": report_path,
            "explained": {"fraction": number(self.explained[0]), "sd": number(self.explained[1])},
            "sentences": list(self.sentences),
            "check": list(self.check),
            "next_experiment": plain(self.next_experiment),
            "remainder": plain(self.remainder.json()) if self.remainder else None,
            "noise_floor": floor,
            "simulated": self.simulated,
            "notes": plain(self.notes),
        }

    def _fit(self) -> dict[str, Any]:
        before, after = self.whiteness_p
        return {
            "per_output": {f.output: f.json() for f in self.fit},
            "heldout": list(self.heldout),
            "whiteness_p": {"before": number(before), "after": number(after)},
        }


def _place(place: Located) -> dict[str, Any]:
    table = asdict(place)
    table["band_hz"] = [number(v) for v in place.band_hz]
    table["depends_on"] = list(place.depends_on)
    table["share_of_residual_power"] = number(place.share_of_residual_power)
    return table


def number(value: float | None) -> float | None:
    """Return a plain float; None for what JSON cannot hold."""
    return None if value is None or not math.isfinite(value) else float(value)


def plain(value: Any) -> Any:
    """Return nested values as JSON can hold them."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [plain(v) for v in value]
    if isinstance(value, (np.bool_, np.integer)):
        return value.item()
    return number(float(value)) if isinstance(value, (float, np.floating)) else value
