"""The whole answer from a search and its verdict."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from afdsvc.api.physics import Physics
from afdsvc.dataset.sample_checks import CheckFinding
from afdsvc.dataset.split import Split
from afdsvc.explain.check.check import insufficient_excitation, one_frequency
from afdsvc.explain.experiment.next_experiment import experiment_after, first_experiment
from afdsvc.explain.locate.picture import picture
from afdsvc.explain.locate.places import located
from afdsvc.explain.noise.weighting import weighting
from afdsvc.explain.report.courses import courses, fits, spectra, white
from afdsvc.explain.report.explanation import Explanation, Nearest
from afdsvc.explain.report.naming import estimates, names, nearest, offsets, rejections, value_text
from afdsvc.explain.search.fit import Fit, rms
from afdsvc.explain.search.forward import Found
from afdsvc.explain.search.problem import NUISANCE, Problem
from afdsvc.explain.settings import Mapper
from afdsvc.explain.simulate.nominal import Nominal, entry_name
from afdsvc.explain.simulate.simulator import Simulator
from afdsvc.explain.verdict.holdout import HeldOutVerdict, moments, player
from afdsvc.explain.verdict.verdict import Verdict
from afdsvc.lti.statespace import Array
from afdsvc.lti.transfer_function import ratio_text, to_polynomials

SEED = 1  # of the flexible model's features
MOVED = 4  # numbers that a sentence lists at most
CLEAR = 3.0  # standard deviations from which a load is reported


def report(
    found: Found, answer: HeldOutVerdict, roles: Split, findings: Sequence[CheckFinding], library: Iterable[Physics], experiment: bool = True,
    mapper: Mapper = map,
) -> Explanation:
    """Return the explanation: names, courses and fits on what was held out; ``experiment`` False leaves out the next experiment.

    ``mapper`` may work on its parts in parallel.
    """
    play, model = player(found.problem, list(found.end)[-1]), found.problem.nominal.model
    before, verdict, final = found.problem.start(), _excited(answer.verdict, findings), answer.final
    held = courses(play, roles.heldout, "heldout", before, final.point)
    floor = _floor(found, final)
    outputs = [v.name for v in model.outputs]
    claimed = [c.candidate.hypothesis for c in verdict.claims]
    unexplained = verdict.verdict == "unexplained"
    where, named, law, next_experiment, rejected = mapper(lambda part: part(), (
        lambda: located(found.problem, found.start[list(found.start)[-1]], list(found.start)[-1], verdict.gap, np.random.default_rng(SEED)),
        lambda: names(found, verdict, final, {p.name: p.summary for p in library}),
        lambda: picture(found, final, bool(claimed)) if claimed or unexplained else None,
        lambda: _next(found, verdict) if experiment else None,
        lambda: rejections(found, claimed, lambda point: float(np.mean(play.nrmse(roles.heldout, point)))),
    ))
    last, nominal = list(found.end)[-1], found.problem.nominal
    fitted = (*_moments(found.problem, final), *_moved(nominal, final), *_loads(found.problem, final, last), *_offsets(found.problem, final, last))
    return Explanation(
        verdict=verdict.verdict, located=where, named=named, rejected=rejected, candidates=_nearest(found, verdict), law=law,
        fit=fits(held, outputs, floor), heldout=roles.heldout_names, whiteness_p=white(found.problem, held), simulated=play.way,
        explained=verdict.explained if claimed else (0.0, 0.0), gap=verdict.gap, remainder=verdict.remainder if claimed else None,
        check=tuple(f.sentence for f in findings), sentences=(*verdict.sentences, *fitted), next_experiment=next_experiment, noise_floor=floor,
        courses=(*courses(play, roles.train, "train", before, final.point), *held), spectra=spectra(roles.heldout, held, outputs),
        nominal=nominal, point=final.point, substeps=found.problem.substeps, notes=_notes(found, final),
    )


def _nearest(found: Found, verdict: Verdict) -> tuple[Nearest, ...]:
    """Return the laws that come nearest where none is named although there is a gap, or the search found one and the recordings are too short for it."""
    short = verdict.verdict == "insufficient_excitation" and bool(found.steps) and found.steps[0].accepted
    return nearest(found) if verdict.verdict == "unexplained" or short else ()


def _excited(verdict: Verdict, findings: Sequence[CheckFinding]) -> Verdict:
    """Return the verdict, or that excitation or length of the recordings do not allow one where nothing can be named."""
    poor = insufficient_excitation(findings)
    if verdict.verdict == "unexplained":
        poor = poor or one_frequency(findings)
    if verdict.verdict in ("consistent", "unexplained") and not (verdict.gap.present or verdict.gap.enough):
        poor = poor or "the residual changes too slowly for the length of the recordings to distinguish a gap from noise"
    if not poor or verdict.claims:
        return verdict
    return replace(verdict, verdict="insufficient_excitation", sentences=(poor, *verdict.sentences))


def _moments(problem: Problem, final: Fit) -> Iterator[str]:
    """Yield a sentence on every change at a moment: in which recording it comes, and when there."""
    for effect, value in ((final.point.effects[i], final.point.effects[i].values[j]) for i, j in moments(final.point)):
        there = next((f"at {r.t0 + value - r.begins:.4g} s of {r.name}" for r in problem.runs if r.begins <= value < r.begins + len(r) * r.dt), "between two recordings")
        yield f"{effect.hypothesis.title}: the change comes {there}; recordings held out are compared with the moment that fits each of them best"


def _moved(nominal: Nominal, final: Fit) -> Iterator[str]:
    """Yield a sentence on the numbers of the model that the final fit moved by more than a stated standard deviation, the farthest first."""
    theta = final.point.theta
    far = sorted(((e, t) for e, t in zip(nominal.entries, theta, strict=True) if abs(t) > 1), key=lambda pair: -abs(pair[1]))
    if far and nominal.transfer:
        yield f"the fit moves the model, its coefficients by {abs(far[0][1]):.1f} stated standard deviations at most: {', '.join(_ratios(nominal, theta))}"
        return
    stated, fitted = nominal.values(0 * theta), nominal.values(theta)
    said = [f"{entry_name(nominal, e)} from {stated[e.name]:.4g} to {fitted[e.name]:.4g} ({t:+.1f} stated standard deviations)" for e, t in far[:MOVED]]
    if said:
        yield f"the fit moves numbers of the model: {', '.join(said)}{f' and {len(far) - MOVED} more' if len(far) > MOVED else ''}"


def _ratios(nominal: Nominal, theta: Array) -> Iterator[str]:
    """Yield every transfer function that the fit changed, stated and fitted."""
    model, plants = nominal.model, (nominal.plant, nominal.at(theta))
    for i, y in enumerate(model.outputs):
        for j, u in enumerate(model.inputs):
            stated, fitted = (ratio_text(*to_polynomials(plant, i, j), nominal.variable) for plant in plants)
            if stated != fitted:
                yield f"from {u.name} to {y.name} from {stated} to {fitted}"


def _loads(problem: Problem, final: Fit, horizon: float) -> Iterator[str]:
    """Yield a sentence on every constant load that every fit of an integrating plant has, where it is not zero."""
    for effect, values in zip(final.point.effects, estimates(problem, final, horizon), strict=True):
        if effect.hypothesis.family == NUISANCE:
            load = values["load"]
            if load.sd is not None and abs(load.value) > CLEAR * load.sd:
                site = effect.hypothesis.site.removeprefix("state:")
                yield f"a constant {value_text('load', load)} on {site} is fitted to these recordings; the improved model does not have it"


def _offsets(problem: Problem, final: Fit, horizon: float) -> Iterator[str]:
    """Yield a sentence on every reading whose fitted zero matters beside what the model misses of it."""
    matters = np.abs(final.point.offset) > problem.scale * rms(final.residuals)
    for v, fitted, large in zip(problem.nominal.model.outputs, offsets(problem, final, horizon) if matters.any() else (), matters, strict=False):
        if large and fitted.sd is not None and abs(fitted.value) > CLEAR * fitted.sd:
            yield f"a constant {value_text('offset', fitted)} of the reading {v.name} is fitted to these recordings, as one is to those held out; the improved model does not have it, so its own error there is larger"


def _next(found: Found, verdict: Verdict) -> Mapping[str, Any] | None:
    poor = verdict.verdict == "insufficient_excitation"
    best = first_experiment(found.problem.nominal, found.problem.runs) if poor else experiment_after(found, verdict.claims)
    return best.json() if best else None


def _floor(found: Found, final: Fit) -> tuple[float, ...] | None:
    """Return the standard deviation of the noise per output: of what does not repeat with the excitation; None without repetition."""
    last, problem = list(found.end)[-1], found.problem
    power = weighting(problem.runs, problem.residuals(final.point, last)).floor
    return tuple(float(v) for v in np.sqrt(power) * problem.scale) if np.isfinite(power).all() else None


def _notes(found: Found, final: Fit) -> dict[str, Any]:
    last = list(found.end)[-1]
    simulator = Simulator(found.problem.nominal, found.problem.gains[last])
    return {
        "limited_by": found.limited, "correction": last, "correlation_time_samples": final.own_tau, "rounds": len(found.steps),
        "simulation": list(simulator.notes),
    }
