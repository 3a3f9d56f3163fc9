"""Judging one round: is anything added at all, by which hypothesis, and which others the data cannot tell from it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from afdsvc.api.physics import Hypothesis
from afdsvc.explain.baseline import Baseline
from afdsvc.explain.search import Candidate
from afdsvc.lti.statespace import Array

CHANGE = "parameter_change"
SURE = 1e-5  # false-acceptance probability of one hypothesis on the training runs
SURE_CHANGE = 2e-3  # the same for a change of a constant, which invents nothing and has the owner's prior against it already
CLOSE = 10.0  # score units within which a rival is a look-alike
APART = 3.0  # standard errors by which blocks must differ to tell two hypotheses apart
MILD = 2.0  # price of a parameter when asking whether two hypotheses can be told apart
SILENT = 16.0  # how much the selection runs must differ with an effect before they are asked for a gain: four standard errors
FAINT, INEXACT = 0.05, 0.01  # what differs there, per gain where fitted, too little to judge a law's form by; loss allowed there, per gain
STRAINED, WORSE, LOST = 3.0, 4.0, 0.1  # prior deviations from which a fit counts as strained; loss on selection allowed then, least and per gain
ALIKE = 2.0  # score units within which two are equally good
EXACT = 1e-3  # share of a gain to which the form of a law can be trusted: nobody knows one better
AT_END, INSIDE = 1e-3, 1.0  # part of its range that counts as its end; standard errors a shorter law may be worse by
FAR_OFF = 5.0  # prior standard deviations a nuisance parameter may move without being suspect


@dataclass(frozen=True, slots=True)
class Tried:
    """How many hypotheses were looked at, and how many constants they change: those have a chance of error of their own."""

    all: int
    changes: int

    @classmethod
    def of(cls, hypotheses: Iterable[Hypothesis]) -> Tried:
        """Count, every count at least one."""
        tried = list(hypotheses)
        constants = {(h.site, h.parameters[0].name) for h in tried if h.physics == CHANGE}
        return cls(max(len(tried), 1), max(len(constants), 1))


@dataclass(frozen=True, slots=True, eq=False)
class Rival:
    """A candidate beside the best: how much it falls behind (``score``), in how many standard errors (``z``), its weight."""

    candidate: Candidate
    score: float
    z: float
    weight: float


@dataclass(frozen=True, slots=True, eq=False)
class Ruling:
    """The outcome of one round: accepted or not and why, the rivals in order (the first is the choice), the others.

    ``gain`` is the log-likelihood ratio (twice) on the training runs, ``share`` the part of the selection runs' residual
    power above the noise floor that the choice takes away.
    """

    accepted: bool
    reason: str
    rivals: tuple[Rival, ...]
    beaten: tuple[Rival, ...]
    nothing: Candidate
    gain: float
    share: float


def judge(base: Baseline, candidates: Sequence[Candidate], tried: Tried, samples: tuple[int, int]) -> Ruling:
    """Rule on the candidates of a round; ``samples`` are those of train and select."""
    nothing = next(c for c in candidates if c.hypothesis is None)
    named = [c for c in candidates if c.hypothesis is not None and np.isfinite(c.train)]
    if not named:
        return Ruling(False, "no hypothesis applies to this machine", (), (), nothing, 0.0, 0.0)
    price = _price(base, nothing, named, samples)
    scored = sorted(((score(base, nothing, c, samples, price), c) for c in named), key=lambda s: -s[0])
    scored = _general(base, nothing, scored, samples)
    inexact = EXACT * max(sum(gains(base, nothing, scored[0][1], samples)), 0.0)
    rivals, beaten = _rivals(scored, price, inexact)
    rivals = _simplest_first(rivals, inexact)
    choice = rivals[0].candidate
    gain, gain_select = gains(base, nothing, choice, samples)
    reason = _objection(base, nothing, choice, gain, gain_select, tried, samples)
    return Ruling(not reason, reason, tuple(rivals), tuple(beaten), nothing, gain, share(base, nothing, choice, samples))


def _general(
    base: Baseline, nothing: Candidate, scored: list[tuple[float, Candidate]], samples: tuple[int, int]
) -> list[tuple[float, Candidate]]:
    """Leave out what fits the training runs best and fails the selection runs, where another law does well on both."""
    gained = [gains(base, nothing, c, samples) for _, c in scored]
    sound = [not _fails(nothing, c, *g, samples) for (_, c), g in zip(scored, gained, strict=True)]
    well = [ok and min(g) > 0 and value > 0 for ok, g, (value, _) in zip(sound, gained, scored, strict=True)]
    if sound[0] or not any(well):
        return scored
    return [s for ok, s in zip(sound, scored, strict=True) if ok]


def _fails(nothing: Candidate, c: Candidate, gain: float, gain_select: float, samples: tuple[int, int]) -> bool:
    """Whether a candidate does not improve the selection runs where it should, or makes them worse where it need not.

    Quiet selection runs hardly reach what a clearance or a limit does, and hold it with the size that its exact form has there. Laws are
    right to a tenth of their answer: a hundredth of what a law explains may be lost in them.
    """
    if c.differs < FAINT * gain and gain_select > -INEXACT * gain:
        return False
    lenient = _strained(nothing) or c.differs < SILENT
    return bool(samples[1]) and gain_select <= (-max(WORSE, LOST * (gain + gain_select)) if lenient else 2.0)


def gains(base: Baseline, nothing: Candidate, c: Candidate, samples: tuple[int, int]) -> tuple[float, float]:
    """Return twice the log-likelihood ratio on train and select against adding nothing."""
    if base.limited == "noise":
        return nothing.train - c.train, nothing.select - c.select
    worth = [n / base.memory for n in samples]
    return (
        worth[0] * float(np.log(nothing.train / max(c.train, 1e-300))),
        worth[1] * float(np.log(max(nothing.select, 1e-300) / max(c.select, 1e-300))) if samples[1] else 0.0,
    )


def score(base: Baseline, nothing: Candidate, c: Candidate, samples: tuple[int, int], price: float) -> float:
    """Return the gain on train and select less the ``price`` of every parameter."""
    return sum(gains(base, nothing, c, samples)) - c.parameters * price


def _price(base: Baseline, nothing: Candidate, named: Sequence[Candidate], samples: tuple[int, int]) -> float:
    """Return the price of a parameter: the logarithm of how many samples' worth there is about the effect (Schwarz 1978).

    Most samples say nothing about a faint effect: its largest gain is what there is to know of it, and never more than the samples
    (effective sample size: Berger, Bayarri and Pericchi 2014, Econometric Reviews 33).
    """
    known = max(sum(gains(base, nothing, c, samples)) for c in named)
    return float(np.log(np.clip(known, np.exp(MILD), max(sum(samples) / base.memory, np.exp(MILD)))))


def _rivals(scored: Sequence[tuple[float, Candidate]], price: float, inexact: float) -> tuple[list[Rival], list[Rival]]:
    """Split into those within reach of the best (with weights) and those beaten; what is ``inexact`` tells nobody apart.

    The choice pays the full price of every parameter; whether a rival can be told from it is asked at the mild price of
    Akaike, or a law that contains the choice as a special case would count as refuted just for being longer.
    """
    top, best = scored[0]
    rivals: list[Rival] = []
    beaten: list[Rival] = []
    for value, c in scored:
        longer = c.parameters - best.parameters
        z = separation(c.blocks, best.blocks, longer * MILD + _strain(c) - _strain(best) - inexact)
        close = top - value - longer * (price - MILD) - inexact
        evidence = min(max(close, 0.0), max(z, 0.0) ** 2) if c is not best else 0.0
        rival = Rival(c, top - value, z, float(np.exp(-evidence / 2)))
        (rivals if c is best or close < CLOSE or z < APART else beaten).append(rival)
    total = sum(r.weight for r in rivals)
    return [Rival(r.candidate, r.score, r.z, r.weight / total) for r in rivals], beaten


def _strain(c: Candidate) -> float:
    """Return what the prior of the model's own parameters costs the candidate; the blocks hold data only."""
    return float(np.dot(c.point.theta, c.point.theta))


