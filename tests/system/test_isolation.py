"""The promise of the gas bearing, by simulation through the very pipeline of the service.

All four faults at -50 %, both controllers, 0 and 1100 rpm: detected, on the right axis, the right part, severity within what
its standard error says; a smaller burst never leads to a wrong name; no alarm while nothing is wrong.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from afdsvc.app import ports
from afdsvc.app.pipelines import burst_design, pipeline_of
from afdsvc.diagnosis.verdict import alarm_decisions, conclude
from afdsvc.service.clock import FastClock
from afdsvc.service.scheduler import BurstOrder

FAULTS = ("horizontal_actuator", "vertical_actuator", "horizontal_sensor", "vertical_sensor")
LOOPS = [(c, rpm) for c in ("proportional", "lqg") for rpm in (0, 1100)]


def burst_run(machine, plugins, bursts: int = 1, quiet: int = 5000, burst=None):
    """Return the evidence of quiet running and bursts in turn; every burst must play to its end within the limits."""
    port = ports.open_port(machine, "s", FastClock(), plugins)
    stream = pipeline_of(machine, plugins)
    burst = burst or burst_design(machine, stream)(BurstOrder("test"))
    stream.announce(burst)
    evidence, peak = [], 0.0

    def take(block) -> int:
        nonlocal peak
        peak = max(peak, float(np.abs(block.role("y")).max()))
        outcome = stream.step(block)
        assert not outcome.findings
        evidence.extend(outcome.evidence)
        return len(block)

    for _ in range(bursts):
        done = 0
        while done < quiet:
            done += take(port.read())
        port.check(burst, machine.limits)
        with port.arm(machine.limits) as drive:
            drive.play(burst)
            while drive.playing:
                take(port.read())
            assert drive.aborted == ""
        take(port.read())
    assert peak < 10.0
    return evidence


def one(bearing, plugins, controller, rpm, fault, seed):
    """Return the verdict on one fault present from the start."""
    machine = bearing(controller, rpm, seed, {fault: (-0.5, 0.0)})
    return conclude(burst_run(machine, plugins))


@pytest.mark.parametrize(("controller", "rpm"), LOOPS)
@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_is_detected_and_named(bearing, plugins, controller, rpm, fault):
    verdict = one(bearing, plugins, controller, rpm, fault, 7)
    assert verdict.fault == fault
    assert abs(verdict.severity.value + 0.5) < 4 * verdict.severity.sd


@pytest.mark.long
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(("controller", "rpm"), LOOPS)
@pytest.mark.parametrize("fault", FAULTS)
def test_twenty_of_twenty(bearing, plugins, controller, rpm, fault):
    """Detected, right axis, right part 20 of 20; severities as their standard errors promise."""
    verdicts = [one(bearing, plugins, controller, rpm, fault, seed) for seed in range(100, 120)]
    assert [v.fault for v in verdicts] == [fault] * 20
    z = np.array([(v.severity.value + 0.5) / v.severity.sd for v in verdicts])
    print(f"{controller} {rpm} {fault}: z rms {np.sqrt(np.mean(z**2)):.2f}, beyond 2 sd {np.sum(np.abs(z) > 2)}")
    assert np.sum(z**2) < stats.chi2(20).ppf(0.999)


@pytest.mark.long
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(("controller", "rpm"), LOOPS)
def test_a_small_burst_is_never_falsely_sure(bearing, plugins, controller, rpm):
    """At 0.3 um actuator and sensor of one axis cannot be distinguished: both are reported, the wrong one never alone."""
    undecided = 0
    for fault in FAULTS:
        for seed in range(5):
            machine = bearing(controller, rpm, seed, {fault: (-0.5, 0.0)}, bursts={"output_amplitude": 0.3, "seconds": 1.0})
            verdict = conclude(burst_run(machine, plugins))
            assert verdict.fault in (None, fault)
            undecided += verdict.fault is None
            if verdict.detected:
                assert verdict.weights[fault] > 0
    assert undecided >= 10


@pytest.mark.long
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(("controller", "rpm"), LOOPS)
def test_fifty_fault_free_bursts_raise_no_alarm(bearing, plugins, controller, rpm):
    """Four loops of 50 bursts at 1 per 1000 for each of three burst detectors: 0.6 alarms expected in 200 bursts."""
    evidence = burst_run(bearing(controller, rpm, 11), plugins, bursts=50)
    raised = [e for e in alarm_decisions(evidence) if e.burst]
    print(
        controller,
        rpm,
        "alarms",
        [(e.detector, e.statistic) for e in raised],
        "refused",
        sum(not e.trustworthy for e in evidence),
    )
    assert not raised
