"""A driver for real hardware, to start from: replace `Converter` by the calls of your input-output card.

Run it: python examples/lab_driver.py
"""

from __future__ import annotations

import time

import numpy as np

from afdsvc.api.bursts import Burst, Limits, Line
from afdsvc.api.signals import Channel
from afdsvc.hal.control_loop import LoopSettings
from afdsvc.hal.hardware import DrivenRig
from afdsvc.plants.registry import plant
from afdsvc.plugins.manager import load
from afdsvc.service.clock import RealClock


class Converter:
    """Stands for the card: two analogue inputs and outputs, and a sample clock. Here a little physics answers."""

    def __init__(self, dt: float) -> None:
        self.dt, self.volts, self._next = dt, np.zeros(2), time.perf_counter()
        self._plant, self._x = plant("gas_bearing").discrete(), np.zeros(6)
        self._rng = np.random.default_rng(0)

    def wait_for_tick(self) -> None:
        """A card's driver blocks until the hardware clock ticks; software has to spin."""
        self._next = max(self._next + self.dt, time.perf_counter() - 0.1)
        while time.perf_counter() < self._next:
            pass

    def read_micrometres(self) -> np.ndarray:
        """Return the two displacements."""
        self._x = self._plant.A @ self._x + self._plant.B @ self.volts
        return self._plant.C @ self._x + 0.36 * self._rng.standard_normal(2)


class LabDriver:
    """The five methods afdsvc asks of a machine; all are called from the control thread."""

    def __init__(self, dt: float) -> None:
        self._card = Converter(dt)
        self.at_rest = False

    def open(self) -> None:
        """Connect, and bring the actuators to rest."""
        self.rest()

    def read(self) -> np.ndarray:
        """Wait for the tick and return the outputs in the units of the channels."""
        self._card.wait_for_tick()
        return self._card.read_micrometres()

    def write(self, u: np.ndarray) -> None:
        """Send the inputs; they hold until the next call."""
        self._card.volts = u.copy()
        self.at_rest = False

    def rest(self) -> None:
        """The safe value of the actuators, whatever happened before."""
        self._card.volts = np.zeros(2)
        self.at_rest = True

    def close(self) -> None:
        """Disconnect."""


def main(seconds: float = 1.0) -> None:
    """Close the loop around the driver with the LQG controller and play one short burst within tight limits."""
    bearing = plant("gas_bearing")
    controller = load().get("controllers", "lqg").design(bearing.discrete(), bearing.recommended["lqg"])
    channels = tuple(Channel(f"{role}_{axis}") for role in ("u", "y", "alpha", "beta") for axis in ("horizontal", "vertical"))
    limits = Limits(bearing.output_limit, bearing.input_limit, np.array([1.0, 1.0]))
    driver = LabDriver(bearing.sample_time)
    rig = DrivenRig(driver, controller.interconnection, channels, limits, LoopSettings("lab", "first"), RealClock())
    try:
        rig.read()
        with rig.arm(limits) as drive:
            drive.play(Burst("hello", 2, samples=round(seconds / rig.dt), ramp=100, lines=(Line(0, 390.0, 0.3),)))
            while drive.playing:
                rig.read()
        status = rig.status()
        ended = drive.aborted or "played to its end"
        print(f"{status.samples} samples, {status.late} late, head-room {100 * status.head_room:.0f} %, burst {ended}")
    finally:
        rig.close()
    assert driver.at_rest


if __name__ == "__main__":
    main()
