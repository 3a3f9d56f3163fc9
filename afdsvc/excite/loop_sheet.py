"""What the loop makes of excitation, disturbances, faults and another gain of its controller, before anything is played.

Phase and amplitude of every fault against its severity at candidate frequencies (thesis 5.5, P4 figure 0.11, P5 figure 0.7), what a
frequency disturbs (5.43), the nu-gap between healthy and faulty plant (chapter 5's measure of detectability), and the poles of the loop
for a multiple of the controller (P5 figure 0.3).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.optimize import brentq

from afdsvc.api.bursts import Burst
from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.statistics.fault_curves import loop_response
from afdsvc.errors import BadInput
from afdsvc.excite.efficiency import efficiency
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.gap import nu_gap, stability_margin
from afdsvc.lti.stability import closed_loop_matrix
from afdsvc.lti.statespace import Array, ComplexArray, StateSpace

SEVERITIES = (-0.1, -0.25, -0.5, -0.75, -1.0)
FACTORS = np.unique(np.concatenate([np.linspace(-4.0, 4.0, 161), [1.0]]))  # of the controller's gain
SPREAD = 4  # frequencies between those of the burst and the limits of what can be played


def loop_sheet(problem: DetectionProblem, burst: Burst, controller: StateSpace, frequencies: Sequence[float] = ()) -> dict[str, Any]:
    """Return the sheet as a JSON document: ``candidates``, ``nu_gap``, ``controller_gain``.

    Parameters
    ----------
    problem : DetectionProblem
        The machine in its loop.
    burst : Burst
        The designed burst; its frequencies are candidates too.
    controller : StateSpace
        K from y to u (positive feedback), m outputs and p inputs.
    frequencies : sequence of float
        Candidates [rad/s], in place of the burst's and some between; raises `BadInput` for one that cannot be sampled.
    """
    omega = candidate_frequencies(problem, burst, frequencies)
    return {
        "candidates": _candidates(problem, omega, controller),
        "nu_gap": gaps(problem, controller),
        "controller_gain": controller_gain(problem.plant, controller),
    }


def candidate_frequencies(problem: DetectionProblem, burst: Burst, frequencies: Sequence[float] = ()) -> Array:
    """Return the candidates [rad/s], rising: those given, or the burst's lines, and some evenly spread in the logarithm."""
    highest = math.pi / problem.plant.dt
    bad = [w for w in frequencies if not 0 < w < highest]
    if bad:
        raise BadInput(f"frequency {bad[0]:g} rad/s; expected one between 0 and {highest:g} rad/s, half the sampling rate")
    lines = [line.omega for line in burst.lines]
    return np.unique(frequencies if len(frequencies) else [*lines, *np.geomspace(highest / 1000, 0.6 * highest, SPREAD)])


def severities_of(problem: DetectionProblem) -> list[float]:
    """Return the severities that are shown, within the machine's range."""
    low, high = problem.severity_range
    return [s for s in SEVERITIES if low <= s <= high] or [low]


def phasors(problem: DetectionProblem, omega: Sequence[float] | Array, severities: Sequence[float] | Array) -> ComplexArray:
    """Return the whitened residual per unit of alpha, ``(faults, severities, frequencies, outputs, inputs)``."""
    loop = loop_response(problem, omega)
    return np.stack([loop.paths(name, severities).r for name in problem.fault_names])


def disturbance_gain(plant: StateSpace, controller: StateSpace, omega: Sequence[float] | Array) -> tuple[Array, Array]:
    """Return the largest gain from a disturbance at the inputs to the outputs, without and with the controller, ``(frequencies,)``."""
    G, K = frequency_response(plant, omega), frequency_response(controller, omega)
    closed = np.linalg.solve(np.eye(plant.outputs) - G @ K, G)
    return np.linalg.norm(G, 2, axis=(1, 2)), np.linalg.norm(closed, 2, axis=(1, 2))


def _candidates(problem: DetectionProblem, omega: Array, controller: StateSpace) -> list[dict[str, Any]]:
    """Return an entry per frequency and input: what it disturbs, and amplitude and phase of every fault at every severity."""
    severities = severities_of(problem)
    r, y = phasors(problem, omega, severities), np.abs(loop_response(problem, omega).healthy().y[0])
    worst = efficiency(problem, omega, severities[-1]).worst()
    without, within = disturbance_gain(problem.plant, controller, omega)
    return [
        {
            "rad_s": float(w), "input": name, "disturbs": dict(zip(problem.output_names, map(float, y[k, :, j]), strict=True)),
            "efficiency_of_worst_fault": float(worst[k, j]), "disturbance_gain_open": float(without[k]), "disturbance_gain_closed": float(within[k]),
            "severities": severities,
            "faults": {
                fault: {output: _polar(r[f, :, k, i, j]) for i, output in enumerate(problem.output_names)}
                for f, fault in enumerate(problem.fault_names)
            },
        }
        for k, w in enumerate(omega)
        for j, name in enumerate(problem.input_names)
    ]  # fmt: skip


