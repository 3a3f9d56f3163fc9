"""What in the residual is noise: its floor and colour without trusting the model, and the predictor gain it asks for.

With a repeating excitation, what does not repeat is noise, whatever the model is worth. Without, the residual itself has to
serve and every significance is judged against it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from afdsvc.dataset.experiment import Run
from afdsvc.dataset.periods import fold, running_median
from afdsvc.errors import IllConditioned
from afdsvc.explain.nominal import Nominal
from afdsvc.lti.riccati import kalman_predictor_gain
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.stats.ar_noise import Whitener, fit, white, whiteness_p

RATIOS = (0.0, *(10.0**k for k in range(-7, 5)))


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """The noise: its whitener, whether it was measured apart from the model (``known``), and samples it rests on.

    ``sd (p,)`` is its standard deviation per output before whitening; ``p_white`` the p-value of its whiteness.
    """

    whitener: Whitener
    known: bool
    sd: Array
    p_white: float
    samples: int


def wandering(runs: Sequence[Run], residuals: Sequence[Array]) -> list[Array]:
    """Return the part of each period that does not repeat, ``(period, p)`` each, scaled to the variance of the noise.

    Empty when no run holds two settled periods without gaps.
    """
    pieces: list[Array] = []
    for run, e in zip(runs, residuals, strict=True):
        folded = fold(run, e)
        if folded is None:
            continue
        count = folded.shape[0]
        pieces += list((folded - folded.mean(0)) * np.sqrt(count / (count - 1)))
    return pieces


def floor(runs: Sequence[Run], residuals: Sequence[Array]) -> Floor:
    """Return the noise floor from what does not repeat, or from the residual itself."""
    pieces = wandering(runs, residuals)
    known = bool(pieces)
    if not known:
        pieces = [np.nan_to_num(e) for e in residuals]
    everything = np.vstack(pieces)
    p_white = whiteness_p([x - x.mean(0) for x in pieces])
    if known and p_white > 1e-4:
        cov = np.cov(everything.T).reshape(everything.shape[1], -1)
        whitener = white(cov)
    elif known:
        whitener = fit(toneless(pieces))
    else:
        whitener = white(positive((everything**2).mean(0)))
    return Floor(whitener, known, np.sqrt(positive(everything.var(0))), p_white, len(everything))


def positive(variance: Array) -> Array:
    return np.maximum(variance, 1e-24 * max(float(variance.max(initial=0.0)), 1e-200))


def toneless(pieces: Sequence[Array]) -> list[Array]:
    """Return the pieces with lines that tower over their neighbourhood pulled down to it, so they do not colour the floor."""
    return [_without_tones(x) for x in pieces]


def _without_tones(x: Array) -> Array:
    spectrum = np.fft.rfft(x, axis=0)
    size = np.abs(spectrum)
    around = running_median(size, 51)
    tall = size > 6 * around
    spectrum[tall] *= (around / np.maximum(size, 1e-300))[tall]
    return np.asarray(np.fft.irfft(spectrum, len(x), axis=0))


def predictor_gain(plant: StateSpace, nominal: Nominal, ratio: float, sizes: Array, drive: Array) -> Array | None:
    """Return the gain ``Kp (n, p)`` for process noise ``ratio`` times the input's power and output noise ``sizes**2``.

    None when the Riccati equation has no stabilising solution.
    """
    s = nominal.steps(np.zeros(len(nominal.entries)))
    a, b = np.linalg.matrix_power(s.phi, s.nsub), s.gam
    for _ in range(s.nsub - 1):
        b = s.phi @ b + s.gam
    n, p = plant.order, plant.outputs
    if ratio == 0.0 and np.abs(np.linalg.eigvals(a)).max(initial=0.0) < 1 - 1e-9:
        return np.zeros((n, p))
    spread = b * drive[None, :]
    Q = ratio * (spread @ spread.T) + 1e-12 * np.diag(np.maximum(np.diag(spread @ spread.T), 1e-30))
    try:
        return -kalman_predictor_gain(StateSpace(a, b, plant.C, plant.D, nominal.dt), Q, np.diag(sizes**2))
    except IllConditioned:
        return None
