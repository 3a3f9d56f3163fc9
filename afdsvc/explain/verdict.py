"""The verdict: consistent, a parameter off, physics left out, or unexplained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from afdsvc.explain.coloured import ROUNDING, coloured, faintly_coloured
from afdsvc.explain.explanation import Named
from afdsvc.explain.forward import Found
from afdsvc.explain.naming import is_change
from afdsvc.explain.settle import raw, started
from afdsvc.explain.stationary import Growth, growth
from afdsvc.explain.stepped import stepped
from afdsvc.explain.strain import irregular, strained
from afdsvc.explain.verify import Explained

ENOUGH = 0.8  # explained fraction below which names are withdrawn
SOMETHING = 1e-6  # p-value of what repeats below which something is there
SURELY_LEFT = 1e-4  # p-value of what is left below which it is more than noise
COLOURED = "coloured_noise"
OTHER_NOISE = 1.25  # ratio to the stated noise from which it is said


@dataclass(frozen=True, slots=True)
class Judgement:
    """The verdict with its reasons; ``names`` are those of the noise, ``keeps`` says whether the physics found may be named."""

    verdict: str
    sentences: tuple[str, ...]
    keeps: bool = False
    names: tuple[Named, ...] = ()
    remains: bool = False


def judged(found: Found, done: Explained) -> Judgement:
    """Return the verdict on a finished search."""
    if _only_rounding(found):
        return Judgement("consistent", (f"what is left is less than {ROUNDING:g} of every reading, as the rounding of computed recordings",))
    told = _noise_names(found)
    words = (*_noise_words(found), *(n.sentence for n in told))
    noise = tuple(n for n in told if found.end.limited == "noise" or n.physics != COLOURED)  # colour may be what the model leaves
    restless = growth(found.end.objective.runs, raw(found.end.objective, found.end.point))
    rounded = {n.site for n in noise if n.physics == "quantisation"}  # what rounding does repeats, and follows the level
    if restless is not None and restless.matters and f"output:{found.end.nominal.model.outputs[restless.output].name}" not in rounded:
        return Judgement("unexplained", (_restless(found, restless), *words), remains=True)
    if found.steps and _too_little(done):
        best = found.steps[0].ruling.rivals[0].candidate.key
        why = f"only {100 * done.fraction:.0f} % of the gap goes with the best hypotheses ({best} first), so none of them is claimed"
        return Judgement("unexplained", (why, *words), remains=True)
    tinted = {n.site.partition(":")[2] for n in noise if n.physics == COLOURED}
    lacking = strained(found.end, _explained_by_laws(found)) or (irregular(found.end, tinted) if found.steps else "")
    if lacking:
        nearest = f"; nearest comes {found.steps[0].ruling.rivals[0].candidate.key}, which is not claimed" if found.steps else ""
        return Judgement("unexplained", (lacking + nearest, *words), remains=True)
    if found.steps:
        changed = is_change([e.hypothesis for e in found.end.point.effects]) and not noise
        return Judgement("parameter_change" if changed else "omitted_physics", (_closed(found, done), *words), True, noise, _left(done))
    if _left(done) and not rounded:
        p = done.before.total.p if done.before else 0.0
        why = f"something repeats with the excitation (p = {p:.1g}) that no hypothesis explains"
        return Judgement("unexplained", (why, *words), remains=True)
    if noise:
        return Judgement("omitted_physics", words, True, noise, _left(done))
    faint = _faint_noise_names(found)
    if faint:
        return Judgement("omitted_physics", (*words, *(n.sentence for n in faint)), True, faint)
    return Judgement("consistent", ("nothing is left in the recordings but noise", *words))


def _only_rounding(found: Found) -> bool:
    """Whether the model leaves no more than arithmetic does, at every output."""
    runs = found.start.objective.runs
    left = np.max([np.sqrt(np.nanmean(e**2, axis=0)) for e in raw(found.start.objective, found.start.point)], axis=0)
    return bool((left < ROUNDING * np.max([np.nanstd(r.Y, axis=0) for r in runs], axis=0)).all())


def _explained_by_laws(found: Found) -> float:
    """Return by how much the named laws lower the cost, with what the model's numbers had absorbed; 0 where only constants are changed."""
    effects = found.end.point.effects
    if not effects or is_change([e.hypothesis for e in effects]):
        return 0.0
    return _fallen(found) + max(_relieved(found), 0.0)


