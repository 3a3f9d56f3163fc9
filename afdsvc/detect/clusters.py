"""Alarms per hour of a sliding window.

Neighbouring windows share their samples, so exceedances come in clusters and "probability per sample times samples"
counts each alarm many times. For a window of N samples whose template moves with the excitation, one alarm is one
cluster and

    rate = (h / N) phi(h) nu(h sqrt(2 / N)) P_set(h) / Q(h)     per sample

with Siegmund's function nu for the discreteness of time (D. Siegmund, *Sequential Analysis*, 1985, chapter IV).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import brentq

from afdsvc.detect.thresholds.maximum import tests_counted
from afdsvc.detect.thresholds.power import tail
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array

SINGLE = np.ones((1, 1))


def siegmund(x: float) -> float:
    """Return Siegmund's function nu(x), 1 at 0 and falling like ``exp(-0.583 x)`` at first."""
    if x < 1e-8:
        return 1.0
    half = x / 2
    Phi, phi = 1 - tail(half), math.exp(-(half**2) / 2) / math.sqrt(2 * math.pi)
    return (2 / x) * (Phi - 0.5) / (half * Phi + phi)


def alarm_rate(h: float, window: int, directions: Array = SINGLE) -> float:
    """Return alarms per sample of ``max_k`` over a sliding window of ``window`` samples against the threshold h > 0."""
    if window < 1 or not h > 0:
        raise BadInput(f"threshold {h} over {window} samples; expected a positive threshold and at least one sample")
    phi = math.exp(-(h**2) / 2) / math.sqrt(2 * math.pi)
    return (h / window) * phi * siegmund(h * math.sqrt(2 / window)) * tests_counted(directions, h)


def cluster_threshold(alarms_per_sample: float, window: int, directions: Array = SINGLE) -> float:
    """Return h at which a sliding window raises ``alarms_per_sample`` (alarms per hour times sample time / 3600)."""
    if not 0 < alarms_per_sample < alarm_rate(1.0, window, directions):
        raise BadInput(f"alarm rate {alarms_per_sample} per sample; expected below one alarm per window and above 0")
    goal = math.log(alarms_per_sample)
    return float(brentq(lambda h: math.log(alarm_rate(h, window, directions)) - goal, 1.0, 37.0, xtol=1e-9))
