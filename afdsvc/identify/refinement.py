"""The plant of a wanted order that explains the residuals best: reduction judged by the recordings themselves.

A truncation throws away what is small in some norm; here the distance that counts is ``|beta - S(G) alpha|`` on the
recordings, over all plants G of the order, started from a truncation. The excitation alpha is free of noise, so the
estimate is consistent whatever the colour of the noise, and a plant that the controller does not stabilise cannot come
out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from afdsvc.dataset.arrays import Recording
from afdsvc.identify.fit import ResponseBand
from afdsvc.identify.impulse_fit import approach
from afdsvc.identify.indirect import Mismatch
from afdsvc.identify.local_coordinates import local_structure
from afdsvc.lti.coprime import Factorisation
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.reduce import balanced_truncation
from afdsvc.lti.stability import is_stable
from afdsvc.lti.statespace import Array, StateSpace

_RESTARTS = 4


@dataclass(frozen=True, slots=True, eq=False)
class Refinement:
    """The refined plant, the mean square of what remains unexplained (relative to the start), and the objective
    there."""

    system: StateSpace
    gain: float
    objective: Mismatch
    point: Array

    def band(self, omega: Array, groups: int = 16) -> ResponseBand:
        """Return the frequency response with its covariance.

        Gradients of groups of samples (long against the noise's memory) tell how much the minimum would move without
        each: ``H^-1 (sum g g') H^-1``, valid for noise of any colour.
        """
        local, parts = self.objective.local(self.point), self.objective.group_gradients(self.point, groups)
        count = len(parts)
        moves = np.linalg.solve(local.curvature, (parts - parts.mean(axis=0)).T).T * np.sqrt(count / (count - 1))
        structure, step = self.objective.structure, 1e-3
        centre = self.point * structure.scales

        def response(z: Array) -> Array:
            return np.asarray(frequency_response(structure.build(z), omega))

        slopes = np.stack(
            [(response(centre + h) - response(centre - h)) / (2 * step) for h in np.diag(step * structure.scales)]
        )
        shifts = np.tensordot(moves, slopes, axes=1)
        split = np.stack([shifts.real, shifts.imag], axis=-1)
        covariance = np.einsum("gkpmi,gkpmj->kpmij", split, split)
        return ResponseBand(omega, response(centre).astype(np.complex128), covariance, freedom=count - 1)


def refine(
    fact: Factorisation, signals: Sequence[Recording], start: StateSpace, whitener: StateSpace | None = None
) -> Refinement:
    """Return the plant of the order of ``start`` whose S explains ``signals`` (alpha as u, beta as y) best.

    Correlations bring the start near at a cost that does not grow with the recordings; sweeps over the samples have
    the last word, so neither the start nor where an impulse response was cut off is left in the result. ``whitener``
    filters beta before the sweeps: without it every frequency counts alike, however noisy it is.
    """
    first = _left(_objective(fact, signals, start, whitener))
    system = approach(fact, signals, _balanced(start))
    objective = _objective(fact, signals, system, whitener)
    if _left(objective) > first:
        objective = _objective(fact, signals, start, whitener)
    for _ in range(_RESTARTS):  # the coordinates are those of the point they start from
        before, z = _left(objective), np.zeros(len(objective.structure.parameters))
        unbounded = np.full(len(z), np.inf)
        best, _ = objective.minimise(z, -unbounded, unbounded)
        system = objective.structure.build(best.point * objective.structure.scales)
        found = Refinement(system, _left(objective, best.point) / first, objective, best.point)
        if found.gain * first > before * (1 - 1e-4):
            break
        objective = _objective(fact, signals, system, whitener)
    return found


def _objective(
    fact: Factorisation, signals: Sequence[Recording], around: StateSpace, whitener: StateSpace | None
) -> Mismatch:
    objective = Mismatch(local_structure(_balanced(around)), fact, signals, 2, whitener)
    if whitener is not None:
        objective.tolerance = 1e-2  # flat directions of a weighted fit take long to walk and change nothing
    return objective


def _left(objective: Mismatch, z: Array | None = None) -> float:
    """Return the mean square of what the plant at z (at the origin of the coordinates) leaves unexplained."""
    z = np.zeros(len(objective.structure.parameters)) if z is None else z
    return float(np.trace(objective.error_covariance(z * objective.structure.scales)))


def _balanced(system: StateSpace) -> StateSpace:
    return balanced_truncation(system, system.order).system if is_stable(system.A, system.dt) else system
