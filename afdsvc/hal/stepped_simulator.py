"""A machine simulated by an FMI unit or a Python function that advances step by step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from afdsvc.api.bursts import Limits
from afdsvc.api.clock import Clock
from afdsvc.api.model import SteppedPlant
from afdsvc.api.signals import Channel
from afdsvc.hal import control_sample
from afdsvc.hal.control_loop import ControlLoop, LoopSettings, Prediction, Samples
from afdsvc.lti.statespace import Array, StateSpace


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
    answers with what is no number, ends the machine with a sentence that names it.
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
    ) -> None:
        super().__init__(interconnection, channels, limits, settings, clock, prediction)
        self._unit, self._faults = unit, faults
        self._noise = np.random.default_rng(seed)
        self._chol = np.linalg.cholesky(output_cov)
        self._answer = unit.begin()

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
