"""When a growing fault reaches a limit: a straight line through the newest severities, and Fieller's interval for where it crosses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2
from scipy.stats import t as student

FEWEST = 5  # estimates a line is drawn through
ACCEPTED = 0.01  # a line that scatters more than this often by chance alone is not believed


@dataclass(frozen=True, slots=True)
class Forecast:
    """A line through the newest ``points`` estimates: ``value`` at the newest, ``slope`` per unit of time with ``slope_sd``.

    ``reaches`` is when the line crosses the limit, with the ends of its 95 % interval; all None where the slope leads away from the
    limit or may be zero.
    """

    points: int
    value: float
    slope: float
    slope_sd: float
    reaches: float | None = None
    earliest: float | None = None
    latest: float | None = None


def forecast(t: Sequence[float], value: Sequence[float], sd: Sequence[float], limit: float) -> Forecast | None:
    """Return the line through the newest estimates and when it reaches ``limit``; None where no line fits even the newest five.

    ``t`` increases, in any unit; ``value`` and ``sd`` are severities and their standard errors. Of the newest 5, 10, 20, ... and
    all estimates the longest stretch counts whose line a chi-square test accepts: a fault that grows faster than before is followed by its present rate.

    Source: E. C. Fieller, *Some problems in interval estimation*, J. R. Stat. Soc. B 16 (1954): the crossing time is a ratio of two
    estimates, and its interval need not be symmetric.

    >>> found = forecast([0, 1, 2, 3, 4, 5], [-0.10, -0.12, -0.14, -0.16, -0.18, -0.20], [0.005] * 6, -0.5)
    >>> round(found.reaches, 6), found.earliest < 20 < found.latest
    (20.0, True)
    """
    x, y, s = (np.asarray(part, dtype=np.float64) for part in (t, value, sd))
    sizes = [*(FEWEST * 2**k for k in range(len(x).bit_length()) if FEWEST * 2**k < len(x)), len(x)] if len(x) >= FEWEST else []
    fits = [_line(x[-n:] - x[-1], y[-n:], s[-n:]) for n in sizes]
    accepted = [fit for fit in fits if fit[1] <= chi2.isf(ACCEPTED, fit[0] - 2)]
    return _crossing(accepted[-1], float(x[-1]), limit) if accepted else None


Line = tuple[int, float, np.ndarray, np.ndarray]  # points, chi-square, offset and slope, their covariance


def _line(x: np.ndarray, y: np.ndarray, s: np.ndarray) -> Line:
    design = np.column_stack([np.ones_like(x), x]) / s[:, None]
    cov = np.linalg.pinv(design.T @ design)
    found = cov @ design.T @ (y / s)
    return len(x), float(np.sum((y / s - design @ found) ** 2)), found, cov


def _crossing(fit: Line, newest: float, limit: float) -> Forecast:
    n, _, (a, b), C = fit
    plain = Forecast(n, float(a), float(b), float(np.sqrt(C[1, 1])))
    q2 = float(student.isf(0.025, n - 2)) ** 2
    far, steep = a - limit, b * b - q2 * C[1, 1]
    if steep <= 0 or far * b >= 0:
        return plain
    half, last = far * b - q2 * C[0, 1], far * far - q2 * C[0, 0]
    root = math.sqrt(max(half * half - steep * last, 0.0))
    ends = sorted((newest + (-half - root) / steep, newest + (-half + root) / steep))
    return Forecast(n, plain.value, plain.slope, plain.slope_sd, newest - far / b, *ends)
