"""Each method as a function from a prepared problem to a fit; the same steps in the same order."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from afdsvc.api.evidence import p_value_text
from afdsvc.dataset.arrays import InputOutputData
from afdsvc.errors import AfdsvcError, BadInput
from afdsvc.identify.cross_validation import Choice, Feedback, choose_candidate, feedback_of, fitted_candidate
from afdsvc.identify.excitation import Excitation, require_excitation, supported_order
from afdsvc.identify.fit import Fit, jackknife_band, repetitions
from afdsvc.identify.methods.black_box_pem import black_box_band, black_box_pem
from afdsvc.identify.methods.greybox import GreyboxOptions, fit_greybox, greybox_band
from afdsvc.identify.methods.hansen import loop_is_stable, rebuilt_plant, youla_signals
from afdsvc.identify.methods.pbsid import Predictor, decompose_predictor, decompose_predictor_groups, realise_predictor
from afdsvc.identify.methods.repeated_indirect import NoiseCovariances, fit_recentred
from afdsvc.identify.methods.subspace import Subspace, Weighting, decompose, realise
from afdsvc.identify.numerics.innovations_form import InnovationsForm, fitted_errors
from afdsvc.identify.options import IdentifyOptions
from afdsvc.identify.order import answer_p, choose_horizon, choose_order, memory, simulated_order
from afdsvc.identify.parameters.structure import Structure, model_structure
from afdsvc.identify.preparation import Prepared
from afdsvc.identify.reduction import ReducedPlant, compare_reductions, reduction_cost, refine_from
from afdsvc.identify.settings import SETTINGS
from afdsvc.identify.validation import can_be_simulated
from afdsvc.lti.coprime import Factorisation
from afdsvc.lti.stability import is_stable
from afdsvc.lti.statespace import Array, StateSpace


@dataclass(frozen=True, slots=True, eq=False)
class MethodResult:
    """A fit, the full-order plant it came from where it was reduced, and the reductions that were compared.

    ``refit`` chooses and fits anew from other recordings, where the structure was chosen by samples left out.
    """

    fit: Fit
    full: StateSpace | None = None
    reductions: tuple[ReducedPlant, ...] = ()
    refit: Callable[[Sequence[InputOutputData]], Fit] | None = None


def band_hz(plant: StateSpace) -> tuple[float, float]:
    """Return the band in which a discrete plant acts: a tenth of its slowest pole to twice its fastest, below 0.4 /
    dt; integrators act in every band."""
    poles = plant.poles()
    angles = np.abs(np.log(poles[np.abs(poles) > 1e-9]))
    rates = angles[angles > 1e-9] / plant.dt / (2 * np.pi)
    if not rates.size:
        return 0.001 / plant.dt, 0.4 / plant.dt
    high = min(2 * float(rates.max()), 0.4 / plant.dt)
    return max(float(rates.min()) / 10, high / 1e4), high


def omega_grid(dt: float, points: int = 120) -> Array:
    """Return the angular frequencies [rad/s] at which responses are reported, logarithmic up to nearly half the
    rate."""
    return np.geomspace(1e-3, 0.98, points) * np.pi / dt


def hansen(problem: Prepared, options: IdentifyOptions) -> MethodResult:
    """Identify S from (eta, eps), rebuild the plant, reduce it."""
    fact = _known_controller(problem, "hansen")
    signals = [youla_signals(fact, r).centred() for r in problem.training]
    offered = exciting(problem, signals, options.order or problem.nominal.order)
    largest = 2 * problem.nominal.order + fact.controller.order + 4
    largest = min(largest, supported_order(offered.persistent_order, problem.nominal.outputs))
    found, order, reason = _open_loop_order(signals, problem.slowest, largest, options)
    if order == 0:
        return MethodResult(_nominal_stands(problem, reason))
    S = realise(found, order, stable=True)
    full = rebuilt_plant(fact, S.system)
    reduced = options.reduce_to if options.reduce_to is not None else problem.nominal.order
    note = f"S of order {order} with horizon {found.horizon}, plant of order {full.order}"
    fit = Fit("hansen", _output_error(full), found.singular_values, reason, deviation=S.system, notes=(note,))
    if reduced >= full.order:
        return MethodResult(
            _banded(fit, repetitions(_hansen_repeat(fact, found.horizon, order, options, None, reduced), problem.training, options.groups)), full
        )
    reductions = _reductions(full, fact, reduced, problem.training, options)
    if options.reduction == "refined":
        return _refined(problem, signals, fit, full, reductions, options)
    fit = replace(
        fit,
        model=_output_error(_chosen(reductions)),
        notes=(f"{note}, reduced to {reduced} by {reductions[0].method} truncation",),
    )
    repeat = _hansen_repeat(fact, found.horizon, order, options, reductions[0].method, reduced)
    return MethodResult(_banded(fit, repetitions(repeat, problem.training, options.groups)), full, tuple(reductions))


def _refined(
    problem: Prepared,
    signals: Sequence[InputOutputData],
    fit: Fit,
    full: StateSpace,
    reductions: list[ReducedPlant],
    options: IdentifyOptions,
) -> MethodResult:
    """Fit the reduced plant to the recordings, from the truncation that disturbs the loop least, from the nominal plant and from PBSIDopt."""
    fact = _known_controller(problem, "hansen")
    truncated, first = [r.system for r in reductions[:1] if r.loop_stable and r.system is not None], reductions[0].system
    order = problem.nominal.order if first is None else first.order
    others = (_answering_at_once(g, problem.nominal) for g in (problem.nominal, *_by_predictor(problem, order)))
    stable = [*truncated, *(g for g in others if g.order == order and loop_is_stable(g, fact.controller))]
    starts = stable or [_chosen(reductions)]
    refinement = refine_from(fact, signals, starts, _whitener(problem, fact))
    found = reduction_cost("refined", refinement.system, full, fact, problem.training)
    band = refinement.band(omega_grid(full.dt), options.groups) if options.groups else None
    note = (
        f"{fit.notes[0]}, reduced to {found.system.order if found.system else 0} by {reductions[0].method} "
        f"truncation and refined on the recordings from {len(starts)} starts"
    )
    return MethodResult(
        replace(fit, model=_output_error(refinement.system), band=band, notes=(note,)), full, (found, *reductions)
    )


def _answering_at_once(start: StateSpace, nominal: StateSpace) -> StateSpace:
    """Return a start with the nominal feedthrough where it has none: what is zero at the start stays zero."""
    return start if start.D.any() else StateSpace(start.A, start.B, start.C, nominal.D, start.dt)


def _by_predictor(problem: Prepared, order: int) -> list[StateSpace]:
    """Return the plant of PBSIDopt, none where it fails."""
    past = max(40, choose_horizon(problem.training, 2 * problem.slowest, windows=1))
    try:
        return [realise_predictor(decompose_predictor(problem.training, past), order).system]
    except (AfdsvcError, np.linalg.LinAlgError):
        return []


def _whitener(problem: Prepared, fact: Factorisation) -> StateSpace | None:
    """Return the whitening filter for an unstable plant with known noise, None for any other.

    The noise of beta holds the zeros of Mt at the unstable poles: next to none where the plant is slow, which is lost when every
    frequency counts alike.
    """
    sd = problem.model.output_sd
    if sd is None or not sd.all() or is_stable(problem.nominal.A, problem.nominal.dt):
        return None
    return NoiseCovariances(np.diag(sd**2), problem.model.process_cov).whitener(fact)


def _hansen_repeat(
    fact: Factorisation, horizon: int, order: int, options: IdentifyOptions, reduction: str | None, reduced: int
) -> Callable[[Sequence[InputOutputData]], StateSpace]:
    """Return the whole way from recordings of u and y to the plant, every choice fixed."""

    def estimate(recordings: Sequence[InputOutputData]) -> StateSpace:
        signals = [youla_signals(fact, r) for r in recordings]
        full = rebuilt_plant(
            fact, realise(decompose(signals, horizon, cast(Weighting, options.weighting)), order, stable=True).system
        )
        return full if reduction is None else _chosen(compare_reductions(full, fact, reduced, recordings, [reduction]))

    return estimate




def _open_loop_order(
    recordings: Sequence[InputOutputData], slowest: float, largest: int, options: IdentifyOptions
) -> tuple[Subspace, int, str]:
    """Return decomposition, order and why; a horizon not asked for is stretched to the slowest mode found."""
    p, weighting = recordings[0].y.shape[1], cast(Weighting, options.weighting)
    horizon = options.horizon or choose_horizon(recordings, slowest)
    order, reason = _order(recordings, horizon, min(largest, (horizon - 1) * p), options, closed_loop=False)
    found = decompose(recordings, horizon, weighting)
    if order == 0 and answer_p(recordings) < SETTINGS.response_level:
        most = min(largest, (horizon - 1) * p)
        order, lead = simulated_order(recordings, lambda n: realise(found, n, stable=True).system, most)
        reason = (
            f"order {order}: the response to the inputs is significant, and the simulation error is smallest (criterion lower by {lead:.4g})"
        )
    if options.horizon is None and order:
        longer = choose_horizon(recordings, memory(realise(found, order, stable=True).system.poles()))
        if longer > 1.3 * horizon:
            order, reason = _order(recordings, longer, min(largest, (longer - 1) * p), options, closed_loop=False)
            found = decompose(recordings, longer, weighting)
    return found, order, reason


def subspace(problem: Prepared, options: IdentifyOptions) -> MethodResult:
    """Identify the plant from u and y in open loop."""
    if problem.fact is not None or problem.closed_loop_signs:
        signs = ", ".join(problem.closed_loop_signs) or "[controller] in the model"
        raise BadInput(f"method 'subspace' is biased in closed loop, and this is one ({signs}); use hansen or pbsid")
    exciting(problem, problem.training, options.order or problem.nominal.order)
    found, order, reason = _open_loop_order(problem.training, problem.slowest, 2 * problem.nominal.order + 8, options)
    order = max(order, 1)
    feedthrough = options.feedthrough is not False
    fit = Fit(
        "subspace",
        realise(found, order, stable=True, feedthrough=feedthrough),
        found.singular_values,
        reason,
        notes=(f"horizon {found.horizon}",),
    )

    def estimate(recordings: Sequence[InputOutputData]) -> StateSpace:
        return realise(
            decompose(recordings, found.horizon, cast(Weighting, options.weighting)), order, stable=True, feedthrough=feedthrough
        ).system

    return MethodResult(_banded(fit, repetitions(estimate, problem.training, options.groups)))


def pbsid(problem: Prepared, options: IdentifyOptions) -> MethodResult:
    """Identify the plant from u and y with feedback present or not, by PBSIDopt."""
    exciting(problem, problem.training, options.order or problem.nominal.order)
    if problem.played:  # noise that the controller brings back to u is no excitation to rely on
        exciting(problem, problem.played, options.order or problem.nominal.order)
    past, order, reason = _closed_loop_order(problem, options)
    feedthrough = bool(options.feedthrough)
    found, without = decompose_predictor_groups(problem.training, past, max(options.groups, 2), feedthrough)
    fit = Fit("pbsid", realise_predictor(found, order), found.singular_values, reason, notes=(f"past window {past}, {'with' if feedthrough else 'without'} feedthrough",))

    def realised(rest: Callable[[], Predictor]) -> Callable[[], StateSpace]:
        return lambda: realise_predictor(rest(), order).system

    return MethodResult(_banded(fit, [realised(rest) for rest in without[: options.groups]]))


def pem(problem: Prepared, options: IdentifyOptions) -> MethodResult:
    """Identify the plant from u and y by prediction errors, a black box started from PBSIDopt."""
    return _black_box(problem, options, noise=True)


def output_error(problem: Prepared, options: IdentifyOptions) -> MethodResult:
    """Identify the plant from u and y by simulation errors (open loop), a black box started from PBSIDopt."""
    return _black_box(problem, options, noise=False)


def _black_box(problem: Prepared, options: IdentifyOptions, noise: bool) -> MethodResult:
    fit = pbsid(problem, replace(options, groups=0)).fit
    model = black_box_pem(fit.model, problem.training, noise)
    band = black_box_band(model, problem.training, omega_grid(model.system.dt), noise, options.groups) if options.groups else None
    return MethodResult(replace(fit, method="pem" if noise else "output_error", model=model, band=band))


def chosen(problem: Prepared, options: IdentifyOptions) -> MethodResult:
    """Identify the plant from u and y; method, horizon, feedthrough, order and noise model by samples left out."""
    exciting(problem, problem.training, 1)
    feedback = feedback_of(problem.training)
    answers = feedback.p < SETTINGS.feedback_level
    loop = answers and feedback.share > SETTINGS.feedback_share
    fixed = (options.order, options.horizon, options.feedthrough)
    tries = [(loop, True), (False, True), (True, False)] if answers else [(False, True)]
    for loop, simulated in dict.fromkeys(tries):  # a loop around an unstable plant shows in that no simulation is better than the mean
        try:
            choice = choose_candidate(problem.training, SETTINGS.largest_order, answers, loop, simulated, *fixed)
        except BadInput:
            if (loop, simulated) == tries[-1]:
                raise
            continue
        if choice.loss < 1 or (loop, simulated) == tries[-1]:
            break
    notes = (_feedback_note(feedback, loop),) if answers else ()
    fit = _fitted_choice(problem.training, choice, options, notes, simulated)
    return MethodResult(fit, refit=lambda recordings: chosen(replace(problem, training=tuple(recordings)), options).fit)


def _fitted_choice(recordings: Sequence[InputOutputData], choice: Choice, options: IdentifyOptions, notes: tuple[str, ...], simulated: bool) -> Fit:
    """Return the fit of the candidate chosen, of the next best where its model cannot be simulated over the recordings (and must be)."""
    for c in (choice.candidate, *choice.others):
        try:
            model = fitted_candidate(c, recordings)
        except (AfdsvcError, np.linalg.LinAlgError):
            continue
        if not simulated or _simulates(model, recordings):
            break
    else:
        raise BadInput("no candidate that was chosen by samples left out could be fitted to all of them; give method and order")
    if c != choice.candidate:
        notes = (*notes, f"fitted to all samples, the candidate chosen gave no stable model; the next best did: order {c.order} by {c.sentence}")
    fit = Fit(c.refined or c.method, model, order_reason=choice.sentence, notes=(c.sentence, *notes))
    if not options.groups:
        return fit
    if c.refined:
        return replace(fit, band=black_box_band(model, recordings, omega_grid(model.system.dt), c.refined == "pem", options.groups))
    return _banded(fit, repetitions(lambda several: fitted_candidate(c, several).system, recordings, options.groups))


def _simulates(model: InnovationsForm, recordings: Sequence[InputOutputData]) -> bool:
    """Whether simulations of a model over the recordings miss less than the outputs' power, and one that grows has a predictor to be judged by."""
    try:
        left = sum((fitted_errors(model.system, r.u, r.y) ** 2).sum(axis=0) for r in recordings)
    except AfdsvcError:
        return False
    stable = all(can_be_simulated(model.system, len(r)) for r in recordings)
    return bool((left < sum((r.y**2).sum(axis=0) for r in recordings)).all()) and (stable or bool(model.gain.any()))


