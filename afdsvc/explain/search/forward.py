"""Forward and backward search: which effects, one after another, close the gap."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from afdsvc.api.physics import Hypothesis, Machine, Physics
from afdsvc.explain.gap.finding import Gap
from afdsvc.explain.noise.weighting import noise_share
from afdsvc.explain.search.base import Settled, otherwise_between
from afdsvc.explain.search.evidence import (
    HypothesisEvidence,
    Losses,
    block_spans,
    fitted_losses,
    hypothesis_evidence,
    noise_times,
    refitted,
)
from afdsvc.explain.search.fit import Fit, priced
from afdsvc.explain.search.machine import bandwidth, hypotheses, machine
from afdsvc.explain.search.path import (
    FINER,
    added_path,
    bases,
    coarse,
    converged,
    exchanged_path,
    fewer_path,
    kept_promises,
    promising,
    refined,
    resumed_path,
    trial,
    whole_path,
)
from afdsvc.explain.search.problem import Problem
from afdsvc.explain.search.ranking import (
    Candidate,
    in_no_doubt,
    is_constant,
    is_offset,
    is_reason,
    look_alikes,
    mechanism,
    vote_shares,
    winner,
)
from afdsvc.explain.search.screen import shortlist
from afdsvc.explain.settings import Mapper
from afdsvc.stats.spectral_peaks import peaks
from afdsvc.stats.tones import tones

Path = dict[float, Fit]
Progress = Callable[[str, float], None]
Better = Callable[[Problem, Path, Path], float]

AT_END = 0.99  # of the end of a range, from where on a fit counts as ended there
STARTS = 2  # of every hypothesis that are tried, by what they promise


@dataclass(frozen=True, slots=True, eq=False)
class Round:
    """One round: the candidates, best first; whether the first was accepted, and why not; of an accepted one, why only the recordings held out could
    confirm it, and, of a further effect, what is decided ``instead`` where they do not. ``limited`` says what limits the best fit: "noise" or "model".
    ``worse`` are look-alikes with which those recordings are surely followed worse, ``confirmed`` how sure they are followed better with it."""

    candidates: tuple[Candidate, ...]
    accepted: bool
    limited: str
    reason: str = ""
    instead: Round | None = None
    worse: tuple[Candidate, ...] = ()
    confirmed: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What the search found: the problem, the refitted model without effects, the final one, the rounds.

    ``evidence`` is that of the final model over the one without effects. ``otherwise`` is the problem with inputs held instead of smooth between
    samples, or the other way round, where the effects fit better so: then the search ended with them and has to begin anew.
    """

    problem: Problem
    start: dict[float, Fit]
    end: dict[float, Fit]
    machine: Machine
    steps: tuple[Round, ...]
    limited: str
    evidence: HypothesisEvidence
    otherwise: Problem | None = None

    @property
    def effects(self) -> int:
        """How many effects were accepted, offsets aside."""
        return sum(s.accepted and not is_offset(s.candidates[0].hypothesis) for s in self.steps)


