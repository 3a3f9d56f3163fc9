"""The loop around a driver: the same samples as the simulator, and rest on every exit."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.port import DrivablePort, Port
from afdsvc.api.signals import Channel, Trace
from afdsvc.errors import BadInput
from afdsvc.hal.control_loop import LoopSettings
from afdsvc.hal.hardware import DrivenRig
from afdsvc.hal.replay import Replay, blocks_of
from afdsvc.service.clock import FastClock


class PlantDriver:
    """Hardware that is a linear plant with the simulator's own noise; it can be ordered to fail at a sample."""

    def __init__(self, machine, seed: int = 1, fail_at: int = -1, nan_at: int = -1) -> None:
        self.G, self.x, self.u, self.k = machine.plant, np.zeros(machine.plant.order), np.zeros(2), 0
        self.rng = np.random.default_rng(np.random.SeedSequence(seed).spawn(2)[0])
        self.chol = np.linalg.cholesky(machine.output_cov)
        self.fail_at, self.nan_at = fail_at, nan_at
        self.log: list[str] = []

    def open(self) -> None:
        self.log.append("open")

    def read(self) -> np.ndarray:
        if self.k:
            self.x = self.G.A @ self.x + self.G.B @ self.u
        y = self.G.C @ self.x + self.rng.standard_normal(2) @ self.chol.T
        if self.k == self.fail_at:
            raise OSError("the card does not answer")
        if self.k == self.nan_at:
            y[0] = np.nan
        self.k += 1
        return y

    def write(self, u: np.ndarray) -> None:
        self.u = u.copy()

    def rest(self) -> None:
        self.u = np.zeros(2)
        self.log.append("rest")

    def close(self) -> None:
        self.log.append("close")


def rig(machine, driver, block=250):
    return DrivenRig(
        driver,
        machine.controller.interconnection,
        machine.channels,
        machine.limits,
        LoopSettings("m", "s", block),
        FastClock(),
    )


def play(port, request, limits):
    blocks = [port.read()]
    with port.arm(limits) as drive:
        drive.play(request)
        while drive.playing:
            blocks.append(port.read())
    blocks.append(port.read())
    return np.vstack([b.values for b in blocks])


def test_rig_and_simulator_give_the_same_samples(bearing, simulated):
    """One control sample serves both; the plant's sums differ only in their order."""
    machine = bearing()
    request = Burst("b", 2, 1000, 100, (Line(0, 390.0, 0.5), Line(1, 500.0, 0.5)))
    a = play(rig(machine, PlantDriver(machine)), request, machine.limits)
    b = play(simulated(), request, machine.limits)
    assert np.abs(a - b).max() < 1e-11 * np.abs(b).max()


@pytest.mark.parametrize("fail_at", [0, 100, 300, 777])
def test_a_driver_that_fails_leaves_the_actuators_at_rest(bearing, fail_at):
    machine = bearing()
    driver = PlantDriver(machine, fail_at=fail_at)
    port = rig(machine, driver)
    with pytest.raises(OSError, match="does not answer"):
        play(port, Burst("b", 2, 1000, 100, (Line(0, 390.0, 0.5),)), machine.limits)
    assert driver.log[-1] == "rest"
    assert not driver.u.any()
    port.close()
    port.close()
    assert driver.log.count("close") == 1
    assert port.read() is None


def test_nan_holds_the_input_and_ends_the_burst(bearing):
    machine = bearing()
    port = rig(machine, PlantDriver(machine, nan_at=600))
    values = play(port, Burst("b", 2, 1000, 100, (Line(0, 390.0, 0.5),)), machine.limits)
    assert np.isnan(values[600, 2])
    assert np.array_equal(values[600, :2], values[599, :2])
    assert np.abs(values[600:, 4:6]).max() == 0
    assert np.isfinite(values[601:, :4]).all()


def test_replay_cannot_be_driven_and_passes_values_bit_for_bit():
    rng = np.random.default_rng(0)
    channels = (Channel("u_force", "N"), Channel("y_position", "m"))
    trace = Trace("run.csv", 1e-3, channels, rng.standard_normal((1003, 2)) * 1e-7)
    port = Replay(blocks_of(trace, "axis", "s", 0, 250), FastClock())
    assert isinstance(port, Port)
    assert not isinstance(port, DrivablePort)
    blocks = []
    while (block := port.read()) is not None:
        blocks.append(block)
    assert [len(b) for b in blocks] == [250, 250, 250, 250, 3]
    assert np.array_equal(np.vstack([b.values for b in blocks]), trace.values)


def test_a_rotating_machine_records_speed_and_angle_of_its_driver(bearing):
    machine = bearing(rpm=1100)

    class Turning(PlantDriver):
        def rotation(self) -> tuple[float, float]:
            return 115.2, 0.01 * self.k

    with pytest.raises(BadInput, match=r"driver PlantDriver has no 'rotation\(\)'; a rotating machine records"):
        rig(machine, PlantDriver(machine))
    block = rig(machine, Turning(machine)).read()
    assert block.column("aux_speed") == pytest.approx(np.full(250, 115.2))
    assert block.column("aux_angle") == pytest.approx(0.01 * np.arange(1, 251))
