"""Run lengths of the CUSUM test on a Gaussian log-likelihood ratio, exactly.

The increments are ``N(-mu^2/2, mu^2)`` without and ``N(+mu^2/2, mu^2)`` with the change; ``mu`` is the deflection
gained per sample (root mean square when it varies). The CUSUM starts at 0, is reflected there and alarms above ``b``.
Its average run length is ``N / R``: the mean length N of the sequential test between 0 and b over the probability R
that this test ends above b, both from one integral equation (E. S. Page, *Biometrika* 41, 1954) solved with
Gauss-Legendre nodes. N and R solve well-conditioned equations, so run lengths of years lose no digits.

When mu is so small that the kernel is needle-thin (b > 150 mu), several samples are taken together and the boundary
moved by Siegmund's 1.166 mu, which is accurate to O(mu^2) there.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array

OVERSHOOT = 1.1657  # twice the mean overshoot of a standard normal random walk, 0.58286
LONGEST = 700.0  # of a run length, its logarithm: a float holds e^709
_STEP = 0.2
_FINEST = 150.0  # largest b / mu given to the integral equation


def run_length(mu: float, b: float, changed: bool = False, bias: float = 0.0, step: float | None = None) -> float:
    """Return the average run length in samples, before (``changed`` False) or from the change, started at 0.

    ``bias`` is added to the mean of every increment: what a wrong model does to it. ``step`` is the mean step at the
    ends of an excursion where steps are uneven: then the boundary is moved by Siegmund's 1.166 step.
    """
    _check(mu, b)
    drift = _drift(mu, changed) + bias
    if step is not None:
        return _diffusion(mu, b + OVERSHOOT * step, drift)
    if b > _FINEST * mu:
        return _diffusion(mu, b + OVERSHOOT * mu, drift)
    x, w, kernel = _grid(mu, b, drift)
    both = np.linalg.solve(np.eye(len(x)) - kernel, np.column_stack([np.ones(len(x)), _over(x, mu, b, drift)]))
    steps, over = (w * _density(x, mu, drift)) @ both
    N, R = 1 + float(steps), float(_over(np.zeros(1), mu, b, drift)[0]) + float(over)
    return N / R


def boundary(mu: float, samples: float) -> float:
    """Return b with an average run length of ``samples`` before the change; raises `BadInput` below two samples."""
    _check(mu, 1.0)
    shortest = 2 * run_length(mu, 1e-9)
    if not samples > shortest:
        raise BadInput(f"run length of {samples:.3g} samples; expected one above {shortest:.3g}")
    goal = math.log(samples)
    return float(brentq(lambda b: math.log(run_length(mu, b)) - goal, 1e-9, goal + 1, xtol=1e-7))  # ARL >= e^b


def alarm_probability(mu: float, b: float, samples: int, changed: bool = False, bias: float = 0.0) -> float:
    """Return the probability of an alarm within ``samples`` samples of the start at 0; ``bias`` as in `run_length`.

    Steps smaller than 0.2 are taken several at a time, the boundary moved as above.
    """
    _check(mu, b)
    wide = max(mu, _STEP, b / 300)
    lump = (wide / mu) ** 2
    width, drift = max(b + OVERSHOOT * (mu - wide), 1e-6), (_drift(mu, changed) + bias) * lump
    x, w, kernel = _grid(wide, width, drift)
    n = len(x)
    walk = np.zeros((n + 1, n + 1))  # state 0 is the atom at zero; alarms leave
    walk[1:, 1:], walk[1:, 0] = kernel, _under(x, wide, drift)
    walk[0, 1:], walk[0, 0] = _density(x, wide, drift) * w, _under(np.zeros(1), wide, drift)[0]
    return float(1 - np.linalg.matrix_power(walk, max(1, round(samples / lump)))[0].sum())


def burst_boundary(mu: float, samples: int, false_alarm: float) -> float:
    """Return b at which a CUSUM started at 0 alarms within ``samples`` samples with probability ``false_alarm``."""
    if not 0 < false_alarm < 0.5:
        raise BadInput(f"false-alarm probability {false_alarm}; expected a number between 0 and 0.5")
    high, low = math.log(samples / false_alarm) + 1e-3, 1e-3 * mu  # P(alarm) <= samples e^-b
    if alarm_probability(mu, low, samples) <= false_alarm:
        return low
    return float(brentq(lambda b: math.log(alarm_probability(mu, b, samples) / false_alarm), low, high, xtol=1e-4))


def _drift(mu: float, changed: bool) -> float:
    return (1 if changed else -1) * mu**2 / 2


def _grid(mu: float, b: float, drift: float) -> tuple[Array, Array, Array]:
    n = 24 + math.ceil(1.6 * b / mu)  # one node per standard deviation is already spectrally accurate
    x, w = np.polynomial.legendre.leggauss(n)
    x, w = 0.5 * b * (x + 1), 0.5 * b * w
    return x, w, _density(x[None, :] - x[:, None], mu, drift) * w[None, :]


def _density(x: Array, mu: float, drift: float) -> Array:
    return np.asarray(np.exp(-0.5 * ((x - drift) / mu) ** 2) / (mu * math.sqrt(2 * math.pi)))


def _over(x: Array, mu: float, b: float, drift: float) -> Array:
    return np.asarray(ndtr((x - b + drift) / mu))


def _under(x: Array, mu: float, drift: float) -> Array:
    return np.asarray(ndtr((-x - drift) / mu))


def _diffusion(mu: float, b: float, drift: float) -> float:
    """Return the run length of the reflected Brownian motion: the small-step limit; infinite where no float holds it."""
    k = 2 * drift / mu**2
    if -k * b > LONGEST:
        return math.inf
    if abs(k * b) < 1e-6:
        return (b / mu) ** 2
    return 2 / mu**2 * (math.exp(-k * b) + k * b - 1) / k**2


def _check(mu: float, b: float) -> None:
    if not (mu > 0 and b > 0 and math.isfinite(mu) and math.isfinite(b)):
        raise BadInput(f"deflection per sample {mu} and boundary {b}; expected two positive numbers")
