"""The control loop: J_K changes nothing while alpha is silent, limits hold inside the sample, every exit leaves rest."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from afdsvc.api.bursts import Burst, Limits, Line
from afdsvc.app import ports
from afdsvc.errors import Refused
from afdsvc.hal.control_loop import LoopSettings
from afdsvc.hal.simulator import ScheduledFault, SimulatedPlant, SimulatedRig
from afdsvc.service.clock import FastClock, RealClock


def burst(amplitude: float = 0.3, samples: int = 1000, inputs: int = 2) -> Burst:
    """Return a sine on the first input."""
    return Burst("b", inputs, samples, 100, (Line(0, 390.0, amplitude),))


def simulator(machine, block=250, slice=50, seed=1, faults=(), limits=None):
    """Return a simulator with blocks and slices of a chosen size."""
    plant = SimulatedPlant(machine.augmented.close, machine.output_cov, speed=machine.speed, faults=faults)
    return SimulatedRig(
        plant,
        machine.controller.interconnection,
        machine.channels,
        limits or machine.limits,
        LoopSettings("m", "s", block, slice),
        FastClock(),
        seed,
    )


def run(port, samples, request=None, at=0, limits=None):
    """Return everything read until ``samples`` have come, a burst starting after ``at`` samples; and why it ended."""
    rows, blocks = 0, []
    cause = ""
    while rows < samples:
        if request is not None and rows >= at:
            with port.arm(limits or port._limits) as drive:
                drive.play(request)
                while drive.playing:
                    blocks.append(port.read())
                    rows += len(blocks[-1])
                cause = drive.aborted
            request = None
            continue
        blocks.append(port.read())
        rows += len(blocks[-1])
    return blocks, cause


def values(blocks):
    return np.vstack([b.values for b in blocks])


@pytest.mark.parametrize("controller", ["proportional", "lqg"])
@pytest.mark.parametrize("rpm", [0, 1100])
def test_nominal_loop_is_the_plain_controller(bearing, controller, rpm):
    """J_K with alpha = 0 is K: against a plain loop of plant and K, to machine precision."""
    machine = bearing(controller, rpm)
    port = simulator(machine)
    got = values([port.read() for _ in range(8)])
    G, K = machine.plant, machine.controller.factorisation.K
    noise = (
        np.random.default_rng(np.random.SeedSequence(1).spawn(2)[0]).standard_normal((2000, 2))
        @ np.linalg.cholesky(machine.output_cov).T
    )
    x, xk, u, y = np.zeros(G.order), np.zeros(K.order), np.empty((2000, 2)), np.empty((2000, 2))
    for k in range(2000):
        y[k] = G.C @ x + noise[k]
        u[k] = K.C @ xk + K.D @ y[k]
        x, xk = G.A @ x + G.B @ u[k], K.A @ xk + K.B @ y[k]
    scale = np.abs(got[:, :4]).max()
    assert np.abs(got[:, :2] - u).max() < 1e-12 * scale
    assert np.abs(got[:, 2:4] - y).max() < 1e-12 * scale


@settings(max_examples=25, deadline=None)
@given(block=st.integers(10, 600), slice=st.integers(1, 300), start=st.integers(0, 700), fault=st.integers(0, 1500))
def test_same_samples_at_any_cut(bearing, block, slice, start, fault):
    """Blocks and slices are packaging: the samples are those of one long run, bit for bit."""
    machine = bearing()
    faults = (ScheduledFault("horizontal_actuator", -0.5, fault),)
    a, _ = run(simulator(machine, 250, 50, faults=faults), 2500)
    b, _ = run(simulator(machine, block, slice, faults=faults), 2500)
    assert np.array_equal(values(a)[:2500], values(b)[:2500])
    assert [x.seq for x in b] == list(range(len(b)))
    assert all(y.k0 == x.k0 + len(x) for x, y in pairwise(b))


def test_real_time_and_fast_give_the_same_samples(bearing):
    machine = bearing()
    fast = simulator(machine)
    real = simulator(machine)
    real._clock = RealClock()
    request = burst(0.5, 700)
    a, _ = run(fast, 1500, request, at=300)
    b, _ = run(real, 1500, request, at=300)
    assert np.array_equal(values(a), values(b))


def test_blocks_never_span_an_edge_of_a_burst(bearing):
    blocks, cause = run(simulator(bearing()), 4000, burst(), at=600)
    assert cause == ""
    inside = [b for b in blocks if b.burst]
    assert {b.burst for b in inside} == {"b"}
    assert sum(map(len, inside)) == 1000
    outside = values([b for b in blocks if not b.burst])[:, 4:6]
    assert np.abs(outside).max() == 0
    alpha = values(inside)[:, 4]
    assert alpha[0] == 0
    assert np.abs(np.diff(alpha)).max() < 0.3 * 390 * 2e-4 * 1.2  # no jump larger than the sine's own steepest step


def test_output_limit_ends_the_burst_within_one_sample(bearing):
    machine = bearing()
    tight = Limits(np.array([2.0, 10.0]), machine.limits.input, machine.limits.alpha)
    blocks, cause = run(simulator(machine), 6000, burst(2.0, 3000), limits=tight)
    assert "an output reached its limit" in cause
    all_ = values(blocks)
    first = int(np.flatnonzero(np.abs(all_[:, 2]) > 2.0)[0])
    assert np.abs(all_[first:, 4:6]).max() == 0
    assert np.abs(all_[first - 1, 4]) > 0
    edge = next(b for b in blocks if not b.burst and b.k0 >= first)
    assert edge.k0 == first


def test_actuator_limit_ends_the_burst_in_the_sample_and_is_never_exceeded(bearing):
    machine = bearing()
    weak = Limits(machine.limits.output, np.array([0.9, 0.9]), np.array([5.0, 5.0]))
    blocks, cause = run(simulator(machine, limits=weak), 6000, burst(4.0, 3000))
    assert "an actuator reached its limit" in cause
    assert np.abs(values(blocks)[:, :2]).max() <= 0.9


def test_total_sensor_loss_does_not_break_the_limits(bearing):
    machine = bearing()
    port = simulator(machine, faults=(ScheduledFault("horizontal_sensor", -1.0, 100),))
    blocks, _ = run(port, 10_000, burst(1.0, 2000), at=500)
    assert np.abs(values(blocks)[:, :2]).max() <= machine.limits.input.max()


class Boom(Exception):
    """Raised on purpose."""


@pytest.mark.parametrize("after", [0, 1, 3])
def test_an_exception_in_the_burst_leaves_the_plant_at_rest(bearing, after):
    port = simulator(bearing())
    drives = []

    def fail() -> None:
        with port.arm(port._limits) as drive:
            drives.append(drive)
            drive.play(burst(0.5, 5000))
            for _ in range(after):
                port.read()
            raise Boom

    with pytest.raises(Boom):
        fail()
    rest = values([port.read() for _ in range(4)])
    assert np.abs(rest[:, 4:6]).max() == 0
    with pytest.raises(Refused, match="arm the machine again"):
        drives[0].play(burst())
    with port.arm(port._limits) as again:
        again.play(burst())


def test_stop_fades_out_over_the_ramp(bearing):
    port = simulator(bearing())
    blocks = []
    with port.arm(port._limits) as drive:
        drive.play(burst(0.5, 5000))
        blocks += [port.read(), port.read()]
        drive.stop("enough")
        while drive.playing:
            blocks.append(port.read())
        assert drive.aborted == "enough"
    alpha = values(blocks)[:, 4]
    assert len(alpha) == 600
    assert abs(alpha[-1]) < 1e-3
    assert np.abs(np.diff(alpha)).max() < 0.06


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        (burst(samples=80_000), "lasts 16 s"),
        (burst(amplitude=300.0), "at most"),
        (Burst("w", 2, 100, 0, waveform=np.full((100, 2), np.nan)), "NaN"),
        (burst(inputs=1), "has 1 inputs"),
        (Burst("r", 2, 4000, 100, (Line(0, 62.0, 4.0),)), "would drive output 0 to"),
    ],
)
def test_a_burst_beyond_a_limit_is_refused_with_its_reason(simulated, wrong, reason):
    port = simulated()
    with pytest.raises(Refused, match=reason):
        port.check(wrong, port._limits)


def test_two_bursts_at_once_are_refused(bearing):
    port = simulator(bearing())
    with port.arm(port._limits) as drive:
        drive.play(burst())
        with pytest.raises(Refused, match="only one burst is played at a time"):
            drive.play(burst())
        with pytest.raises(Refused, match="armed already"), port.arm(port._limits):
            pass


def test_a_fault_starts_at_its_sample(bearing):
    machine = bearing()
    healthy = values(run(simulator(machine), 3000)[0])
    faulty = values(run(simulator(machine, faults=(ScheduledFault("vertical_sensor", -0.5, 1234),)), 3000)[0])
    differs = np.flatnonzero(np.any(healthy[: len(faulty)] != faulty, axis=1))
    assert differs[0] == 1234


def test_unknown_fault_is_named(plugins, bearing):
    machine = bearing(faults={"nonsense": (-0.5, 1.0)})
    with pytest.raises(Exception, match="fault 'nonsense' is unknown; this machine has horizontal_actuator"):
        ports.open_port(machine, "s", FastClock(), plugins)
