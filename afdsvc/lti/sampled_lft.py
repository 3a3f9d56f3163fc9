"""Exact sampling of a plant with its faults pulled out.

Inside a sample period the feedback ``w = theta z`` acts continuously, so no discrete plant of low rank in theta is
exact. What is done here: a channel whose z depends only on the held inputs stays one channel (actuators, exact); one
that acts only on outputs stays one channel (sensors, exact); every other is expanded over the sample in a polynomial
through k Gauss points, at which ``w = theta z`` holds. With theta = 0 the result is exactly the sampled healthy plant;
otherwise the error falls like the power 2k of (rate x sample time). k is raised until closing the sampled LFT agrees
with sampling the closed plant to 1e-12 at severities -0.9, -0.5 and 0.5 (1e-10 is accepted).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.linalg import expm

from afdsvc.errors import IllConditioned
from afdsvc.lti.lft import AugmentedPlant
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.scaling import rescale, state_scaling
from afdsvc.lti.statespace import Array, StateSpace

ACCURACY = 1e-12  # where adding points stops
LIMIT = 1e-10  # what is accepted
POINTS = (4, 6, 8, 10, 12, 16, 20, 24)
QUADRATURE = 10
PROBES = (-0.9, -0.5, 0.5)


def sample_augmented(augmented: AugmentedPlant, dt: float) -> AugmentedPlant:
    """Return the augmented plant at sample time ``dt`` [s], inputs held; agrees with `sample_zoh` of every faulty
    plant.

    Raises `IllConditioned` when the faults act so fast that no number of Gauss points up to 14 is accurate.
    """
    t = state_scaling(augmented.system.A)
    scaled = AugmentedPlant(rescale(augmented.system, t), augmented.fault_names, augmented.widths)
    kinds = _kinds(scaled)
    best, error = scaled, float("inf")
    for points in [1] if not kinds.dynamic.size else POINTS:
        sampled = _collocated(scaled, kinds, dt, points)
        found = _error(scaled, sampled, dt)
        if found < error:
            best, error = sampled, found
        if error <= ACCURACY:
            break
    if not error <= LIMIT:
        raise IllConditioned(
            f"the faults act too fast for the sample time {dt} s (relative error {error:.1e} with {POINTS[-1]} points "
            f"inside a sample, expected at most {LIMIT:.0e}); sample faster or leave out the fastest parameter"
        )
    return AugmentedPlant(rescale(best.system, 1 / t), best.fault_names, best.widths)


@dataclass(frozen=True, slots=True, eq=False)
class _Kinds:
    """Channel numbers by what happens to them inside a sample."""

    held: NDArray[np.int64]
    instant: NDArray[np.int64]
    dynamic: NDArray[np.int64]
    at_sample: NDArray[np.int64]  # dynamic channels whose w is also needed at the sample itself


def _kinds(a: AugmentedPlant) -> _Kinds:
    s, k = a.system, a.channels
    loop = s.D[:k, :k] != 0
    held = _stays_inside(~(s.C[:k] != 0).any(axis=1), loop)
    instant = _stays_inside(~(s.B[:, :k] != 0).any(axis=0), loop.T) & ~held
    dynamic = ~held & ~instant
    reaches_now = (s.D[k:, :k] != 0).any(axis=0) | loop[instant].any(axis=0)
    at_sample = dynamic & (reaches_now | (loop & dynamic[:, None]).any(axis=0) & reaches_now.any())
    return _Kinds(*(np.flatnonzero(mask) for mask in (held, instant, dynamic, at_sample)))


def _stays_inside(candidates: NDArray[np.bool_], uses: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the candidates that use no channel outside the set, shrinking the set until that is true."""
    while True:
        kept = candidates & ~(uses & ~candidates[None, :]).any(axis=1)
        if (kept == candidates).all():
            return kept
        candidates = kept


def _error(continuous: AugmentedPlant, sampled: AugmentedPlant, dt: float) -> float:
    """Return the largest relative difference between closing then sampling and sampling then closing."""
    worst = 0.0
    for severity in PROBES:
        theta = np.full(len(continuous.fault_names), severity)
        a, b = sample_zoh(continuous.close(theta), dt), sampled.close(theta)
        for x, y in ((a.A, b.A), (a.B, b.B), (a.C, b.C), (a.D, b.D)):
            worst = max(worst, float(np.abs(x - y).max(initial=0.0) / max(np.abs(x).max(initial=0.0), 1e-300)))
    return worst


@dataclass(frozen=True, slots=True, eq=False)
class _Inside:
    """What moves the state inside a sample: dynamic w through ``Bd``, constants (held w, then u) through ``Bc``."""

    A: Array
    Bd: Array
    Bc: Array
    dt: float
    points: int


