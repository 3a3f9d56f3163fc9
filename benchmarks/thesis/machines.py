"""The machines of the thesis in their loops, and the published detector over their residuals."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.thresholds.power import tail_point
from afdsvc.lti.coprime import Factorisation, observer_factorisation, proportional_factorisation
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.lft import fault_signature
from afdsvc.lti.riccati import kalman_predictor_gain, lqr
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.whitening import whitening_filter
from afdsvc.lti.yjbk import closed_loop, interconnection
from afdsvc.plants.gas_bearing import gas_bearing
from afdsvc.testing.machines import bearing_problem, unstable_problem

FAULTS = ("horizontal_actuator", "vertical_actuator", "horizontal_sensor", "vertical_sensor")
HALF = -0.5


@dataclass(frozen=True, eq=False)
class Loop:
    """A plant in its loop: the problem (residual, faults) and the factors that say where alpha enters."""

    problem: DetectionProblem
    factors: Factorisation
    whitening: object

    def signature(self, fault: str, omega: float, severity: float = HALF) -> np.ndarray:
        """Return the whitened residual per unit of alpha, complex ``(outputs, inputs)``."""
        S = fault_signature(self.problem.augmented, self.problem.interconnection, {fault: severity})
        return (frequency_response(self.whitening, [omega]) @ frequency_response(S, [omega]))[0]

    def problem_signature(self, severities: dict[str, float], omega: float) -> complex:
        """Return the whitened residual per unit of alpha, first output and input, with several parameters changed."""
        S = fault_signature(self.problem.augmented, self.problem.interconnection, severities)
        return complex((frequency_response(self.whitening, [omega]) @ frequency_response(S, [omega]))[0, 0, 0])

    def simulated_efficiency(self, fault: str, omega: float, source: int, seen: int, severity: float = HALF) -> float:
        """Return f_alpha from simulated runs of the loop with and without the fault, without noise."""
        G, periods = self.problem.plant, round(2 * np.pi / omega / self.problem.plant.dt) * 10
        alpha = sine(self, omega, 1.0, source, 2 * periods)
        deflection = self._runs(G, alpha)[0]
        r = simulate(self.whitening, self._runs(self.problem.augmented.close({fault: severity}), alpha)[1])[0]
        wave = np.exp(-1j * omega * G.dt * np.arange(2 * periods))[periods:]
        return float(abs(wave @ r[periods:, seen]) / np.linalg.norm(wave @ deflection[periods:]))

    def _runs(self, plant: StateSpace, alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return outputs and beta of the loop around this plant."""
        m, p = plant.inputs, plant.outputs
        out, _ = simulate(closed_loop(self.factors, plant).system, np.hstack([np.zeros((len(alpha), 2 * p + m)), alpha]))
        return out[:, :p], out[:, -p:]

    def efficiency(self, fault: str, omega: float, source: int, seen: int, severity: float = HALF) -> float:
        """Return f_alpha, the residual over the largest deflection that alpha causes (thesis 5.43, P5 20)."""
        N = frequency_response(self.factors.N, [omega])[0]
        return float(abs(self.signature(fault, omega, severity)[seen, source]) / np.linalg.norm(N[:, source]))


@lru_cache(maxsize=8)
def bearing(controller: str = "proportional", rpm: int = 0) -> Loop:
    """Return the gas bearing with P5's proportional controller (sign corrected, +0.2) or its LQG."""
    problem, physical = bearing_problem(controller, rpm), gas_bearing(rpm)
    G = problem.plant
    F = lqr(G, 1e-4 * np.diag([0, 0, 1, 1, 0, 0]), np.eye(2))
    f = proportional_factorisation(G, 0.2, F) if controller == "proportional" else observer_factorisation(G, F, kalman_predictor_gain(G, 0.01 * np.eye(6), np.eye(2)))
    return Loop(replace(problem, interconnection=interconnection(f)), f, whitening_filter(f, physical.output_cov)[0])


@lru_cache(maxsize=2)
def p4(faults: tuple[str, ...] = ("b1", "b2")) -> Loop:
    """Return the unstable plant of P4 with the LQ gains that reproduce its figures."""
    problem = unstable_problem(faults=faults)
    G = problem.plant
    f = observer_factorisation(G, lqr(G, np.eye(2), 0.1), kalman_predictor_gain(G, np.eye(2), 1.0))
    return Loop(replace(problem, interconnection=interconnection(f)), f, whitening_filter(f, problem.output_cov)[0])


def wrong(theta: float) -> Factorisation:
    """Return the factors of a nominal model with (1 - theta) of the sampled A and its observer controller (4.39)."""
    G = gas_bearing().discrete()
    return observed(StateSpace((1 - theta) * G.A, G.B, G.C, G.D, G.dt))


def observed(nominal: StateSpace, weight: float = 1e-4) -> Factorisation:
    """Return factors with P5's observer and LQ state feedback, this weight on the velocities."""
    F = lqr(nominal, weight * np.diag([0, 0, 1.0, 1, 0, 0]), np.eye(2))
    return observer_factorisation(nominal, F, kalman_predictor_gain(nominal, 0.01 * np.eye(6), np.eye(2)))


