"""Measured against simulated, output by output, by the model as it is stated: nothing is fitted but where each recording starts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import correlate

from afdsvc.explain.search.problem import Problem
from afdsvc.lti.statespace import Array

SHARE = 0.1  # of the shortest recording, by which measured and simulated are shifted against each other at most
CORRELATED = 0.5  # correlation that they have then at least
BETTER = 0.02  # of the correlation, by which a shift must improve it to be reported


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """One output of the model beside its recordings, both about their means.

    ``t (n,)`` s, ``measured (n,)`` and ``simulated (n,)`` are those of the first recording, ``offset`` is what was taken off between them.
    ``r2`` is the coefficient of determination over all recordings, ``gain`` the factor that fits the simulation to what was measured
    best, ``delay`` [s] by how much the measured output comes later. ``how`` says what the simulation is driven by.
    """

    output: str
    unit: str
    t: Array
    measured: Array
    simulated: Array
    offset: float
    r2: float
    gain: float
    delay: float
    how: str


def compared(problem: Problem) -> tuple[Compared, ...]:
    """Return the comparison of every output."""
    horizon = 0.0 if problem.regular else [h for h in problem.settings.horizons if h > 0][-1]
    loop = "simulated in its loop, from what was added to the controller's output"
    how = loop if problem.closed else "simulated from the inputs" if horizon == 0.0 else "predicted: the model does not forget its start and is corrected by the outputs"
    simulated = [s.y for s in problem.simulated(problem.start(), horizon)]
    return tuple(_output(problem, simulated, j, how) for j in range(len(problem.scale)))


def _output(problem: Problem, simulated: list[Array], j: int, how: str) -> Compared:
    pairs = [_about_means(r.Y[:, j], s[:, j]) for r, s in zip(problem.runs, simulated, strict=True)]
    y, s = (np.concatenate(parts) for parts in zip(*((a, b) for a, b, _ in pairs), strict=True))
    seen = np.isfinite(y)
    power = max(float(y[seen] @ y[seen]), 1e-300)
    r2 = 1 - float(((y - s)[seen] ** 2).sum()) / power
    gain = float(y[seen] @ s[seen]) / max(float(s[seen] @ s[seen]), 1e-300)
    first, variable = problem.runs[0], problem.nominal.model.outputs[j]
    measured, drawn, offset = pairs[0]
    t = first.t0 + first.dt * np.arange(len(first), dtype=np.float64)
    delay = _delay([(a, b) for a, b, _ in pairs]) * first.dt if how.startswith("simulated") else 0.0
    return Compared(variable.name, variable.unit, t, measured, drawn, offset, r2, gain, delay, how)


def _about_means(measured: Array, simulated: Array) -> tuple[Array, Array, float]:
    simulated = np.nan_to_num(np.clip(simulated, -1e100, 1e100))
    offset = float(np.nanmean(measured) - simulated.mean())
    return measured - np.nanmean(measured), simulated - simulated.mean(), offset


def _delay(pairs: list[tuple[Array, Array]]) -> int:
    """Return the shift in samples at which measured and simulated resemble each other most, 0 where none is clearly better or they never do."""
    most = int(SHARE * min(len(y) for y, _ in pairs))
    found = np.abs(sum(correlate(np.nan_to_num(y), s, method="fft")[len(s) - 1 - most : len(s) + most] for y, s in pairs))
    size = np.sqrt(sum(float(np.nansum(y**2)) for y, _ in pairs) * sum(float(s @ s) for _, s in pairs))
    best = int(np.argmax(found))
    return best - most if found[best] > max(CORRELATED * size, found[most] + BETTER * size) else 0
