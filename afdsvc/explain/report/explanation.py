"""What `explain` answers, as values: places, names, fit before and after, and everything a page or a new model needs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from afdsvc.explain.gap.finding import Gap
from afdsvc.explain.search.problem import Point
from afdsvc.explain.simulate.nominal import Nominal
from afdsvc.lti.statespace import Array


@dataclass(frozen=True, slots=True)
class Located:
    """A place where simulation and recordings differ: output, input path (or None), band [Hz], share of the residual's power.

    ``depends_on`` names what predicts the residual (inputs, states, other signals, "time"); ``kind`` is "repeating" where the
    residual repeats with the excitation, else "predictable"; ``evidence`` is one sentence with the statistics.
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


@dataclass(frozen=True, slots=True)
class Named:
    """A name for the gap or one of its look-alikes: physics, site, weight among its look-alikes, parameters, one sentence.

    ``effect`` counts the effects found (look-alikes of one effect share the number), ``share_of_gap`` is the part of the gap it
    closes, or of what the other effects leave, ``partial`` whether a part of the gap remains that a flexible model predicts; ``family`` is the group of laws it
    belongs to, ``parameter`` what changed when it is a parameter change.
    """

    physics: str
    site: str
    weight: float
    parameters: Mapping[str, Estimate]
    sentence: str
    effect: int = 1
    share_of_gap: float = 1.0
    partial: bool = False
    family: str = ""
    parameter: str = ""


@dataclass(frozen=True, slots=True)
class Rejected:
    """A hypothesis that was fitted and not claimed: its error on the held-out recordings (ratio, all outputs) and why."""

    physics: str
    site: str
    heldout_nrmse: float
    why: str


@dataclass(frozen=True, slots=True)
class Nearest:
    """A hypothesis that comes near where none is claimed: the share of the gap it closes, and a sentence."""

    physics: str
    site: str
    share_of_gap: float
    sentence: str


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
        """Return it as plain values; ``r2 = 1 - nrmse`` is the thesis' measure (4.38), ``r2_classical = 1 - nrmse^2``."""
        both = {"before": self.before_nrmse, "after": self.after_nrmse}
        return {k: {"r2": 1 - v, "r2_classical": 1 - v**2, "nrmse": v} for k, v in both.items()} | {"noise_floor_nrmse": self.noise_floor_nrmse}


@dataclass(frozen=True, slots=True, eq=False)
class RecordingCourse:
    """One recording beside both simulations: ``t (n,)`` s, ``measured``, ``before``, ``after`` ``(n, p)``.

    ``role`` is "train" or "heldout". ``before`` is the model as stated, ``after`` the improved one.
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


@dataclass(frozen=True, slots=True, eq=False)
class LawPicture:
    """A law without a name at one site: ``y (k,)`` against ``x (k,)`` with its 95 % band, and the named law there.

    ``against`` says what ``x`` is; ``unit`` and ``x_unit`` are the units; ``named_y`` is None where no name is claimed.
    """

    site: str
    against: str
    unit: str
    x_unit: str
    x: Array
    y: Array
    low: Array
    high: Array
    named_y: Array | None
    sentence: str


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """The whole answer.

    ``simulated`` says how the simulations were run: "from the inputs", "in closed loop" or "predicted" (corrected by the
    measurements, where the plant alone would drift away). ``whiteness_p`` is (before, after) on the held-out recordings.
    ``explained`` is the fraction of the gap that is closed with its standard deviation; ``gap`` and ``remainder`` are the
    findings of the gap test before and after. ``nominal`` and ``point`` are the final model: its numbers refitted, and the
    effects claimed with their values, simulated in ``substeps`` of a sample at least. ``noise_floor`` is the noise's standard deviation per output (None: not known).
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
    gap: Gap
    remainder: Gap | None
    candidates: tuple[Nearest, ...]
    law: LawPicture | None
    check: tuple[str, ...]
    sentences: tuple[str, ...]
    next_experiment: Mapping[str, Any] | None
    noise_floor: tuple[float, ...] | None
    courses: tuple[RecordingCourse, ...]
    spectra: tuple[Spectrum, ...]
    nominal: Nominal
    point: Point
    substeps: int = 1
    notes: Mapping[str, Any] = field(default_factory=dict)

    def json(self, model_path: str | None, report_path: str | None) -> dict[str, Any]:
        """Return the document of `explain --json`; the paths are those of the improved MODEL.toml and of the report."""
        left = None if self.remainder is None else _gap(self.remainder) | {"share_of_gap": 1 - self.explained[0]}
        table: dict[str, Any] = plain({
            "verdict": self.verdict, "gap": _gap(self.gap), "located": [asdict(p) for p in self.located],
            "named": [asdict(n) for n in self.named], "candidates": [asdict(c) for c in self.candidates], "rejected": [asdict(r) for r in self.rejected],
            "law": asdict(self.law) if self.law else None,
            "fit": {
                "per_output": {f.output: f.json() for f in self.fit}, "heldout": self.heldout,
                "whiteness_p": dict(zip(("before", "after"), self.whiteness_p, strict=True)),
            },
            "model": model_path, "report": report_path, "explained": {"fraction": self.explained[0], "sd": self.explained[1]},
            "sentences": self.sentences, "check": self.check, "next_experiment": self.next_experiment, "remainder": left,
            "noise_floor": self.noise_floor, "simulated": self.simulated, "notes": self.notes,
        })
        return table


def _gap(gap: Gap) -> dict[str, Any]:
    return {
        "present": gap.present, "r2": gap.total, "p_value": gap.p_value, "explainable": float(np.mean(gap.within_reach)),
        "depends_on": [{"group": name, "share": share} for name, share in gap.depends_on], "sentence": gap.sentence,
    }


def plain(value: Any) -> Any:
    """Return nested values as JSON can hold them: lists, plain numbers, None for what is not finite."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [plain(v) for v in value]
    if isinstance(value, (np.bool_, np.integer)):
        return value.item()
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return value
