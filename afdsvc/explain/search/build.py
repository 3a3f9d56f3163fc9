"""From a model and recordings to a problem: way of simulating, horizons, scales, initial states."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.linalg as sla

from afdsvc.dataset.experiment import Run
from afdsvc.dataset.screening import LARGEST
from afdsvc.explain.noise.weighting import even
from afdsvc.explain.search.fit import fit
from afdsvc.explain.search.problem import Point, Problem, loads, loop_known
from afdsvc.explain.settings import Settings
from afdsvc.explain.simulate.nominal import Nominal
from afdsvc.explain.simulate.predictor import correction_gain
from afdsvc.lti.statespace import Array

STRONG = 0.3  # predictor of the trajectories that scales are taken from
WINDOW = 0.02  # of a run, from which its initial state is guessed, and the least number of samples
LEAST_WINDOW = 20
STEPS = 5  # towards the initial state, and the shares of each that are tried
SHARES = (1.0, 0.3, 0.1, 0.03)


def build(nominal: Nominal, runs: Sequence[Run], settings: Settings, heldout: Sequence[Run] = ()) -> Problem:
    """Return the problem of explaining ``runs`` with the model; ``heldout`` must be simulated in the same way."""
    scale = _positive(np.sqrt(np.mean([np.nanvar(r.Y, axis=0) for r in runs], axis=0)))
    force = _force(nominal, runs, scale)
    theta = np.zeros(len(nominal.entries))
    gains = {h: correction_gain(nominal, theta, (force, scale), h) for h in (*settings.horizons, STRONG)}
    n = nominal.plant.order
    problem = Problem(nominal, tuple(runs), scale, np.ones(n), tuple(np.zeros(n) for _ in runs), gains, even(len(scale)), settings)
    states = np.vstack([s.x for s in problem.simulated(problem.start(), STRONG)])
    problem = replace(problem, state_scale=_positive(np.sqrt(np.mean(np.minimum(np.abs(states), LARGEST) ** 2, axis=0))))
    regular = not n or growth(nominal) < 1 - 1e-9  # it forgets its initial state, and can be simulated from its inputs alone
    problem = replace(problem, offset_free=regular, regular=regular, loads=() if regular else loads(nominal, force, settings.load_sd))
    if all(r.W is not None for r in heldout) and _follows_in_loop(problem):
        problem = replace(problem, closed=True, regular=True, settings=replace(settings, horizons=(0.0,)))
    return replace(problem, x0=tuple(initial(problem, k) for k in range(len(runs))))


def _positive(x: Array) -> Array:
    return np.asarray(np.where(x > 0, x, 1.0))


def _force(nominal: Nominal, runs: Sequence[Run], scale: Array) -> Array:
    """Return the rms of what the inputs do to the rate of every state, ``(n,)``: where forces act, and how large they are. Of a machine that nothing
    drives it is that of its free motion with outputs of this ``scale``, by its Gramian."""
    A, B, C = nominal.plant.A, nominal.plant.B, nominal.plant.C
    rms = np.sqrt(np.mean(np.vstack([r.U for r in runs]) ** 2, axis=0))
    force = np.sqrt((B * rms) ** 2 @ np.ones(B.shape[1]))
    if force.any():
        return np.asarray(force)
    with np.errstate(invalid="ignore"), warnings.catch_warnings(action="ignore"):
        P = sla.solve_continuous_lyapunov(A, -np.eye(len(A)))
        free = np.sqrt(np.diag(A @ P @ A.T)) * np.max(scale / np.sqrt(np.diag(C @ P @ C.T)))
    return np.asarray(free if not nominal.plant.discrete and np.isfinite(free).all() and free.any() else np.ones(len(B)))


def growth(nominal: Nominal) -> float:
    """Return the factor by which the plant's slowest or fastest growing motion changes in a sample."""
    s = nominal.steps(np.zeros(len(nominal.entries)))
    with np.errstate(all="ignore"):
        whole = np.linalg.matrix_power(s.phi, s.nsub)
    return float(np.abs(np.linalg.eigvals(whole)).max(initial=0.0)) if np.isfinite(whole).all() else np.inf


def _follows_in_loop(problem: Problem) -> bool:
    """Whether the loop can be closed around the model with the stated controller, and follows the recordings better than their mean and than from
    the inputs, where feedback puts what disturbs the outputs (Forssell and Ljung, Automatica 35, 1999); a stable plant also when both are refitted."""
    if not loop_known(problem):
        return False
    ways = replace(problem, closed=True), problem
    loop, inputs = (float(np.mean(np.vstack(p.residuals(p.start(), 0.0)) ** 2)) for p in ways)
    if problem.regular and loop < min(1.0, inputs):  # deviances are negative where the mean is worse
        loop, inputs = (fit(p, p.start(), 0.0, 1.0).deviance for p in (p.beginning() for p in ways))
    return loop < min(1.0, inputs)


def initial(problem: Problem, k: int) -> Array:
    """Return the initial state of run ``k`` that fits its first samples, held to the size of the states by a weak prior.

    Damped Gauss-Newton, from zero or from the smallest state with the first reading, whichever fits better.
    """
    run, n, unit = problem.runs[k], problem.nominal.plant.order, problem.state_scale
    part = run.span(0, min(len(run), max(LEAST_WINDOW, 3 * n, int(WINDOW * len(run)))))
    alone = problem.of([part], [np.zeros(n)])

    def residual(x0: Array) -> Array:
        point = Point(np.zeros(len(problem.nominal.entries)), (x0,), np.zeros(len(problem.scale)))
        return alone.residuals(point, 0.0)[0].ravel()

    def misfit(x0: Array) -> float:
        return float(np.linalg.norm(residual(x0)))

    if not n:
        return np.zeros(0)
    x = min(np.zeros(n), alone.resting()[0], key=misfit)
    for _ in range(STEPS):
        e = residual(x)
        J = np.column_stack([(residual(x + 1e-3 * unit * row) - e) / 1e-3 for row in np.eye(n)])
        J[~np.isfinite(J)] = 0.0
        ridge = 1e-4 * len(e) / n * np.eye(n)
        step = unit * np.linalg.solve(J.T @ J + ridge, -J.T @ e - ridge @ (x / unit))
        share = next((s for s in SHARES if misfit(x + s * step) <= np.linalg.norm(e)), 0.0)
        if not share:
            break
        x = x + share * step
    return np.asarray(x)
