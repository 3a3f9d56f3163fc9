"""Spectra of inputs and outputs where the excitation is, and the nominal frequency response there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from afdsvc.dataset.experiment import Run
from afdsvc.dataset.periods import fold
from afdsvc.explain.simulate.nominal import Nominal
from afdsvc.lti.statespace import Array

STRONG = 0.02  # amplitude over the strongest of the same input
MOST = 800
ComplexArray = np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class ExcitedLines:
    """Amplitudes at the excited lines of all runs: ``U (L, m)``, ``Y (L, p)`` complex, angle per sample ``angle (L,)`` rad,
    ``samples (L,)`` how many samples each amplitude rests on, and ``runs`` how many recordings they come from."""

    U: ComplexArray
    Y: ComplexArray
    angle: Array
    samples: Array
    runs: int


def lines(nominal: Nominal, runs: Sequence[Run]) -> ExcitedLines:
    """Return the lines of all runs; ordinary recordings count as one period under a Hann window."""
    pieces = [_of_run(r) for r in runs]
    U, Y, angle, samples = (np.concatenate(part) for part in zip(*pieces, strict=True))
    return ExcitedLines(U, Y, angle, samples, len(runs))


def _of_run(run: Run) -> tuple[ComplexArray, ComplexArray, Array, Array]:
    Y = _filled(run.Y)
    u, y = fold(run, run.U), fold(run, Y)
    if u is not None and y is not None:
        count, n = u.shape[:2]
        U, S = np.fft.rfft(u.mean(0), axis=0) * 2 / n, np.fft.rfft(y.mean(0), axis=0) * 2 / n
        worth = count * n
    else:
        n = worth = len(run)
        window = np.hanning(n)[:, None]
        U, S = (np.fft.rfft((x - x.mean(0)) * window, axis=0) * 4 / n for x in (run.U, Y))
    top = n // 2
    size = (np.abs(U[1:top]) / np.maximum(np.abs(U[1:top]).max(0), 1e-300)).max(1, initial=0.0)
    rows = np.flatnonzero(size > STRONG) + 1
    if len(rows) > MOST:
        rows = rows[np.linspace(0, len(rows) - 1, MOST).astype(int)]
    return U[rows], S[rows], 2 * np.pi * rows / n, np.full(len(rows), float(worth))


def _filled(Y: Array) -> Array:
    """Return the outputs with gaps bridged by straight lines."""
    if np.isfinite(Y).all():
        return Y
    out, t = Y.copy(), np.arange(len(Y))
    for j in range(Y.shape[1]):
        good = np.isfinite(Y[:, j])
        out[:, j] = np.interp(t, t[good], Y[good, j]) if good.any() else 0.0
    return out


def line_response(nominal: Nominal, theta: Array, angle: Array) -> ComplexArray:
    """Return the sampled nominal frequency response ``(L, p, m)``; a line on a pole gets a large finite value."""
    s = nominal.steps(theta)
    plant = nominal.at(theta)
    a, b = np.linalg.matrix_power(s.phi, s.nsub), s.gam
    for _ in range(s.nsub - 1):
        b = s.phi @ b + s.gam
    z = np.exp(1j * angle)
    if not plant.order:
        return np.repeat(plant.D[None].astype(complex), len(z), axis=0)
    return np.asarray(plant.C @ np.linalg.solve(z[:, None, None] * np.eye(len(a)) - a, np.repeat(b[None], len(z), 0)) + plant.D)
