"""The machine's motion as the excitation makes it: signals to ask what a residual depends on, with no noise fed back in them.

A controller feeds noise back into the inputs, so inputs, predicted states and outputs carry the noise of the past, and with a
residual that is not perfectly white anything would seem to depend on them. With a known controller the nominal loop is
played closed from what was added to it; with an excitation that repeats, periods are averaged; otherwise predictions from the
past have to serve, which is right as far as the residual is white.
"""

from __future__ import annotations

import numpy as np

from afdsvc.dataset.experiment import Run
from afdsvc.dataset.periods import fold
from afdsvc.explain.objective import Point
from afdsvc.explain.simulator import Simulated, Simulator
from afdsvc.lti.statespace import Array

LIKE = 0.5  # how far the played loop may be from the measured inputs (power of the difference over their power) to stand for them
STEADY = 0.3  # scatter of the inputs between periods, over their power, from which their mean period does not stand for them


def motion(simulator: Simulator, run: Run, point: Point, x0: Array) -> Simulated:
    """Return inputs, states and outputs of one run as free of noise as they can be had; zero where nothing was excited."""
    predicted = simulator.run(run, point.theta, x0, point.effects)
    if run.W is not None:
        played = simulator.run(run, point.theta, x0, point.effects, closed=True)
        if _stands_for(played.u, run.U):
            return played
        if _at_rest(run):
            return Simulated(*(np.zeros_like(a) for a in (predicted.y, predicted.u, predicted.x)))
    return _averaged(run, predicted)


def _stands_for(played: Array, measured: Array) -> bool:
    power = float((measured**2).sum())
    return bool(np.isfinite(played).all() and ((played - measured) ** 2).sum() < LIKE * power)


def _at_rest(run: Run) -> bool:
    """Whether nothing was added to the loop and no reference moved, so that the inputs are noise fed back."""
    if run.W is None or np.ptp(run.REF, axis=0).max(initial=0.0) > 0:
        return False
    added = run.W[len(run) // 4 :]
    return bool(added.std(0).max() < 0.05 * max(float(run.U.std(0).max()), 1e-300))


def _averaged(run: Run, predicted: Simulated) -> Simulated:
    """Return the mean period put end to end, where the inputs repeat well enough."""
    u = fold(run, predicted.u)
    if u is None or ((u - u.mean(0)) ** 2).sum() > STEADY * (u**2).sum():
        return predicted
    return Simulated(*(_tiled(run, a) for a in (predicted.y, predicted.u, predicted.x)))


def _tiled(run: Run, a: Array) -> Array:
    folded = fold(run, a)
    if folded is None:
        return a
    n, period = len(a), run.period
    count = n // period + 2
    whole = np.tile(folded.mean(0), (count, 1))
    return np.ascontiguousarray(whole[len(whole) - n :])
