"""How much is left to gain: a free-form model of the residual, judged on recordings it was not fitted to.

The residual is regressed on smooth functions of inputs and predicted states, let in as forces (through the nominal plant) and
directly at the outputs. It names nothing and is no part of the improved model; it only says whether a law remains to be found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from afdsvc.dataset.experiment import Run
from afdsvc.explain.baseline import Baseline
from afdsvc.explain.explanation import Remainder
from afdsvc.explain.objective import Objective
from afdsvc.explain.settle import raw, started
from afdsvc.explain.simulator import Effect
from afdsvc.lti.statespace import Array

RIDGE = 1e-3  # of the mean power of the features, times the number of samples
WORTH_MODELLING = 0.05


def remainder(base: Baseline, select: Sequence[Run], closed: float) -> Remainder:
    """Return what is left after the fraction ``closed`` of the gap, and the part of it a free-form model would predict."""
    gain = free_gain(base, select)
    left = float(np.clip(1 - closed, 0.0, 1.0))
    said = f"{100 * left:.0f} % of the gap is left; a free-form model of the residual would predict {100 * gain:.0f} % of the residual's power"
    more = "so a law remains to be found" if gain > WORTH_MODELLING else "so little would be gained by one more smooth law of inputs and motion"
    return Remainder(left, gain, f"{said}, {more}")


def free_gain(base: Baseline, select: Sequence[Run]) -> float:
    """Return the part of the residual's power on the selection runs that a free-form model fitted to the training runs predicts."""
    if not select:
        return 0.0
    objective, point = base.objective, base.point
    held = replace(objective, runs=tuple(select))
    there = started(held, point)
    fitted = [_features(objective, r, x, point.theta, point.effects) for r, x in zip(objective.runs, point.x0, strict=True)]
    sizes = np.sqrt(np.mean([np.mean(f**2, axis=(0, 1)) for f in fitted], axis=0)) + 1e-300
    sd = np.sqrt(np.mean([(e**2).mean(0) for e in raw(objective, point)], axis=0)) + 1e-300
    X = np.vstack([(f / sizes).reshape(-1, f.shape[2]) for f in fitted])
    target = np.concatenate([(e / sd).ravel() for e in raw(objective, point)])
    weights = np.linalg.solve(X.T @ X + RIDGE * len(X) * np.eye(X.shape[1]), X.T @ target)
    before = after = 0.0
    for run, x, e in zip(held.runs, there.x0, raw(held, there), strict=True):
        f = _features(held, run, x, point.theta, point.effects) / sizes
        rest = e / sd - f @ weights
        before, after = before + float((e / sd).ravel() @ (e / sd).ravel()), after + float((rest**2).sum())
    return float(np.clip(1 - after / max(before, 1e-300), 0.0, 1.0))


def _features(objective: Objective, run: Run, x0: Array, theta: Array, effects: Sequence[Effect]) -> Array:
    """Return the features of a run, shape ``(n, p, count)``."""
    simulator = objective.simulator
    s = simulator.run(run, theta, x0, effects)
    signals = np.hstack([run.U, s.x])
    scaled = signals / (np.sqrt((signals**2).mean(0)) + 1e-300)
    shapes = np.hstack([scaled, scaled**2, scaled**3, np.abs(scaled), scaled * np.abs(scaled), np.tanh(4 * scaled)])
    shapes = np.clip(np.hstack([shapes, np.ones((len(run), 1))]), -50.0, 50.0)
    p = run.Y.shape[1]
    direct = np.concatenate([shapes[:, None, :] * (np.arange(p) == j)[None, :, None] for j in range(p)], axis=2)
    return np.concatenate([direct, _through(objective, theta, shapes, len(run))], axis=2)


def _through(objective: Objective, theta: Array, shapes: Array, n: int) -> Array:
    """Return every shape as a force on every driven state, seen at the outputs: ``(n, p, shapes x states)``."""
    nominal = objective.simulator.nominal
    steps = nominal.steps(theta)
    C = nominal.at(theta).C
    A = np.linalg.matrix_power(steps.phi, steps.nsub) - objective.simulator.gain @ C
    rates = [i for i, v in enumerate(nominal.model.states) if v.rate_of] or list(range(len(A)))
    if np.abs(np.linalg.eigvals(A)).max(initial=0.0) > 1 - 1e-6:
        return np.zeros((n, C.shape[0], 0))
    padded = 2 * n
    z = np.exp(2j * np.pi * np.arange(n + 1) / padded)
    G = C @ np.linalg.solve(z[:, None, None] * np.eye(len(A)) - A, np.broadcast_to(steps.gx[:, rates], (n + 1, len(A), len(rates))))
    spectra = np.fft.rfft(shapes, padded, axis=0)
    columns = [np.fft.irfft(G[:, :, [k]] * spectra[:, None, :], padded, axis=0)[:n] for k in range(len(rates))]
    return np.asarray(np.concatenate(columns, axis=2))
