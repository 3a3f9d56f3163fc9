"""The whole way from a model and recordings to an explanation of the gap between them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from afdsvc.api.model import Model
from afdsvc.api.physics import Physics
from afdsvc.api.signals import Trace
from afdsvc.dataset.experiment import Run, prepare
from afdsvc.dataset.finding import Finding
from afdsvc.dataset.split import Split, split
from afdsvc.errors import BadInput
from afdsvc.explain.baseline import as_stated
from afdsvc.explain.check import check, insufficient_excitation, objection, one_frequency
from afdsvc.explain.clock import aligned
from afdsvc.explain.explanation import Course, Explanation, Located, OutputFit
from afdsvc.explain.forward import Found, Progress, Yardstick, forward
from afdsvc.explain.freeform import remainder
from afdsvc.explain.improved import extended
from afdsvc.explain.locate import locate
from afdsvc.explain.naming import names, rejections
from afdsvc.explain.next_experiment_rivals import experiment_after, first_experiment
from afdsvc.explain.nominal import nominal
from afdsvc.explain.objective import Objective, Point
from afdsvc.explain.prediction import Player, nrmse, player
from afdsvc.explain.search import Mapper
from afdsvc.explain.settle import started
from afdsvc.explain.spectra import spectra
from afdsvc.explain.strain import strained
from afdsvc.explain.verdict import Judgement, judged
from afdsvc.explain.verify import explained, shape
from afdsvc.lti.statespace import Array
from afdsvc.stats.ar_noise import whiteness_p

MOST_EFFECTS = 3
WORSE = 1.1  # ratio of held-out errors, after to before, beyond which names are withdrawn


def explain(
    model: Model, recordings: Sequence[Trace], holdout: Sequence[Trace], library: Iterable[Physics], *,
    mapper: Mapper = map, progress: Progress = lambda what, share: None, most: int = MOST_EFFECTS, rehearse: bool = True,
) -> Explanation:
    """Locate the gap between a model and recordings, name the physics left out, model it, and show the fit.

    ``holdout`` is never looked at before the report; without one the last recording, or the last third of a single one, is
    kept back. ``mapper`` may run hypotheses in parallel; ``progress`` is told what is going on and how far it is (0 to 1).
    ``rehearse`` False leaves out the next experiment, whose rehearsals can take as long as a round of the search. Nothing is
    drawn at random. Raises `BadInput` for recordings that do not fit the model.
    """
    progress("reading", 0.0)
    offered = list(library)
    findings = check(model, recordings)
    if objection(findings):
        raise BadInput(objection(findings))
    runs = prepare(model, [*recordings, *holdout])
    roles = split(runs[: len(recordings)], runs[len(recordings) :])
    _refuse_still(model, roles.heldout)
    start = nominal(model, runs[0].dt)
    found = forward(start, roles.train, roles.select, offered, most, mapper, progress)
    progress("reporting", 0.9)
    held = roles.heldout if found.tone is None else aligned(found.end.objective, found.end.point, roles.heldout, found.tone)
    roles = Split(found.start.objective.runs, found.select, held)
    answer = _answer(found, roles, offered, findings, rehearse)
    progress("reporting", 1.0)
    return answer


def _refuse_still(model: Model, held: Sequence[Run]) -> None:
    """Raise `BadInput` where a reading never moves in what is held out: no fit could be shown there."""
    for j, v in enumerate(model.outputs):
        y = np.concatenate([r.Y[:, j] for r in held])
        if np.nanmax(y) == np.nanmin(y):
            names = ", ".join(r.name for r in held)
            raise BadInput(f"{names}, held out: y_{v.name} reads {np.nanmin(y) + 0.0:.6g} {v.unit} in every sample; recordings in which it moves are wanted")


def _answer(found: Found, roles: Split, offered: Sequence[Physics], findings: Sequence[Finding], rehearse: bool) -> Explanation:
    nom = found.start.nominal
    playing = player(nom, (*roles.train, *roles.select, *roles.heldout), found.start.point, found.end.objective.simulator.ramped)
    courses = _courses(found, roles, playing)
    held = [c for c in courses if c.role == "heldout"]
    done = explained(Yardstick(found.end, roles.select), found.start.point, found.end.point)
    floor = tuple(float(v) for v in found.end.floor.sd) if found.end.floor.known else None
    fits = tuple(_fit(held, j, v.name, floor) for j, v in enumerate(nom.model.outputs))
    judgement = _by_heldout(_by_excitation(judged(found, done), findings), fits, found)
    named = names(found, {p.name: p.summary for p in offered}) if judgement.keeps else ()

    def error(point: Point) -> float:
        return nrmse(*_stacked([(r.Y, playing.outputs(r, point)) for r in roles.heldout]))

    return Explanation(
        verdict=judgement.verdict,
        located=_located(found, roles),
        named=(*named, *judgement.names),
        rejected=rejections(found, error),
        fit=fits,
        heldout=roles.heldout_names,
        whiteness_p=_whiteness(found, roles.heldout),
        simulated=playing.way,
        explained=(done.fraction, done.sd),
        check=tuple(f.sentence for f in findings),
        sentences=_sentences(judgement, found),
        next_experiment=_next(found, judgement) if rehearse else None,
        remainder=remainder(found.end, roles.select, done.fraction) if judgement.remains else None,
        noise_floor=floor,
        courses=courses,
        spectra=spectra(roles.heldout, held, [v.name for v in nom.model.outputs]),
        nominal=nom,
        point=found.end.point,
        improved=extended(nom, found.end.point),
        notes={"limited_by": found.start.limited, "process_noise_ratio": found.start.ratio, "shapes": _shapes(found)},
    )


def _located(found: Found, roles: Split) -> tuple[Located, ...]:
    """Return where model and recordings part; where only strained numbers hide it, where the model as stated parts from them."""
    start = found.start
    places = locate(start, roles.select, found.machine)
    if places or not strained(start):
        return places
    stated = locate(as_stated(start), roles.select)
    return tuple(replace(p, evidence=f"with the model's numbers as stated: {p.evidence}") for p in stated)


def _shapes(found: Found) -> list[float | None]:
    tests = [shape(found.end, k) for k in range(len(found.end.point.effects))]
    return [None if t is None else t.share for t in tests]


def _by_excitation(judgement: Judgement, findings: Sequence[Finding]) -> Judgement:
    """Return the judgement, or that the excitation does not allow one where nothing can be named."""
    poor = insufficient_excitation(findings)
    if judgement.verdict == "unexplained":
        poor = poor or one_frequency(findings)
    if not poor or judgement.keeps:
        return judgement
    return Judgement("insufficient_excitation", (poor, *judgement.sentences), remains=judgement.remains)


def _by_heldout(judgement: Judgement, fits: Sequence[OutputFit], found: Found) -> Judgement:
    """Return the judgement, or that nothing is claimed because what was found does worse on the recordings nobody had looked at."""
    before, after = (float(np.linalg.norm([getattr(f, k) for f in fits])) for k in ("before_nrmse", "after_nrmse"))
    if not judgement.keeps or not found.steps or after <= WORSE * before:
        return judgement
    best = found.steps[0].ruling.rivals[0].candidate.key
    why = (
        f"on the recordings held out the best hypotheses ({best} first) do worse than the model without them ({100 * after:.3g} % instead of "
        f"{100 * before:.3g} %), so none of them is claimed"
    )
    return Judgement("unexplained", (why, *judgement.sentences), remains=True)


def _next(found: Found, judgement: Judgement) -> Mapping[str, Any] | None:
    if judgement.verdict == "insufficient_excitation":
        return first_experiment(found.start.nominal, found.start.objective.runs).json()
    best = experiment_after(found) if judgement.keeps else None
    return best.json() if best else None


def _courses(found: Found, roles: Split, playing: Player) -> tuple[Course, ...]:
    before = Point(np.zeros(len(found.start.point.theta)), ())
    listed = []
    for role, runs in (("train", roles.train), ("select", roles.select), ("heldout", roles.heldout)):
        for r in runs:
            t: Array = np.asarray(r.t0 + r.dt * np.arange(len(r)), dtype=np.float64)
            listed.append(Course(r.name, role, t, r.Y, playing.outputs(r, before), playing.outputs(r, found.end.point)))
    return tuple(listed)


def _fit(held: Sequence[Course], j: int, name: str, floor: Sequence[float] | None) -> OutputFit:
    y = np.concatenate([c.measured[:, j] for c in held])
    before, after = (np.concatenate([getattr(c, k)[:, j] for c in held]) for k in ("before", "after"))
    noise = None if floor is None else floor[j] / max(float(np.nanstd(y)), 1e-300)
    return OutputFit(name, nrmse(y, before), nrmse(y, after), noise)


def _stacked(pairs: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Return measured and simulated outputs of all runs as one column each, every output in units of its own spread."""
    sizes = np.maximum(np.nanstd(np.vstack([y for y, _ in pairs]), axis=0), 1e-300)
    return tuple(np.concatenate([(p[k] / sizes).ravel() for p in pairs]) for k in (0, 1))  # type: ignore[return-value]


def _whiteness(found: Found, heldout: Sequence[Run]) -> tuple[float, float]:
    objective = replace(found.end.objective, runs=tuple(heldout))
    return _white(objective, Point(np.zeros(len(found.start.point.theta)), ())), _white(objective, found.end.point)


def _white(objective: Objective, point: Point) -> float:
    pieces = objective.whitened(started(objective, point))
    return whiteness_p(pieces) if all(np.isfinite(w).all() for w in pieces) else 0.0


def _sentences(judgement: Judgement, found: Found) -> tuple[str, ...]:
    stop = () if found.last is None else (f"the search stopped: {found.last.reason}",)
    return (*judgement.sentences, *stop)