def search(
    settled: Settled, library: Sequence[Physics], mapper: Mapper = map, progress: Progress = lambda what, share: None,
    remainder: Callable[[Problem, Path], Gap | None] = lambda problem, path: None, better: Better = lambda problem, before, after: 0.5,
    excluded: Container[tuple[str, ...]] = (), choose: bool = True,
) -> Found:
    """Return what the search finds; every effect accepted is refitted with all numbers of the model. Mechanisms ``excluded`` are not tried.

    ``remainder`` tests whether the residual of a path is predictable. ``better`` says how sure it is that the recordings held out are followed better with an
    effect: it has to be where the effect gains, but in too few resampled blocks or closing too little of the gap, and a further effect must not do worse
    there. In the end an effect without which they are likely followed better is dropped.
    Offsets belong to the recordings, not to the machine: they count as no effect, and what comes after them is compared with the model that has them.
    Half a sample between held and smooth inputs would stand for a further effect, so with ``choose`` that is decided anew beside each; so would
    the error of coarse steps, which laws that are simulated in finer ones do not have.
    """
    problem, start, limited = settled.problem, settled.start, settled.limited
    rounds = whole = Rounds(problem, settled.part, settled.taus, start, settled.rough, limited, mapper, remainder, {}, progress)
    path, rough = start, settled.rough
    steps: list[Round] = []
    seen = _seen(problem, path, limited)
    number = problem.settings.effects if float(list(start.values())[-1].sd.max()) < problem.settings.rounding else 0
    while number < problem.settings.effects and len(steps) < 2 * problem.settings.effects:  # two offsets may take turns
        if number and rounds.exhausted(path):
            break
        seen = _seen(problem, path, limited)
        offered = [h for h in hypotheses(library, seen, not problem.regular) if h.key not in _keys(path) and mechanism(h) not in excluded]
        rounds = replace(rounds, at=(f"round {len(steps) + 1}", number / problem.settings.effects))
        step = rounds.next(path, rough, offered, number > 0)
        more, surely = rounds.accepted(step.candidates[0]) if step.accepted else (path, rough), 1.0
        while step.accepted and (
            _ended(more[0]) or ((step.reason or number) and not (surely := better(problem, path, more[0])) > (problem.settings.sure if step.reason else 0.0))
        ):
            why = "its fit ends at the limit of what it means" if _ended(more[0]) else "the recordings held out are followed worse with it"
            refuted = replace(step, accepted=False, reason=step.reason or f"{step.candidates[0].hypothesis.title}: {why}")
            steps, step = (steps, refuted) if step.instead is None else ([*steps, refuted], step.instead)
            more = rounds.accepted(step.candidates[0]) if step.accepted else (path, rough)
        steps.append(replace(step, confirmed=surely))
        if not step.accepted:
            break
        path, rough = more
        if coarse(problem, path):
            finer = [r.finer(noise_times([rough]) | noise_times([path])) for r in (rounds, whole)]
            again = refined(finer[0].problem, finer[0].part, finer[0].taus, path, rough)
            if list(again[0].values())[-1].deviance < list(path.values())[-1].deviance:  # else coarse steps favour no other law
                (rounds, whole), problem, (path, rough) = finer, finer[0].problem, again
        rounds, whole = (replace(r, taus=noise_times([rough]) | noise_times([path])) for r in (rounds, whole))
        if is_offset(step.candidates[0].hypothesis):
            rounds = replace(rounds, start=path, losses={})
        else:
            number += 1
        if choose and (otherwise := otherwise_between(problem, path)) is not None:
            return Found(problem, start, path, seen, tuple(steps), limited, whole.over(path, start, 0), otherwise)
    path, steps = _helpful(whole, *whole.exchanged(path, steps), better)
    steps = [_followed(problem, step, path, better) if step.accepted else step for step in steps]
    return Found(problem, start, path, seen, tuple(steps), limited, whole.over(path, start, 0))


def _kept(steps: Sequence[Round], path: dict[float, Fit]) -> list[Round]:
    """Return the rounds, not accepted where a later one left nothing for their effect; of an effect that was found again the last."""
    last = {s.candidates[0].hypothesis.key: s for s in steps if s.accepted}
    gone = [s.accepted and not (s.candidates[0].hypothesis.key in _keys(path) and s is last[s.candidates[0].hypothesis.key]) for s in steps]
    why = "{}: nothing is left for it beside the other effects"
    return [replace(s, accepted=False, reason=why.format(s.candidates[0].hypothesis.title)) if g else s for s, g in zip(steps, gone, strict=True)]


def _helpful(rounds: Rounds, path: Path, steps: Sequence[Round], better: Better) -> tuple[Path, list[Round]]:
    """Return the path and the rounds without effects that the recordings held out are likely followed better without, beside the others."""
    found = list(steps)
    for k, step in enumerate(found):
        at = [i for i, e in enumerate(list(path.values())[-1].point.effects) if step.accepted and e.hypothesis.key == step.candidates[0].hypothesis.key]
        if at and sum(s.accepted for s in found) > 1:
            fewer = fewer_path(rounds.problem, path, rounds.taus, at[0])
            if better(rounds.problem, path, fewer) > rounds.problem.settings.probable:
                why = f"{step.candidates[0].hypothesis.title}: the recordings held out are followed better without it"
                path, found[k] = fewer, replace(step, accepted=False, reason=why)
    return path, [*(s for s in found if s.accepted), *(s for s in found if not s.accepted)]


def _followed(problem: Problem, step: Round, path: Path, better: Better) -> Round:
    """Return a round with the look-alikes apart with which, all other effects the same, the recordings held out are surely followed worse; the more
    there are, the surer (Bonferroni)."""
    alike = look_alikes(step.candidates, problem.settings, step.limited)
    level, others = 1 - (1 - problem.settings.sure) / max(1, len(alike) - 1), _keys(path) - {alike[0].hypothesis.key}
    worse = [mechanism(c.hypothesis) for c in alike[1:] if _keys(c.path) - {c.hypothesis.key} == others and better(problem, c.path, path) > level]
    apart = tuple(c for c in step.candidates if mechanism(c.hypothesis) in worse)
    return replace(step, candidates=tuple(c for c in step.candidates if c not in apart), worse=apart)


