"""After a search: the next experiment for the look-alikes it left, or for a machine that was hardly excited."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from afdsvc.api.bursts import Limits
from afdsvc.dataset.experiment import Run, sampled
from afdsvc.excite.identification_bursts import Band, multisine_burst
from afdsvc.explain.check_information import noise_sd
from afdsvc.explain.check_lines import response
from afdsvc.explain.forward import Found, Step
from afdsvc.explain.next_experiment import Contender, NextExperiment, next_experiment
from afdsvc.explain.nominal import Nominal
from afdsvc.lti.statespace import Array

DOUBT = 0.02  # weight from which a look-alike has to be told from the first
LOUD = 10.0  # rms of the outputs over the noise that an experiment should reach
SECONDS, PERIODS = 0.5, 5
REACH = 3.0  # upper edge over the model's fastest pole


def experiment_after(found: Found, limits: Limits | None = None) -> NextExperiment | None:
    """Return the burst that tells the look-alikes of the most doubtful effect apart; None when no name is in doubt."""
    doubtful = [(_doubt(s), s) for s in found.steps if _doubt(s) >= DOUBT]
    if not doubtful:
        return None
    _, step = max(doubtful, key=lambda pair: pair[0])
    rivals = [r for r in step.ruling.rivals if r.weight >= DOUBT or r is step.ruling.rivals[0]]
    return next_experiment(found.start, [Contender(r.candidate.key, r.candidate.point) for r in rivals], limits)


def _doubt(step: Step) -> float:
    return max((r.weight for r in step.ruling.rivals[1:]), default=0.0)


def first_experiment(nominal: Nominal, runs: Sequence[Run], limits: Limits | None = None) -> NextExperiment:
    """Return a burst that would excite a machine that was not: all inputs, outputs ten times as loud as their noise."""
    dt, m = nominal.dt, nominal.plant.inputs
    fastest = float(np.abs(_continuous_poles(nominal)).max(initial=0.2 / dt)) / (2 * np.pi)
    low, high = 1 / SECONDS, float(np.clip(REACH * fastest, 40 / SECONDS, 0.4 / dt))
    shape = multisine_burst(
        Band(low, max(high, 2 * low), np.ones(m), dt), SECONDS * PERIODS, np.random.default_rng(1), "odd_random", PERIODS, "first_experiment"
    )
    angles = np.array([line.omega * dt for line in shape.lines])
    T = _from_alpha(nominal, angles)
    columns = np.abs(T[np.arange(len(angles)), :, [line.input for line in shape.lines]])
    power = sum((columns[k] * shape.lines[k].amplitude) ** 2 / 2 for k in range(len(angles)))
    level = LOUD / float((np.sqrt(power) / noise_sd(nominal, runs)).max())
    if limits is not None:
        level = min(level, float(np.min(limits.alpha)))
    burst = type(shape)(
        shape.name, m, shape.samples, shape.ramp, tuple(type(x)(x.input, x.omega, x.amplitude * level, x.phase) for x in shape.lines),
        settle=shape.settle, purpose="explain", notes=dict(shape.notes),
    )
    names = " and ".join(v.name for v in nominal.model.inputs)
    text = (
        f"to excite the machine: an odd multisine with detection lines on input {names} from {low:.4g} to {high:.4g} Hz, peak {level:.4g} "
        f"{nominal.model.inputs[0].unit}, {PERIODS} periods of {SECONDS:g} s, and the same at half the level"
    )
    return NextExperiment(text, burst, 0.0, 0.0, 1.0, (low, high))


def _continuous_poles(nominal: Nominal) -> Array:
    poles = nominal.plant.poles()
    if nominal.plant.discrete:
        return np.abs(np.log(np.where(np.abs(poles) > 1e-6, poles, 1e-6)) / nominal.dt)
    return np.abs(poles)


def _from_alpha(nominal: Nominal, angle: Array) -> np.ndarray:
    """Return the response of the outputs to alpha ``(L, p, m)``: G (1 - K G)^-1 with the controller where it is known."""
    G = response(nominal, np.zeros(len(nominal.entries)), angle)
    K = None if nominal.model.controller is None else sampled(nominal.model.controller, nominal.dt)
    if K is None:
        return G
    z = np.exp(1j * angle)
    inner = K.D + K.C @ np.linalg.solve(z[:, None, None] * np.eye(K.order) - K.A, np.repeat(K.B[None], len(z), 0)) if K.order else K.D
    return np.asarray(G @ np.linalg.inv(np.eye(G.shape[2]) - inner @ G))
