"""A simulated machine: a linear plant with scheduled faults and noise, in real time or as fast as it goes."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from afdsvc.api.bursts import Limits
from afdsvc.api.clock import Clock
from afdsvc.api.model import SteppedPlant
from afdsvc.api.signals import Channel
from afdsvc.errors import BadInput
from afdsvc.hal import control_sample
from afdsvc.hal.control_loop import ControlLoop, LoopSettings, Prediction, Samples
from afdsvc.lti.statespace import Array, StateSpace

REFRESH = 50  # samples after which the plant of a rotor that runs up or down is taken anew


@dataclass(frozen=True, slots=True, eq=False)
class SpeedProfile:
    """Speed [rad/s] at given samples, linear in between, constant before the first and after the last.

    ``samples (q,)`` rise from 0; ``speeds (q,)``.
    """

    dt: float
    samples: NDArray[np.int64]
    speeds: Array

    @classmethod
    def of(cls, points: Sequence[Sequence[float]], start: float, dt: float) -> SpeedProfile:
        """Return the profile through ``(second, rad/s)``, at ``start`` until the first; raises `BadInput` unless times rise."""
        seconds = [p[0] for p in points]
        if any(b <= a for a, b in pairwise(seconds)) or (seconds and seconds[0] < 0):
            raise BadInput(f"speed profile at {seconds} s; expected rising times from 0 s")
        whole = [(0.0, points[0][1] if points else start), *(p for p in points if p[0] > 0)]
        return cls(dt, np.array([round(p[0] / dt) for p in whole], dtype=np.int64), np.array([float(p[1]) for p in whole]))

    @property
    def turning(self) -> bool:
        """Whether the rotor turns at all."""
        return bool(self.speeds.any())

    def at(self, k: NDArray[np.int64]) -> Array:
        """Return the speed at samples ``k (n,)``."""
        return np.asarray(np.interp(k, self.samples, self.speeds))

    def angle(self, k: NDArray[np.int64]) -> Array:
        """Return the angle [rad] in [0, 2 pi) at samples ``k (n,)``: the integral of the speed."""
        if len(self.samples) == 1 or np.ptp(self.speeds) == 0:
            return np.asarray(np.mod(self.speeds[0] * self.dt * k, 2 * np.pi))
        length = np.diff(self.samples) * self.dt
        turned = np.concatenate([[0.0], np.cumsum(length * (self.speeds[1:] + self.speeds[:-1]) / 2)])
        i = np.clip(np.searchsorted(self.samples, k, side="right") - 1, 0, len(self.samples) - 1)
        since = (k - self.samples[i]) * self.dt
        return np.asarray(np.mod(turned[i] + since * (self.speeds[i] + self.at(k)) / 2, 2 * np.pi))

    def steps(self, k: int, n: int) -> set[int]:
        """Return the samples from ``k`` on, fewer than ``n`` later, at which the plant is taken anew."""
        due: set[int] = set()
        for a, b in self._ramps():
            low, high = max(a, k), min(b, k + n - 1)
            due |= set(range(-(-low // REFRESH) * REFRESH, high + 1, REFRESH)) | ({b} & set(range(k, k + n)))
        return due

    def _ramps(self) -> list[tuple[int, int]]:
        """Return first and last sample of every stretch on which the speed changes."""
        ends = zip(pairwise(self.samples.tolist()), pairwise(self.speeds.tolist()), strict=True)
        return [(a, b) for (a, b), (before, after) in ends if before != after]


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
    ``unbalance`` is the complex amplitude of a rotation-synchronous force per input, in the unit of the input, at that
    speed; it grows with the square of the speed. With a ``profile`` the speed changes and ``turning(severities, rad/s)``
    returns the plant at a speed, in the same states. ``names`` are the faults that can be put in while it runs.
    """

    at: Callable[[dict[str, float]], StateSpace]
    output_cov: Array
    process_cov: Array | None = None
    speed: float = 0.0
    unbalance: Array | None = None
    faults: Sequence[ScheduledFault] = field(default_factory=tuple)
    profile: SpeedProfile | None = None
    turning: Callable[[dict[str, float], float], StateSpace] | None = None
    names: Sequence[str] = ()