def _ended(path: Path) -> bool:
    """Whether the last effect of a path is at the end of a range that decides what it is."""
    effects = list(path.values())[-1].point.effects[-1:]
    return any(c.decisive and v >= AT_END * c.high for e in effects for c, v in zip(e.hypothesis.parameters, e.values, strict=True))


def _keys(path: Path) -> set[str]:
    return {e.hypothesis.key for e in list(path.values())[-1].point.effects}


def _seen(problem: Problem, path: dict[float, Fit], limited: str) -> Machine:
    """Return the machine along the final fit of a path, with the lines and peaks of its residual."""
    last = list(path)[-1]
    residuals = problem.residuals(path[last].point, last)
    return machine(problem, path[last], last, [t.omega for t in tones(problem.runs, residuals)], peaks(problem.runs, residuals, 2 * bandwidth(problem.runs)), limited)


@dataclass(frozen=True, slots=True, eq=False)
class Rounds(Settled):
    """What the rounds of a search share: the model without effects, the map, the judgement of what remains."""

    mapper: Mapper
    remainder: Callable[[Problem, Path], Gap | None]
    losses: dict[tuple[Fit, int], Losses]
    progress: Progress
    at: tuple[str, float] = "", 0.0  # the round, and the share of the search done before it

    def mapped(self, what: str, begin: float, end: float, function: Callable[[Any], Any], items: Iterable[Any]) -> list[Any]:
        """Return the function of all items, saying how many are done; ``begin`` and ``end`` are shares of the round."""
        given, found = list(items), []
        for result in self.mapper(function, given):
            found.append(result)
            share = (begin + (end - begin) * len(found) / len(given)) / self.problem.settings.effects
            self.progress(f"{self.at[0]}, {what} {len(found)} of {len(given)}", self.at[1] + share)
        return found

    def block_losses(self, path: dict[float, Fit], tau: float) -> Losses:
        """Return the losses of blocks for a correlation time, left out and fitted, at the decision horizon; each fit is asked once."""
        last, f = list(path.items())[-1]
        spans, scale = block_spans([len(e) for e in f.residuals], tau, self.problem.settings), list(self.start.values())[-1].sd
        if (f, len(spans)) not in self.losses:
            self.losses[f, len(spans)] = refitted(self.problem, last, f, spans, scale), fitted_losses(f, spans, scale)
        return self.losses[f, len(spans)]

    def gap(self, tau: float) -> float:
        """Return what could be closed at the decision horizon: the loss of blocks for a correlation time, where the noise is known what
        is above it, and the distance of the model's numbers from what is stated."""
        base, w = list(self.start.values())[-1], self.problem.weighting
        floor = 0.0 if w.even else float(base.samples * (w.noise / base.sd**2).sum())
        return max(float(self.block_losses(self.start, tau)[0].sum()) - floor, float(np.sqrt(2.0 * base.samples))) / tau + 2 * base.penalty

    def exhausted(self, path: Path) -> bool:
        """Return whether no effect beside those of a path could be accepted: too small a share of what it leaves repeats with the excitation or
        is predictable, even if the model's numbers came back to what is stated."""
        gap, last = self.remainder(self.problem, path) if self.limited == "model" else None, list(path.values())[-1]
        if gap is None or gap.repeats is None:
            return False
        reach, tau, eased = np.array(gap.within_reach), last.own_tau, 2 * last.penalty + max(last.narrowed, 0.0)
        closed = 1 - float(np.prod(1 - reach)) ** (1 / len(reach)) * np.exp(-eased * tau / (last.samples * len(reach)))
        share = (float(reach @ last.sd**2) * last.samples / tau + eased) / self.gap(tau)
        return bool(max(closed, share) < self.problem.settings.further)

    def next(self, path: dict[float, Fit], rough: dict[float, Fit], offered: Sequence[Hypothesis], further: bool) -> Round:
        """Screen all hypotheses, fit the promising ones along the horizons, those that keep their promise to whole recordings, and
        decide on the first.

        What is missing is correlated for longer than the noise: fits to few independent samples stay near what is known beforehand. Once
        promising hypotheses are fitted, samples count by what the best of them leaves.
        """
        p, s = self.part, self.problem.settings
        chosen, by_chance = shortlist(p, rough, offered, [partial(self.mapped, "screening", k / 10, (k + 1) / 10) for k in range(2)], p.effort * s.refined)
        trials = self.mapped("trying", 0.2, 0.4, partial(trial, p, bases(p, rough, self.taus), self.taus, starts=STARTS), chosen)
        tried = promising(trials, p.effort * s.polished, s.likely)
        begun = self.mapped("fitting", 0.4, 0.6, partial(added_path, p, rough, self.taus), tried)
        taus = noise_times([rough, *begun])
        rough, *begun = self.mapped("fitting again", 0.6, 0.7, partial(resumed_path, p, taus), [rough, *begun])
        begun, path = kept_promises(rough, begun, s.alike, self.limited), resumed_path(self.problem, taus, path)
        fitted = self.mapped("fitting whole recordings", 0.7, 0.9, partial(whole_path, self.problem, taus, base=path), begun)
        counted = noise_times(fitted) if fitted else {}
        self.mapped("leaving out blocks", 0.9, 1.0, lambda path: self.block_losses(path, list(counted.values())[-1]), fitted)
        found = []
        for r, q in zip(begun, fitted, strict=True):
            h = list(q.values())[-1].point.effects[-1].hypothesis
            if not _ended(q):
                found.append(Candidate(h, q, self.evidence(q, path, h, counted), {k: replace(f, J=f.J[:0]) for k, f in r.items()}))
        ranked, limited = self.ranked(found)
        step, others = _decided(ranked, limited, self, by_chance, further), [c for c in ranked if mechanism(c.hypothesis) != mechanism(ranked[0].hypothesis)]
        sure = next((c for c in others if is_reason(c, limited) and in_no_doubt(c, s)), None) if further else None
        return step if sure is None else replace(step, instead=_decided([sure, *(c for c in others if c is not sure)], limited, self, by_chance, further))

    def accepted(self, first: Candidate) -> tuple[dict[float, Fit], dict[float, Fit]]:
        """Return the path with a candidate and without effects that do not pay beside it, fitted to convergence, and its rough one.

        Samples count by the correlation time of what it leaves.
        """
        taus = noise_times([first.rough]) | noise_times([first.path])
        return converged(self.problem, self.part, taus, replace(self, taus=taus).without_idle(first.path), first.rough)

    def finer(self, taus: dict[float, float]) -> Rounds:
        """Return the rounds in finer steps; of linear plants without effects fits are the same in any steps."""
        problem = replace(self.problem, substeps=FINER)
        return replace(self, problem=problem, part=problem if self.part is self.problem else replace(self.part, substeps=FINER), taus=taus)

    def exchanged(self, path: dict[float, Fit], steps: Sequence[Round]) -> tuple[dict[float, Fit], list[Round]]:
        """Return the path and the rounds after every effect was compared with its look-alikes beside all other effects, what gains most
        first, offsets last.

        A round compares effects while later ones are missing: what stands for several at once has the advantage there. An effect gives
        way where the look-alike gains more by what is asked of any effect.
        """
        kept = _kept(steps, path)
        found, rest = [s for s in kept if s.accepted], [s for s in kept if not s.accepted]
        gains, changed = [], False
        for k, step in enumerate(found if len(found) > 1 else []):
            present = {e.hypothesis.key: i for i, e in enumerate(list(path.values())[-1].point.effects)}
            alike = look_alikes(step.candidates, self.problem.settings, step.limited)
            others = fewer_path(self.problem, path, self.taus, present.pop(alike[0].hypothesis.key))
            rivals = [c for c in alike[1:] if c.hypothesis.key not in present] if changed or k + 1 < len(found) else []
            paths = [path, *self.mapper(partial(exchanged_path, self.problem, self.taus, others, path), [c.fit.point.effects[-1] for c in rivals])]
            counted, pairs = noise_times(paths), zip([alike[0], *rivals], paths, strict=True)
            beside = [Candidate(c.hypothesis, q, self.evidence(q, others, c.hypothesis, counted)) for c, q in pairs]
            ranked, limited = self.ranked(beside)
            clear = ranked[0].evidence.gain > beside[0].evidence.gain + self.problem.settings.evidence
            if rivals and (clear or ranked[0] is beside[0]):
                found[k] = replace(step, candidates=tuple(ranked), limited=limited)
                path, changed = ranked[0].path, changed or clear
            gains.append(ranked[0].evidence.gain if clear else beside[0].evidence.gain)
        first = [found[k] for k in sorted(range(len(gains)), key=lambda k: (is_offset(found[k].candidates[0].hypothesis), -gains[k]))] or found
        return path, [*first, *rest]

    def ranked(self, found: Sequence[Candidate]) -> tuple[list[Candidate], str]:
        """Return the winner, the other candidates by gain, and what limits the best fit.

        Where the best fit leaves only noise, constants of the model are reasons like any other.
        """
        ordered, limited = sorted(found, key=lambda c: -c.evidence.gain), self.limited
        reasons = [c for c in ordered if is_reason(c, limited)] or ordered
        if not reasons:
            return [], limited
        first = winner(reasons, self.problem.settings, limited)
        contested = reasons[0] is not ordered[0] or vote_shares(reasons, self.problem.settings, limited).max() < 1
        if limited == "model" and contested and (gap := self.remainder(self.problem, ordered[0].path)) is not None and gap.absent:
            limited = "noise"
            first = winner(ordered, self.problem.settings, limited)
        return [first, *(c for c in ordered if c is not first)], limited

    def evidence(self, path: dict[float, Fit], base: dict[float, Fit], h: Hypothesis, taus: dict[float, float] | None = None) -> HypothesisEvidence:
        """Return the evidence for one hypothesis; a constant of the model costs nothing, it is there already."""
        return self.over(path, base, 0 if is_constant(h) else priced(self.problem, list(path.values())[-1], h), taus)

    def over(self, path: dict[float, Fit], base: dict[float, Fit], count: int, taus: dict[float, float] | None = None) -> HypothesisEvidence:
        """Return the evidence for a path of ``count`` more parameters; samples count by ``taus``, or by the path's own residual, and
        blocks are independent by it: what a law explains is correlated for longer than what it leaves."""
        taus = taus or noise_times([path])
        tau = list(taus.values())[-1]
        noise = noise_share(self.problem.runs, list(path.values())[-1].residuals)
        return hypothesis_evidence(path, base, self.block_losses(path, tau), self.block_losses(base, tau), self.gap(tau), count, taus, noise)

    def without_idle(self, path: dict[float, Fit]) -> dict[float, Fit]:
        """Return the path without effects that do not pay beside the others."""
        last = list(path)[-1]
        for k in range(len(path[last].point.effects) - 1, len(self.problem.loads) - 1, -1):
            fewer = fewer_path(self.problem, path, self.taus, k)
            if self.evidence(path, fewer, path[last].point.effects[k].hypothesis).gain < self.problem.settings.evidence / 2:
                path = fewer
        return path


