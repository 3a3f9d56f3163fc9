"""The whole answer from a search and its verdict."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from afdsvc.api.physics import Physics
from afdsvc.dataset.sample_checks import Finding
from afdsvc.dataset.split import Split
from afdsvc.explain.check.check import insufficient_excitation, one_frequency
from afdsvc.explain.experiment.next_experiment import experiment_after, first_experiment
from afdsvc.explain.locate.picture import picture
from afdsvc.explain.locate.places import located
from afdsvc.explain.noise.weighting import weighting
from afdsvc.explain.report.courses import Player, courses, fits, player, white
from afdsvc.explain.report.explanation import Explanation
from afdsvc.explain.report.naming import names, nearest, rejections
from afdsvc.explain.report.spectra import spectra
from afdsvc.explain.search.fit import Fit, fit
from afdsvc.explain.search.forward import Found
from afdsvc.explain.search.nuisance import NUISANCE
from afdsvc.explain.search.problem import Point
from afdsvc.explain.simulate.simulator import Simulator
from afdsvc.explain.verdict.verdict import Verdict

SEED = 1  # of the flexible model's features
WORSE = 1.1  # ratio of held-out errors, after to before, beyond which names are withdrawn


def report(found: Found, verdict: Verdict, roles: Split, findings: Sequence[Finding], library: Iterable[Physics], experiment: bool = True) -> Explanation:
    """Return the explanation: names, courses and fits on what was held out; names that do worse there are withdrawn.

    ``experiment`` False leaves out the next experiment.
    """
    play, model = player(found), found.problem.nominal.model
    before = found.problem.start()
    verdict, final = _final(found, _excited(verdict, findings), play, roles)
    held = courses(play, roles.heldout, "heldout", before, final.point)
    floor = _floor(found, final)
    outputs = [v.name for v in model.outputs]
    claimed = [c.candidate.hypothesis.key for c in verdict.claims]
    unexplained = verdict.verdict == "unexplained"
    return Explanation(
        verdict=verdict.verdict,
        located=located(found.problem, found.start[list(found.start)[-1]], list(found.start)[-1], verdict.gap, np.random.default_rng(SEED)),
        named=names(found, verdict, final, {p.name: p.summary for p in library}),
        rejected=rejections(found, claimed, lambda point: float(np.mean(play.nrmse(roles.heldout, point)))),
        fit=fits(held, outputs, floor),
        heldout=roles.heldout_names,
        whiteness_p=white(found.problem, held),
        simulated=play.way,
        explained=verdict.explained if claimed else (0.0, 0.0),
        gap=verdict.gap,
        remainder=verdict.remainder if claimed else None,
        candidates=nearest(found) if unexplained else (),
        law=picture(found, final, bool(claimed)) if claimed or unexplained else None,
        check=tuple(f.sentence for f in findings),
        sentences=verdict.sentences,
        next_experiment=_next(found, verdict) if experiment else None,
        noise_floor=floor,
        courses=(*courses(play, roles.train, "train", before, final.point), *held),
        spectra=spectra(roles.heldout, held, outputs),
        nominal=found.problem.nominal,
        point=final.point,
        notes=_notes(found, final),
    )


def _excited(verdict: Verdict, findings: Sequence[Finding]) -> Verdict:
    """Return the verdict, or that the excitation does not allow one where nothing can be named."""
    poor = insufficient_excitation(findings)
    if verdict.verdict == "unexplained":
        poor = poor or one_frequency(findings)
    if not poor or verdict.claims:
        return verdict
    return replace(verdict, verdict="insufficient_excitation", sentences=(poor, *verdict.sentences))


def _final(found: Found, verdict: Verdict, play: Player, roles: Split) -> tuple[Verdict, Fit]:
    """Return the verdict and the final fit: with the claimed effects, else the numbers refitted, else the model as stated.

    What does worse on the recordings held out than the model as stated is withdrawn; what does not do better there than the
    model refitted without effects, or worse than a constant, is not certain.
    """
    last = list(found.end)[-1]
    claimed = {c.candidate.hypothesis.key for c in verdict.claims}
    stated, refitted = (_error(play, roles, p) for p in (found.problem.start(), found.start[last].point))
    if claimed:
        final = _with(found, claimed)
        error = _error(play, roles, final.point)
        if error <= WORSE * stated:
            return verdict if error < min(refitted, 1.0) else _doubted(verdict, error, refitted, found.problem.settings.uncertain), final
        verdict = _withdrawn(verdict, stated, error)
    if refitted <= WORSE * stated:
        return verdict, found.start[last]
    return verdict, fit(found.problem, found.problem.start(), last, found.start[last].tau, iterations=0)


def _with(found: Found, keys: set[str]) -> Fit:
    """Return the final fit with these effects only (and the unknown loads every fit has), refitted where others go."""
    last = list(found.end)[-1]
    end = found.end[last]
    kept = tuple(e for e in end.point.effects if e.hypothesis.key in keys or e.hypothesis.family == NUISANCE)
    return end if len(kept) == len(end.point.effects) else fit(found.problem, replace(end.point, effects=kept), last, end.tau)


def _error(play: Player, roles: Split, point: Point) -> float:
    return float(np.mean(play.nrmse(roles.heldout, point)))


def _doubted(verdict: Verdict, error: float, refitted: float, most: float) -> Verdict:
    why = (
        f"on the recordings held out the error is {100 * error:.3g} %, and {100 * refitted:.3g} % for the model refitted without an "
        "effect, so no name is certain"
    )
    claims = tuple(replace(c, weight=min(c.weight, most)) for c in verdict.claims)
    return replace(verdict, claims=claims, sentences=(*verdict.sentences, why))


def _withdrawn(verdict: Verdict, before: float, after: float) -> Verdict:
    best = verdict.claims[0].candidate.hypothesis.key
    why = (
        f"on the recordings held out the error is {100 * after:.3g} % with {best} and {100 * before:.3g} % with the model as stated, "
        "so nothing is claimed"
    )
    return replace(verdict, verdict="unexplained", claims=(), sentences=(why, *verdict.sentences))


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