def _collocated(a: AugmentedPlant, kinds: _Kinds, dt: float, points: int) -> AugmentedPlant:
    """Return the sampled LFT with ``points`` Gauss points per dynamic channel, in scaled states.

    New channels: held, dynamic at every Gauss point, dynamic at the sample itself, instant.
    """
    s, k = a.system, a.channels
    inside = _Inside(s.A, s.B[:, kinds.dynamic], np.hstack([s.B[:, kinds.held], s.B[:, k:]]), dt, points)
    parts = [_at_sample(a, kinds, kinds.held, points)]
    *at_nodes, (_, by_nodes, _) = _flows(inside)
    parts += [_at_node(a, kinds, flow, i, points) for i, flow in enumerate(at_nodes)]
    parts += [_at_sample(a, kinds, group, points) for group in (kinds.at_sample, kinds.instant)]
    Cz, Dzw, Dzu = (np.vstack([part[i] for part in parts]) for i in range(3))
    healthy = sample_zoh(s.select(slice(k, None), slice(k, None)), dt)  # to the last bit, whatever the faults
    held = sample_zoh(s.select(slice(k, None), list(kinds.held)), dt).B
    later = np.zeros((s.order, kinds.at_sample.size + kinds.instant.size))
    Bw = np.hstack([held, by_nodes, later])
    Dyw = _spread(s.D[k:, :k], kinds, points)
    system = StateSpace(
        healthy.A,
        np.hstack([Bw, healthy.B]),
        np.vstack([Cz, s.C[k:]]),
        np.block([[Dzw, Dzu], [Dyw, s.D[k:, k:]]]),
        dt,
    )
    origin = np.concatenate([kinds.held, np.tile(kinds.dynamic, points), kinds.at_sample, kinds.instant])
    fault = np.repeat(np.arange(len(a.widths)), a.widths)[origin]
    order = np.argsort(fault, kind="stable")
    y, u = range(origin.size, system.outputs), range(origin.size, system.inputs)
    system = system.select([*order, *y], [*order, *u])
    return AugmentedPlant(system, a.fault_names, tuple(int((fault == i).sum()) for i in range(len(a.widths))))


def _spread(D: Array, kinds: _Kinds, points: int) -> Array:
    """Return a feedthrough from w, taken at the sample itself, over the new channels."""
    gauss = np.zeros((D.shape[0], points * kinds.dynamic.size))
    return np.hstack([D[:, kinds.held], gauss, D[:, kinds.at_sample], D[:, kinds.instant]])


def _at_sample(a: AugmentedPlant, kinds: _Kinds, group: NDArray[np.int64], points: int) -> tuple[Array, Array, Array]:
    """Return the rows of z (by state, by w, by u) of channels evaluated at the sample itself."""
    s, k = a.system, a.channels
    return s.C[group], _spread(s.D[group, :k], kinds, points), s.D[group, k:]


def _at_node(
    a: AugmentedPlant, kinds: _Kinds, flow: tuple[Array, Array, Array], i: int, points: int
) -> tuple[Array, Array, Array]:
    """Return the rows of z of the dynamic channels at Gauss point i inside the sample."""
    s, k, dyn, held = a.system, a.channels, kinds.dynamic, kinds.held
    from_start, by_nodes, by_constant = flow
    C, h, d = s.C[dyn], held.size, dyn.size
    by_w = C @ by_nodes
    by_w[:, i * d : (i + 1) * d] += s.D[np.ix_(dyn, dyn)]
    by_held = C @ by_constant[:, :h] + s.D[np.ix_(dyn, held)]
    later = np.zeros((d, kinds.at_sample.size + kinds.instant.size))
    return C @ from_start, np.hstack([by_held, by_w, later]), C @ by_constant[:, h:] + s.D[dyn, k:]


def _flows(s: _Inside) -> list[tuple[Array, Array, Array]]:
    """Return the state at every Gauss point and at the end as maps of x(0), of w at the Gauss points, of constants.

    w is the polynomial through its values at the Gauss points; its convolution with exp(A t) goes from one point to the
    next with a Gauss rule of its own, fine enough that the check at the end decides only about the points.
    """
    n, d, c = s.A.shape[0], s.Bd.shape[1], s.Bc.shape[1]
    constant = np.block([[s.A, s.Bc], [np.zeros((c, n + c))]]) * s.dt
    flow, flows, before = (np.eye(n), np.zeros((n, s.points * d)), np.zeros((n, c))), [], 0.0
    for now in [*((legendre.leggauss(s.points)[0] + 1) / 2), 1.0]:
        step = expm(constant * (now - before))
        pushed = step[:n, :n] @ flow[1] + _pushed(s, before, float(now))
        flow = step[:n, :n] @ flow[0], pushed, step[:n, :n] @ flow[2] + step[:n, n:]
        flows.append(flow)
        before = float(now)
    return flows


def _pushed(s: _Inside, start: float, stop: float) -> Array:
    """Return what w at the Gauss points adds to the state between two fractions of a sample."""
    out = np.zeros((s.A.shape[0], s.points * s.Bd.shape[1]))
    nodes, weights = legendre.leggauss(QUADRATURE)
    length = stop - start
    for x, weight in zip((nodes + 1) / 2, weights / 2, strict=True) if s.Bd.size else ():
        pushed = weight * length * s.dt * (expm(s.A * (s.dt * length * (1 - x))) @ s.Bd)
        out += np.kron(_lagrange(start + length * x, s.points)[None, :], pushed)
    return out


def _lagrange(x: float, points: int) -> Array:
    """Return the values at ``x`` in [0, 1] of the polynomials that are 1 at one Gauss point and 0 at the others."""
    nodes, weights = legendre.leggauss(points)
    degrees = 2 * np.arange(points) + 1
    at_nodes, at_x = legendre.legvander(nodes, points - 1), legendre.legvander(np.array([2 * x - 1]), points - 1)[0]
    return np.asarray(weights / 2 * (at_nodes @ (degrees * at_x)), dtype=np.float64)