def _decided(ranked: list[Candidate], limited: str, rounds: Rounds, by_chance: dict[float, float], further: bool) -> Round:
    """Return the round with its decision; one that falls short by the agreement of the blocks or its share of the gap alone is accepted with that reason for doubt.

    A plant that integrates is judged at the horizon where its evidence is clearest: its simulation sums up every disturbance. At the
    decision horizon every hypothesis has to gain, too.
    """
    s, nothing = rounds.problem.settings, Round(tuple(ranked), False, limited, "no hypothesis of the library gains anything")
    if not ranked:
        return nothing
    e, sure = ranked[0].evidence, ranked[0].evidence.improves(s.resamples)
    gains = [(e.gains[h], max(s.evidence, s.chance * v)) for h, v in by_chance.items() if h in e.gains]
    gain, expected = gains[-1] if rounds.problem.regular else max(gains, key=lambda pair: pair[0] / pair[1])
    if not gain > 0:
        return nothing
    if rounds.limited == "noise" and is_constant(ranked[0].hypothesis):
        expected = s.constant  # one number that is known beforehand, not the best of many hypotheses
    asked, doubts = [(e.gain, min(s.evidence, expected), "gain at the decision horizon")], [(sure, s.sure, "share of resampled blocks that gain")]
    (asked if rounds.limited == "noise" else doubts).insert(0, (gain, expected, "gain of likelihood"))
    if further and rounds.limited == "model":
        asked.append((e.explained, s.further, "share of what the model leaves"))
    if further or rounds.limited == "model":
        doubts.append((e.explained, s.share, "share of the gap"))
    short = [[f"{what} {value:.3g}, expected more than {least:.3g}" for value, least, what in rules if not value > least] for rules in (asked, doubts)]
    reason = [*short[0], *short[1], ""][0]
    return Round(tuple(ranked), not short[0] and sure > 0.5, limited, f"{ranked[0].hypothesis.title}: {reason}" if reason else "")
