"""Fault curves with nuisances projected out."""

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.errors import BadInput
from afdsvc.plugins.detectors.burst_detectors import FaultCurvesDesign

QUIET, DT = 3000, 2e-4


def disturbed(record, problem, burst, amplitude=0.6):
    """The record with slow drift, mains hum and a rotor-synchronous wave in the residual, all absent while quiet."""
    n = np.arange(len(record)) - QUIET
    during = ((n >= 0) & (n < burst.samples))[:, None]
    angle = 60.0 * n * DT + 0.2 * np.sin(3.0 * n * DT)  # speed wanders a little
    wave = amplitude * np.column_stack([np.sin(angle + 1.0), np.cos(angle)])
    hum = 0.5 * amplitude * np.sin(2 * np.pi * 50 * n * DT)[:, None] * np.array([1.0, 0.4])
    drift = 0.3 * amplitude * (n * DT)[:, None] * np.ones(2)
    return replace(record, r=record.r + during * (wave + hum + drift)), angle


@pytest.fixture
def reported(run, shown):
    def make(problem, burst, severities, settings, seed=1):
        record, angle = disturbed(run(problem, burst, severities, seed), problem, burst)
        detector = FaultCurvesDesign().design(problem, settings)
        add = lambda b: replace(b, aux={"angle": angle[b.k0 : b.k0 + len(b)][:, None]})  # noqa: E731
        (found,) = shown(detector, record, burst, spoil=add)
        return found

    return make


CLEAN = {"drift": 1, "mains_hz": 50.0, "mains_harmonics": 2, "rotor_orders": 2}


def test_nuisances_do_not_alarm_once_they_are_projected_out(bursts, reported):
    problem, burst = bursts("proportional", amplitude=0.2)
    assert not reported(problem, burst, {}, CLEAN).detected


def test_small_faults_keep_their_severity_among_nuisances(bursts, reported):
    problem, burst = bursts("proportional", amplitude=0.6)
    for fault in ("horizontal_sensor", "vertical_actuator"):
        found = reported(problem, burst, {fault: -0.2}, CLEAN)
        assert found.detected
        fitted, sd = found.parts[f"severity.{fault}"], found.parts[f"sd.{fault}"]
        assert abs(fitted + 0.2) < 3 * sd


def test_a_rotor_wave_on_a_burst_line_is_not_mistaken_for_a_fault(bursts, run, shown):
    problem, burst = bursts("proportional", amplitude=0.4)
    record = run(problem, burst, {}, 2)
    n = np.arange(len(record)) - QUIET
    # a rotor turning a little off the first line leaks into it
    angle = (burst.lines[0].omega + 1.2) * n * DT
    during = ((n >= 0) & (n < burst.samples))[:, None]
    turning = during * 0.5 * np.column_stack([np.sin(angle), np.cos(angle)])
    add = lambda b: replace(b, aux={"angle": angle[b.k0 : b.k0 + len(b)]})  # noqa: E731
    plain, clean = (FaultCurvesDesign().design(problem, {"rotor_orders": n}) for n in (0, 1))
    both = [replace(record, r=record.r + sign * turning) for sign in (1, -1)]  # a leak looks like a loss with one of them
    assert max(shown(plain, r, burst, spoil=add)[0].statistic for r in both) > 4
    assert not any(shown(clean, r, burst, spoil=add)[0].detected for r in both)


def test_an_unknown_wave_fits_no_fault(bursts, run, shown):
    problem, burst = bursts("proportional", amplitude=0.4)
    record = run(problem, burst, {"horizontal_actuator": -0.3}, 3)
    n = np.arange(len(record)) - QUIET
    during = (n >= 0) & (n < burst.samples)
    odd = np.column_stack([np.zeros(len(n)), np.sin(burst.lines[0].omega * n * DT + 2.0)])
    record = replace(record, r=record.r + 0.4 * during[:, None] * odd)
    (found,) = shown(FaultCurvesDesign().design(problem, {}), record, burst)
    assert found.detected
    assert found.fault is None
    assert found.weights["none_of_these"] > 0.99


def test_a_missing_rotor_angle_is_said(bursts, run, shown):
    problem, burst = bursts("proportional", amplitude=0.4)
    detector = FaultCurvesDesign().design(problem, {"rotor_orders": 1})
    with pytest.raises(BadInput, match="no aux 'angle'"):
        shown(detector, run(problem, burst, {}, 4), burst)
