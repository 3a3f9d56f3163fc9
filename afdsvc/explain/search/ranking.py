"""Which candidate comes first, and how sure that is: how often it is the best when the blocks of the recordings are drawn anew."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from afdsvc.api.physics import Hypothesis
from afdsvc.explain.search.evidence import HypothesisEvidence
from afdsvc.explain.search.fit import Fit
from afdsvc.explain.settings import Settings
from afdsvc.lti.statespace import Array

CONSTANT = "parameter_change"
WHOLE = 0.8  # share of the gap that a constant has to close to be a reason


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A hypothesis fitted along the horizons, with its evidence over the model without it.

    ``path`` are the fits to whole recordings, ``rough`` those to their beginnings.
    """

    hypothesis: Hypothesis
    path: dict[float, Fit]
    evidence: HypothesisEvidence
    rough: dict[float, Fit] = field(default_factory=dict)

    @property
    def fit(self) -> Fit:
        """The fit at the decision horizon."""
        return self.path[list(self.path)[-1]]


def mechanism(h: Hypothesis) -> tuple[str, ...]:
    """Return what the shapes of one mechanism share: physics, site, and the constant that is meant."""
    return h.physics, h.site, h.notes.get("of", h.notes.get("variant", "") if is_constant(h) else "")


def winner(reasons: Sequence[Candidate], settings: Settings, limited: str) -> Candidate:
    """Return the mechanism with the most weight, the simplest of those within `Settings.tie`; of its shapes the simplest that fits alike.

    Where resampled blocks leave that in doubt, what gains as much, within chance, and is in no doubt goes before it. ``reasons`` are ordered by gain.
    """
    votes: dict[tuple[str, ...], float] = {}
    shapes: dict[tuple[str, ...], list[Candidate]] = {}
    for c, w in zip(reasons, vote_shares(reasons, settings, limited), strict=True):
        what = mechanism(c.hypothesis)
        votes[what] = votes.get(what, 0.0) + float(w)
        shapes.setdefault(what, []).append(c)
    near = [k for k, v in votes.items() if v >= max(votes.values()) - settings.tie]
    firsts = [_simplest(shapes[k], settings, limited) for k in near]
    first = min(firsts, key=lambda c: (complexity(c.hypothesis), -c.evidence.gain))
    if in_no_doubt(first, settings):
        return first
    return next((c for c in reasons if c.evidence.gain > first.evidence.gain - settings.likely and in_no_doubt(c, settings)), first)


def in_no_doubt(c: Candidate, settings: Settings) -> bool:
    """Whether a candidate gains in so many resampled blocks that it can be accepted by them."""
    return c.evidence.improves(settings.resamples) > settings.sure


def _simplest(shapes: Sequence[Candidate], settings: Settings, limited: str) -> Candidate:
    """Return the simplest of candidates, ordered by gain, that fit as well as the first."""
    best = shapes[0]
    near = [c for c in shapes if fits_alike(c, best, c.evidence.gain, best.evidence.gain, settings, limited)]
    return min(near, key=lambda c: (complexity(c.hypothesis), -c.evidence.gain))


def complexity(h: Hypothesis) -> tuple[float, int]:
    """Return what orders hypotheses that fit alike: fewer parameters first, descriptions of curves behind mechanisms; then fewer signals read."""
    return sum(c.free and not c.nuisance for c in h.parameters) + (2.0 if getattr(h, "description", False) else 0.0), len(h.reads)


def fits_alike(one: Candidate, best: Candidate, gain: float, highest: float, settings: Settings, limited: str) -> bool:
    """Whether a gain is as good as the highest: within chance, or, where the model limits, close to it in what it closes.

    It has to be close in what it leaves, too; what is simpler may leave more with every parameter less, since a fit that bends further closes
    more. Where the noise is known, every hypothesis has to be close in the residual power that it leaves above the noise.
    """
    if gain >= highest - settings.likely:
        return True
    closed, most = float(one.evidence.closing(np.array(gain))), float(best.evidence.closing(np.array(highest)))
    noise = (1 - settings.tie) * best.evidence.noise * (1 - most)
    fewer = 0.0 if noise else max(complexity(best.hypothesis)[0] - complexity(one.hypothesis)[0], 0.0)
    near = settings.alike ** (1 + fewer) * (1 - closed - noise) <= 1 - most - noise
    return limited == "model" and closed >= (1 - settings.tie) * most and near


def is_reason(c: Candidate, limited: str) -> bool:
    """Whether a candidate can be the reason of a gap.

    Where the model limits, constants that are off are one only where they close nearly all of the gap: with physics left out any fit
    moves them.
    """
    return limited == "noise" or not is_constant(c.hypothesis) or c.evidence.share > WHOLE


def is_offset(h: Hypothesis) -> bool:
    """Whether a hypothesis says where the zero of a signal lies, which belongs to the recordings and not to the machine."""
    return h.family == "offset"


def is_constant(h: Hypothesis) -> bool:
    """Whether a hypothesis says that a number of the model is off, not that physics is missing."""
    return h.physics == CONSTANT


def vote_shares(candidates: Sequence[Candidate], settings: Settings, limited: str) -> Array:
    """Return the share of resamplings in which each candidate comes first, ``(len(candidates),)``, sum 1.

    A resampling draws the blocks with replacement (Efron 1979); their gains are those of the fit, less the price of the parameters: a block
    left out that alone shows a limit speaks against the very law it shows. Mechanisms that fit alike share the
    vote equally, and so do the shapes of each.
    """
    if not candidates:
        return np.zeros(0)
    count = len(candidates[0].evidence.before)
    drawn = np.random.default_rng(count).integers(0, count, (settings.resamples, count))
    gains = np.array([c.evidence.resampled(drawn, fitted=True) for c in candidates])
    votes, kinds = np.zeros(len(candidates)), [mechanism(c.hypothesis) for c in candidates]
    for column in gains.T:
        best = int(np.argmax(column))
        near = [fits_alike(c, candidates[best], g, column[best], settings, limited) for c, g in zip(candidates, column, strict=True)]
        shapes = Counter(what for what, n in zip(kinds, near, strict=True) if n)
        votes += [n and 1.0 / (len(shapes) * shapes[what]) for what, n in zip(kinds, near, strict=True)]
    return np.asarray(votes / votes.sum())


def look_alikes(candidates: Sequence[Candidate], settings: Settings, limited: str = "model") -> list[Candidate]:
    """Return the first candidate and the reasons that close nearly as much and gain as they must, of every mechanism the simplest shape that fits alike."""
    if not candidates:
        return []
    least, best = settings.alike * candidates[0].evidence.closed, candidates[0]
    shapes: dict[tuple[str, ...], list[Candidate]] = {}
    for c in candidates[1:]:
        reason = is_reason(c, limited) or is_constant(best.hypothesis)
        if reason and c.evidence.closed >= least and c.evidence.gain > settings.evidence:
            shapes.setdefault(mechanism(c.hypothesis), []).append(c)
    return [best, *(_simplest(found, settings, limited) for what, found in shapes.items() if what != mechanism(best.hypothesis))]
