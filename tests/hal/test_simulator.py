"""A rotor that changes its speed: angle, unbalance and plant follow, and the machine still holds."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.app import commissioning, ports
from afdsvc.errors import BadInput
from afdsvc.files.site import MachineSection
from afdsvc.hal.simulator import REFRESH, SpeedProfile
from afdsvc.service.clock import FastClock


def test_angle_is_the_integral_of_the_speed() -> None:
    profile = SpeedProfile.of([(0.1, 100.0), (0.3, 400.0), (0.5, 50.0)], 0.0, 1e-3)
    fine = np.arange(60_000) / 100  # samples in hundredths; the oracle is a sum of small steps
    speed = profile.at(fine)
    summed = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * 1e-5)])[::100]
    assert np.abs(np.exp(1j * profile.angle(np.arange(600))) - np.exp(1j * summed)).max() < 1e-6
    assert profile.at(np.array([0, 200, 599])) == pytest.approx([100.0, 250.0, 50.0])


def test_steps_do_not_depend_on_how_samples_are_asked_for() -> None:
    profile = SpeedProfile.of([(0.1, 100.0), (0.33, 400.0), (0.4, 400.0), (0.5, 0.0)], 0.0, 1e-3)
    whole = profile.steps(0, 1000)
    assert whole == set().union(*(profile.steps(k, 7) for k in range(0, 1001, 7)))
    assert whole == {*range(100, 331, REFRESH), 330, *range(400, 501, REFRESH)}
    assert not SpeedProfile.of([], 100.0, 1e-3).steps(0, 1000)


def test_times_that_do_not_rise_are_refused() -> None:
    with pytest.raises(BadInput, match=r"speed profile at \[1.0, 1.0\] s; expected rising times"):
        SpeedProfile.of([(1.0, 5.0), (1.0, 6.0)], 0.0, 1e-3)


def turboexpander(plugins, **driver):
    config = MachineSection(
        id="expander", plant="amb_turboexpander", driver={"kind": "simulator", "real_time": False, **driver}, block=1000
    )
    return commissioning.commission(config, plugins)


def samples(machine, plugins, count):
    port = ports.open_port(machine, "s", FastClock(), plugins)
    return np.vstack([port.read().values for _ in range(count // machine.config.block)])


def test_the_machine_passes_speeds_and_its_unbalance_goes_with_their_square(plugins) -> None:
    machine = turboexpander(plugins, speed=[(0.5, 31500), (1.0, 15750)])
    values = samples(machine, plugins, 20_000)
    names = [c.name for c in machine.channels]
    speed, angle = values[:, names.index("aux_speed")], values[:, names.index("aux_angle")]
    assert speed[[0, -1]] == pytest.approx([3298.67, 1649.34], abs=0.01)
    y = values[:, 4:8]
    assert np.abs(y).max() < 5.0
    for part, unbalance in ((slice(0, 5000), 1.0), (slice(12_000, 20_000), 0.25)):
        turn = np.exp(-1j * angle[part])
        found = 2 * np.mean(turn[:, None] * y[part], axis=0)
        loop = commission_at(machine, float(speed[part][0]))
        wanted = loop @ (machine.physical.unbalance * unbalance)
        assert np.abs(found - wanted).max() < 5 * 0.5 * np.sqrt(2 / len(y[part]))


def commission_at(machine, speed):
    """Return the response of the displacements to a disturbing current at the rotor's own frequency, loop closed."""
    from afdsvc.lti.frequency import frequency_response

    G = machine.physical.at_speed(speed).discrete()
    g = frequency_response(G, [speed])[0]
    k = frequency_response(machine.controller.factorisation.K, [speed])[0]
    return np.linalg.solve(np.eye(4) - g @ k, g)


def test_the_simulated_machine_may_be_another_than_the_model(plugins) -> None:
    """All 320 states of the finite elements run in place of the 8 of the model; the same noise moves both alike."""
    full, small = turboexpander(plugins, options={"states": 320}), turboexpander(plugins)
    y, model = (samples(m, plugins, 3000)[:, 4:8] for m in (full, small))
    assert 1e-4 < np.abs(y - model).max() < 0.03
    with pytest.raises(BadInput, match=r"'driver.options' gives sample time 0.001 s; the machine's is 0.0001 s"):
        samples(turboexpander(plugins, options={"sample_time": 1e-3}), plugins, 1000)


def test_a_fault_put_in_while_the_machine_runs_is_one_of_the_site_file(bearing, plugins) -> None:
    """From the sample it is put in on, the same noise gives the same samples; severity 0 repairs it."""
    scheduled = ports.open_port(bearing(faults={"horizontal_actuator": (-0.5, 0.2)}), "s", FastClock(), plugins)
    asked = ports.open_port(bearing(), "s", FastClock(), plugins)
    dt = asked.dt
    want, found = [], []
    while sum(map(len, found)) * dt < 0.4:
        if sum(map(len, found)) * dt >= 0.2 - 1e-9 and not getattr(asked, "put_in", False):
            asked.inject("horizontal_actuator", -0.5)
            asked.put_in = True
        want.append(scheduled.read().values)
        found.append(asked.read().values)
    assert np.array_equal(np.vstack(want), np.vstack(found))
    healthy = ports.open_port(bearing(), "s", FastClock(), plugins)
    healthy.inject("vertical_sensor", -0.3)
    healthy.inject("vertical_sensor", 0.0)
    assert np.array_equal(healthy.read().values, ports.open_port(bearing(), "s", FastClock(), plugins).read().values)
    with pytest.raises(BadInput, match="fault 'rust' is unknown; this machine has horizontal_actuator"):
        asked.inject("rust", -0.5)