def residuals(loop: Loop, fault: str, severity: float, start: int, alpha: np.ndarray, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Return beta and the white r ``(n, outputs)`` of a run in which the fault begins at sample ``start``."""
    problem, J, rng = loop.problem, loop.problem.interconnection, np.random.default_rng(seed)
    healthy, m, p = problem.plant, problem.plant.inputs, problem.plant.outputs
    noise = rng.standard_normal((len(alpha), p)) @ np.linalg.cholesky(problem.output_cov).T
    x, xj, out = np.zeros(healthy.order), np.zeros(J.order), np.empty((len(alpha), 2 * p + m))
    G = healthy
    for k, a in enumerate(alpha):
        if k == start:
            G = problem.augmented.close({fault: severity})
        y = G.C @ x + noise[k]
        into = np.concatenate([y, a])
        answer = J.C @ xj + J.D @ into
        xj, x = J.A @ xj + J.B @ into, G.A @ x + G.B @ answer[:m]
        out[k] = np.concatenate([answer[m:], y, answer[:m]])
    r, _ = simulate(problem.innovations, out[:, p:])
    return out[:, :p], r


def sine(loop: Loop, omega: float, amplitude: float, source: int, samples: int) -> np.ndarray:
    """Return alpha ``(samples, inputs)``, one sine."""
    alpha = np.zeros((samples, loop.problem.plant.inputs))
    alpha[:, source] = amplitude * np.sin(omega * loop.problem.plant.dt * np.arange(samples))
    return alpha


def matched(r: np.ndarray, omega: float, dt: float, phase: float, window: int) -> np.ndarray:
    """Return the correlation of r with the unit wave of this phase over the last ``window`` samples, NaN before (thesis 5.20)."""
    wave = r * np.sin(omega * dt * np.arange(len(r)) + phase)
    total = np.concatenate([[0.0], np.cumsum(wave)])
    found = np.full(len(r), np.nan)
    found[window - 1 :] = total[window:] - total[:-window]
    return found


@dataclass(frozen=True)
class Detected:
    """What the published detector does: share of windows over the threshold before and after the fault, and the decision after it.

    ``reached``: mean of T after the fault in standard deviations, from this many ``windows``; ``deflection``: what S predicts for it.
    """

    before: float
    after: float
    decisions_before: int
    decided: str
    share: float
    deflection: float
    reached: float
    windows: float


def detect(
    loop: Loop, fault: str, omega: float, amplitude: float, source: int, seen: int, window: int, seconds: float = 3.0,
    begins: float = 2.0, false_alarm: float = 2e-5, severity: float = HALF, seed: int = 1,
) -> Detected:  # fmt: skip
    """Return what the matched filter for this fault finds in a run, and which phase among those of all visible faults fits best."""
    dt = loop.problem.plant.dt
    n, start = round((begins + seconds) / dt) + 2 * window, round(begins / dt) + window
    _, r = residuals(loop, fault, severity, start, sine(loop, omega, amplitude, source, n), seed)
    return detect_in(r, loop, fault, omega, amplitude, source, seen, window, 0, start, false_alarm, severity)


def detect_in(
    r: np.ndarray, loop: Loop, fault: str, omega: float, amplitude: float, source: int, seen: int, window: int, steady: int, start: int,
    false_alarm: float = 2e-5, severity: float = HALF,
) -> Detected:  # fmt: skip
    """Return the same for residuals ``(n, outputs)`` from the first sample of the sine; it is ``steady`` from there on, the fault begins at ``start``."""
    dt, variance = loop.problem.plant.dt, loop.problem.covariance[seen, seen]
    answers = {name: loop.signature(name, omega, severity)[seen, source] for name in loop.problem.fault_names}
    visible = {name: float(np.angle(a)) for name, a in answers.items() if abs(a) > 1e-9}
    sd = np.sqrt(variance * window / 2)
    statistics = {name: matched(r[:, seen], omega, dt, phase, window) / sd for name, phase in visible.items()}
    T = statistics.get(fault, np.max(list(statistics.values()), axis=0))
    quiet, faulty = slice(steady + window, start), slice(start + window, None)
    stacked = np.array(list(statistics.values()))
    choices, names = stacked.argmax(axis=0) if len(stacked) else np.zeros(len(r), int), list(visible)
    votes = np.bincount(choices[faulty], minlength=len(names))
    h = tail_point(false_alarm)
    return Detected(
        float(np.mean(T[quiet] > h)), float(np.mean(T[faulty] > h)), len(np.unique(choices[quiet])), names[int(votes.argmax())],
        float(votes.max() / votes.sum()), float(abs(answers[fault]) * amplitude * np.sqrt(window / 2 / variance)),
        float(T[faulty].mean()), len(T[faulty]) / window,
    )  # fmt: skip


def autocorrelation(x: np.ndarray, lags: int = 20) -> np.ndarray:
    """Return the normalised autocorrelation at lags 1 to ``lags``."""
    x = x - x.mean()
    return np.array([x[k:] @ x[:-k] for k in range(1, lags + 1)]) / (x @ x)
