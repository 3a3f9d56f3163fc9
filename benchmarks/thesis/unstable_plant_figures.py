"""Publication P4: the open-loop unstable plant, its whitening filter, thresholds, and an uncertain parameter."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from afdsvc.detect.thresholds.power import detection_probability, tail_point
from benchmarks.thesis.figure import Figure, Row
from benchmarks.thesis.gas_bearing_figures import reached
from benchmarks.thesis.machines import Detected, autocorrelation, detect, p4, residuals
from benchmarks.thesis.recorded import Measured

OMEGA, AMPLITUDE, WINDOW, FALSE_ALARM, LOSS = 125.0, 0.1, 200, 1e-4, -0.1
WEAK = "its wave of 0.06 in noise of 0.38 gives a deflection of 1.6 in 200 samples"


def amplitude(fault: str) -> float:
    return float(AMPLITUDE * abs(p4().signature(fault, OMEGA, LOSS)[0, 0]))


def phase(fault: str, severity: float = LOSS) -> float:
    return float(np.degrees(np.angle(p4().signature(fault, OMEGA, severity)[0, 0])) % 360)


def efficiency() -> list[Row]:
    omega = np.linspace(10, 125, 24)
    found = {name: np.array([p4().efficiency(name, w, 0, 0, LOSS) for w in omega]) for name in ("b1", "b2")}
    hardest = np.minimum(found["b1"], found["b2"])
    return [Row("best frequency in 10 to 125 rad/s", 125, float(omega[hardest.argmax()]), 0.01), Row("the hardest fault gets easier with frequency", True, bool((np.diff(hardest) > 0).all()))]


def phases() -> list[Row]:
    sizes = np.linspace(-0.05, -1.0, 20)
    rising = {f: np.array([phase(f, s) for s in sizes]) for f in ("b1", "b2")}
    return [Row("loss of 10 % of b1 [deg]", 48.4, phase("b1"), 0.05), Row("loss of 10 % of b2 [deg]", 306, phase("b2"), 0.2), Row("the phase of b2 moves less than 10 degrees with its size", None, bool(np.ptp(rising["b2"]) < 10), 0, "no number is printed; ours, kept", True)]


def whiteness(quiet: tuple[np.ndarray, np.ndarray] | None = None) -> list[Row]:
    beta, r = quiet or residuals(p4(), "b1", 0.0, -1, np.zeros((20_000, 1)), 2)
    band = 1.96 / math.sqrt(len(r))
    return [
        Row("innovation is white", False, bool(np.mean(np.abs(autocorrelation(beta[:, 0])) < band) > 0.8)), Row("r is white", True, bool(np.mean(np.abs(autocorrelation(r[:, 0])) < band) > 0.8)),
        Row("variance of r", 0.14, float(r.var()), 0.01), Row("variance of r, exactly 0.11 p^2", None, float(p4().problem.covariance[0, 0]), 1e-6, "0.14 is one measured run", 0.147194),
    ]  # fmt: skip


def threshold() -> list[Row]:
    A0 = amplitude("b1")
    return [
        Row("amplitude A0", 0.29, A0, 0.005), Row("energy (61)", 8.3, WINDOW * A0**2 / 2, 0.1),
        Row("threshold (62)", 4.0, math.sqrt(0.14 * WINDOW * A0**2 / 2) * tail_point(FALSE_ALARM), 0.05),
    ]  # fmt: skip


def deflection(fault: str) -> float:
    return amplitude(fault) * math.sqrt(WINDOW / 2 / float(p4().problem.covariance[0, 0]))


def first_detected(found: Detected | None = None) -> list[Row]:
    found = found or detect(p4(), "b1", OMEGA, AMPLITUDE, 0, 0, WINDOW, begins=5.0, false_alarm=FALSE_ALARM, severity=LOSS)
    return [
        *threshold(), Row("detected after 5 s", True, found.after > 0.95), Row("quiet before", True, found.before < 0.005),
        reached(found), Row("P_D", None, detection_probability(FALSE_ALARM, deflection("b1")), 0.002, "no number is printed; ours, kept", 0.9999),
    ]  # fmt: skip


def first_decided(found: Detected | None = None) -> list[Row]:
    found = found or detect(p4(), "b1", OMEGA, AMPLITUDE, 0, 0, WINDOW, begins=5.0, false_alarm=FALSE_ALARM, severity=LOSS)
    return [Row("healthy, the decision switches", True, found.decisions_before > 1), Row("after 5 s it names b1", True, found.decided == "b1"), Row("share of decisions for b1", None, found.share, 0.02, "no number is printed; ours, kept", 1.0), reached(found)]


def second_detected(found: Detected | None = None) -> list[Row]:
    found = found or detect(p4(), "b2", OMEGA, AMPLITUDE, 0, 0, WINDOW, begins=2.0, false_alarm=FALSE_ALARM, severity=LOSS)
    return [reached(found), Row("detected after 5 s", True, found.after > 0.5, 0, WEAK, False), Row("P_D", None, detection_probability(FALSE_ALARM, deflection("b2")), 0.002, "no number is printed; ours, kept", 0.016)]


def uncertain() -> list[Row]:
    loop, rows = p4(("b1", "b2", "a11")), []

    def spread(severity: float) -> float:
        S = [np.angle(loop.problem_signature({"b1": severity, "a11": mu}, OMEGA)) for mu in (-0.01, 0.0, 0.01)]
        return float(np.degrees(max(S) - min(S)))

    small, large = spread(-0.1), spread(-0.5)
    rows.append(Row("bounds narrow as the fault grows", True, large < small))
    A_mu = AMPLITUDE * abs(loop.problem_signature({"a11": 0.01}, OMEGA))
    bias = WINDOW * amplitude("b1") * A_mu / 2
    return [*rows, Row("bias of the threshold (67)", 0.1, float(bias), 0.01, "(67) squares an amplitude: wrong units; the bias is linear", 1.23)]


def _recorded(rows: Callable[[Detected], list[Row]], fault: str) -> Callable[[Measured], list[Row]]:
    """Return the rows of what the detector finds in a recording."""
    return lambda m: rows(m.detect(p4(), fault, 0, WINDOW, FALSE_ALARM))


FIGURES = [
    Figure("p4-0.10", "f_alpha for both faults", efficiency),
    Figure("p4-0.11", "phase against the size of the fault", phases),
    Figure("p4-0.12", "autocorrelation of innovation and residual", whiteness, recorded=lambda m: whiteness(m.healthy(p4())), experiment="p4-b1"),
    Figure("p4-0.13", "the decision at each step", first_decided, recorded=_recorded(first_decided, "b1"), experiment="p4-b1"),
    Figure("p4-0.14a", "statistic for a loss of b1", first_detected, recorded=_recorded(first_detected, "b1"), experiment="p4-b1"),
    Figure("p4-0.14b", "statistic for a loss of b2", second_detected, recorded=_recorded(second_detected, "b2"), experiment="p4-b2"),
    Figure("p4-0.15", "phases with an uncertain parameter", uncertain),
]
