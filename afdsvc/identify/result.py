"""The result of `identify`: fit, validation, the improved model, and the JSON document."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from afdsvc.api.model import Model, Quantity, Variable
from afdsvc.identify.fit import Fit, ResponseBand
from afdsvc.identify.reduction import ReducedPlant
from afdsvc.identify.validation import Agreement
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.stats.fit_measures import Measures


@dataclass(frozen=True, slots=True, eq=False)
class HoldoutPreview:
    """A stretch of a recording not used, for the eye: ``t (N,)`` [s], measured and predicted outputs, each ``(N, p)``.

    ``before`` is None when the nominal model cannot be simulated.
    """

    recording: str
    t: Array
    measured: Array
    before: Array | None
    after: Array


@dataclass(frozen=True, slots=True, eq=False)
class IdentifyResult:
    """What came out.

    ``before`` and ``after`` are the measures per output on the recordings named in ``heldout``, of the nominal model
    and of the fit; ``model`` is the improved model; ``loop_stable`` says whether the current controller stabilises it
    (None without a controller). ``cross_check`` compares with PBSIDopt; ``full`` is the plant before reduction.
    """

    fit: Fit
    model: Model
    nominal: StateSpace
    before: Mapping[str, Measures]
    after: Mapping[str, Measures]
    heldout: tuple[str, ...]
    training: tuple[str, ...]
    loop_stable: bool | None
    nominal_band: ResponseBand
    full: StateSpace | None = None
    reductions: tuple[ReducedPlant, ...] = ()
    cross_check: Agreement | None = None
    preview: HoldoutPreview | None = None
    warnings: tuple[str, ...] = ()
    data: tuple[str, ...] = ()  # those of the warnings that say what was done to the recordings

    def _second_route(self) -> tuple[str, ...]:
        check = self.cross_check
        return () if check is None else (f"second route (PBSIDopt on u and y): {check.sentence}",)

    def json(self, model_path: str | None = None) -> dict[str, Any]:
        """Return the document of ``identify --json``; ``model_path`` is where the model was written."""
        fit = self.fit
        document: dict[str, Any] = {
            "method": fit.method,
            "order": fit.order,
            "parameters": {
                e.name: {"value": e.value, "sd": e.sd, "unit": e.unit, "before": e.prior} for e in fit.parameters
            },
            "fit": {
                "per_output": {
                    k: {"before": _measure(self.before[k]), "after": _measure(self.after[k])} for k in self.after
                },
                "heldout": list(self.heldout),
            },
            "loop_stable": self.loop_stable,
            "model": model_path,
            "trained_on": list(self.training),
            "order_reason": fit.order_reason,
            "notes": [*fit.notes, *self._second_route()],
            "warnings": list(self.warnings),
        }
        if fit.deviation is not None:
            document["deviation_order"] = fit.deviation.order
        if fit.tests is not None:
            document["residuals"] = {
                "whiteness_p": fit.tests.p_white,
                "independence_p": fit.tests.p_independent.tolist(),
                "feedback_p": fit.tests.p_feedback.tolist(),
            }
        if self.cross_check is not None:
            document["cross_check"] = {
                "method": "pbsid",
                "relative": self.cross_check.relative,
                "deviations": self.cross_check.deviations,
                "verdict": self.cross_check.verdict,
                "sentence": self.cross_check.sentence,
            }
        if self.reductions:
            document["reductions"] = [
                {
                    "method": r.method,
                    "loop_stable": r.loop_stable,
                    "plant_error": _finite(r.plant_error),
                    "loop_error": _finite(r.loop_error),
                }
                for r in self.reductions
            ]
        return document


def improved_model(model: Model, fit: Fit) -> Model:
    """Return the model with what was found: parameters or entries in place for a grey box, else new discrete
    matrices."""
    if not fit.parameters:
        return _black_box(model, fit)
    found = {e.name: e for e in fit.parameters}
    if model.dynamics is not None or model.plant is None:
        parameters = {
            name: Quantity(found[name].value, q.unit, found[name].sd / max(abs(found[name].value), 1e-300))
            if name in found
            else q
            for name, q in model.parameters.items()
        }
        return replace(model, parameters=parameters)
    matrices = {k: getattr(model.plant, k).copy() for k in "ABCD"}
    deviations = {k: v.copy() for k, v in model.entry_sd.items()}
    for name, e in found.items():
        k, place = name[0], tuple(int(i) - 1 for i in name[2:-1].split(","))
        matrices[k][place], deviations[k][place] = e.value, e.sd
    plant = StateSpace(matrices["A"], matrices["B"], matrices["C"], matrices["D"], model.plant.dt)
    return replace(model, plant=plant, entry_sd=deviations)


def _black_box(model: Model, fit: Fit) -> Model:
    states = tuple(Variable(f"x{i + 1}") for i in range(fit.order))
    noise = None
    if fit.model.gain.any():
        noise = np.sqrt(np.diag(fit.model.covariance))
    return replace(
        model,
        states=states,
        plant=fit.system,
        dynamics=None,
        sample_time=fit.system.dt,
        parameters={},
        entry_sd={},
        output_sd=model.output_sd if noise is None else noise,
        process_cov=None,
    )


def _measure(m: Measures) -> dict[str, float]:
    return {"r2": m.r2, "nrmse": m.nrmse, "r2_classical": m.r2_classical}


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
