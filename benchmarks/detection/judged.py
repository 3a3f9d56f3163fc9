"""One burst on a true machine, judged by detectors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from afdsvc.api.bursts import Burst
from afdsvc.api.detection import DetectionProblem, Detector, ResidualBlock
from afdsvc.api.evidence import Evidence
from afdsvc.detect.features.shared_filter import shared_regressors
from afdsvc.lti.simulate import simulate
from benchmarks.detection.truth import TrueMachine
from benchmarks.detection.truth_problem import alpha_of, loss_of

QUIET = 3000  # samples before the burst, of a loop that settles soon


def quiet(problem: DetectionProblem) -> int:
    """Return the samples before the burst: what the residual takes to settle, and as many as a decision asks for."""
    return max(QUIET, 2500 + shared_regressors(problem).settling())


def judged(
    machine: TrueMachine, problem: DetectionProblem, detector: Detector, burst: Burst, seed: int | Sequence[int],
    loss: Mapping[str, float] | np.ndarray | None = None, noisier: float = 1.0, units: tuple[float, float] = (1.0, 1.0),
) -> Evidence:
    """Return the decision on a burst after quiet samples; ``loss`` by fault, or ``(samples, faults)`` over the burst; ``noisier`` multiplies
    the noise of the burst. ``units`` multiply the numbers of inputs and outputs between machine and detector."""
    before = quiet(problem)
    alpha = alpha_of(burst, machine.dt, before)
    course = np.zeros((len(alpha), len(problem.fault_names)))
    course[0 if isinstance(loss, Mapping) else before :] = loss_of(problem, dict(loss)) if isinstance(loss, Mapping) else 0.0 if loss is None else loss
    run = machine.run(np.random.default_rng(seed), alpha, course, noisier=np.r_[np.ones(before), np.full(burst.samples, noisier)])
    u, y, beta = units[0] * run["u"], units[1] * run["y"], units[1] * run["beta"]
    r, _ = simulate(problem.innovations, np.hstack([y, u]))
    burst = replace(burst, lines=tuple(replace(line, amplitude=units[0] * line.amplitude) for line in burst.lines))
    state, found = detector.start(), []
    for a, b, playing in ((0, before, None), (before, len(alpha), burst)):
        parts = (r, beta, u, y, units[0] * alpha)
        state, evidence = detector.step(state, ResidualBlock(a, machine.dt, *(x[a:b] for x in parts), playing, burst.name if playing else "", before))
        found += evidence
    return found[-1]


def shown(problem: DetectionProblem, detectors: Sequence[Detector], run: Mapping[str, np.ndarray], burst: Burst | None) -> list[list[Evidence]]:
    """Return the evidence of every detector for a run: quiet samples, then the burst (None: all of it is quiet)."""
    r, _ = simulate(problem.innovations, np.hstack([run["y"], run["u"]]))
    end = len(r) if burst is None else quiet(problem)
    parts = (r, run["beta"], run["u"], run["y"], run["alpha"])
    edges = [(k, min(k + 5000, end), None) for k in range(0, end, 5000)] + ([] if burst is None else [(end, len(r), burst)])
    blocks = [ResidualBlock(a, problem.plant.dt, *(x[a:b] for x in parts), playing, "b" if playing else "", end) for a, b, playing in edges]
    found = []
    for detector in detectors:
        state, decisions = detector.start(), []
        for block in blocks:
            state, evidence = detector.step(state, block)
            decisions += evidence
        found.append(decisions)
    return found
