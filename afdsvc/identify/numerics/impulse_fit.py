"""Gradients of the matrices of S with respect to those of the plant: the chain rule through the closed loop.

With J_K = ``[y, alpha] -> [u, beta]`` and a plant without feedthrough, S is bilinear in the plant's matrices, so its
slopes follow from theirs exactly, all parameters at once.

Fitting a stable system to impulse responses: the cost does not grow with the length of the recordings.

The sum of squares of ``beta - S alpha`` depends on the recordings only through correlations: with the first L + 1
Markov parameters ``g = [S_0 ... S_L]`` and the windows ``a(k) = [alpha(k) ... alpha(k-L)]``,

    sum (beta - g a)(beta - g a)' = Gbb - g Gab - Gab' g' + g Gaa g'

Gaa, Gab and Gbb are built once. L covers the memory of S (down to `FORGOTTEN`); windows that reach before the recording
do not count, so no initial state is needed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy

import numpy as np

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.errors import BadInput, IllConditioned
from afdsvc.identify.methods.black_box_pem import local_structure
from afdsvc.identify.methods.hansen import settling_samples
from afdsvc.identify.numerics.compression import window_products
from afdsvc.identify.numerics.prediction_errors import responses, whitening_of
from afdsvc.identify.parameters.noise_structure import Slopes
from afdsvc.identify.parameters.structure import Structure
from afdsvc.lti.coprime import Factorisation
from afdsvc.lti.lft import star
from afdsvc.lti.stability import is_stable
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.lti.yjbk import interconnection
from afdsvc.stats.levenberg_marquardt import Local, descend


def differences(build: Callable[[Array], StateSpace], point: Array, steps: Array) -> Slopes:
    """Return the slopes of the matrices of ``build`` at a point by central differences, shapes ``(q, ...)``."""
    pairs = [(build(point + h), build(point - h)) for h in np.diag(steps)]

    def slope(name: str) -> Array:
        return np.stack(
            [(getattr(a, name) - getattr(b, name)) / (2 * h) for (a, b), h in zip(pairs, steps, strict=True)]
        )

    return Slopes(slope("A"), slope("B"), slope("C"), slope("D"))


def closed_slopes(augmented: StateSpace, plant: StateSpace, moved: Slopes) -> Slopes:
    """Return the slopes of ``S = F_u(J_K, G)`` from those of G, stacked ``(q, rows, columns)``.

    The states are those of the plant, then those of J_K (as `afdsvc.lti.lft.star` orders them). Raises `BadInput` for a
    plant with feedthrough.
    """
    if plant.D.any() or moved.D.any():
        raise BadInput("the plant has a feedthrough; the slopes of S are bilinear only without one")
    q, n, k, p, m = len(moved.A), plant.order, augmented.order, plant.outputs, plant.inputs
    from_y, to_u = augmented.B[:, :p], augmented.C[:m]
    direct, excited, seen = augmented.D[:m, :p], augmented.D[:m, p:], augmented.D[m:, :p]
    A, B = np.zeros((q, n + k, n + k)), np.zeros((q, n + k, excited.shape[1]))
    C = np.zeros((q, len(seen), n + k))
    A[:, :n, :n] = moved.A + moved.B @ (direct @ plant.C) + (plant.B @ direct) @ moved.C
    A[:, :n, n:], A[:, n:, :n] = moved.B @ to_u, from_y @ moved.C
    B[:, :n], C[:, :, :n] = moved.B @ excited, seen @ moved.C
    return Slopes(A, B, C, np.zeros((q, len(seen), excited.shape[1])))


def filtered_slopes(after: StateSpace, slopes: Slopes) -> Slopes:
    """Return the slopes of ``after @ S`` from those of S; the filter's states come after those of S."""
    q, n, k = len(slopes.A), slopes.A.shape[1], after.order
    A, B = np.zeros((q, n + k, n + k)), np.zeros((q, n + k, slopes.B.shape[2]))
    C = np.zeros((q, after.outputs, n + k))
    A[:, :n, :n], A[:, n:, :n] = slopes.A, after.B @ slopes.C
    B[:, :n], B[:, n:] = slopes.B, after.B @ slopes.D
    C[:, :, :n] = after.D @ slopes.C
    return Slopes(A, B, C, after.D @ slopes.D)


#: Remaining share of an impulse response where it is cut off.
FORGOTTEN = 1e-3
#: Longest memory in samples, and largest share of a recording it may take.
LONGEST, LARGEST_SHARE = 800, 0.2

_REWEIGHTINGS = 2
#: Relative decrease of the unexplained power that makes another start necessary.
_GAIN = 1e-3
#: Decrease of half the weighted sum of squares that is good enough for an approach.
_TOLERANCE = 1e-2


def approach(fact: Factorisation, recordings: Sequence[InputOutputData], start: StateSpace) -> StateSpace:
    """Return the plant of the order of ``start`` whose S explains the correlations of alpha (u) with beta (y) best.

    It lies within a fraction of a standard error of the best on the samples themselves, since it leaves out the first
    samples of every recording (the memory of S).
    """
    objective = ImpulseFit(local_structure(start), fact, recordings)
    z = np.zeros(len(objective.structure.parameters))
    before, after = np.inf, float(np.trace(objective.covariance(z)))
    while after < before * (1 - _GAIN):
        z = _minimised(objective, z)
        start = objective.structure.build(z * objective.structure.scales)
        before, after = after, float(np.trace(objective.covariance(z)))
        # Coordinates, and the weights of the outputs, belong to the point they start from: start again from here.
        objective, z = objective.around(local_structure(start)), np.zeros(len(z))
    return start


