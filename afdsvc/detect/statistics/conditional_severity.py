"""Severity of a fault given that it was detected: the normal law of its estimate, truncated at the threshold.

Sources: A. Cohen, H. Sackrowitz, "Two stage conditionally unbiased estimators of the selected mean", Statistics & Probability
Letters 8 (1989) 273-278; J. Lee, D. Sun, Y. Sun, J. Taylor, "Exact post-selection inference, with application to the lasso",
Annals of Statistics 44 (2016) 907-927, theorem 5.2.
"""

from __future__ import annotations

from dataclasses import replace

from scipy.optimize import brentq
from scipy.special import log_ndtr, ndtri

from afdsvc.api.evidence import Severity
from afdsvc.detect.isolation import Fit

HALF = 1.959964  # standard errors to each side of a 95 % interval
BIASED = 0.3  # of the standard error: linearisation errors up to which an interval for random errors alone has its coverage to a per cent
FAR = 6.0  # standard errors beyond the limit of detection from which on the detection says nothing


def log_truncated_cdf(estimate: float, severity: float, sd: float, cut: float) -> float:
    """Return the log of the distribution function of an estimate that is reported only below ``cut``.

    Parameters
    ----------
    estimate : float
        Where the function is evaluated, at most ``cut``.
    severity : float
        True severity, the mean before truncation.
    sd : float
        Standard deviation before truncation, positive.
    cut : float
        Estimate at which the statistic equals its threshold.

    Returns
    -------
    float
        ``log(Phi((estimate - severity) / sd) / Phi((cut - severity) / sd))``; it falls with ``severity``.
    """
    return float(log_ndtr((estimate - severity) / sd) - log_ndtr((cut - severity) / sd))


def severity_at(probability: float, estimate: float, sd: float, cut: float, bounds: tuple[float, float] = (-1.0, 0.0)) -> float:
    """Return the severity under which an estimate this low or lower has this probability, given detection.

    Probability 0.5 gives the median-unbiased estimate; 0.975 and 0.025 give the ends of the equal-tailed 95 % interval.

    Parameters
    ----------
    probability : float
        Between 0 and 1.
    estimate, sd, cut : float
        As in `log_truncated_cdf`.
    bounds : tuple of float
        Smallest and largest severity; a solution beyond them is moved to the nearer one.

    Returns
    -------
    float
        Severity, relative (0 healthy, -1 total loss).

    Examples
    --------
    >>> round(severity_at(0.5, -0.10, 0.02, -0.08), 4)
    -0.0937
    """
    low, high = bounds

    def excess(severity: float) -> float:
        return log_truncated_cdf(estimate, severity, sd, cut) - log_ndtr(ndtri(probability))

    if excess(low) <= 0:
        return low
    return high if excess(high) >= 0 else float(brentq(excess, low, high, xtol=1e-12))


def given_detection(fit: Fit, bounds: tuple[float, float]) -> Severity:
    """Return a detected fault's severity: median-unbiased and with a 95 % interval, both given the detection.

    Far from the limit of detection these are the plain estimate, its standard error and 1.96 of them to both sides. No interval is given
    where the error of a linearisation counts: it is not a random number.
    """
    found = _given_detection(fit, bounds)
    return found if fit.bias < BIASED * fit.sd else replace(found, low=None, high=None)


def _given_detection(fit: Fit, bounds: tuple[float, float]) -> Severity:
    x, sd, (low, high) = fit.severity, fit.sd, bounds
    if not fit.limit < x + FAR * sd:
        return Severity(x, sd, max(x - HALF * sd, low), min(x + HALF * sd, high))
    ends = [severity_at(p, x, sd, max(fit.limit, x), bounds) for p in (0.975, 0.5, 0.025)]
    return Severity(ends[1], max(sd, (ends[2] - ends[0]) / (2 * HALF)), ends[0], ends[2])
