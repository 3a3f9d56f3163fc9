"""Physical parameters through S(theta) when they are far from nominal: fit, make what was found the nominal plant, repeat.

The noise in the residual is ``(Mt + S Ut) d``: a filter that whitens it where S = 0 does not where S is large, and the
standard errors are then wrong. With the plant that was found as the new nominal one, S is small again: the recorded u and
y give the alpha and beta of its own coprime factors exactly, and their noise is white once more.

Two states at the beginning of a recording are treated differently. Where S is small its own state shows next to nothing: S
starts at rest and the samples in which its loop settles are not counted. The whitening filter of an unstable plant is slow
(as slow as the plant is unstable) and starts far off: its state is fitted, which is exact and costs no sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.errors import IllConditioned
from afdsvc.identify.fit import Fit
from afdsvc.identify.methods.hansen import settling_samples, youla_signals
from afdsvc.identify.methods.indirect import Mismatch, fit_indirect, judged
from afdsvc.identify.parameters.structure import Structure
from afdsvc.lti.coprime import Factorisation
from afdsvc.lti.python_control import factorise
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.lti.whitening import whitening_filter
from afdsvc.lti.yjbk import deviation_system

SETTLED = 1e-3  # share of its first transient that the loop has left where counting begins
ENOUGH = 0.1  # of a standard error: a smaller change of every parameter ends the rounds
EXACT = 1e-6  # of a typical change: the same where there is no noise


@dataclass(frozen=True, slots=True, eq=False)
class NoiseCovariances:
    """Covariances of the white output noise ``(p, p)`` and, where there is any, of the process noise ``(n, n)``."""

    output_cov: Array
    process_cov: Array | None = None

    def whitener(self, fact: Factorisation) -> StateSpace:
        """Return the whitening filter; a mode on the border of stability is granted a little process noise."""
        try:
            return whitening_filter(fact, self.output_cov, self.process_cov)[0]
        except IllConditioned:
            return whitening_filter(fact, self.output_cov, self.process_cov, regularise=1e-6)[0]


def fit_recentred(
    structure: Structure,
    nominal: Factorisation,
    recordings: Sequence[InputOutputData],
    noise: NoiseCovariances | None = None,
    norm: int = 2,
    rounds: int = 6,
) -> Fit:
    """Return the parameters from recordings of u and y made with the controller of ``nominal``.

    Without ``noise`` nothing is whitened. Ends after ``rounds`` at most, or when a round changes nothing any more. Raises
    what `fit_indirect` raises.
    """
    fit, done = fit_indirect(structure, nominal, _signals(nominal, recordings), norm, _whitener(noise, nominal)), 0
    while done < rounds - 1:
        done += 1
        before = _values(fit)
        plant = structure.build(before)
        plant = plant if plant.discrete else sample_zoh(plant, recordings[0].dt)
        fit = _at_rest(structure, factorise(plant, nominal.controller), recordings, noise, norm, before)
        if (np.abs(_values(fit) - before) < ENOUGH * np.sqrt(np.diag(fit.covariance)) + EXACT * structure.scales).all():
            break
    notes = (*fit.notes, f"the estimate was made the nominal plant {done} times")
    return replace(fit, deviation=deviation_system(nominal, fit.system), notes=notes)


def _values(fit: Fit) -> Array:
    return np.array([p.value for p in fit.parameters])


def _signals(fact: Factorisation, recordings: Sequence[InputOutputData]) -> list[InputOutputData]:
    return [youla_signals(fact, r).centred() for r in recordings]


def _whitener(noise: NoiseCovariances | None, fact: Factorisation) -> StateSpace | None:
    return None if noise is None else noise.whitener(fact)


class _AtRest(Mismatch):
    """The misfit of recordings of eta and eps that S meets at rest; the state of the whitening filter is fitted.

    Where S is 0 counting from too early costs precision and no truth: a short recording keeps half of itself.
    """

    def __init__(
        self, structure: Structure, fact: Factorisation, recordings: Sequence[InputOutputData], norm: int, whitener: StateSpace | None
    ) -> None:
        super().__init__(structure, fact, recordings, norm, whitener)
        half = min(map(len, recordings)) // 2
        self.skip = max(settling_samples(fact.Lf), min(settling_samples(fact.R, SETTLED), half))
        self.free = 0 if whitener is None else whitener.order


def _from_the_start(fact: Factorisation, recording: InputOutputData) -> InputOutputData:
    """Return eta and eps with the samples in which their filter settles: S settles meanwhile."""
    settled = youla_signals(fact, recording)
    out, _ = simulate(fact.Lf, np.hstack([recording.u, recording.y]))
    m = fact.plant.inputs
    return InputOutputData(out[:, :m] - settled.u.mean(axis=0), out[:, m:] - settled.y.mean(axis=0), recording.dt, recording.name)


def _at_rest(
    structure: Structure, fact: Factorisation, recordings: Sequence[InputOutputData], noise: NoiseCovariances | None, norm: int, start: Array
) -> Fit:
    signals = [_from_the_start(fact, r) for r in recordings]
    objective = _AtRest(structure, fact, signals, norm, _whitener(noise, fact))
    lower = np.asarray([p.lower for p in structure.parameters]) / structure.scales
    upper = np.asarray([p.upper for p in structure.parameters]) / structure.scales
    minimum, steps = objective.minimise(start / structure.scales, lower, upper)
    return judged(objective, minimum, steps)
