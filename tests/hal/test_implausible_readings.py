"""Readings that no working sensor returns: plant inputs stay finite and within their limits, and control recovers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from afdsvc.app import commissioning, ports
from afdsvc.errors import BadInput
from afdsvc.files.site import MachineSection
from afdsvc.hal import control_sample
from afdsvc.hal.control_loop import LoopSettings
from afdsvc.hal.hardware import DrivenRig
from afdsvc.service.clock import FastClock

HUGE = 1.7e308


class BearingDriver:
    """The nominal plant without noise as hardware; a sensor returns ``wrong`` at sample 300."""

    def __init__(self, machine, wrong: float) -> None:
        self.G, self.x, self.u, self.k, self.wrong = machine.plant, np.zeros(machine.plant.order), np.zeros(2), 0, wrong
        self.x[0] = 1e-3

    def open(self) -> None: ...

    def read(self) -> np.ndarray:
        self.x = self.G.A @ self.x + self.G.B @ self.u
        self.k += 1
        return np.array([self.wrong, 0.0]) if self.k == 301 else self.G.C @ self.x

    def write(self, u: np.ndarray) -> None:
        self.u = u.copy()

    def rest(self) -> None: ...

    def close(self) -> None: ...


def samples(machine, wrong: float, sensor_range=None) -> np.ndarray:
    loop = LoopSettings("m", "s", sensor_range=sensor_range)
    rig = DrivenRig(BearingDriver(machine, wrong), machine.controller.interconnection, machine.channels, machine.limits, loop, FastClock())
    return np.vstack([rig.read().values for _ in range(20)])


@pytest.mark.parametrize("wrong", [HUGE, -HUGE, np.inf, np.nan])
def test_a_reading_outside_its_range_counts_as_missing_and_is_over_with_its_sample(bearing, wrong):
    machine = bearing()
    found, usual = samples(machine, wrong), samples(machine, 0.0)
    assert np.isnan(found[300, 2:4]).any()
    assert np.isfinite(found[np.arange(len(found)) != 300]).all()
    assert np.abs(found[:, :2]).max() <= machine.limits.input.max()
    assert np.abs(found[-500:, 2:4]).max() <= 2 * np.abs(usual[300:]).max()


@pytest.mark.parametrize("wrong", [HUGE, 1e300])
def test_a_controller_that_overflows_is_reset_and_the_actuators_rest(bearing, wrong):
    machine = bearing()
    found = samples(machine, wrong, sensor_range=[1.79e308, 1.79e308])
    assert np.isfinite(found[:, :2]).all()
    assert np.abs(found[:, :2]).max() <= machine.limits.input.max()
    if wrong == HUGE:
        assert not found[300, :2].any()
        assert np.isfinite(found[302:]).all()


@settings(max_examples=200, deadline=None)
@given(readings=st.lists(st.tuples(*2 * [st.floats() | st.sampled_from([HUGE, -HUGE, 1e154])]), min_size=1, max_size=30), armed=st.booleans())
def test_whatever_is_read_the_inputs_are_finite_and_within_their_limits(bearing, readings, armed):
    machine = bearing()
    K, bounds = control_sample.contiguous_system(machine.controller.interconnection), machine.limits
    xk, u, beta = np.zeros(K.order), np.zeros(2), np.zeros(2)
    for y in readings:
        alpha = 0.5 * bounds.alpha
        control_sample.control_sample(
            K.A, K.B, K.C, K.D, xk, *control_sample.no_q(2, 2), np.array(y), alpha, armed, bounds.output, bounds.input, u, beta,
        )
        assert np.isfinite(u).all()
        assert (np.abs(u) <= bounds.input).all()
        assert (np.abs(alpha) <= bounds.alpha).all()
        assert np.isfinite(xk).all()


def test_the_range_is_stated_in_the_site_file_one_value_per_output(plugins):
    config = MachineSection(id="bearing", plant="gas_bearing", limits={"sensor_range": [3.0]})
    with pytest.raises(BadInput, match=r"key 'limits.sensor_range' has 1 values; expected 2"):
        ports.open_port(commissioning.commission(config, plugins), "s", FastClock(), plugins)
