"""How sure a name is: how often it is the best when the blocks of the recordings are drawn anew."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from afdsvc.explain.search.forward import Candidate, alike, is_constant, is_reason
from afdsvc.explain.settings import Settings
from afdsvc.lti.statespace import Array


def weights(candidates: Sequence[Candidate], settings: Settings, limited: str, rng: np.random.Generator) -> Array:
    """Return the share of resamplings in which each candidate comes first, ``(len(candidates),)``, sum 1.

    A resampling draws the left-out blocks with replacement (Efron 1979). Those that fit alike share the vote.
    """
    if not candidates:
        return np.zeros(0)
    count = len(candidates[0].evidence.before)
    drawn = rng.integers(0, count, (settings.resamples, count))
    gains = np.array([c.evidence.resampled(drawn) for c in candidates])
    votes = np.zeros(len(candidates))
    for column in gains.T:
        best = int(np.argmax(column))
        near = [alike(c.evidence, candidates[best].evidence, g, column[best], settings, limited) for c, g in zip(candidates, column, strict=True)]
        votes[near] += 1.0 / sum(near)
    return np.asarray(votes / votes.sum())


def look_alikes(candidates: Sequence[Candidate], settings: Settings, limited: str = "model") -> list[Candidate]:
    """Return the first candidate and the reasons that close nearly as much and gain as they must."""
    if not candidates:
        return []
    least, best = settings.alike * candidates[0].evidence.closed, candidates[0]
    others = [c for c in candidates[1:] if is_reason(c, limited) or is_constant(best.hypothesis)]
    return [best, *(c for c in others if c.evidence.closed >= least and c.evidence.gain > settings.evidence)]
