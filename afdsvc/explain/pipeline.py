"""The whole way from a model and recordings to an explanation of the gap between them, one line a step."""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from afdsvc.api.evidence import p_value_text
from afdsvc.api.model import Model
from afdsvc.api.physics import Hypothesis, Physics
from afdsvc.api.signals import Trace
from afdsvc.dataset.experiment import Run, joined, prepare
from afdsvc.dataset.sample_checks import CheckFinding
from afdsvc.dataset.split import Split, split
from afdsvc.explain.check.check import checked, one_frequency
from afdsvc.explain.check.response import refuse_still
from afdsvc.explain.gap.decision import gap_test
from afdsvc.explain.gap.finding import Gap
from afdsvc.explain.gap.settings import GapSettings
from afdsvc.explain.gap.signals import LEAST_SAMPLES
from afdsvc.explain.locate.residual import by_innovations, signal_names, signals
from afdsvc.explain.report.explanation import Explanation
from afdsvc.explain.report.report import report
from afdsvc.explain.search.base import Settled, settled, under_slow_noise
from afdsvc.explain.search.build import build
from afdsvc.explain.search.fit import Fit, rms
from afdsvc.explain.search.forward import Found, Path, Progress, search
from afdsvc.explain.search.problem import Point, Problem
from afdsvc.explain.search.ranking import mechanism
from afdsvc.explain.settings import Mapper, Settings
from afdsvc.explain.simulate.nominal import mean_input, nominal
from afdsvc.explain.verdict.holdout import HeldOutVerdict, checked_on_holdout, doubted, player
from afdsvc.explain.verdict.verdict import DOUBT, verdict

SAME = 1e-4  # power of the difference of two residuals, over that of one: 1 % of its rms
MOST_MISSED = 0.5  # share of the variance of the recordings held out above which what is missed is not taken for noise, unless its size is known
ATTEMPTS = 3  # searches, each without the first names that the recordings held out have not confirmed
SEED = 20261122  # of the surrogates and of the resampled blocks: the same recordings give the same answer


def explain(
    model: Model, recordings: Sequence[Trace], holdout: Sequence[Trace], library: Iterable[Physics], *,
    mapper: Mapper = map, progress: Progress = lambda what, share: None, settings: Settings | None = None,
    trust_units: bool = False, experiment: bool = True,
) -> Explanation:
    """Locate the gap between a model and recordings, name the physics left out, model it, and show the fit.

    Nothing is fitted to ``holdout``; names that do worse there are withdrawn. Without one the last recording, or the last third of a
    single one, is held out. ``mapper`` may run hypotheses in parallel; ``progress`` gets a word and a share (0 to 1). ``trust_units``
    makes warnings of what looks like wrong units or signs; ``experiment`` False leaves out the next experiment. Raises `BadInput`
    for recordings that do not fit the model.
    """
    progress("checking", 0.0)
    findings, roles = _checked(model, recordings, holdout, trust_units)
    base, remainder, offered = settled(replace(_problem(model, roles, settings or Settings(), findings), mapper=mapper)), Remainder(np.random.default_rng(SEED), mapper), list(library)
    progress("testing", 0.0)
    gap = remainder(base.problem, base.start)
    if gap.absent:  # noise limits: the refit may have moved numbers of the model to follow the recordings
        base = replace(base, limited="noise")
    found, answer = _confirmed(base, gap, offered, mapper, progress, remainder, roles.heldout)
    answer = _consistent_there(answer, found.problem, list(found.end)[-1], roles.heldout, remainder)
    progress("reporting", 0.9)
    explanation = report(found, answer, roles, findings, offered, experiment, mapper)
    progress("reporting", 1.0)
    return explanation


def _checked(model: Model, recordings: Sequence[Trace], holdout: Sequence[Trace], trust_units: bool) -> tuple[tuple[CheckFinding, ...], Split]:
    """Return what the check says, and what is fitted and held out."""
    given, recordings = len(recordings), joined(recordings)
    findings = checked(model, recordings, trust_units)
    if len(recordings) < given:
        findings = (*findings, CheckFinding("ok", "recordings", f"{given - len(recordings)} files go on where others end, and are taken as parts of them"))
    runs = prepare(model, [*recordings, *holdout])
    roles = split(runs[: len(recordings)], runs[len(recordings) :])
    refuse_still(model, roles)
    return findings, roles


def _problem(model: Model, roles: Split, settings: Settings, findings: Sequence[CheckFinding]) -> Problem:
    if one_frequency(findings):  # a complex gain for every input and output distinguishes no effects
        settings = replace(settings, effects=1)
    return build(nominal(model, roles.train[0].dt, mean_input(roles.train)), roles.train, settings, roles.heldout)


