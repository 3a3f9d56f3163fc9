"""From claims to names: parameters with standard deviations in the units of people, sentences, hypotheses not claimed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from afdsvc.api.physics import Coefficient, Hypothesis, site_words
from afdsvc.dataset.units import with_unit
from afdsvc.explain.report.explanation import Estimate, Named, Nearest, Rejected
from afdsvc.explain.search.fit import Coordinates, Fit, fit, logarithmic
from afdsvc.explain.search.forward import Found, Round
from afdsvc.explain.search.problem import Point, Problem
from afdsvc.explain.search.ranking import Candidate, is_constant, mechanism
from afdsvc.explain.simulate.effects import PlacedEffect
from afdsvc.explain.verdict.verdict import Claim, Verdict
from afdsvc.lti.statespace import Array

LEAST_WEIGHT = 1e-3
MOST_NAMES = 8  # per effect
MOST_REJECTED = 6  # per round of the search
PARTIAL = 0.9  # share of the gap below which an explanation with a predictable remainder is partial
UNKNOWN = 10.0  # standard deviation, over the size of the parameter, from which nothing is known of it


def names(found: Found, verdict: Verdict, final: Fit, summaries: Mapping[str, str]) -> tuple[Named, ...]:
    """Return the names of every claimed effect with their look-alikes, the first of each effect first."""
    last = list(found.end)[-1]
    partial = verdict.explained[0] < PARTIAL and verdict.remainder is not None and verdict.remainder.present
    own = {e.hypothesis.key: p for e, p in zip(final.point.effects, estimates(found.problem, final, last), strict=True)}
    listed, numbers = [], list(dict.fromkeys(c.effect for c in verdict.claims))
    of_what = "the gap" if len(numbers) == 1 else "what the other effects leave"
    for number in numbers:
        alike = _each_once([c for c in verdict.claims if c.effect == number])
        for claim in [c for k, c in enumerate(alike) if not k or c.weight >= LEAST_WEIGHT][:MOST_NAMES]:
            h = claim.candidate.hypothesis
            parameters = own.get(h.key) or _own_of(found.problem, claim.candidate, last)
            listed.append(_named(claim, parameters, len(alike), partial, summaries, _shape(h, alike), of_what))
    return tuple(listed)


def _own_of(problem: Problem, of: Candidate, horizon: float) -> Mapping[str, Estimate]:
    """Return the parameters of a candidate in its own fit, where other effects may come after it."""
    beside = zip(of.fit.point.effects, estimates(problem, of.fit, horizon), strict=True)
    return next(values for effect, values in beside if effect.hypothesis.key == of.hypothesis.key)


def _shape(h: Hypothesis, alike: Sequence[Claim]) -> str:
    """Return what distinguishes a name from another of the same physics and site, "" where none is listed beside it."""
    same = [c for c in alike if (c.candidate.hypothesis.physics, c.candidate.hypothesis.site) == (h.physics, h.site)]
    return h.notes.get("variant", "") if len(same) > 1 and not is_constant(h) else ""


def _each_once(claims: Sequence[Claim]) -> list[Claim]:
    """Return the claims with the shapes of one thing taken as one, the first of them, their weights added."""
    first: dict[tuple[str, ...], Claim] = {}
    for c in claims:
        what = mechanism(c.candidate.hypothesis)
        first[what] = replace(first[what], weight=first[what].weight + c.weight) if what in first else c
    return list(first.values())


def _named(
    claim: Claim, parameters: Mapping[str, Estimate], alike: int, partial: bool, summaries: Mapping[str, str], shape: str = "", of_what: str = "the gap"
) -> Named:
    h = claim.candidate.hypothesis
    what = h.notes.get("variant", "") if is_constant(h) else ""
    values = "; ".join(value_text(name, e) for name, e in parameters.items())
    law = f"{what} other than stated" if what else summaries.get(h.physics, h.physics.replace("_", " "))
    doubt = f", weight {claim.weight:.2f} among {alike} that fit alike" if alike > 1 else ""
    sentence = f"{site_words(h.site)}: {law}{f', {shape}' if shape else ''}{f' ({values})' if values else ''}; closes {100 * claim.share:.0f} % of {of_what}{doubt}"
    return Named(h.physics, h.site, claim.weight, parameters, sentence, claim.effect, claim.share, partial, h.family, what)


def value_text(name: str, e: Estimate) -> str:
    """Return a number with its name, standard deviation and unit."""
    spread = "" if e.sd is None else f" +- {e.sd:.2g}"
    return f"{name} {with_unit(f'{e.value:.4g}{spread}', e.unit)}"


def estimates(problem: Problem, of: Fit, horizon: float) -> list[dict[str, Estimate]]:
    """Return the fitted parameters of every effect by name; forces in the unit of the input that acts there.

    Standard deviations come from the inverse of the information matrix, all numbers of the model and initial states fitted
    beside them and samples counted by the correlation time of the residual; those of logarithmic coordinates by the delta
    rule. Shape parameters that are not findings of their own are left out, unless nothing else was fitted.
    """
    c, sd = _deviations(problem, of, horizon)
    spreads = {(i, j): s * _size(x, of.point.effects[i].values[j], u) for (i, j, x), s, u in zip(c.slots, sd[c.k + c.p : c.shared], c.units, strict=True)}
    B = problem.nominal.at(of.point.theta).B
    return [_of_effect(e, {j: spreads[i, j] for j, x in enumerate(e.hypothesis.parameters) if x.free}, B) for i, e in enumerate(of.point.effects)]


def offsets(problem: Problem, of: Fit, horizon: float) -> list[Estimate]:
    """Return what was added to the simulation of every output, with the standard deviation of `estimates`; none where readings have no free zero."""
    c, sd = _deviations(problem, of, horizon)
    own = sd[c.k : c.k + c.p] * problem.scale[: c.p]
    return [Estimate(float(v), float(s), o.unit) for v, s, o in zip(of.point.offset, own, problem.nominal.model.outputs, strict=False)]


def _deviations(problem: Problem, of: Fit, horizon: float) -> tuple[Coordinates, Array]:
    """Return the coordinates of a fit and their standard deviations, from the inverse of its information matrix."""
    here = fit(problem, of.point, horizon, of.own_tau, iterations=0)
    return Coordinates(problem, of.point), np.sqrt(np.maximum(np.diag(np.linalg.pinv(here.H, hermitian=True)), 0.0))


def _size(c: Coefficient, value: float, unit: float) -> float:
    """Return the derivative of a parameter with respect to its coordinate."""
    return abs(value) if logarithmic(c) else unit


def _of_effect(effect: PlacedEffect, spreads: Mapping[int, float], B: Array) -> dict[str, Estimate]:
    h = effect.hypothesis
    free = [(j, c) for j, c in enumerate(h.parameters) if c.free]
    found = {c.name: _estimate(float(effect.values[j]), c, spreads[j], B) for j, c in [x for x in free if not x[1].nuisance] or free}
    if h.lasting and effect.begun:
        size = float(np.sqrt(np.mean([b @ b for b in effect.begun])))
        found |= {c.name: _estimate(size * float(v), c, np.inf, B) for c, v in zip(h.parameters, effect.values, strict=True) if not c.free and not c.nuisance}
    return found


def _estimate(value: float, c: Coefficient, spread: float, B: Array) -> Estimate:
    factor = 1 / c.per(B)
    size = max(abs(value), 0.0 if logarithmic(c) else c.scale)
    known = np.isfinite(spread) and 0 < spread < UNKNOWN * size
    return Estimate(value * factor, spread * abs(factor) if known else None, c.unit)


def rejections(found: Found, claimed: Sequence[Hypothesis], error: Callable[[Point], float]) -> tuple[Rejected, ...]:
    """Return the hypotheses that were fitted and not claimed in any shape, round by round; ``error`` gives a point's held-out NRMSE."""
    listed: dict[tuple[str, str], Rejected] = {}
    named = {(h.physics, h.site) for h in claimed}
    for step in found.steps:
        for c in [c for c in (*step.worse, *step.candidates) if (c.hypothesis.physics, c.hypothesis.site) not in named][:MOST_REJECTED]:
            h = c.hypothesis
            if (h.physics, h.site) not in listed:
                listed[h.physics, h.site] = Rejected(h.physics, h.site, error(c.fit.point), _why(c, step))
    return tuple(listed.values())


