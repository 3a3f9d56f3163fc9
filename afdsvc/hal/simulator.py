"""A simulated machine: a linear plant with scheduled faults and noise, in real time or as fast as it goes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from afdsvc.api.bursts import Limits
from afdsvc.api.clock import Clock
from afdsvc.api.signals import Channel
from afdsvc.errors import BadInput
from afdsvc.hal import kernel
from afdsvc.hal.loop import ControlLoop, LoopSettings, Prediction, Samples
from afdsvc.lti.statespace import Array, StateSpace


@dataclass(frozen=True, slots=True)
class ScheduledFault:
    """A fault that appears at a sample and stays: name, severity (0 to -1), and the sample it starts at."""

    name: str
    severity: float
    start: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedPlant:
    """What is simulated.

    ``at(severities)`` returns the discrete plant with these faults (all of one order; D = 0). ``output_cov (p, p)`` is the
    covariance of the white output noise, ``process_cov (m, m)`` that of white noise added to the inputs, ``speed`` the
    rotor speed in rad/s (its angle is then recorded).
    ``unbalance`` is the complex amplitude of a rotation-synchronous force per input, in the unit of the input.
    """

    at: Callable[[dict[str, float]], StateSpace]
    output_cov: Array
    process_cov: Array | None = None
    speed: float = 0.0
    unbalance: Array | None = None
    faults: Sequence[ScheduledFault] = field(default_factory=tuple)


class Simulator(ControlLoop):
    """A `DrivablePort` around a `SimulatedPlant`: the same seed gives the same samples at any pace and block size."""

    def __init__(
        self,
        plant: SimulatedPlant,
        interconnection: StateSpace,
        channels: tuple[Channel, ...],
        limits: Limits,
        settings: LoopSettings,
        clock: Clock,
        seed: int,
        prediction: Prediction | None = None,
    ) -> None:
        super().__init__(interconnection, channels, limits, settings, clock, prediction)
        self._plant = plant
        self._changes = sorted({f.start for f in plant.faults if f.start > 0})
        self._G = self._plant_at(0)
        self._x = np.zeros(self._G.order)
        self._chol = np.linalg.cholesky(plant.output_cov)
        self._process = None if plant.process_cov is None else np.linalg.cholesky(plant.process_cov)
        self._noise, self._shake = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))

    def inject(self, fault: ScheduledFault) -> None:
        """Add a fault that starts at its sample, or at the next one when that has passed."""
        start = max(fault.start, self._k)
        later = ScheduledFault(fault.name, fault.severity, start)
        self._plant = SimulatedPlant(
            self._plant.at,
            self._plant.output_cov,
            self._plant.process_cov,
            self._plant.speed,
            self._plant.unbalance,
            (*self._plant.faults, later),
        )
        self._changes = sorted({*self._changes, start})
        if start == self._k:
            self._G = self._plant_at(start)

    def _plant_at(self, k: int) -> StateSpace:
        system = self._plant.at({f.name: f.severity for f in self._plant.faults if f.start <= k})
        if np.abs(system.D).max(initial=0.0) > 0:
            raise BadInput("the simulated plant has a direct term D; a sampled plant with D = 0 is wanted")
        return kernel.contiguous(system)

    def _run(self, alpha: Array, limits: Limits | None) -> Samples:
        """Run the slice in pieces that end where a fault starts."""
        edges = [0, *(c - self._k for c in self._changes if 0 < c - self._k < len(alpha)), len(alpha)]
        pieces: list[Samples] = []
        for a, b in pairwise(edges):
            if self._k + a in self._changes:
                self._G = self._plant_at(self._k + a)
            if pieces and pieces[-1].cause != kernel.NO_CAUSE:
                alpha[a:b] = 0.0
            pieces.append(self._piece(alpha[a:b], limits, self._k + a))
        return _join(pieces)

    def _piece(self, alpha: Array, limits: Limits | None, k: int) -> Samples:
        n = len(alpha)
        noise = self._noise.standard_normal((n, self.p)) @ self._chol.T
        aux, force = self._rotation(np.arange(k, k + n))
        if self._process is not None:
            force = force + self._shake.standard_normal((n, self.m)) @ self._process.T
        u, y, beta = np.empty((n, self.m)), np.empty((n, self.p)), np.empty((n, self.p))
        bounds = limits or self._limits
        G, K = self._G, self._K
        cause, at = kernel.closed_loop(
            G.A,
            G.B,
            G.C,
            self._x,
            K.A,
            K.B,
            K.C,
            K.D,
            self._xk,
            alpha,
            force,
            noise,
            limits is not None,
            bounds.output,
            bounds.input,
            self._u,
            u,
            y,
            beta,
        )
        return Samples(u, y, beta, alpha, aux, cause, at)

    def _rotation(self, k: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return the auxiliary columns (speed, angle) and the unbalance force of these samples."""
        n, speed = len(k), self._plant.speed
        force = np.zeros((n, self.m))
        if not speed:
            return np.zeros((n, 0)), force
        angle = np.mod(speed * self.dt * k, 2 * np.pi)
        if self._plant.unbalance is not None:
            force = np.real(np.exp(1j * angle)[:, None] * self._plant.unbalance[None, :])
        return np.column_stack([np.full(n, speed), angle]), force


def _join(pieces: list[Samples]) -> Samples:
    if len(pieces) == 1:
        return pieces[0]
    cause, at, before = kernel.NO_CAUSE, -1, 0
    for piece in pieces:
        if piece.cause != kernel.NO_CAUSE and cause == kernel.NO_CAUSE:
            cause, at = piece.cause, before + piece.at
        before += len(piece.u)

    def column(name: str) -> Array:
        return np.vstack([getattr(piece, name) for piece in pieces])

    return Samples(column("u"), column("y"), column("beta"), column("alpha"), column("aux"), cause, at)
