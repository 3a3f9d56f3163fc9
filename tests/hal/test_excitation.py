"""Q in the control sample: exact where it acts, gone in the very sample of a limit, and alpha's burst on top of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.bursts import Burst, Limits, Line
from afdsvc.api.retuning import Promise, Tuning
from afdsvc.errors import Refused
from afdsvc.hal.control_loop import LoopSettings
from afdsvc.hal.hardware import DrivenRig
from afdsvc.hal.simulator import ScheduledFault, SimulatedPlant, SimulatedRig
from afdsvc.lti.lft import star
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.yjbk import retuned_interconnection
from afdsvc.service.clock import FastClock

DT = 2e-4
FAULT = (ScheduledFault("horizontal_actuator", -0.4),)


def some_q(size: float = 1.0) -> StateSpace:
    """Return a stable Q of order 3 that the damaged and the healthy bearing both bear."""
    rng = np.random.default_rng(3)
    A = np.array([[0.9, 0.1, 0.0], [-0.1, 0.9, 0.0], [0.0, 0.0, 0.5]])
    return StateSpace(A, rng.standard_normal((3, 2)), size * 0.003 * rng.standard_normal((2, 3)), size * 0.02 * rng.standard_normal((2, 2)), DT)


def simulator(machine, limits=None, faults=FAULT, seed=1):
    plant = SimulatedPlant(machine.augmented.close, machine.output_cov, faults=faults)
    J, settings = machine.controller.interconnection, LoopSettings("m", "s", 100, 25)
    return SimulatedRig(plant, J, machine.channels, limits or machine.limits, settings, FastClock(), seed)


def rows(port, count):
    return np.vstack([port.read().values for _ in range(count // 100)])


class Plant:
    """The damaged bearing with its own noise, as hardware."""

    def __init__(self, G, cov, seed=1):
        self.G, self.x, self.u, self.first = G, np.zeros(G.order), np.zeros(2), True
        self.rng, self.root = np.random.default_rng(np.random.SeedSequence(seed).spawn(2)[0]), np.linalg.cholesky(cov)

    def open(self):
        pass

    def read(self):
        if not self.first:
            self.x = self.G.A @ self.x + self.G.B @ self.u
        self.first = False
        return self.G.C @ self.x + self.root @ self.rng.standard_normal(2)

    def write(self, u):
        self.u = u.copy()

    def rest(self):
        self.u = np.zeros(2)

    close = open


def by_hand(machine, gains, seed=1):
    """Return u and y of plant, J_K and Q in a loop that shares no code with the control sample."""
    plant, J, Q = Plant(machine.augmented.close({"horizontal_actuator": -0.4}), machine.output_cov, seed), machine.controller.interconnection, some_q()
    xj, xq, out = np.zeros(J.order), np.zeros(3), []
    for g in gains:
        y = plant.read()
        beta = J.C[2:] @ xj + J.D[2:, :2] @ y
        alpha = g * (Q.C @ xq + Q.D @ beta)
        u = J.C[:2] @ xj + J.D[:2, :2] @ y + J.D[:2, 2:] @ alpha
        xj = J.A @ xj + J.B[:, :2] @ y + J.B[:, 2:] @ alpha
        xq = Q.A @ xq + Q.B @ beta if g > 0 else np.zeros(3)
        plant.write(u)
        out.append([*u, *y])
    return np.array(out)


@pytest.mark.parametrize("hardware", [False, True])
def test_q_acts_as_its_equations_say_from_rest_to_rest(bearing, hardware):
    machine = bearing()
    if hardware:
        driver = Plant(machine.augmented.close({"horizontal_actuator": -0.4}), machine.output_cov)
        port = DrivenRig(driver, machine.controller.interconnection, machine.channels, machine.limits, LoopSettings("m", "s", 100, 25), FastClock())
    else:
        port = simulator(machine)
    found = [rows(port, 200)]
    port.retune(Tuning(some_q(), 0.01, 0.02))
    found.append(rows(port, 400))
    assert port.retuned == 1
    port.restore("asked")
    found.append(rows(port, 300))
    assert (port.retuned, port.restored_because) == (0, "asked")
    rise, fall = (0.5 - 0.5 * np.cos(np.pi * np.arange(1, n + 1) / n) for n in (50, 100))
    gains = np.concatenate([np.zeros(200), rise, np.ones(350), 1 - fall, np.zeros(200)])
    assert np.abs(np.vstack(found)[:, :4] - by_hand(machine, gains)).max() < 1e-9


def test_one_sample_in_and_one_sample_out(bearing):
    port = simulator(bearing())
    found = [rows(port, 100)]
    port.retune(Tuning(some_q(), 0.0, 0.0))
    found.append(rows(port, 100))
    port.restore("asked")
    found.append(rows(port, 100))
    assert np.abs(np.vstack(found)[:, :4] - by_hand(bearing(), np.repeat([0.0, 1.0, 0.0], 100))).max() < 1e-9
    port.retune(Tuning(some_q(), 0.0, 0.0))  # again, from rest
    assert port.restored_because == ""


def test_a_limit_takes_q_back_in_the_very_sample(bearing):
    machine = bearing()
    port = simulator(machine)
    port.retune(Tuning(some_q(), 0.0, 0.0))
    free = rows(port, 1000)
    limit = 0.9 * np.abs(free[:, 2]).max()
    first = int(np.flatnonzero(np.abs(free[:, 2]) > limit)[0])
    port = simulator(machine, replace(machine.limits, output=np.array([limit, 1e3])))
    port.retune(Tuning(some_q(), 0.0, 0.0))
    rows(port, 1000)
    assert port.restored_because == f"an output reached its limit at sample {first}"
    assert port.retuned == 0
    port = simulator(machine, replace(machine.limits, output=np.array([limit, 1e3])))
    port.retune(Tuning(some_q(), 0.0, 0.0))
    expected = by_hand(machine, np.concatenate([np.ones(first), np.zeros(1000 - first)]))
    assert np.abs(rows(port, 1000)[:, :4] - expected).max() < 1e-9


def test_an_actuator_at_its_limit_takes_q_back_and_is_never_passed(bearing):
    machine, bound = bearing(), 0.35
    port = simulator(machine, Limits(machine.limits.output, np.full(2, bound), np.ones(2)))
    port.retune(Tuning(some_q(30.0), 0.0, 0.0))
    found = rows(port, 1000)
    assert "an actuator reached its limit" in port.restored_because
    assert np.abs(found[:, :2]).max() <= bound


def test_a_lost_lease_ends_q_at_the_next_slice(bearing):
    port, asked = simulator(bearing()), []

    def lease():
        asked.append(port.status().samples)
        return "the lease expired" if len(asked) > 4 else ""

    port.retune(Tuning(some_q(), 0.0, 0.002), lease)
    rows(port, 200)
    assert port.restored_because == "the lease expired"
    assert asked == [0, 0, 25, 50, 75]
    assert port.retuned == 0
    with pytest.raises(Refused, match="the lease expired, before the first sample"):
        port.retune(Tuning(some_q(), 0.0, 0.0), lambda: "the lease expired")


def test_a_promise_broken_ends_q_and_one_kept_does_not(bearing):
    port = simulator(bearing())
    plain = rows(port, 1000)
    cost = float(np.mean(np.sum(plain[:, 2:4] ** 2, axis=1)))
    for share, reason in ((3.0, ""), (0.3, "the measured cost is")):
        port = simulator(bearing())
        port.retune(Tuning(some_q(), 0.0, 0.0, Promise(np.eye(2), np.zeros((2, 2)), share * cost, 0.1)))
        rows(port, 2000)
        assert port.restored_because.startswith(reason)
        assert port.retuned == (0 if reason else 1)


def test_a_burst_shows_in_beta_as_the_loop_with_q_says(bearing):
    machine, found = bearing(), []
    for play in (True, False):
        port = simulator(machine)
        port.retune(Tuning(some_q(), 0.0, 0.0))
        if play:
            with port.arm(machine.limits) as drive:
                drive.play(Burst("sine", 2, 1000, 100, (Line(0, 390.0, 0.1),)))
                found.append(rows(port, 1500))
        else:
            found.append(rows(port, 1500))
    excited = found[0] - found[1]
    alpha, beta = excited[:, 4:6], excited[:, 6:8]
    loop = star(machine.augmented.close({"horizontal_actuator": -0.4}), retuned_interconnection(machine.controller.interconnection, some_q()), 2, 2)
    assert np.abs(beta - simulate(loop, alpha)[0]).max() < 1e-9
    assert np.abs(alpha).max() > 0.09
    assert np.abs(beta).max() > 1e-3


def test_what_does_not_fit_is_refused(bearing):
    port = simulator(bearing())
    for Q, why in (
        (StateSpace.gain(np.zeros((1, 2)), DT), "Q is 1 x 2"),
        (StateSpace.gain(np.zeros((2, 2)), 1e-3), r"expected 2 x 2 at 0\.0002 s"),
        (StateSpace.of([[1.2]], [[1.0, 0.0]], [[1.0], [0.0]], None, DT), r"Q is not stable; its pole is 1\.2"),
        (StateSpace(np.full((1, 1), np.nan), np.zeros((1, 2)), np.zeros((2, 1)), np.zeros((2, 2)), DT), "not stable"),
        (StateSpace(0.5 * np.eye(201), np.zeros((201, 2)), np.zeros((2, 201)), np.zeros((2, 2)), DT), "201 states"),
    ):
        with pytest.raises(Refused, match=why):
            port.retune(Tuning(Q, 0.1, 0.1))
    port.retune(Tuning(some_q(), 0.1, 0.1))
    with pytest.raises(Refused, match="another Q acts"):
        port.retune(Tuning(some_q(), 0.1, 0.1))
