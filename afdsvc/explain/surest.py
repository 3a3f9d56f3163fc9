"""Refitting where the model limits: with the correction of the states that leaves the parameters surest.

Names are found with the weakest correction that keeps a simulation from drifting away. What is wrong at the lowest frequencies
then outweighs everything else, and a fit moves the constants to please it. How sure parameters are under a weighting, the
correlation of the residual included, is told by the sandwich covariance (H. White, "Maximum likelihood estimation of
misspecified models", Econometrica 50, 1982; with the kernel of W. K. Newey and K. D. West, Econometrica 55, 1987). Of all
corrections whose parameters are about as sure as any other's, the weakest is taken: it is nearest to a simulation, which is
what the improved model is for.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import fftconvolve

from afdsvc.explain.baseline import Baseline, corrected, power
from afdsvc.explain.noise import RATIOS
from afdsvc.explain.objective import slope
from afdsvc.lti.statespace import Array

AS_SURE = 1.1  # ratio of standard deviations, in the geometric mean, that counts as equally sure
WORSE = 2  # corrections in a row that are less sure than the best before the search stops
LAGS = 2.0  # correlation times of the residual that the covariance looks over
SHORTEST = 20  # of a run that those lags may be at most


def surest(base: Baseline) -> Baseline:
    """Return the baseline refitted under the surest correction; itself where noise limits or nothing was named."""
    if base.limited != "model" or not base.point.effects:
        return base
    lags = max(int(min(LAGS * base.memory, min(len(r) for r in base.objective.runs) / SHORTEST)), 1)
    tried = [(_spread(base, lags), base)]
    for ratio in RATIOS[RATIOS.index(base.ratio) + 1 :]:
        found = corrected(base, ratio)
        if found is None or power(found) > power(base):  # a sensor that folds its readings sends the correction the wrong way
            continue
        tried.append((_spread(found, lags), found))
        if len(tried) - 1 - int(np.argmin([s for s, _ in tried])) >= WORSE:
            break
    least = min(s for s, _ in tried)
    return next(b for s, b in tried if s <= least + np.log(AS_SURE))


def _spread(base: Baseline, lags: int) -> float:
    """Return the mean logarithm of the standard deviations of constants and of the effects' own parameters."""
    t = slope(base.objective, base.point)
    k, states = len(base.point.theta), sum(len(x) for x in base.point.x0)
    own = [c.free and not c.nuisance for e in base.point.effects for c in e.hypothesis.parameters]
    chosen = np.array([*[True] * k, *[False] * states, *own]) & (np.abs(t.scales) > 0)
    used = np.abs(t.scales) > 0
    bread = np.linalg.inv(t.J[:, used].T @ t.J[:, used] + np.diag(t.weight[used] ** 2))
    meat = _long_run(t.J[:, used] * t.full[: len(t.J), None], lags * base.nominal.plant.outputs) + np.diag(t.weight[used] ** 2)
    sandwich = (bread @ meat @ bread)[np.ix_(chosen[used], chosen[used])] * np.outer(t.scales[chosen], t.scales[chosen])
    sign, size = np.linalg.slogdet(sandwich)
    return float(0.5 * size / max(int(chosen.sum()), 1)) if sign > 0 and np.isfinite(size) else np.inf


def _long_run(g: Array, lags: int) -> Array:
    """Return the covariance of the sum of the rows, correlated over ``lags`` rows: Bartlett's kernel as two running means."""
    smooth = fftconvolve(g, np.full((lags, 1), 1 / np.sqrt(lags)), axes=0)
    return np.asarray(smooth.T @ smooth)