def _why(c: Candidate, step: Round) -> str:
    """Return why a candidate is not claimed: what the accepted one does better, or what it lacks."""
    best = step.candidates[0]
    closes = f"closes {100 * c.evidence.explained:.0f} % of the gap" if c.evidence.explained > 0 else "closes nothing of the gap"
    if c in step.worse:
        return f"{closes} on left-out blocks; the recordings held out are surely followed worse with it than with {best.hypothesis.title}"
    if not step.accepted:
        return f"{closes}; {step.reason}" if c is best else f"{closes}, less than {best.hypothesis.title}, which is not accepted either"
    if c is best:
        return f"{closes} on left-out blocks, but is not claimed: what is said of the recordings held out or of the remainder speaks against it"
    return f"{closes} on left-out blocks; {best.hypothesis.title} closes {100 * best.evidence.explained:.0f} %"


def nearest(found: Found, most: int = 3) -> tuple[Nearest, ...]:
    """Return the hypotheses that come nearest where none is claimed, by the share of the gap they close, one shape of each."""
    candidates = found.steps[0].candidates if found.steps else ()
    ordered = sorted((c for c in candidates if c.evidence.explained > 0), key=lambda c: c.evidence.explained)
    best = list({(c.hypothesis.physics, c.hypothesis.site): c for c in ordered}.values())
    best = sorted(best, key=lambda c: -c.evidence.explained)[:most]
    return tuple(
        Nearest(c.hypothesis.physics, c.hypothesis.site, c.evidence.explained, f"{site_words(c.hypothesis.site)}: {c.hypothesis.physics.replace('_', ' ')} would close {100 * c.evidence.explained:.0f} % of the gap")
        for c in best
    )
