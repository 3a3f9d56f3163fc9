"""Several faults at once, from the sums a regression keeps or from the excited lines, and faults that change during a burst.

With score b and information G a combination of faults explains ``max (theta' b - theta' G theta / 2)``, severities within their bounds.
Combinations of one and two faults compete by that less half the logarithm of the samples for each severity (G. Schwarz, *Ann. Statist.*
6, 1978). Those that no data of this burst can distinguish have the same gain, and none of them gets a weight that names it. Where one fault
suffices, the loss that each other one may have besides is bounded by the profile likelihood (W. Q. Meeker and L. A. Escobar, *Am. Statist.*
49, 1995).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.special import chdtrc, logsumexp

from afdsvc.detect.burst_detector import BurstFinding
from afdsvc.detect.isolation import NONE, Fit, LineData, likelihood_gain
from afdsvc.detect.statistics.fault_curves import FaultCurves
from afdsvc.lti.statespace import Array

JOINED = "+"  # between the names of faults that are present together
TOGETHER = 0.05  # how often a machine with a fault has a second one
OPEN = 0.05  # odds of the likeliest pair against the likeliest single fault from which pairs are weighed with them
NEGLIGIBLE = 1e-6  # weight of a combination that is not listed
UNEXPLAINED = 1e-3  # p-value of what a pair leaves of the lines below which it is not an explanation
REFINED = 8  # pairs, the likeliest by linearisation, that are fitted on the lines
STEPS = 8  # Gauss-Newton steps of such a fit
NUDGE = 1e-4  # severity by which derivatives are taken
SINGULAR = 1e-9  # share of the information of one fault that another must leave for the two to be distinguished
EXCLUDED = 0.5 * 1.959964**2  # log likelihood that a loss must fall short by: bounds hold with 97.5 %
GRID, COARSE = 2001, 21  # severities of a second fault that are tried, and on the curves of the lines
HALVINGS, NEWTON = 8, 3  # steps to the bound between two of them, and to the nearest point


@dataclass(frozen=True, slots=True, eq=False)
class Combination:
    """Faults by number, their severities and covariance ``(k, k)``, and the log likelihood gained."""

    faults: tuple[int, ...]
    severity: Array
    covariance: Array
    gain: float

    def score(self, samples: int) -> float:
        """Return the gain less the price of its severities, and of being two faults where one is usual."""
        return self.gain - 0.5 * len(self.faults) * math.log(samples) + (len(self.faults) - 1) * math.log(TOGETHER)


def combined(b: Array, G: Array, seen: Sequence[int], bounds: tuple[float, float]) -> list[Combination]:
    """Return every single fault and every pair of those ``seen``, the severities of a pair both being losses."""
    found = [_fit(b, G, (i,), bounds) for i in seen]
    return [c for c in found + [_fit(b, G, pair, bounds) for pair in combinations(seen, 2)] if c is not None]


def weighed(found: Sequence[Combination], names: Sequence[str], samples: int) -> dict[str, float]:
    """Return the weights of combinations by name."""
    scores = [c.score(samples) for c in found]
    total = logsumexp(scores)
    return {JOINED.join(names[i] for i in c.faults): float(np.exp(s - total)) for c, s in zip(found, scores, strict=True)}


def _fit(b: Array, G: Array, faults: tuple[int, ...], bounds: tuple[float, float]) -> Combination | None:
    own = list(faults)
    information, score = G[np.ix_(own, own)], b[own]
    scale = np.sqrt(np.diag(information))
    if np.linalg.eigvalsh(information / np.outer(scale, scale))[0] < SINGULAR:
        return None
    severity = np.linalg.solve(information, score)
    if len(own) > 1 and not ((severity > bounds[0] - 0.1) & (severity < bounds[1])).all():
        return None  # a pair with a gain of more than everything, or none at all, is a single fault
    severity = np.clip(severity, *bounds)
    gain = float(severity @ score - 0.5 * severity @ information @ severity)
    return Combination(faults, severity, np.array(np.linalg.inv(information), dtype=np.float64), gain)


def likeliest_combination(found: Sequence[Combination], faults: int) -> Combination | None:
    """Return the combination of so many faults that gains most, None without any."""
    return max((c for c in found if len(c.faults) == faults), key=lambda c: c.gain, default=None)


def alike(found: Sequence[Combination], best: Combination, names: Sequence[str]) -> dict[str, float]:
    """Return the combinations of more faults that explain the data as well as the best one does, for a finding's parts: only their being more
    faults speaks against them. Values are the log likelihoods they fall short by."""
    more = [c for c in found if len(c.faults) > len(best.faults) and not set(best.faults) <= set(c.faults)]
    return {f"alike.{JOINED.join(names[i] for i in c.faults)}": best.gain - c.gain for c in more if best.gain - c.gain < -math.log(OPEN)}


def weighs_several(weights: Iterable[str], parts: Iterable[str]) -> bool:
    """Whether a decision with these names of weights and parts weighed several faults at once: pairs, or what a second fault may be besides one."""
    return any(JOINED in name for name in weights) or any(name.startswith(("alike.", "besides.")) for name in parts)


def besides(b: Array, G: Array, single: Combination, seen: Sequence[int], names: Sequence[str], low: float) -> dict[str, float]:
    """Return the largest loss, at most ``low``, that every other fault may have besides a single one, for a finding's parts.

    What the second fault makes of the first is not in score and information: the bound is wider by the share the first has lost.
    """
    i, lost = single.faults[0], abs(float(single.severity[0]))
    both = {j: [i, j] for j in seen if j != i}
    return {f"besides.{names[j]}": max((1 + lost) * largest_second(b[own], G[np.ix_(own, own)], low), low) for j, own in both.items()}


def largest_second(b: Array, G: Array, low: float, first: tuple[float, float] | None = None) -> float:
    """Return the largest loss that a fault may have besides another one.

    Parameters
    ----------
    b, G : ndarray
        Score ``(2,)`` and information ``(2, 2)`` of the first and of the other fault.
    low : float
        Largest loss of the other one, a negative number.
    first : tuple of float, optional
        Range of the first one's severity, ``(low, 0)`` by default.

    Returns
    -------
    float
        Severity below which the profile likelihood falls short of its maximum by more than `EXCLUDED`.
    """
    s = np.linspace(0.0, low, GRID)
    t = np.clip((b[0] - G[0, 1] * s) / G[0, 0], *(first or (low, 0.0)))
    gain = t * b[0] + s * b[1] - 0.5 * (t**2 * G[0, 0] + 2 * t * s * G[0, 1] + s**2 * G[1, 1])
    return float(s[gain >= gain.max() - EXCLUDED].min())


def paired(finding: BurstFinding, found: Sequence[Combination], pair: Combination, names: Sequence[str], samples: int) -> BurstFinding:
    """Return the finding with single faults and pairs weighed, and fits of the likeliest pair."""
    kept = {name: w for name, w in weighed(found, names, samples).items() if w > NEGLIGIBLE}
    together = Fit(JOINED.join(names[i] for i in pair.faults), float(pair.severity.min()), math.inf, pair.gain, pair.gain)
    product = abs(float(pair.severity.prod()))  # what the second fault makes of the first is not in the regressors
    both = zip(pair.faults, pair.severity.tolist(), np.hypot(np.sqrt(np.diag(pair.covariance)), product).tolist(), strict=True)
    parts = {f"together.{what}.{names[i]}": v for i, s, sd in both for what, v in (("severity", s), ("sd", sd))}
    return replace(finding, fits=(*finding.fits, together), weights=kept, parts={**finding.parts, **parts})


def paired_on_lines(finding: BurstFinding, curves: FaultCurves, data: LineData, reach: Mapping[str, tuple[float, float]], samples: int) -> BurstFinding:
    """Return the finding of a burst's lines with pairs weighed too, where one may be likelier than any single fault.

    What the likeliest pair leaves must be noise: otherwise the finding stays as it is.
    """
    singles = [
        Combination((i,), np.array([f.severity]), np.array([[f.sd**2]]), f.log_likelihood)
        for i, f in enumerate(finding.fits) if math.isfinite(f.sd)
    ]  # fmt: skip
    pairs = _pairs_on_lines(curves, data, reach, [c.faults[0] for c in singles])
    single, pair = likeliest_combination(singles, 1), likeliest_combination(pairs, 2)
    if single is None:
        return finding
    if pair is None or pair.score(samples) - single.score(samples) < math.log(OPEN):
        parts = {**alike(pairs, single, curves.names), **_besides_on_lines(curves, data, reach, single, [c.faults[0] for c in singles])}
        return replace(finding, parts={**finding.parts, **parts})
    point, covariance = curves.together({curves.names[i]: s for i, s in zip(pair.faults, pair.severity.tolist(), strict=True)})
    rest = data.whitened(covariance, data.z - data.R @ point)[0]
    left = float(chdtrc(max(rest.size - 2, 1), float(rest @ rest)))
    if left < UNEXPLAINED:
        return replace(finding, weights={NONE: 1.0}, parts={**finding.parts, "unexplained_p": left})
    return paired(finding, [*singles, *pairs], pair, curves.names, samples)


def _besides_on_lines(
    curves: FaultCurves, data: LineData, reach: Mapping[str, tuple[float, float]], single: Combination, seen: Sequence[int],
) -> dict[str, float]:
    """Return the largest losses of other faults besides a single one, by the profile likelihood on the curves."""
    at, name = float(single.severity[0]), curves.names[single.faults[0]]
    covariance, low = curves.together({name: at})[1], 0.999 * reach[name][0]

    def largest(other: str) -> float:
        return _largest_on_lines(lambda loss, first: _nearest(curves, data, covariance, {name: first, other: loss}, low), at, 0.999 * reach[other][0])

    return {f"besides.{other}": largest(other) for other in (curves.names[j] for j in seen) if other != name}


def _largest_on_lines(nearest: Callable[[float, float], tuple[float, float]], at: float, end: float) -> float:
    """Return the largest loss of ``(0, end)`` that is not excluded; ``nearest(loss, first)`` as `_nearest`, from the first severity near there."""
    grid, halves, firsts = np.linspace(0.0, end, COARSE).tolist(), [], [at]
    for loss in grid:
        half, first = nearest(loss, firsts[-1])
        halves.append(half)
        firsts.append(first)
    k = int(np.flatnonzero(np.array(halves) <= min(halves) + EXCLUDED)[-1])
    inside, outside, first = grid[k], grid[min(k + 1, COARSE - 1)], firsts[k + 1]
    for _ in range(HALVINGS):
        middle = (inside + outside) / 2
        half, there = nearest(middle, first)
        inside, outside, first = (middle, outside, there) if half <= min(halves) + EXCLUDED else (inside, middle, first)
    return float(outside)


def _nearest(curves: FaultCurves, data: LineData, covariance: Array, both: Mapping[str, float], low: float) -> tuple[float, float]:
    """Return half the squared distance to the nearest point where the second of two faults is as stated, and the severity of the first there."""
    (name, first), (other, loss) = both.items()
    for _ in range(NEWTON):
        at = {name: first, other: loss}
        rest, slope = data.whitened(covariance, data.z - data.R @ curves.together(at)[0], data.R @ _tangent(curves, at, name))
        first = min(max(first + float(slope @ rest) / max(float(slope @ slope), 1e-300), low), 0.0)
    (rest,) = data.whitened(covariance, data.z - data.R @ curves.together({name: first, other: loss})[0])
    return 0.5 * float(rest @ rest), first


def _tangent(curves: FaultCurves, at: Mapping[str, float], name: str) -> Array:
    """Return the derivative ``(2 L, p)`` of the wave by one of several severities."""
    low, high = (curves.together({**at, name: at[name] + step})[0] for step in (-NUDGE, NUDGE))
    return np.asarray((high - low) / (2 * NUDGE))


def _pairs_on_lines(curves: FaultCurves, data: LineData, reach: Mapping[str, tuple[float, float]], seen: Sequence[int]) -> list[Combination]:
    """Return the likeliest pairs of the faults ``seen``, both of them losses."""
    z = data.whitened(np.eye(data.z.size), data.z)[0]
    slopes = {i: data.white_waves(data.R @ curves.slope(curves.names[i], 0.0)[None])[0] for i in seen}
    b, G = np.zeros(len(curves.names)), np.zeros((len(curves.names), len(curves.names)))
    for i in seen:
        b[i] = slopes[i] @ z
        G[i, seen] = [float(slopes[i] @ slopes[j]) for j in seen]
    linear = [c for c in (_fit(b, G, pair, (-1.0, 0.0)) for pair in combinations(seen, 2)) if c is not None]
    best = sorted(linear, key=lambda c: -c.gain)[:REFINED]
    return [c for c in (_refined(curves, data, reach, c) for c in best) if c is not None]


def _refined(curves: FaultCurves, data: LineData, reach: Mapping[str, tuple[float, float]], start: Combination) -> Combination | None:
    """Return the likeliest severities of two faults on their curves together; None where one of them is not a loss."""
    names = [curves.names[i] for i in start.faults]
    low = np.array([0.999 * reach[n][0] for n in names])
    theta = np.clip(start.severity, low, 0.0)

    def severities(at: Array) -> dict[str, float]:
        return dict(zip(names, at.tolist(), strict=True))

    for _ in range(STEPS):
        now, covariance = curves.together(severities(theta))
        tangents = [_tangent(curves, severities(theta), name) for name in names]
        rest, *ways = data.whitened(covariance, data.z - data.R @ now, *(data.R @ t for t in tangents))
        slope = np.stack(ways, axis=1)
        moved = np.clip(theta + np.linalg.lstsq(slope, rest, rcond=None)[0], low, 0.0)
        theta, before = moved, theta
        if np.abs(theta - before).max() < 1e-9:
            break
    if not ((theta > low) & (theta < 0)).all():
        return None
    now, covariance = curves.together(severities(theta))
    information = slope.T @ slope
    if np.linalg.cond(information) > 1 / SINGULAR:
        return None
    return Combination(start.faults, theta, np.array(np.linalg.inv(information), dtype=np.float64), likelihood_gain(data, now, covariance))


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """Severity of one fault part by part of a burst ``(S,)`` with standard errors, and p-value of its having stayed the same."""

    severity: Array
    sd: Array
    p: float

    @property
    def onset(self) -> int:
        """First part of the best step from no fault to a constant one; 0 for a fault that was there from the beginning."""
        w = 1 / self.sd**2
        gains = [float(np.sum(w[k:] * self.severity[k:])) ** 2 / float(np.sum(w[k:])) for k in range(len(w))]
        return int(np.argmax(gains))

    def now(self) -> tuple[float, float]:
        """Return severity and standard error at the end of the burst: the mean since the onset if it stayed the same since then."""
        for k in (self.onset, len(self.sd) - 1):
            s, w = self.severity[k:], 1 / self.sd[k:] ** 2
            mean = float(np.sum(w * s) / np.sum(w))
            if float(chdtrc(max(len(s) - 1, 1), float(np.sum(w * (s - mean) ** 2)))) > 0.01:
                break
        return mean, float(np.sum(w)) ** -0.5


def course(scores: Array, information: Array) -> Course | None:
    """Return the course of one fault from its scores and information ``(S,)`` part by part; None where a part says nothing."""
    if not (information > 0).all() or len(scores) < 2:
        return None
    s, sd = scores / information, information**-0.5
    mean = float(np.sum(scores) / np.sum(information))
    return Course(s, sd, float(chdtrc(len(s) - 1, float(np.sum(((s - mean) / sd) ** 2)))))