def separation(worse: Array, better: Array, price: float = 0.0) -> float:
    """Return by how many standard errors the blocks of one candidate (and the ``price`` of its parameters) cost more."""
    d = worse - better
    total, spread = float(d.sum()) + price, float(d.std(ddof=1)) * math.sqrt(len(d))
    if spread > 1e-12 * abs(total):
        return total / spread
    return math.copysign(math.inf, total) if total else 0.0  # the same everywhere, as where one of them leaves


def _simplest_first(rivals: list[Rival], inexact: float) -> list[Rival]:
    """Put the one with the fewest parameters first among those that are as good as the best.

    A law whose shape sits at the end of its range is asked to be another: it gives way to a shorter one of its family at its
    place that the data cannot tell from it.
    """
    best = min(rivals, key=lambda r: r.score)
    shorter = [r for r in rivals if r.z < INSIDE and _limit_of(best.candidate, r.candidate)]
    first = min([*(r for r in rivals if r.score < ALIKE + inexact), *shorter], key=lambda r: (r.candidate.parameters, r.score))
    rest = sorted((r for r in rivals if r is not first), key=lambda r: -r.weight)
    return [first, *rest]


def _limit_of(long: Candidate, short: Candidate) -> bool:
    """Whether a law with a parameter at an end of its range may be a shorter one of its family at its place."""
    a, b = long.hypothesis, short.hypothesis
    if a is None or b is None or (a.family, a.site) != (b.family, b.site) or short.parameters >= long.parameters:
        return False
    pairs = zip(a.parameters, long.effect.values, strict=True)
    return any(p.free and min(v - p.low, p.high - v) <= AT_END * (p.high - p.low) for p, v in pairs)


