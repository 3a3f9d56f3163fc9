"""Real hardware: the driver contract and the control loop around it, one sample at a time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from afdsvc.api.bursts import Limits
from afdsvc.api.clock import Clock
from afdsvc.api.signals import Channel, of_role
from afdsvc.errors import BadInput
from afdsvc.hal import control_sample
from afdsvc.hal.control_loop import ControlLoop, LoopSettings, Prediction, Samples
from afdsvc.lti.statespace import Array, StateSpace


class Driver(Protocol):
    """What a laboratory writes to connect its machine; every method is called from the control thread only.

    The hardware owns the sample clock: `read` waits for its tick. Values are in the units of the channels.
    """

    def open(self) -> None:
        """Connect and bring the actuators to rest; called once before the first `read`."""
        ...

    def read(self) -> Sequence[float]:
        """Wait for the next sample tick and return the measured outputs y (p,), NaN where a sensor failed."""
        ...

    def write(self, u: Array) -> None:
        """Send the plant inputs u (m,); they hold until the next call."""
        ...

    def rest(self) -> None:
        """Bring the actuators to their safe value, whatever happened before; called on every exit."""
        ...

    def close(self) -> None:
        """Disconnect; harmless when called twice."""
        ...


@runtime_checkable
class RotatingDriver(Protocol):
    """What the driver of a rotating machine offers besides."""

    def rotation(self) -> tuple[float, float]:
        """Return speed [rad/s] and angle [rad] of the rotor at the tick `read` has just waited for."""
        ...


class DrivenRig(ControlLoop):
    """A `DrivablePort` around a `Driver`: the same control sample as the simulator, paced by the hardware's clock.

    A machine with the channels ``aux_speed`` and ``aux_angle`` wants a `RotatingDriver`; `BadInput` is raised without.
    """

    def __init__(
        self,
        driver: Driver,
        interconnection: StateSpace,
        channels: tuple[Channel, ...],
        limits: Limits,
        settings: LoopSettings,
        clock: Clock,
        prediction: Prediction | None = None,
    ) -> None:
        super().__init__(interconnection, channels, limits, settings, clock, prediction)
        self._driver = driver
        self._rotor = driver if isinstance(driver, RotatingDriver) else None
        self._aux = len(of_role(channels, "aux"))
        if self._aux and self._rotor is None:
            raise BadInput(f"driver {type(driver).__name__} has no 'rotation()'; a rotating machine records speed and angle")
        self._last = float("nan")
        driver.open()

    def close(self) -> None:
        """Bring the actuators to rest and disconnect."""
        if not self._closed:
            super().close()
            try:
                self._driver.rest()
            finally:
                self._driver.close()

    def _paced(self, alpha: Array) -> Samples:
        """The driver's `read` keeps the pace, so a slice starts at once."""
        self._begin()
        samples = self._run(alpha, self._armed if self._excitation.name else None)
        self._k += len(alpha)
        return samples

    def _run(self, alpha: Array, limits: Limits | None) -> Samples:
        n = len(alpha)
        u, y, beta = np.empty((n, self.m)), np.empty((n, self.p)), np.empty((n, self.p))
        aux = np.zeros((n, self._aux))
        bounds, cause, at, worked = limits or self._limits, control_sample.NO_CAUSE, -1, 0.0
        try:
            for k in range(n):
                y[k] = self._driver.read()
                began = self._clock.monotonic()
                y[k] = self._plausible(y[k])
                if cause != control_sample.NO_CAUSE:
                    alpha[k] = 0.0
                armed = limits is not None and cause == control_sample.NO_CAUSE
                acts = self._tuning.acts
                found = self._sample(y[k], alpha[k], armed, bounds, beta[k])
                self._driver.write(self._u)
                u[k] = self._u
                if (armed or acts) and found != control_sample.NO_CAUSE and cause == control_sample.NO_CAUSE:
                    cause, at = found, k
                if self._rotor is not None and self._aux:
                    aux[k] = self._rotor.rotation()
                ended = self._clock.monotonic()
                worked += ended - began
                self._late += self._missed(began, ended)
        except BaseException:
            self._driver.rest()
            raise
        self._head_room = 1 - worked / (n * self.dt)
        return Samples(u, y, beta, alpha, aux, cause, at)

    def _sample(self, y: Array, alpha: Array, armed: bool, bounds: Limits, beta: Array) -> int:
        K, T = self._K, self._tuning
        return int(
            control_sample.control_sample(
                K.A, K.B, K.C, K.D, self._xk, T.q, T.motion, y, alpha, armed, bounds.output, bounds.input, self._u, beta
            )
        )

    def _missed(self, began: float, ended: float) -> int:
        """A sample is late when its tick came more than half a period late or its work outlasted the period."""
        late = ended - began > self.dt or (math.isfinite(self._last) and began - self._last > 1.5 * self.dt)
        self._last = began
        return int(late)
