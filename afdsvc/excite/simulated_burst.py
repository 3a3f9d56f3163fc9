"""Simulation of a burst: the closed loop with a fault, driven by given noise."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from afdsvc.api.bursts import Burst
from afdsvc.api.detection import DetectionProblem, ResidualBlock
from afdsvc.detect.features.regressors import predictor_gain
from afdsvc.errors import BadInput
from afdsvc.lti.lft import star
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import Array, StateSpace


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedBurst:
    """What the machine would have recorded: ``r, y (n, p)``, ``u, alpha (n, m)``, ``beta (n, p)``."""

    dt: float
    r: Array
    y: Array
    u: Array
    alpha: Array
    beta: Array

    def __len__(self) -> int:
        return len(self.r)

    def blocks(self, size: int, burst: Burst | None = None, start: int = 0, k0: int = 0) -> Iterator[ResidualBlock]:
        """Yield blocks of at most ``size`` samples cut at the edges of a burst that began at sample ``start``."""
        edges = {0, len(self)} | ({start, min(start + burst.samples, len(self))} if burst else set())
        cuts = sorted(edges | set(range(0, len(self), size)))
        for a, b in pairwise(cuts):
            inside = burst is not None and start <= a < start + burst.samples
            yield ResidualBlock(
                k0 + a, self.dt, self.r[a:b], self.beta[a:b], self.u[a:b], self.y[a:b], self.alpha[a:b],
                burst if inside else None, burst.name if inside and burst else "", k0 + start,
            )


def faulty_loop(problem: DetectionProblem, severities: Mapping[str, float]) -> StateSpace:
    """Return the loop from ``[r, alpha]`` (innovations, excitation) to ``[u, y - r, beta]`` with the faults present.

    ``y`` is what the sensors report; with sensor noise only and a stable plant r is that noise, otherwise it also drives the states
    through the predictor's gain. Raises `BadInput` when a fault makes the loop unstable.
    """
    return noisy_loop(problem, severities, predictor_gain(problem, problem.augmented.plant), np.eye(problem.plant.outputs))


def noisy_loop(problem: DetectionProblem, severities: Mapping[str, float], Bn: Array, Dn: Array) -> StateSpace:
    """Return the loop from ``[e, alpha]`` to ``[u, y - Dn e, beta]``, noise e entering states by ``Bn (n, q)``, outputs by ``Dn (p, q)``."""
    g, q = problem.augmented.close(severities), Bn.shape[1]
    n, m, p = g.order, g.inputs, g.outputs
    C = np.vstack([np.zeros((m, n)), g.C, g.C])
    D = np.block([[np.zeros((m, q)), np.eye(m)], [np.zeros((p, q)), g.D], [Dn, g.D]])
    loop = star(StateSpace(g.A, np.hstack([Bn, g.B]), C, D, g.dt), problem.interconnection, p, m)
    if not loop.is_stable():
        worst = float(np.abs(loop.poles()).max())
        raise BadInput(f"with {dict(severities)} the loop has a pole of modulus {worst:.6g}; it cannot be simulated")
    return loop


def simulate_burst(
    problem: DetectionProblem, alpha: Array, noise: Array, severities: Mapping[str, float] | None = None,
    loop: StateSpace | None = None,
) -> SimulatedBurst:
    """Return the record of a run from rest: ``alpha (n, m)``, innovations ``noise (n, p)``; ``loop`` saves
    rebuilding it.
    """
    loop = faulty_loop(problem, severities or {}) if loop is None else loop
    m, p = problem.plant.inputs, problem.plant.outputs
    if alpha.shape != (len(noise), m) or noise.shape != (len(alpha), p):
        raise BadInput(f"alpha {alpha.shape} and noise {noise.shape}; expected (n, {m}) and (n, {p})")
    out, _ = simulate(loop, np.hstack([noise, alpha]))
    u, y, beta = out[:, :m], out[:, m : m + p] + noise, out[:, m + p :]
    r, _ = simulate(problem.innovations, np.hstack([y, u]))
    return SimulatedBurst(problem.plant.dt, r, y, u, alpha, beta)


def played(burst: Burst, dt: float, before: int, after: int = 0) -> Array:
    """Return alpha of a burst with quiet samples around it, shape ``(before + samples + after, inputs)``."""
    return np.vstack([np.zeros((before, burst.inputs)), burst.play(dt), np.zeros((after, burst.inputs))])