def _fallen(found: Found) -> float:
    """Return by how much the whitened sum of squares has fallen since the start of the search, at least 0."""
    costs = [float(np.square(b.objective.vector(b.point)).sum()) for b in (found.start, found.end)]
    return max(costs[0] - costs[1], 0.0)


def _relieved(found: Found) -> float:
    """Return by how much the strain of the model's numbers, as a sum of squares, is less than at the start of the search."""
    before, after = (float(np.dot(b.point.theta, b.point.theta)) for b in (found.start, found.end))
    return before - after


def _restless(found: Found, g: Growth) -> str:
    output = found.end.nominal.model.outputs[g.output].name
    return (
        f"what does not repeat with the excitation is {g.ratio:.2g} times as powerful in {g.loud} as in {g.quiet} at {output} "
        f"(p = {g.p:.1g}): it is no noise of the sensor, and no hypothesis explains it"
    )


def _too_little(done: Explained) -> bool:
    """Whether the names leave too much of the gap, and what they leave is no noise.

    Where nothing that counts repeated before, nothing that counts is left: the evidence lay elsewhere, as in strain that a constant
    took away.
    """
    nothing_before = done.before is not None and done.before.total.p >= SOMETHING
    return not nothing_before and done.fraction + done.sd < ENOUGH and done.p_left < SURELY_LEFT


def _left(done: Explained) -> bool:
    """Whether something still repeats with the excitation at the end."""
    return done.after is not None and done.after.total.p < SOMETHING


def _closed(found: Found, done: Explained) -> str:
    said = _absorbed(found) or f"{100 * min(done.fraction, 1.0):.0f} % of the gap is explained"
    if not _left(done):
        return said
    assert done.after is not None  # noqa: S101
    return f"{said}; a remainder still repeats with the excitation (p = {done.after.total.p:.1g})"


def _absorbed(found: Found) -> str:
    """Return how much nearer to their statement the model's numbers are, where that is most of the evidence; else ""."""
    if _relieved(found) <= _fallen(found):
        return ""
    far, near = (float(np.linalg.norm(b.point.theta)) for b in (found.start, found.end))
    return f"other numbers of the model had absorbed it: they are {near:.2g} standard deviations from what is stated instead of {far:.2g}"


def _noise_names(found: Found) -> tuple[Named, ...]:
    outputs = [(v.name, v.unit) for v in found.end.nominal.model.outputs]
    residuals = raw(found.end.objective, found.end.point)
    first = len(found.order) + 1
    steps = stepped(found.machine.outputs, found.end.floor.sd, first) if found.end.floor.known else ()
    return (*steps, *coloured(found.end.objective.runs, residuals, outputs, first + len(steps), predicted=found.end.ratio > 0))


def _faint_noise_names(found: Found) -> tuple[Named, ...]:
    """Return names for colour of the noise that shows in all recordings together, where they hold nothing else."""
    base = found.end
    if base.limited != "noise" or base.ratio > 0:
        return ()
    runs = (*base.objective.runs, *found.select)
    objective = replace(base.objective, runs=runs)
    residuals = raw(objective, started(objective, base.point))
    return faintly_coloured(runs, residuals, [(v.name, v.unit) for v in base.nominal.model.outputs])


def _noise_words(found: Found) -> Sequence[str]:
    """Return what the noise is beside what the model states."""
    stated, floor = found.end.nominal.model.output_sd, found.end.floor
    said = []
    if floor.known and stated is not None:
        ratios = floor.sd / np.maximum(stated, 1e-300)
        for v, ratio in zip(found.end.nominal.model.outputs, ratios, strict=True):
            if not 1 / OTHER_NOISE < ratio < OTHER_NOISE:
                said.append(f"the noise of sensor {v.name} is {ratio:.2g} times the stated one")
    if found.end.ratio > 0 and found.end.limited == "noise":
        said.append("noise acts inside the machine too, not only on its sensors: the model is compared as a one-step predictor")
    return said
