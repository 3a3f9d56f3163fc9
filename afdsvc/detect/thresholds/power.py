"""Detection and isolation probabilities of a known wave in Gaussian noise.

Everything is a function of the deflection ``d``: the length of the wave measured in standard deviations of the noise,
``d^2 = sum s' Xi^-1 s``. Source: S. M. Kay, *Fundamentals of Statistical Signal Processing: Detection Theory* (1998),
chapters 4 and 7. (The thesis prints ``sqrt(D)`` where the deflection itself belongs; Monte Carlo agrees with Kay.)
"""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

from afdsvc.errors import BadInput


def tail(h: float) -> float:
    """Return ``Q(h)``, the probability that a standard normal exceeds h."""
    return float(ndtr(-h))


def tail_point(probability: float) -> float:
    """Return h with ``Q(h) = probability``; raises `BadInput` outside (0, 1)."""
    return -float(ndtri(_probability(probability)))


def detection_probability(false_alarm: float, deflection: float) -> float:
    """Return ``P_D = Q(Q^-1(P_FA) - d)``: a wave of known shape and sign, the Neyman-Pearson bound."""
    return tail(tail_point(false_alarm) - deflection)


def required_deflection(false_alarm: float, detection: float) -> float:
    """Return the deflection at which a known wave is detected with probability ``detection``."""
    return tail_point(false_alarm) - tail_point(detection)


def pair_confusion(separation: float) -> float:
    """Return the probability that the nearer of two hypotheses ``separation`` standard deviations apart is the wrong
    one.
    """
    return tail(separation / 2)


def weight_reached(separation: float, weight: float) -> float:
    """Return the probability that the right one of two equally likely hypotheses gets at least ``weight``.

    The log-likelihood ratio of the right one is N(s^2/2, s^2), and a posterior weight w is a ratio of ``ln(w / (1 -
    w))``.
    """
    if separation <= 0:
        return 0.0
    return tail((_log_odds(weight) - separation**2 / 2) / separation)


def required_separation(weight: float, probability: float) -> float:
    """Return the separation at which the right hypothesis gets ``weight`` with the given probability."""
    return float(brentq(lambda s: weight_reached(s, weight) - _probability(probability), 1e-6, 100.0))


def _log_odds(weight: float) -> float:
    if not 0.5 < weight < 1:
        raise BadInput(f"weight {weight}; expected a number between 0.5 and 1")
    return math.log(weight / (1 - weight))


def _probability(value: float) -> float:
    if not (0 < value < 1 and np.isfinite(value)):
        raise BadInput(f"probability {value}; expected a number between 0 and 1")
    return value