def _objection(
    base: Baseline, nothing: Candidate, c: Candidate, gain: float, gain_select: float, tried: Tried, samples: tuple[int, int]
) -> str:
    """Return why the choice is not accepted, or ""."""
    k = max(c.parameters, 1)
    change = c.hypothesis is not None and c.hypothesis.physics == CHANGE and base.limited == "noise"
    sure = SURE_CHANGE / tried.changes if change else SURE / tried.all
    wanted = max(float(stats.chi2.isf(sure, k)), k * float(np.log(max(samples[0] / base.memory, 2.0))))
    if base.limited == "noise":
        gain += gain_select  # likelihoods add, and what was not fitted can only lose by chance
    if gain < wanted:
        return f"the best hypothesis ({c.key}) gains {gain:.1f} where chance and {tried.changes if change else tried.all} trials ask for {wanted:.1f}"
    if _fails(nothing, c, *gains(base, nothing, c, samples), samples):
        return f"the best hypothesis ({c.key}) does not improve the recording kept for selection"
    return ""


def bent(theta: Array, ruling: Ruling) -> str:
    """Return why the accepted choice, with the nuisance at ``theta``, asks too much of the model's own parameters, or ""."""
    off, before = float(np.abs(theta).max(initial=0.0)), ruling.nothing.point.theta
    if off <= max(FAR_OFF, float(np.abs(before).max(initial=0.0)) + 1.0) or float(theta @ theta) <= float(before @ before):
        return ""
    return f"the best hypothesis ({ruling.rivals[0].candidate.key}) needs a model parameter {off:.1f} standard deviations off"


def _strained(nothing: Candidate) -> bool:
    """Whether the model fits only with a parameter far from its stated value: then its fit elsewhere is no argument."""
    return float(np.abs(nothing.point.theta).max(initial=0.0)) > STRAINED


def share(base: Baseline, nothing: Candidate, c: Candidate, samples: tuple[int, int]) -> float:
    """Return the part of the gap (cost above the noise floor) that the candidate closes, on the selection runs if any."""
    before, after, n = (nothing.select, c.select, samples[1]) if samples[1] else (nothing.train, c.train, samples[0])
    floor = float(n) if base.limited == "noise" else 0.0
    return (before - after) / max(before - floor, 1e-9 * before, 1e-300)
