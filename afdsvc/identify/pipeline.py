"""Identification from a model and recordings to an improved model and its validation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from afdsvc.api.model import Model
from afdsvc.api.signals import Trace
from afdsvc.dataset.arrays import InputOutputData
from afdsvc.errors import AfdsvcError, BadInput
from afdsvc.identify.fit import Fit, ResponseBand
from afdsvc.identify.methods import registry
from afdsvc.identify.methods.hansen import loop_is_stable
from afdsvc.identify.methods.registry import MethodResult, omega_grid
from afdsvc.identify.options import IdentifyOptions
from afdsvc.identify.order import samples_needed
from afdsvc.identify.preparation import Prepared, nominal_plant, prepare_problem
from afdsvc.identify.result import HoldoutPreview, IdentifyResult, improved_model
from afdsvc.identify.settings import SETTINGS
from afdsvc.identify.validation import (
    Agreement,
    HoldoutSplit,
    agreement,
    can_be_simulated,
    heldout_measures,
    hold_out,
    predicted_outputs,
    predicts_only,
    undamped_modes,
    validate_fit,
)
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.statespace import StateSpace
from afdsvc.stats.fit_measures import Measures


def identify(
    model: Model,
    traces: Sequence[Trace],
    holdout: Sequence[Trace] = (),
    options: IdentifyOptions = IdentifyOptions(),
    rng: np.random.Generator | None = None,
) -> IdentifyResult:
    """Return the plant identified from the traces, judged on the ``holdout`` traces (or the last quarter of each
    trace).

    ``rng`` is needed only for several starting points. Raises `BadInput` naming recording, field and cure when the data
    cannot support an answer: too short, not exciting, drifting, with gaps, with a saturated actuator, made with another
    or an unknown controller.
    """
    problem = prepare_problem(model, traces, holdout, _needed(model, traces, options), options.screening)
    whole = problem.training
    parts = hold_out(problem.training, problem.heldout)
    kept = tuple(a.span(0, len(r)) for a, r in zip(problem.played, parts.training, strict=False))
    problem = replace(problem, training=parts.training, played=kept)
    method = _method(problem, options)
    outcome = _run(method, problem, options, rng)
    names = [v.name for v in model.outputs]
    fit = validate_fit(outcome.fit, parts.heldout, names, problem.fact)
    stable = None if problem.fact is None else loop_is_stable(fit.system, problem.fact.controller)
    before = _before(problem, parts, names)
    check, warning = _cross_check(problem, replace(outcome, fit=fit), options)
    preview = _preview(problem, parts, fit)
    if outcome.refit is not None and not holdout:
        note = f"the fit on samples kept away is that of order {fit.order} by {fit.notes[0]}; method, order and model were then chosen once more from all samples"
        again = outcome.refit(whole)
        fit = replace(again, heldout=fit.heldout, tests=fit.tests, notes=(*again.notes, note))
    return IdentifyResult(
        fit,
        improved_model(model, fit),
        problem.nominal,
        before,
        fit.heldout,
        parts.names,
        tuple(r.name for r in parts.training),
        stable,
        _certain(problem.nominal),
        outcome.full,
        outcome.reductions,
        check,
        preview,
        (*problem.notes, *warning, *_warnings(fit.heldout or {}, before, stable), *_invented(fit.system, problem.nominal, max(len(r) * r.dt for r in parts.training))),
        problem.notes,
    )


def _needed(model: Model, traces: Sequence[Trace], options: IdentifyOptions) -> int:
    """Return the fewest samples of a recording: what the smallest horizon needs that shows the order, two windows where the order is chosen."""
    if options.method in ("greybox", "indirect"):
        return SETTINGS.parametric_samples
    if options.method == "auto" and model.controller is None:
        return 2 * (len(model.inputs) + len(model.outputs) + 1)
    order = options.order or nominal_plant(model, traces[0].dt).order if traces else 1
    return samples_needed(len(model.inputs), len(model.outputs), order)


@dataclass(frozen=True, slots=True)
class MethodPlan:
    """What `identify` will do by itself: the ``method`` ("" where it refuses), and why, in one sentence."""

    method: str = ""
    sentence: str = ""


WHY = {
    "hansen": "the controller is known, so the deviation from the nominal model is identified in the loop (hansen) and the plant rebuilt from it",
    "auto": "no controller is stated and nothing was recorded of one: method, order, feedthrough and noise model are chosen by samples left out",
}


def planned(model: Model, traces: Sequence[Trace], options: IdentifyOptions = IdentifyOptions()) -> MethodPlan:
    """Return what `identify` will do with these recordings, or why it will refuse them; nothing is fitted."""
    try:
        order = nominal_plant(model, traces[0].dt).order
        problem = prepare_problem(model, traces, (), _needed(model, traces, options), options.screening)
        method = _method(problem, options)
        lines = registry.exciting(problem, problem.training, 1 if method == "auto" else order).lines
    except BadInput as error:
        return MethodPlan("", f"identify refuses: {error}")
    held = ", ".join(f"{v.name} {n}" for v, n in zip(model.inputs, lines, strict=True))
    return MethodPlan(method, f"{WHY.get(method, method)}; spectral lines of the inputs: {held}; the last quarter of each recording is held out unless --holdout names others")


def _method(problem: Prepared, options: IdentifyOptions) -> str:
    if options.method != "auto":
        return options.method
    if problem.fact is not None:
        return "hansen"
    if problem.closed_loop_signs:
        raise BadInput(
            f"model '{problem.model.name}' names no controller, but the recording was made in closed loop "
            f"({', '.join(problem.closed_loop_signs)}): add [controller], or choose method pbsid or greybox, "
            "which need none"
        )
    return "auto"


def _usable(problem: Prepared, system: StateSpace) -> bool:
    return all(can_be_simulated(system, len(r)) for r in (*problem.training, *problem.heldout))


def _run(method: str, problem: Prepared, options: IdentifyOptions, rng: np.random.Generator | None) -> MethodResult:
    if method == "greybox":
        return registry.greybox(problem, options, rng)
    ways = {
        "auto": registry.chosen,
        "hansen": registry.hansen,
        "subspace": registry.subspace,
        "pbsid": registry.pbsid,
        "pem": registry.pem,
        "output_error": registry.output_error,
        "indirect": registry.indirect,
    }
    return ways[method](problem, options)


def _before(problem: Prepared, parts: HoldoutSplit, names: Sequence[str]) -> dict[str, Measures]:
    try:
        found = heldout_measures(problem.nominal, parts.heldout, problem.fact)
    except BadInput:  # an unstable nominal model without controller predicts nothing
        found = [Measures(float("-inf"), float("inf"), float("-inf"))] * len(names)
    return dict(zip(names, found, strict=True))


def _cross_check(
    problem: Prepared, outcome: MethodResult, options: IdentifyOptions
) -> tuple[Agreement | None, tuple[str, ...]]:
    """Compare with PBSIDopt where there is an uncertainty to compare with."""
    band = outcome.fit.band
    if not options.cross_check or band is None or outcome.fit.method == "pbsid":
        return None, ()
    try:
        other = registry.pbsid(problem, replace(options, order=None, horizon=None)).fit
    except AfdsvcError as error:
        return None, (f"no cross-check by PBSIDopt: {error}",)
    if problem.fact is None and not _usable(problem, other.system):
        return None, ("no cross-check: the plant that PBSIDopt finds on these recordings is unstable, so it cannot have run in open loop",)
    excited = _excited(problem.training, band)
    if other.band is None or not excited.any():
        return None, ()
    return agreement(_only(band, excited), _only(other.band, excited)), ()


def _preview(problem: Prepared, parts: HoldoutSplit, fit: Fit, samples: int = 600) -> HoldoutPreview:
    """Return the middle of the first recording not used, with what nominal model and fit make of it."""
    recording = parts.heldout[0].centred()
    start = max(0, (len(recording) - samples) // 2)
    shown = slice(start, start + samples)
    try:
        before = predicted_outputs(problem.nominal, recording, problem.fact)[shown]
    except BadInput:
        before = None
    if predicts_only(fit, [recording], problem.fact):
        after = (recording.y - fit.model.errors(recording.u, recording.y))[shown]
    else:
        after = predicted_outputs(fit.system, recording, problem.fact)[shown]
    t = recording.dt * np.arange(start, start + len(after), dtype=np.float64)
    return HoldoutPreview(parts.names[0], t, recording.y[shown], before, after)


def _excited(recordings: Sequence[InputOutputData], band: ResponseBand) -> np.ndarray:
    """Return which frequencies hold a thousandth or more of the input's strongest power."""
    dt = recordings[0].dt
    power = sum(np.interp(band.omega, *_smooth_spectrum(r.u, dt)) for r in recordings)
    return np.asarray(power > 1e-3 * np.max(power))


