"""Two faults at once, faults that change inside a burst, and energy that nothing explains."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.detection import FalseAlarms
from afdsvc.detect.combinations import EXCLUDED, Combination, _besides_on_lines, combined, course, largest_second, weighed
from afdsvc.detect.isolation import LineData
from afdsvc.detect.stability_range import reachable
from afdsvc.detect.statistics.fault_curves import fault_curves
from afdsvc.plugins.detectors.burst_detectors import RegressionDesign
from afdsvc.plugins.manager import load
from benchmarks.detection.judged import judged
from benchmarks.detection.truth import machines
from benchmarks.detection.truth_problem import loss_of, problem_of

MACHINE = next(m for m in machines() if m.name == "direct feedthrough")
PROBLEM = problem_of(MACHINE, FalseAlarms(1e-2))
BURST = Burst("b", 2, 2000, 100, tuple(Line(i, w + 70.0 * i, 2.5) for i in range(2) for w in (220.0, 610.0)), settle=60)
DETECTOR = RegressionDesign().design(PROBLEM, {})


LINES = {kind: load().get("detectors", kind).design(PROBLEM, {}) for kind in ("matched_filter", "fault_curves")}


def found(loss, runs=20, detector=DETECTOR, burst=BURST):
    return [judged(MACHINE, PROBLEM, detector, burst, seed, loss) for seed in range(runs)]


@pytest.mark.parametrize("kind", ["regression", *LINES])
@pytest.mark.parametrize("faults", [("a0", "s0"), ("a1", "s1")])
def test_both_of_two_faults_are_named(faults, kind):
    evidence = found(dict.fromkeys(faults, -0.2), detector=LINES.get(kind, DETECTOR))
    assert Counter(e.fault for e in evidence)["+".join(faults)] >= 19
    for e in evidence:
        if e.fault:
            assert all(abs(e.parts[f"together.severity.{f}"] + 0.2) < 5 * e.parts[f"together.sd.{f}"] for f in faults)


@pytest.mark.parametrize("kind", ["regression", *LINES])
def test_pairs_that_do_the_same_share_the_weight(kind):
    """Both actuators or both sensors a fifth weaker: the same loop gain."""
    for e in found({"a0": -0.2, "a1": -0.2}, 5, LINES.get(kind, DETECTOR)):
        assert (e.detected, e.fault) == (True, None)
        assert e.weights["a0+a1"] + e.weights["s0+s1"] > 0.99


@pytest.mark.parametrize("kind", ["regression", "matched_filter"])
def test_two_sensors_that_do_what_one_actuator_does_are_reported(kind):
    machine = next(m for m in machines() if m.name == "integrating")
    problem = problem_of(machine, FalseAlarms(1e-2))
    detector = load().get("detectors", kind).design(problem, {})
    burst = Burst("b", 1, 2000, 100, (Line(0, 220.0, 3.0), Line(0, 610.0, 3.0)), settle=60)
    for seed in range(5):
        e = judged(machine, problem, detector, burst, seed, {"s0": -0.2, "s1": -0.2})
        assert e.detected
        assert e.fault in ("a0", None)
        assert e.weights.get("s0+s1", 0.0) > 0.01 or "alike.s0+s1" in e.parts


@pytest.mark.parametrize("kind", ["regression", *LINES])
@pytest.mark.parametrize("fault", ["a0", "s1"])
def test_one_fault_stays_one(fault, kind):
    assert Counter(e.fault for e in found({fault: -0.2}, detector=LINES.get(kind, DETECTOR)))[fault] >= 19


@pytest.mark.parametrize("kind", ["regression", *LINES])
def test_a_second_fault_too_small_for_the_burst_is_inside_the_bound_stated_besides_the_first(kind):
    small = replace(BURST, lines=tuple(replace(line, amplitude=line.amplitude / 8) for line in BURST.lines))
    bounds = [e.parts["besides.a0"] for e in found({"a0": -0.2, "s0": -0.2}, 20, LINES.get(kind, DETECTOR), small) if "besides.a0" in e.parts]
    assert len(bounds) >= 10
    assert sum(bound <= -0.2 for bound in bounds) >= len(bounds) - 1
    for e in found({"a0": -0.2}, 5, LINES.get(kind, DETECTOR)):  # a large burst leaves little room for a second one
        assert -0.1 < e.parts["besides.s0"] <= 0


@pytest.mark.parametrize(("first", "at", "second"), [("a0", -0.2, "s1"), ("a0", -0.7, "s0")])
def test_the_bound_of_a_second_fault_on_lines_is_where_the_exact_profile_falls_short(first, at, second):
    curves, reach = fault_curves(PROBLEM, BURST.lines), reachable(PROBLEM)
    point, covariance = curves.together({first: at})
    data = LineData(point, np.eye(len(point)), np.zeros((point.size, point.size)))
    i, j = (curves.names.index(name) for name in (first, second))
    found = _besides_on_lines(curves, data, reach, Combination((i,), np.array([at]), np.eye(1), 0.0), [i, j])

    def short(loss):
        def rest(of_first):
            (r,) = data.whitened(covariance, curves.together({first: of_first, second: loss})[0] - point)
            return 0.5 * float(r @ r)

        return minimize_scalar(rest, bounds=(0.999 * reach[first][0], 0.0), method="bounded").fun - EXCLUDED

    assert found[f"besides.{second}"] == pytest.approx(brentq(short, 0.999 * reach[second][0], -1e-6), rel=2e-3)


@pytest.mark.parametrize("kind", ["regression", *LINES])
def test_two_faults_that_do_exactly_what_one_does_are_inside_the_bound(kind):
    """One input and one output: the losses multiply, and the two cannot be distinguished."""
    machine = next(m for m in machines() if m.name == "huge units")
    problem = problem_of(machine, FalseAlarms(1e-2))
    burst = Burst("b", 1, 2000, 100, tuple(Line(0, w, 5 * float(machine.spread()[1][0])) for w in (220.0, 610.0)), settle=60)
    detector = load().get("detectors", kind).design(problem, {})
    for seed in range(5):
        parts = judged(machine, problem, detector, burst, seed, {"a0": -0.2, "s0": -0.2}).parts
        assert max(v for k, v in parts.items() if k.startswith("besides.")) < -0.3


def test_the_largest_second_loss():
    apart, alike = np.diag([100.0, 400.0]), np.full((2, 2), 100.0)
    assert largest_second(apart @ [-0.3, -0.1], apart, -1.0) == pytest.approx(-0.1 - 1.96 / 20, abs=0.005)
    assert largest_second(alike @ [-0.3, -0.1], alike, -1.0) == pytest.approx(-0.4 - 1.96 / 10, abs=0.005)  # all of it may be the other one
    assert largest_second(apart @ [-0.3, -0.1], apart, -0.15) == -0.15


def test_a_fault_that_begins_in_the_burst_is_reported_at_its_present_severity():
    after = (np.arange(BURST.samples) >= BURST.samples // 2)[:, None] * loss_of(PROBLEM, {"a0": -0.3})
    for e in found(after, 6):
        assert (e.fault, e.parts["onset_part"]) == ("a0", 4.0)
        assert e.severity is not None
        assert abs(e.severity.value + 0.3) < 5 * e.severity.sd
        assert [e.parts[f"course.{k}"] < -0.15 for k in range(8)] == [False] * 4 + [True] * 4
    assert all("onset_part" not in e.parts for e in found({"a0": -0.3}, 6))


@pytest.mark.parametrize("kind", ["growing", "intermittent"])
def test_the_course_of_a_fault_follows_what_it_did(kind):
    t = np.arange(BURST.samples) / BURST.samples
    share = t if kind == "growing" else (t * 4 % 2 < 1).astype(float)
    for e in found(share[:, None] * loss_of(PROBLEM, {"a0": -0.4}), 6):
        reported = np.array([e.parts[f"course.{k}"] for k in range(8)])
        true = -0.4 * share.reshape(8, -1).mean(axis=1)
        assert e.fault in ("a0", None)
        assert e.parts["course_p"] < 1e-3
        assert np.corrcoef(reported, true)[0, 1] > 0.9


def test_energy_that_nothing_explains_withholds_the_name():
    rng = np.random.default_rng(0)
    rattle = rng.normal(0, 0.3, (BURST.samples, 1)) * loss_of(PROBLEM, {"s0": 1.0}) + loss_of(PROBLEM, {"a0": -0.3})  # a loose contact
    evidence = found(rattle, 6)
    assert all(e.detected and e.fault is None and e.weights == {"none_of_these": 1.0} for e in evidence)


def test_faults_that_cannot_be_distinguished_are_not_combined():
    G = np.array([[100.0, 100.0, 0.0], [100.0, 100.0, 0.0], [0.0, 0.0, 50.0]])
    all_of = combined(np.array([-30.0, -30.0, -20.0]), G, [0, 1, 2], (-1.0, 0.0))
    assert [c.faults for c in all_of] == [(0,), (1,), (2,), (0, 2), (1, 2)]
    weights = weighed(all_of, ("a", "b", "c"), 1000)
    assert weights["a"] == pytest.approx(weights["b"])
    assert weights["a+c"] == pytest.approx(weights["b+c"])
    assert max(c.gain for c in all_of) == pytest.approx(30**2 / 200 + 20**2 / 100)


def test_a_course_that_stays_the_same_has_uniform_p_values():
    rng, G = np.random.default_rng(1), np.full(8, 400.0)
    p = [course(-0.2 * G + 20 * rng.standard_normal(8), G).p for _ in range(2000)]
    assert np.mean(np.array(p) < 0.1) == pytest.approx(0.1, abs=0.02)
