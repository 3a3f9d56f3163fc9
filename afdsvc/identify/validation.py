"""Judging a model on recordings it has not seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from afdsvc.dataset.arrays import Recording
from afdsvc.errors import BadInput
from afdsvc.identify.fit import Fit
from afdsvc.identify.hansen import excited_loop
from afdsvc.identify.innovations import fitted_errors
from afdsvc.lti.coprime import Factorisation
from afdsvc.lti.simulate import simulate
from afdsvc.lti.stability import describe_pole, is_stable, worst_pole
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.stats.fit_measures import Measures, measures
from afdsvc.stats.portmanteau import residual_tests

#: Growth of a slightly unstable mode over a recording up to which an open-loop simulation still means something.
LARGEST_GROWTH = 1e3


@dataclass(frozen=True, slots=True)
class Split:
    """Recordings to fit and recordings kept away, with the names of the latter as they are reported."""

    training: tuple[Recording, ...]
    heldout: tuple[Recording, ...]
    names: tuple[str, ...]


def split(training: Sequence[Recording], heldout: Sequence[Recording], share: float = 0.25) -> Split:
    """Return the split; without recordings to hold out, the last ``share`` of every recording is kept away."""
    if heldout:
        return Split(tuple(training), tuple(heldout), tuple(r.name for r in heldout))
    cuts = [round(len(r) * (1 - share)) for r in training]
    kept = tuple(r.span(0, cut) for r, cut in zip(training, cuts, strict=True))
    away = tuple(r.span(cut, len(r)) for r, cut in zip(training, cuts, strict=True))
    return Split(kept, away, tuple(f"{r.name} (last {100 * share:.0f} %)" for r in training))


def predicted_outputs(system: StateSpace, recording: Recording, fact: Factorisation | None = None) -> Array:
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
    """Whether nothing grows by more than `LARGEST_GROWTH` over the recording; integrators may be simulated."""
    margin = worst_pole(system.A, system.dt)[1]
    return bool(-margin * samples < np.log(LARGEST_GROWTH))


def heldout_measures(
    system: StateSpace, recordings: Sequence[Recording], fact: Factorisation | None = None
) -> list[Measures]:
    """Return the measures of every output over all the recordings together."""
    measured = np.vstack([r.y - r.y.mean(axis=0) for r in recordings])
    predicted = np.vstack([predicted_outputs(system, r.centred(), fact) for r in recordings])
    return measures(measured, predicted)


def validated(
    fit: Fit, recordings: Sequence[Recording], names: Sequence[str], fact: Factorisation | None = None
) -> Fit:
    """Return the fit with its measures and residual tests on recordings not used; ``names`` are those of the outputs.

    The residuals tested are one-step prediction errors when the fit has a noise model, simulation errors otherwise.
    """
    found = heldout_measures(fit.system, recordings, fact)
    centred = [r.centred() for r in recordings]
    if fit.model.gain.any():
        errors = np.vstack([fit.model.errors(r.u, r.y) for r in centred])
    else:
        errors = np.vstack([r.y - predicted_outputs(fit.system, r, fact) for r in centred])
    tests = residual_tests(errors, np.vstack([r.u for r in centred]))
    per_output: Mapping[str, Measures] = dict(zip(names, found, strict=True))
    return replace(fit, heldout=per_output, tests=tests)