def _smooth_spectrum(u: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    power = (np.abs(np.fft.rfft(u, axis=0)) ** 2).sum(axis=1)
    width = max(1, len(power) // 200)
    smooth = np.convolve(power, np.ones(width) / width, mode="same")
    return 2 * np.pi * np.fft.rfftfreq(len(u), dt), smooth


def _only(band: ResponseBand, kept: np.ndarray) -> ResponseBand:
    return ResponseBand(band.omega[kept], band.value[kept], band.covariance[kept], band.freedom)


def _certain(system: StateSpace) -> ResponseBand:
    omega = omega_grid(system.dt)
    value = frequency_response(system, omega)
    return ResponseBand(omega, value, np.zeros((*value.shape, 2, 2)))


def _invented(found: StateSpace, nominal: StateSpace, duration: float) -> tuple[str, ...]:
    return tuple(
        f"the identified plant has an undamped mode at {hz:.4g} Hz that the nominal model does not have; "
        "at the speed of rotation or mains frequency it is a periodic disturbance, not the plant: remove it from u and y first"
        for hz in undamped_modes(found, nominal, duration)
    )


def _warnings(after: Mapping[str, Measures], before: Mapping[str, Measures], stable: bool | None) -> tuple[str, ...]:
    notes = ["the current controller does not stabilise the identified plant"] if stable is False else []
    errors = {name: (before[name].nrmse, after[name].nrmse) for name in after}
    notes += [
        f"output '{name}': the model that was given follows the samples held out better than the identified one "
        f"(error {100 * given:.3g} % of the output's deviation, identified {100 * found:.3g} %)"
        for name, (given, found) in errors.items()
        if found > SETTINGS.worse * given
    ]
    return tuple(notes)