def _polar(values: ComplexArray) -> dict[str, list[float | None]]:
    """Return amplitudes and phases in [0, 360) degrees; an amplitude of zero has no phase."""
    return {
        "amplitude": [float(f"{abs(v):.4g}") for v in values],
        "phase_deg": [round(float(np.degrees(np.angle(v)) % 360), 2) if abs(v) > 1e-12 else None for v in values],
    }


def gaps(problem: DetectionProblem, controller: StateSpace) -> dict[str, Any]:
    """Return the margin of the loop, and for every fault the nu-gap to the healthy plant at every severity.

    Signals are counted in the machine's limits where it states them. A fault whose gap is below the margin leaves the loop stable. A gap
    is not a probability of detection: it knows neither noise nor how long a burst is.
    """
    scale = _scaling(problem)
    G, K = _scaled(problem.plant, *scale), _scaled(controller, *scale[::-1])
    severities = severities_of(problem)
    faults = {
        name: [nu_gap(G, _scaled(problem.augmented.close({name: s}), *scale)) for s in severities] for name in problem.fault_names
    }
    return {"margin": stability_margin(G, K), "severities": severities, "faults": faults}


def _scaling(problem: DetectionProblem) -> tuple[Array, Array]:
    """Return what counts as one unit of each output and input: its limit, 1 where none is stated."""
    if problem.limits is None:
        return np.ones(problem.plant.outputs), np.ones(problem.plant.inputs)
    both = (np.asarray(problem.limits.output, dtype=float), np.asarray(problem.limits.input, dtype=float))
    output, input_ = (np.where(np.isfinite(limit) & (limit > 0), limit, 1.0) for limit in both)
    return output, input_


def _scaled(system: StateSpace, output: Array, input_: Array) -> StateSpace:
    """Return the system between signals counted in the units of its outputs and inputs."""
    return StateSpace(system.A, system.B * input_, system.C / output[:, None], system.D * input_ / output[:, None], system.dt)


def loop_poles(plant: StateSpace, controller: StateSpace, factors: Sequence[float] | Array) -> ComplexArray:
    """Return the poles of the loop with the controller's output multiplied by each factor, ``(factors, states)``: the root locus.

    Poles of one factor follow those of the one before.
    """
    rows: list[ComplexArray] = []
    for factor in factors:
        K = StateSpace(controller.A, controller.B, factor * controller.C, factor * controller.D, controller.dt)
        poles = np.linalg.eigvals(closed_loop_matrix(plant, K)).astype(complex)
        rows.append(_followed(rows[-1], poles) if rows else poles)
    return np.array(rows)


def _followed(before: ComplexArray, poles: ComplexArray) -> ComplexArray:
    """Return the poles in the order in which they are closest to those before."""
    from scipy.optimize import linear_sum_assignment

    return poles[linear_sum_assignment(np.abs(before[:, None] - poles[None, :]))[1]]


def least_damping(poles: ComplexArray, dt: float) -> float:
    """Return the smallest damping ratio of discrete poles; below zero for an unstable loop. Poles at zero have died out."""
    s = np.log(poles[np.abs(poles) > 1e-12].astype(complex)) / dt
    return float(np.min(-s.real / np.maximum(np.abs(s), 1e-300))) if s.size else 1.0


def controller_gain(plant: StateSpace, controller: StateSpace) -> dict[str, Any]:
    """Return between which multiples of the controller the loop is stable, around 1, its least damping, and the multiple that damps most.

    ``stable_from`` and ``stable_to`` are None where the loop is still stable at the last of the multiples tried, -4 to 4.
    """

    def excess(factor: float) -> float:
        return float(np.abs(loop_poles(plant, controller, [factor])).max(initial=0.0)) - 1.0

    rows, here = loop_poles(plant, controller, FACTORS), int(np.flatnonzero(FACTORS == 1.0)[0])
    damping = np.array([least_damping(row, plant.dt) for row in rows])
    unstable = np.flatnonzero(np.abs(rows).max(axis=1, initial=0.0) >= 1.0)
    below, above = unstable[unstable < here], unstable[unstable > here]
    stable = slice(below[-1] + 1 if below.size else 0, above[0] if above.size else len(FACTORS))
    best = int(np.argmax(damping[stable])) + (stable.start or 0)
    return {
        "stable_from": float(brentq(excess, FACTORS[below[-1]], FACTORS[below[-1] + 1])) if below.size else None,
        "stable_to": float(brentq(excess, FACTORS[above[0] - 1], FACTORS[above[0]])) if above.size else None,
        "least_damping": float(damping[here]), "best_factor": float(FACTORS[best]), "best_damping": float(damping[best]),
    }  # fmt: skip