def _confirmed(
    base: Settled, gap: Gap, library: Sequence[Physics], mapper: Mapper, progress: Progress, remainder: Remainder, heldout: Sequence[Run]
) -> tuple[Found, HeldOutVerdict]:
    """Return what is found and said; where the recordings held out do not confirm the first name, of a search without it."""
    unconfirmed: list[Hypothesis] = []
    answers: list[tuple[Found, HeldOutVerdict]] = []
    while len(answers) < ATTEMPTS and (not answers or answers[-1][1].unconfirmed):
        unconfirmed += [found.steps[0].candidates[0].hypothesis for found, _ in answers[-1:]]
        found = _searched(base, gap, library, mapper, progress, remainder, heldout, [mechanism(h) for h in unconfirmed])
        after = remainder(found.problem, found.end) if found.end is not found.start else None
        answers.append((found, checked_on_holdout(found, verdict(found, gap, after), heldout, len(answers) + 1)))
    named = [k for k, (_, answer) in enumerate(answers) if answer.verdict.claims]
    chosen = next((k for k in named if not answers[k][1].unconfirmed), named[0] if named else 0)
    found, answer = answers[chosen]
    if unconfirmed[:chosen]:
        why = f"{', '.join(h.title for h in unconfirmed[:chosen])} fits better, but the recordings held out do not confirm it: no name is certain"
        answer = replace(answer, verdict=doubted(answer.verdict, why, base.problem.settings.uncertain))
    return found, answer


def _searched(
    base: Settled, before: Gap, library: Sequence[Physics], mapper: Mapper, progress: Progress, remainder: Remainder,
    heldout: Sequence[Run], excluded: Container[tuple[str, ...]],
) -> Found:
    """Return what the search finds; where it finds no effect and noise is not known, also under slow noise, which is divided out.

    Beside an offset that was found, effects found so have to follow the recordings held out better.
    """

    def better(problem: Problem, without: Path, path: Path) -> float:
        last = list(path)[-1]
        return player(problem, last).better(heldout, without[last].point, path[last].point)

    def searched(base: Settled, choose: bool = True) -> Found:
        found = search(base, library, mapper, progress, remainder, better, excluded, choose)
        return found if found.otherwise is None else searched(settled(found.otherwise, choose=False), choose=False)

    found = searched(base)
    if not base.problem.weighting.even or not found.steps or found.effects:
        return found
    again = searched(under_slow_noise(base, 1 - np.clip(before.whitened, 0.0, 1.0)))
    if not found.steps[0].accepted:
        return again
    return again if again.effects and better(base.problem, found.end, again.end) > base.problem.settings.probable else found


def _consistent_there(answer: HeldOutVerdict, problem: Problem, horizon: float, heldout: Sequence[Run], remainder: Remainder) -> HeldOutVerdict:
    """Return the answer, not consistent where the recordings held out contradict it: the model misses more than half of their variance, or a
    flexible model predicts what it misses; short ones are not tested."""
    if answer.verdict.claims or answer.verdict.verdict not in ("consistent", "parameter_change"):
        return answer
    play = player(problem, horizon)
    missed = float(np.mean(play.nrmse(heldout, answer.final.point))) ** 2
    if missed > MOST_MISSED and not problem.weighting.measured:
        return _contradicted(answer, f"the model misses {100 * missed:.0f} % of the variance of the recordings held out: noise that large would hide any law")
    if answer.verdict.verdict != "consistent":
        return answer
    samples = sum(map(len, heldout))
    if samples < LEAST_SAMPLES:
        said = f"the recordings held out have {samples} samples; a test of what is missed there needs at least {LEAST_SAMPLES}"
        return replace(answer, verdict=replace(answer.verdict, sentences=(*answer.verdict.sentences, said)))
    there, point, _ = play.begun(heldout, answer.final.point)
    if rms(there.residuals(point, play.horizon)).max() < problem.settings.rounding:
        return answer
    gap = remainder.of(there, point, play.horizon)
    if not gap.present or gap.total < DOUBT:
        return answer
    said = f"on the recordings held out a flexible model predicts {100 * gap.total:.0f} % of the residual's power ({p_value_text(gap.p_value)}): they show what those fitted do not"
    return _contradicted(answer, said)


def _contradicted(answer: HeldOutVerdict, why: str) -> HeldOutVerdict:
    return replace(answer, verdict=replace(answer.verdict, verdict="unexplained", sentences=(*answer.verdict.sentences, why)))


@dataclass(frozen=True, slots=True, eq=False)
class Remainder:
    """Tests whether the residual of a path is predictable: that of the simulation where the plant allows one.

    Each fit is tested once. A fit whose residual differs from that of a tested one by less than `SAME` gets its answer.
    """

    rng: np.random.Generator
    mapper: Mapper = map
    known: dict[Fit, Gap] = field(default_factory=dict)

    def __call__(self, problem: Problem, path: Path) -> Gap:
        """Return the gap that a path leaves."""
        horizon, fit = list(path.items())[-1]
        tested = next((f for f in self.known if _same(f, fit)), None)
        if tested is not None:
            return self.known[tested]
        point = by_innovations(problem, fit, horizon, GapSettings().whitening_order)
        self.known[fit] = self.of(problem, point, horizon)
        return self.known[fit]

    def of(self, problem: Problem, point: Point, horizon: float) -> Gap:
        """Return the gap at a point."""
        return gap_test(signals(problem, point, horizon), *signal_names(problem), self.rng, mapper=self.mapper)


def _same(a: Fit, b: Fit) -> bool:
    """Whether the residuals of two fits differ by less than `SAME`, in every output."""
    if [e.shape for e in a.residuals] != [e.shape for e in b.residuals]:
        return False
    first, second = np.vstack(a.residuals), np.vstack(b.residuals)
    return bool((((first - second) ** 2).sum(0) <= SAME * (first**2).sum(0)).all())