def _feedback_note(feedback: Feedback, loop: bool) -> str:
    found = f"past outputs predict the inputs ({p_value_text(feedback.p)}; up to {100 * feedback.share:.2g} % of an input's power)"
    if loop:
        return f"{found}: taken as recorded in closed loop, identified by methods that feedback does not bias"
    return f"{found}: if a controller was at work, name it in the model, or compare with method pem: a method for open loop is biased by about that share"


def _closed_loop_order(problem: Prepared, options: IdentifyOptions) -> tuple[int, int, str]:
    """Return past window, order and why; a window not asked for is stretched to twice the slowest mode found."""
    recordings, largest = problem.training, problem.nominal.order + 8
    past = options.horizon or max(40, choose_horizon(recordings, 2 * problem.slowest, windows=1))
    order, reason = _order(recordings, past, min(largest, max(2, past // 3)), options, closed_loop=True)
    if options.horizon is None and order:
        model = realise_predictor(decompose_predictor(recordings, past), order)
        longer = choose_horizon(recordings, 2 * memory(model.system.poles()), windows=1)
        if longer > 1.3 * past:
            past = longer
            order, reason = _order(recordings, past, min(largest, max(2, past // 3)), options, closed_loop=True)
    return past, max(order, 1), reason


def greybox(problem: Prepared, options: IdentifyOptions, rng: np.random.Generator | None) -> MethodResult:
    """Fit physical parameters (or uncertain entries) by maximum likelihood on u and y."""
    structure = _structure(problem, options)
    exciting(problem, problem.training, problem.nominal.order)
    entries = problem.model.dynamics is None
    settings = GreyboxOptions(starts=options.starts, prior=entries if options.prior is None else options.prior)
    fit = fit_greybox(structure, problem.training, settings, rng)
    return MethodResult(replace(fit, band=greybox_band(structure, fit, omega_grid(problem.nominal.dt))))


def indirect(problem: Prepared, options: IdentifyOptions) -> MethodResult:
    """Fit physical parameters through S(theta), what was found becoming the nominal plant until it stays."""
    fact, structure = _known_controller(problem, "indirect"), _structure(problem, options)
    signals = [youla_signals(fact, r).centred() for r in problem.training]
    exciting(problem, signals, problem.nominal.order)
    sd = problem.model.output_sd
    noise = None if sd is None else NoiseCovariances(np.diag(sd**2), problem.model.process_cov)
    fit = fit_recentred(structure, fact, problem.training, noise, options.norm)
    return MethodResult(replace(fit, band=greybox_band(structure, fit, omega_grid(problem.nominal.dt))))


def _structure(problem: Prepared, options: IdentifyOptions) -> Structure:
    rates = tuple(s.name for s in problem.model.states if s.rate_of is not None)
    structure = model_structure(problem.model, rates if options.process_states is None else options.process_states)
    if options.free is None:
        return structure
    known = [p.name for p in structure.parameters]
    for name in options.free:
        if name not in known:
            raise BadInput(f"model '{problem.model.name}' has no free parameter '{name}'; it has {', '.join(known)}")
    kept = [known.index(name) for name in options.free]

    def build(theta: Array) -> StateSpace:
        values = structure.values.copy()
        values[kept] = theta
        return structure.build(values)

    return replace(structure, parameters=tuple(structure.parameters[k] for k in kept), build=build)


def _known_controller(problem: Prepared, method: str) -> Factorisation:
    if problem.fact is None:
        raise BadInput(
            f"model '{problem.model.name}' names no controller, and method '{method}' needs the one that ran; "
            "add [controller], "
            "or use method pbsid or greybox, which need none"
        )
    return problem.fact


def exciting(problem: Prepared, recordings: Sequence[InputOutputData], order: int) -> Excitation:
    """Return the excitation of recordings where it supports the order; raises `BadInput` with the burst that would."""
    names = [v.name for v in problem.model.inputs]
    size = np.max([r.u.std(axis=0) for r in problem.training], axis=0)
    return require_excitation(recordings, order, names, problem.nominal.outputs, band_hz(problem.nominal), size)


def _order(
    recordings: Sequence[InputOutputData], horizon: int, largest: int, options: IdentifyOptions, closed_loop: bool
) -> tuple[int, str]:
    if options.order is not None:
        return options.order, f"order {options.order}: asked for"
    choice = choose_order(recordings, horizon, largest, closed_loop)
    return choice.order, choice.sentence


def _nominal_stands(problem: Prepared, reason: str) -> Fit:
    S = StateSpace.gain(np.zeros((problem.nominal.outputs, problem.nominal.inputs)), problem.nominal.dt)
    note = "no deviation from the nominal model shows in the recordings; the nominal model is kept"
    return Fit("hansen", _output_error(problem.nominal), order_reason=reason, deviation=S, notes=(note,))


def _output_error(system: StateSpace) -> InnovationsForm:
    """Return the plant without a noise model."""
    return InnovationsForm(system, np.zeros((system.order, system.outputs)), np.eye(system.outputs))


def _reductions(
    full: StateSpace, fact: Factorisation, reduced: int, recordings: Sequence[InputOutputData], options: IdentifyOptions
) -> list[ReducedPlant]:
    found = compare_reductions(full, fact, reduced, recordings)
    return (
        found
        if options.reduction in ("best", "refined")
        else sorted(found, key=lambda r: r.method != options.reduction)
    )


def _chosen(reductions: Sequence[ReducedPlant]) -> StateSpace:
    best = reductions[0]
    if best.system is None or not best.loop_stable:
        raise BadInput(f"reduction '{best.method}' failed: {best.failure}; ask for a higher order with reduce_to")
    return best.system


def _banded(fit: Fit, repeated: Sequence[Callable[[], StateSpace]]) -> Fit:
    return replace(fit, band=jackknife_band(fit.system, repeated, omega_grid(fit.system.dt))) if repeated else fit


__all__ = ["MethodResult", "band_hz", "chosen", "exciting", "greybox", "hansen", "indirect", "omega_grid", "output_error", "pbsid", "pem", "subspace"]
