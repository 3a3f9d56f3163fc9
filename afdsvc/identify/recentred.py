"""Physical parameters through S(theta) when they are far from nominal: fit, make what was found the nominal plant, repeat.

The noise in the residual is ``(Mt + S Ut) d``: a filter that whitens it where S = 0 does not where S is large, and the
standard errors are then wrong. With the plant that was found as the new nominal one, S is small again: the recorded u and
y give the alpha and beta of its own coprime factors exactly, and their noise is white once more. Where S is small a state
of S shows next to nothing: after the first round it starts at rest instead of being fitted to noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from afdsvc.errors import BadInput, IllConditioned
from afdsvc.identify.descent import Local
from afdsvc.identify.fit import Fit
from afdsvc.identify.hansen import settling_samples, youla_signals
from afdsvc.identify.indirect import Mismatch, _fit, fit_indirect
from afdsvc.identify.recordings import Recording
from afdsvc.identify.structure import Structure
from afdsvc.identify.sweep import sweep
from afdsvc.lti.choice import factorise
from afdsvc.lti.coprime import Factorisation
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.lti.whitening import whitening_filter

SETTLED = 3e-3  # share of its first transient that a filter has left


def fit_recentred(
    structure: Structure, controller: StateSpace, recordings: Sequence[Recording], output_cov: Array, rounds: int = 3
) -> Fit:
    """Return the parameters from recordings of u and y made with ``controller`` (discrete, positive feedback).

    ``output_cov (p, p)`` is the covariance of the white output noise. Raises what `fit_indirect` raises, and
    `NotStabilising` when the controller does not hold the plant found on the way.
    """
    theta = np.asarray(structure.values, dtype=np.float64)
    dt = recordings[0].dt
    for k in range(rounds):
        plant = structure.build(theta)
        fact = factorise(plant if plant.discrete else sample_zoh(plant, dt), controller)
        signals = [youla_signals(fact, r) for r in recordings]
        whitener = _whitener(fact, output_cov, min(map(len, signals)) // 3)
        fit = _at_rest(structure, fact, signals, whitener, theta) if k else fit_indirect(structure, fact, signals, 2, whitener)
        theta = np.array([p.value for p in fit.parameters])
    return replace(fit, notes=(*fit.notes, f"made the nominal plant {rounds - 1} times"))


def _whitener(fact: Factorisation, output_cov: Array, samples: int) -> StateSpace:
    """Return the whitening filter that settles within so many samples; modes on the border of stability never let it, unless
    a little process noise is granted. Raises `BadInput` when a thousandth of the output noise is not enough."""
    for granted in (0.0, 1e-6, 1e-5, 1e-4, 1e-3):
        try:
            made = whitening_filter(fact, output_cov, regularise=granted)[0]
        except IllConditioned:
            continue
        if settling_samples(made, SETTLED) <= samples:
            return made
    raise BadInput(f"the whitening filter does not settle within {samples} samples; a longer recording is wanted")


class _AtRest(Mismatch):
    """The misfit of recordings that S meets at rest, without the samples in which the whitening filter settles."""

    def __init__(
        self, structure: Structure, fact: Factorisation, recordings: Sequence[Recording], whitener: StateSpace
    ) -> None:
        super().__init__(structure, fact, recordings, 2, whitener)
        first = settling_samples(whitener, SETTLED)
        self.recordings = [Recording(r.u[first:], r.y[first:], r.dt, r.name) for r in self.recordings]

    def local(self, z: Array) -> Local:
        scale, count, theta = self.structure.scales, len(z), z * self.structure.scales
        S, slopes = self.signature(theta), self.slopes(theta)
        whitener = np.linalg.inv(np.linalg.cholesky(self.covariance))
        found = [sweep(S, slopes, r.u, r.y, np.zeros(S.order), whitener) for r in self.recordings]
        gradient, matrix = sum(f.gradient for f in found), sum(f.matrix for f in found)
        curvature = np.asarray(matrix)[:count, :count] * np.outer(scale, scale)
        return Local(sum(f.cost for f in found), np.asarray(gradient)[:count] * scale, curvature)


def _at_rest(
    structure: Structure, fact: Factorisation, signals: Sequence[Recording], whitener: StateSpace, start: Array
) -> Fit:
    objective = _AtRest(structure, fact, signals, whitener)
    lower = np.asarray([p.lower for p in structure.parameters]) / structure.scales
    upper = np.asarray([p.upper for p in structure.parameters]) / structure.scales
    minimum, steps = objective.minimise(start / structure.scales, lower, upper)
    return _fit(objective, minimum, steps)