class SimulatedRig(ControlLoop):
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
        self._faults, self._asked = list(plant.faults), deque[ScheduledFault]()
        self._changes = {f.start for f in plant.faults if f.start > 0}
        self._profile = plant.profile or SpeedProfile.of([], plant.speed, interconnection.dt)
        self._G = self._plant_at(0)
        self._x = np.zeros(self._G.order)
        self._chol = np.linalg.cholesky(plant.output_cov)
        self._process = None if plant.process_cov is None else np.linalg.cholesky(plant.process_cov)
        self._noise, self._shake = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))

    def inject(self, fault: str, severity: float) -> None:
        """Give a fault this severity from the next samples on; raises `BadInput` for one that the machine does not have."""
        if fault not in self._plant.names:
            raise BadInput(f"fault '{fault}' is unknown; this machine has {', '.join(self._plant.names)}")
        self._asked.append(ScheduledFault(fault, severity))

    def _plant_at(self, k: int) -> StateSpace:
        present = {f.name: f.severity for f in self._faults if f.start <= k}
        turning = self._plant.turning
        system = self._plant.at(present) if turning is None else turning(present, float(self._profile.at(np.array([k]))[0]))
        if np.abs(system.D).max(initial=0.0) > 0:
            raise BadInput("the simulated plant has a direct term D; expected a sampled plant with D = 0")
        return control_sample.contiguous_system(system)

    def _run(self, alpha: Array, limits: Limits | None) -> Samples:
        """Run the slice in pieces that end where a fault starts or the speed has moved on."""
        while self._asked:
            self._faults.append(replace(self._asked.popleft(), start=self._k))
            self._changes.add(self._k)
        due = self._profile.steps(self._k, len(alpha)) | self._changes
        edges = [0, *sorted(c - self._k for c in due if 0 < c - self._k < len(alpha)), len(alpha)]
        pieces: list[Samples] = []
        for a, b in pairwise(edges):
            if self._k + a in due:
                self._G = self._plant_at(self._k + a)
            if pieces and pieces[-1].cause != control_sample.NO_CAUSE:
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
        cause, at = control_sample.run_closed_loop(
            G.A,
            G.B,
            G.C,
            self._x,
            K.A,
            K.B,
            K.C,
            K.D,
            self._xk,
            self._tuning.q,
            self._tuning.motion,
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
        n, profile = len(k), self._profile
        force = np.zeros((n, self.m))
        if not profile.turning:
            return np.zeros((n, 0)), force
        angle, speed = profile.angle(k), profile.at(k)
        if self._plant.unbalance is not None:
            force = np.real(np.exp(1j * angle)[:, None] * self._plant.unbalance[None, :])
            if self._plant.profile is not None:
                force *= (speed[:, None] / self._plant.speed) ** 2
        return np.column_stack([speed, angle]), force


def _join(pieces: list[Samples]) -> Samples:
    if len(pieces) == 1:
        return pieces[0]
    cause, at, before = control_sample.NO_CAUSE, -1, 0
    for piece in pieces:
        if piece.cause != control_sample.NO_CAUSE and cause == control_sample.NO_CAUSE:
            cause, at = piece.cause, before + piece.at
        before += len(piece.u)

    def column(name: str) -> Array:
        return np.vstack([getattr(piece, name) for piece in pieces])

    return Samples(column("u"), column("y"), column("beta"), column("alpha"), column("aux"), cause, at)


@dataclass(frozen=True, slots=True)
class GainFault:
    """A gain that changes by ``severity`` (-1: gone) at a sample and stays: of input or output number ``index``."""

    side: str
    index: int
    severity: float
    start: int = 0


class SteppedSimulator(ControlLoop):
    """A `DrivablePort` around a `SteppedPlant`: J_K and its limits act in every sample, as around hardware.

    ``output_cov (p, p)`` is that of white noise added to what the simulator answers, drawn from ``seed``. A simulator that fails, or
    answers with what is not a number, ends the machine with a sentence that names it. ``sites`` names the gains that faults can be put
    into while it runs, as (side, index).
    """

    def __init__(
        self,
        unit: SteppedPlant,
        output_cov: Array,
        faults: Sequence[GainFault],
        interconnection: StateSpace,
        channels: tuple[Channel, ...],
        limits: Limits,
        settings: LoopSettings,
        clock: Clock,
        seed: int,
        prediction: Prediction | None = None,
        sites: Mapping[str, tuple[str, int]] | None = None,
    ) -> None:
        super().__init__(interconnection, channels, limits, settings, clock, prediction)
        self._unit, self._faults, self._sites = unit, tuple(faults), sites or {}
        self._noise = np.random.default_rng(seed)
        self._chol = np.linalg.cholesky(output_cov)
        self._answer = unit.begin()

    def inject(self, fault: str, severity: float) -> None:
        """Give a gain this severity from the next sample on; raises `BadInput` for a fault that is not a gain."""
        if fault not in self._sites:
            raise BadInput(f"fault '{fault}' cannot be injected into a stepped simulator; gain faults can: {', '.join(self._sites) or 'none'}")
        side, index = self._sites[fault]
        self._faults = (*(f for f in self._faults if (f.side, f.index) != (side, index)), GainFault(side, index, severity))

    def close(self) -> None:
        """Release the simulator."""
        if not self._closed:
            super().close()
            self._unit.close()

    def _run(self, alpha: Array, limits: Limits | None) -> Samples:
        n, K, T = len(alpha), self._K, self._tuning
        u, y, beta = np.empty((n, self.m)), np.empty((n, self.p)), np.empty((n, self.p))
        noise = self._noise.standard_normal((n, self.p)) @ self._chol.T
        bounds, cause, at = limits or self._limits, control_sample.NO_CAUSE, -1
        for k in range(n):
            acting, sensing = self._gains(self._k + k)
            y[k] = self._plausible(sensing * self._answer + noise[k])
            if cause != control_sample.NO_CAUSE:
                alpha[k] = 0.0
            armed = limits is not None and cause == control_sample.NO_CAUSE
            acts = T.acts
            found = int(
                control_sample.control_sample(
                    K.A, K.B, K.C, K.D, self._xk, T.q, T.motion, y[k], alpha[k], armed, bounds.output, bounds.input, self._u, beta[k]
                )
            )
            if (armed or acts) and found != control_sample.NO_CAUSE and cause == control_sample.NO_CAUSE:
                cause, at = found, k
            u[k] = self._u
            self._answer = self._unit.advance(acting * self._u, self.dt)
        return Samples(u, y, beta, alpha, np.zeros((n, 0)), cause, at)

    def _gains(self, k: int) -> tuple[Array, Array]:
        """Return the gains of actuators and sensors at a sample."""
        acting, sensing = np.ones(self.m), np.ones(self.p)
        for fault in self._faults:
            if fault.start <= k:
                (acting if fault.side == "input" else sensing)[fault.index] *= 1 + fault.severity
        return acting, sensing