def _minimised(objective: ImpulseFit, z: Array) -> Array:
    unbounded = np.full(len(z), np.inf)
    for _ in range(_REWEIGHTINGS):
        objective.weight(z)
        z = descend(objective.local, z, -unbounded, unbounded, tolerance=_TOLERANCE).point
    return z


class ImpulseFit:
    """The misfit of S(G(z)) for a structure of discrete plants G, over ``z`` in units of the structure's scales."""

    def __init__(self, structure: Structure, fact: Factorisation, recordings: Sequence[InputOutputData]) -> None:
        self.structure, self.augmented = structure, interconnection(fact)
        start = self.deviation(np.zeros(len(structure.parameters)))
        shortest = int(LARGEST_SHARE * min(map(len, recordings)))
        self.memory = max(1, min(round(1.5 * settling_samples(start, FORGOTTEN)), LONGEST, shortest))
        self.count = sum(len(r) - self.memory for r in recordings)
        self.Gaa = np.sum([window_products(r.u, self.memory + 1) for r in recordings], axis=0)
        self.Gab = np.sum([_cross(r, r.y, self.memory) for r in recordings], axis=0)
        self.Gbb = np.sum([r.y[self.memory :].T @ r.y[self.memory :] for r in recordings], axis=0)
        self.whitener = np.eye(recordings[0].y.shape[1])

    def around(self, structure: Structure) -> ImpulseFit:
        """Return the same correlations with another structure."""
        other = copy(self)
        other.structure = structure
        return other

    def deviation(self, z: Array) -> StateSpace:
        """Return S of the plant at z; raises `IllConditioned` where the controller does not stabilise it."""
        S = self._closed(z)
        if not is_stable(S.A, S.dt):
            raise IllConditioned("the controller does not stabilise the plant")
        return S

    def covariance(self, z: Array) -> Array:
        """Return the covariance of what S(z) leaves unexplained, shape ``(p, p)``."""
        g = self._markov(self.deviation(z), None)[0]
        cross = g @ self.Gab
        spread = self.Gbb - cross - cross.T + g @ self.Gaa @ g.T
        return np.asarray((spread + spread.T) / 2 / self.count)

    def weight(self, z: Array) -> None:
        """Weight the outputs with the covariance of what z leaves unexplained."""
        found = self.covariance(z)
        self.whitener = whitening_of(found + 1e-12 * np.trace(self.Gbb) / self.count * np.eye(len(found)))

    def local(self, z: Array) -> Local:
        """Return cost, gradient and curvature at z."""
        g, dg = self._derivatives(z)
        weight = self.whitener.T @ self.whitener
        left = self.Gab.T - g @ self.Gaa
        cost = 0.5 * float(np.sum(weight * (self.Gbb - g @ self.Gab - left @ g.T)))
        gradient = -np.einsum("qpw,pw->q", dg, weight @ left)
        half = np.matmul(self.whitener, dg).reshape(len(dg), -1, self.Gaa.shape[0])
        curvature = np.einsum("qpw,rpw->qr", half, half @ self.Gaa, optimize=True)
        return Local(cost, gradient, curvature)

    def _derivatives(self, z: Array) -> tuple[Array, Array]:
        plant, steps = self._plant(z), np.full(len(z), 1e-3)
        moved = differences(self._plant, z, steps)
        if plant.D.any() or moved.D.any():
            return self._markov(self.deviation(z), differences(self._closed, z, steps))
        return self._markov(self.deviation(z), closed_slopes(self.augmented, plant, moved))

    def _closed(self, z: Array) -> StateSpace:
        plant = self._plant(z)
        return star(plant, self.augmented, plant.outputs, plant.inputs)

    def _plant(self, z: Array) -> StateSpace:
        return self.structure.build(z * self.structure.scales)

    def _markov(self, S: StateSpace, slopes: Slopes | None) -> tuple[Array, Array]:
        """Return ``g (p, (L+1) m)``, latest sample first in the window order of Gaa, and its slopes ``(q, p, (L+1)
        m)``."""
        m, p, length = S.inputs, S.outputs, self.memory + 1
        slopes = slopes or Slopes(*(np.zeros((0, *getattr(S, k).shape)) for k in ("A", "B", "C", "D")))
        g, dg = np.empty((p, length, m)), np.empty((len(slopes.A), p, length, m))
        for j in range(m):
            impulse = np.zeros((length, m))
            impulse[0, j] = 1.0
            value, moved = responses(S, slopes, impulse)
            # a window holds alpha(k-L) first: the impulse response backwards
            g[:, :, j], dg[:, :, :, j] = value[::-1].T, np.moveaxis(moved[::-1], (0, 1, 2), (2, 1, 0))
        return g.reshape(p, length * m), dg.reshape(len(dg), p, length * m)


def _cross(recording: InputOutputData, outputs: Array, memory: int) -> Array:
    """Return ``sum_k window(k) y(k)'`` over whole windows, shape ``((L+1) m, p)``."""
    u, count = recording.u, len(recording) - memory
    return np.concatenate([u[lag : lag + count].T @ outputs[memory : memory + count] for lag in range(memory + 1)])
