"""Validation on held-out recordings: fit measures, agreement of two independent estimates, undamped modes.

The orbit of an unbalanced rotor, or interference at mains frequency, is predictable without any input. An order chosen from the data then
makes room for an undamped mode, which draws the disturbance from its initial state and is not a property of the plant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.errors import BadInput
from afdsvc.identify.fit import Fit, ResponseBand
from afdsvc.identify.methods.hansen import excited_loop
from afdsvc.identify.numerics.innovations_form import fitted_errors
from afdsvc.identify.settings import SETTINGS
from afdsvc.lti.coprime import Factorisation
from afdsvc.lti.simulate import simulate
from afdsvc.lti.stability import describe_pole, is_stable, worst_pole
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.stats.fit_measures import Measures, measures
from afdsvc.stats.portmanteau import residual_tests


@dataclass(frozen=True, slots=True)
class HoldoutSplit:
    """Recordings to fit and recordings kept away, with the names of the latter as they are reported."""

    training: tuple[InputOutputData, ...]
    heldout: tuple[InputOutputData, ...]
    names: tuple[str, ...]


def hold_out(training: Sequence[InputOutputData], heldout: Sequence[InputOutputData], share: float = 0.25) -> HoldoutSplit:
    """Return the split; without recordings to hold out, the last ``share`` of every recording is kept away."""
    if heldout:
        return HoldoutSplit(tuple(training), tuple(heldout), tuple(r.name for r in heldout))
    cuts = [round(len(r) * (1 - share)) for r in training]
    kept = tuple(r.span(0, cut) for r, cut in zip(training, cuts, strict=True))
    away = tuple(r.span(cut, len(r)) for r, cut in zip(training, cuts, strict=True))
    return HoldoutSplit(kept, away, tuple(f"{r.name} (last {100 * share:.0f} %)" for r in training))


def predicted_outputs(system: StateSpace, recording: InputOutputData, fact: Factorisation | None = None) -> Array:
    """Return what a model makes of a recording, shape ``(N, p)``, with the best initial state.

    A stable (or integrating) plant is simulated from the recorded input; an unstable one inside its loop, from the
    excitation the recording contains (``fact`` is needed then, and the controller must stabilise the model).
    """
    if can_be_simulated(system, len(recording)):
        return np.asarray(recording.y - fitted_errors(system, recording.u, recording.y))
    if fact is None:
        raise BadInput(
            f"the model has the pole {describe_pole(worst_pole(system.A, system.dt)[0], system.dt)}: it cannot be simulated "
            "without its controller; name the controller in the model, or identify with a smaller order"
        )
    m = fact.plant.inputs
    eta = simulate(fact.Lf, np.hstack([recording.u, recording.y]))[0][:, :m]
    loop = excited_loop(fact, system).select(slice(m, None), slice(None))
    if not is_stable(loop.A, loop.dt):
        raise BadInput("the controller does not stabilise the model, so nothing can be predicted with it")
    return np.asarray(recording.y - fitted_errors(loop, eta, recording.y))


def can_be_simulated(system: StateSpace, samples: int) -> bool:
    """Whether nothing grows by more than `IdentificationSettings.largest_growth` over the recording; integrators may be simulated."""
    margin = worst_pole(system.A, system.dt)[1]
    return bool(-margin * samples < np.log(SETTINGS.largest_growth))


def heldout_measures(
    system: StateSpace, recordings: Sequence[InputOutputData], fact: Factorisation | None = None
) -> list[Measures]:
    """Return the measures of every output over all the recordings together."""
    measured = np.vstack([r.y - r.y.mean(axis=0) for r in recordings])
    predicted = np.vstack([predicted_outputs(system, r.centred(), fact) for r in recordings])
    return measures(measured, predicted)


def validate_fit(
    fit: Fit, recordings: Sequence[InputOutputData], names: Sequence[str], fact: Factorisation | None = None
) -> Fit:
    """Return the fit with its measures and residual tests on recordings not used; ``names`` are those of the outputs.

    The residuals tested are one-step prediction errors when the fit has a noise model, simulation errors otherwise.
    """
    centred = [r.centred() for r in recordings]
    by_prediction = predicts_only(fit, recordings, fact)
    if fit.model.gain.any():
        errors = np.vstack([fit.model.errors(r.u, r.y) for r in centred])
    else:
        errors = np.vstack([r.y - predicted_outputs(fit.system, r, fact) for r in centred])
    measured = np.vstack([r.y for r in centred])
    found = measures(measured, measured - errors) if by_prediction else heldout_measures(fit.system, recordings, fact)
    if by_prediction:
        fit = replace(fit, notes=(*fit.notes, PREDICTED))
    tests = residual_tests(errors, np.vstack([r.u for r in centred]), lags=min(25, len(errors) // 4))
    per_output: Mapping[str, Measures] = dict(zip(names, found, strict=True))
    return replace(fit, heldout=per_output, tests=tests)


PREDICTED = "the plant is unstable and no controller is named, so the fit on data not used is that of one-step predictions, not of a simulation"


def predicts_only(fit: Fit, recordings: Sequence[InputOutputData], fact: Factorisation | None) -> bool:
    """Whether a model can be judged by one-step predictions only: an unstable plant with a noise model and without its controller."""
    return fact is None and bool(fit.model.gain.any()) and not all(can_be_simulated(fit.system, len(r)) for r in recordings)


@dataclass(frozen=True, slots=True)
class Agreement:
    """Two frequency responses against each other.

    ``relative`` is the median over frequency of ``|G1 - G2| / |G1|`` (spectral norms); ``deviations`` the median
    distance in combined standard deviations (about 0.8 expected when only noise separates them, far above 2 when one is
    biased), ``farthest`` the distance that a tenth of the frequencies exceed (about 1.5 expected); ``resolution`` the median relative
    difference that the bands would let pass (two combined standard deviations).
    """

    relative: float
    deviations: float
    farthest: float = 0.0
    resolution: float = 0.0

    @property
    def verdict(self) -> str:
        """One of "agree", "differ", and "undecided": bands so wide that agreement would say nothing."""
        if self.deviations >= MEDIAN_LIMIT or self.farthest >= FARTHEST_LIMIT:
            return "differ"
        return "undecided" if self.resolution > COARSEST else "agree"

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        verdict = {
            "agree": "they agree within their uncertainty",
            "differ": "they differ by more than their uncertainty: do not trust either",
            "undecided": f"this decides nothing, since the bands would let {100 * self.resolution:.2g} % pass: record longer or excite more",
        }[self.verdict]
        return f"the two routes differ by {100 * self.relative:.2g} % ({self.deviations:.2g} standard deviations): {verdict}"


#: Limits of an agreement: median and upper tenth of the distance in standard deviations, and the coarsest resolution that confirms anything.
MEDIAN_LIMIT, FARTHEST_LIMIT, COARSEST = 2.0, 4.0, 0.25


def agreement(first: ResponseBand, second: ResponseBand) -> Agreement:
    """Return how well two responses on the same frequencies agree."""
    size = np.linalg.norm(first.value, ord=2, axis=(1, 2))
    relative = np.linalg.norm(first.value - second.value, ord=2, axis=(1, 2)) / size
    spread = np.sqrt(first.sd**2 + second.sd**2)
    distance = np.abs(first.value - second.value) / np.where(spread > 0, spread, np.inf)
    passed = 2 * np.linalg.norm(spread, axis=(1, 2)) / size
    return Agreement(float(np.median(relative)), float(np.median(distance)), float(np.quantile(distance, 0.9)), float(np.median(passed)))


#: Relative damping below which a mode counts as undamped, growing modes too, and how near in frequency a nominal one excuses it.
LEAST_DAMPING, NEIGHBOURHOOD = 0.01, 0.2
#: In a short recording more damping counts as none: a mode of which this decay (natural logarithm) leaves five per cent rings from end to end.
LEAST_DECAY, MOST_DAMPING = 3.0, 0.05


def undamped_modes(found: StateSpace, nominal: StateSpace, duration: float = float("inf")) -> list[float]:
    """Return the frequencies [Hz] of undamped and growing modes of a discrete system that the nominal one does not have nearby.

    ``duration`` [s] is that of the longest recording.
    """
    known = _undamped(nominal, duration, 2.0)
    new = [w for w in _undamped(found, duration) if not (np.abs(known - w) < NEIGHBOURHOOD * w).any()]
    return [float(w / (2 * np.pi)) for w in new]


def _undamped(system: StateSpace, duration: float, factor: float = 1.0) -> Array:
    poles = system.poles().astype(np.complex128)
    rates = np.log(poles[(np.abs(poles) > 0) & (poles.imag > 0)]) / system.dt
    omega = np.abs(rates)
    return np.asarray(omega[-rates.real < factor * np.clip(LEAST_DECAY / (omega * duration), LEAST_DAMPING, MOST_DAMPING) * omega])
