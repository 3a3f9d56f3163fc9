"""The picture of a law: fitted without a form at the accepted or suspected site, its band, and the named law beside it.

The heights of the knots are fitted with the other effects and initial states; the numbers of the model and the sensors' offsets stay
where the named law (or the nearest one) leaves them, as a part proportional to the signal, or a constant one, would be theirs as well. Then a ridge on the
second differences of the heights is added, as strong as predicts left-out blocks best. The picture chooses nothing.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from afdsvc.api.physics import Hypothesis
from afdsvc.explain.locate.free_law import KNOTS, LawSite, evaluated, signal_of, site
from afdsvc.explain.locate.places import described
from afdsvc.explain.report.explanation import LawPicture
from afdsvc.explain.search.evidence import block_spans, left_out
from afdsvc.explain.search.fit import Coordinates, Fit, fit
from afdsvc.explain.search.forward import Found
from afdsvc.explain.search.problem import Point, Problem
from afdsvc.explain.search.ranking import Candidate
from afdsvc.explain.simulate.effects import PlacedEffect
from afdsvc.lti.statespace import Array

RIDGES = (0.0, 1e-3, 1e-2, 1e-1, 1.0, 10.0)  # over the mean information on a knot
WIDE = 1.96  # standard deviations of the band
ITERATIONS = 8


def picture(found: Found, final: Fit, claimed: bool) -> LawPicture | None:
    """Return the law at the first accepted site, else at that of the nearest hypothesis; None where no static law applies."""
    for candidate in found.steps[0].candidates if found.steps else ():
        drawn = _site(found, candidate)
        if drawn is not None:
            return _drawn(found, final, candidate, drawn, claimed)
        if claimed:
            return None
    return None


def _site(found: Found, candidate: Candidate) -> LawSite | None:
    if not candidate.hypothesis.reads:
        return None
    last = list(found.end)[-1]
    simulated = found.problem.simulated(candidate.fit.point, last)
    u, x, y = (np.vstack([getattr(s, name) for s in simulated]) for name in ("u", "x", "y"))
    read = candidate.hypothesis.reads[0]
    return None if read.kind not in ("u", "x", "y") else site(candidate.hypothesis, found.machine, signal_of(read, u, x, y))


def _drawn(found: Found, final: Fit, candidate: Candidate, drawn: LawSite, claimed: bool) -> LawPicture | None:
    """Fit the law with the other effects kept, smooth it, and put it beside the named one."""
    last, key = list(found.end)[-1], candidate.hypothesis.key
    like = final.point if claimed else candidate.fit.point
    named = next((e for e in like.effects if e.hypothesis.key == key), None)
    if named is None:
        return None
    drawn = replace(drawn, factor=drawn.factor * _regained(found.problem, like, named.hypothesis))
    without = replace(like, effects=tuple(e for e in like.effects if e is not named))
    beside = evaluated(named.hypothesis, named.values, drawn.knots, _others(found, named.hypothesis), found.problem.nominal.dt)
    base = fit(found.problem, without, last, final.tau, ITERATIONS)
    problem, start = _held(found.problem, without)
    whole = fit(problem, start.added(PlacedEffect(drawn.hypothesis, np.concatenate([drawn.knots, beside]))), last, final.tau, ITERATIONS)
    here = fit(problem, whole.point, last, final.tau, iterations=0)
    heights, sd, loss = _smoothed(problem, here, drawn, base.sd)
    if not np.isfinite(heights).all():
        return None
    left = float(left_out(base, block_spans([len(e) for e in base.residuals], base.tau, problem.settings), base.sd).sum())
    return _law(drawn, heights, sd, beside if claimed else None, 1 - loss / left)


def _regained(problem: Problem, point: Point, h: Hypothesis) -> float:
    """Return the stated gain from the input whose unit a force is given in, over the refitted one."""
    through = next((c.through for c in h.parameters if c.through is not None), None)
    stated, refitted = (problem.nominal.at(theta).B for theta in (np.zeros_like(point.theta), point.theta))
    return float(stated[through] / refitted[through]) if through is not None and refitted[through] else 1.0


def _held(problem: Problem, point: Point) -> tuple[Problem, Point]:
    """Return the problem with the numbers of the model and the offsets held at a point, and the point there."""
    nominal, theta = problem.nominal, point.theta
    held = replace(nominal, model=nominal.moved(theta) if nominal.python else nominal.model, plant=nominal.at(theta), entries=())
    return replace(problem, nominal=held, offset_free=False), replace(point, theta=np.zeros(0))


def _others(found: Found, h: Hypothesis) -> list[float]:
    groups = {"u": found.machine.inputs, "x": found.machine.states, "y": found.machine.outputs}
    return [groups[s.kind][s.index].mean if s.kind in groups else 0.0 for s in h.reads[1:]]


def _smoothed(problem: Problem, here: Fit, drawn: LawSite, scale: Array) -> tuple[Array, Array, float]:
    """Return heights, standard deviations and the loss on left-out blocks at the ridge that makes it smallest.

    To second order about the fit: the ridge adds ``r R`` to the information ``H``, and moves the numbers to ``(H + r R)^-1 H q``.
    """
    c = Coordinates(problem, here.point)
    own = slice(c.shared - KNOTS, c.shared)
    q, units = c.pack(here.point), np.array(c.units[-KNOTS:])
    bend = _second_differences(drawn.knots) * units
    R = np.zeros_like(here.H)
    R[own, own] = bend.T @ bend
    size = float(np.trace(here.H[own, own])) / max(float(np.trace(R)), 1e-300)
    spans, best = block_spans([len(e) for e in here.residuals], here.tau, problem.settings), None
    for ridge in RIDGES:
        H = here.H + ridge * size * R
        shift: Array = np.asarray(np.linalg.lstsq(H, -ridge * size * R @ q, rcond=1e-12)[0], dtype=np.float64)
        moved = _moved(here, H, shift)
        loss = float(left_out(moved, spans, scale).sum())
        if best is None or loss < best[2]:
            spread = np.sqrt(np.maximum(np.diag(np.linalg.pinv(H, hermitian=True))[own], 0.0))
            best = ((q + shift)[own] * units, spread * units, loss)
    assert best is not None  # noqa: S101
    return best


def _moved(here: Fit, H: Array, shift: Array) -> Fit:
    """Return the fit with its numbers moved by ``shift``, its residuals to first order."""
    change, first, residuals = here.J @ shift, 0, []
    for e in here.residuals:
        residuals.append(e + change[first : first + e.size].reshape(e.shape))
        first += e.size
    return replace(here, residuals=tuple(residuals), H=H)


def _second_differences(x: Array) -> Array:
    """Return the matrix of changes of slope at the inner knots, times their mean distance, ``(k - 2, k)``."""
    step, rows = np.diff(x), np.zeros((len(x) - 2, len(x)))
    for i in range(len(rows)):
        rows[i, i : i + 3] = [1 / step[i], -1 / step[i] - 1 / step[i + 1], 1 / step[i + 1]]
    return np.asarray(rows * step.mean())


def _law(drawn: LawSite, heights: Array, sd: Array, named: Array | None, gained: float) -> LawPicture:
    x, adds = drawn.knots, drawn.knots if drawn.adds else 0.0
    y, band = adds + drawn.factor * heights, WIDE * abs(drawn.factor) * sd
    beside = None if named is None else adds + drawn.factor * named
    tested = f"on left-out blocks it removes {100 * gained:.0f} % of the squared error" if gained > 0 else "left-out blocks do not confirm it"
    said = f"{drawn.words}: {described(x, y, np.abs(band), drawn.adds, drawn.of, drawn.unit)}; {tested}"
    return LawPicture(drawn.words, drawn.against, drawn.unit, drawn.of.unit, x, y, y - band, y + band, beside, said)
