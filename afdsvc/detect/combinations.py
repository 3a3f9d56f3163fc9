"""Several faults at once, and faults that change during a burst, from the sums a regression keeps.

With score b and information G a combination of faults explains ``max (theta' b - theta' G theta / 2)``, severities within their bounds.
Combinations of one and two faults compete by that less half the logarithm of the samples for each severity (G. Schwarz, *Ann. Statist.*
6, 1978). Those that no data of this burst can tell apart have the same gain, and none of them gets a weight that names it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.special import chdtrc, logsumexp

from afdsvc.lti.statespace import Array

JOINED = "+"  # between the names of faults that are present together
TOGETHER = 0.05  # how often a machine with a fault has a second one
SINGULAR = 1e-9  # share of the information of one fault that another must leave for the two to be told apart


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
