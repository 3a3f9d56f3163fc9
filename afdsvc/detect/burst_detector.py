"""The frame around every burst detector: follow the bursts, keep the gate, judge once at the end of each burst.

What is computed from the samples of a burst is a `BurstStatistic`; everything a detector needs besides (quiet data,
missing, frozen or saturated signals, evidence in words) is here and the same for all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from afdsvc.api.bursts import Burst
from afdsvc.api.detection import DetectionProblem, ResidualBlock
from afdsvc.api.evidence import Evidence, p_value_text
from afdsvc.detect.features.front_end import FrontEnd, Played, Seen, Stage, front_end
from afdsvc.detect.features.nuisances import NONE as NO_NUISANCES
from afdsvc.detect.features.nuisances import Nuisances
from afdsvc.detect.features.regressors import without_faults
from afdsvc.detect.features.shared_filter import Filters, shared_regressors
from afdsvc.detect.features.whiteness_gate import Gate, Judgement
from afdsvc.detect.isolation import NONE, Fit
from afdsvc.detect.statistics.conditional_severity import given_detection
from afdsvc.errors import AfdsvcError
from afdsvc.lti.statespace import Array

BOUND = 2.0  # standard errors beyond an early estimate where the severity hardly lies


@dataclass(frozen=True, slots=True)
class BurstFinding:
    """What a statistic says about one burst: ``statistic`` against ``threshold``, one fit per fault, their weights.

    ``early``: the data chose when to stop, so severities are biased away from zero; they are reported as bounds. ``refused`` says why
    the burst must not be judged although its signals are complete.
    """

    statistic: float
    threshold: float
    fits: tuple[Fit, ...] = ()
    weights: Mapping[str, float] = field(default_factory=dict)
    parts: Mapping[str, float] = field(default_factory=dict)
    output: str = ""
    early: bool = False
    refused: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class BurstSamples:
    """Consecutive samples of a burst: ``first`` counts from its beginning; ``series (n, S, p)`` is the normalised
    residual and, for statistics that regress on them, the features of the faults' regressors."""

    first: int
    dt: float
    series: Array
    block: ResidualBlock


class BurstStatistic(Protocol):
    """What a burst detector computes. ``start`` and ``step`` build sums whose size does not depend on the burst's
    length.
    """

    def start(self, burst: Burst, dt: float) -> Any:
        """Return the sums before the first sample."""
        ...

    def step(self, sums: Any, samples: BurstSamples) -> tuple[Any, BurstFinding | None]:
        """Return the sums after the samples, and a finding when the burst need not be waited for."""
        ...

    def decide(self, sums: Any, burst: Burst, dt: float) -> Sequence[BurstFinding]:
        """Return what the burst shows, once all its samples were seen."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Playing:
    """Sums of the burst in progress that began at sample ``start``; ``refused`` says why the statistic cannot judge it, "" where it can."""

    start: int
    sums: Any
    refused: str = ""
    decided: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class BurstDetectorState:
    """State of a burst detector: what its front end has seen, and its own sums."""

    seen: Seen
    playing: Playing | None = None


@dataclass(frozen=True, slots=True, eq=False)
class BurstDetector:
    """A detector that decides at the end of every burst. ``sure`` is the weight that singles a fault out.

    Quiet data are judged after the nuisances are taken out: unbalance is no reason to distrust a model. When they need an
    explanation the last quiet samples are looked at again with the filters ``explain``.
    """

    name: str
    problem: DetectionProblem
    statistic: BurstStatistic
    front: FrontEnd
    explain: Filters
    sure: float = 0.99
    frozen: int = 100

    def start(self) -> BurstDetectorState:
        """Return the initial state."""
        return BurstDetectorState(self.front.rest)

    def step(self, state: BurstDetectorState, block: ResidualBlock) -> tuple[BurstDetectorState, Sequence[Evidence]]:
        """Return the state after the block and the decisions that fell inside it."""
        found: list[Evidence] = []
        seen, stages = self.front.step(block, state.seen)
        playing = state.playing
        for stage in stages:
            piece = stage.piece
            if playing is not None and not (piece.burst is not None and piece.burst_start == playing.start):
                found += self._judge(stage.before, playing, piece.k0 - 1, piece.dt)
                playing = None
            if piece.burst is not None:
                playing, evidence = self._burst_piece(playing, stage, piece.burst)
                found += evidence
        return BurstDetectorState(seen, playing), found

    def _burst_piece(self, playing: Playing | None, stage: Stage, burst: Burst) -> tuple[Playing | None, list[Evidence]]:
        found: list[Evidence] = []
        piece, played = stage.piece, stage.after.played
        assert played is not None  # noqa: S101 - the front end follows every burst
        now, first = playing or self._begin(piece, burst), piece.k0 - played.start
        if not (now.decided or now.refused or played.checks.bad or played.checks.gap):
            sums, early = self.statistic.step(now.sums, BurstSamples(first, piece.dt, stage.series, piece))
            now = replace(now, sums=sums)
            if early is not None:
                found += self._early(stage.after, played, early, piece)
                now = replace(now, decided=bool(found))
        if first + len(piece) >= burst.samples:
            return None, [*found, *self._judge(stage.after, now, piece.k0 + len(piece) - 1, piece.dt)]
        return now, found

    def _begin(self, piece: ResidualBlock, burst: Burst) -> Playing:
        try:
            return Playing(piece.burst_start, self.statistic.start(burst, piece.dt))
        except AfdsvcError as error:
            return Playing(piece.burst_start, None, str(error))

    def _early(self, seen: Seen, played: Played, finding: BurstFinding, piece: ResidualBlock) -> list[Evidence]:
        """Report a finding before the burst has ended, unless something speaks against it (then the end decides)."""
        complaint = played.checks.complaint(played.checks.n, self.frozen, self.problem.input_names, self.problem.output_names)
        complaint = complaint or played.lines.complaint(self.problem, played.burst)
        judgement = self._judgement(seen)
        if complaint or not judgement.ok:
            return []
        k = played.start + int(finding.parts.get("sample", played.checks.n - 1))
        return [evidence(self.name, self.problem, k, piece.dt, played.name, finding, judgement, "", self.sure)]

    def _judge(self, seen: Seen, now: Playing, k: int, dt: float) -> list[Evidence]:
        problem, played = self.problem, seen.played
        if now.decided or played is None:
            return []
        complaint = played.checks.complaint(played.burst.samples, self.frozen, problem.input_names, problem.output_names)
        complaint = complaint or now.refused or played.lines.complaint(problem, played.burst)
        judgement, unusable = self._judgement(seen), played.checks.bad or played.checks.gap or now.refused
        try:
            findings = [] if unusable else self.statistic.decide(now.sums, played.burst, dt)
        except AfdsvcError as error:
            findings, complaint = [], complaint or str(error)
        findings = findings or [BurstFinding(float("nan"), float("nan"))]
        about = (self.name, problem, k, dt, played.name)
        return [evidence(*about, f, judgement, complaint or f.refused or ("" if judgement.explained_by else self._loud(played, f)), self.sure) for f in findings]

    def _loud(self, played: Played, finding: BurstFinding) -> str:
        """Return the sentence that the burst was louder or quieter than stated.

        "" when it was not, when the finding stands all the same, and for a statistic that knows no faults: it looks for just that.
        """
        share, p = played.noise.loudness(self.front.gate.level, self.front.gate.estimated)
        if share == 1.0 or not finding.fits or finding.statistic > max(share, 1.0) * finding.threshold:
            return ""
        return f"during the burst the residual beside its lines has {share**0.5:.3g} times the stated standard deviation ({p_value_text(p)})"

    def _judgement(self, seen: Seen) -> Judgement:
        """Return whether the quiet data can be trusted, as they are or with one fault's share taken out."""
        found = self.front.gate.judge(seen.gate)
        if found.ok or found.found is None:
            return found
        return seen.recent.explained(self.front.gate, self.explain, self.front.nuisances, self.problem) or found


def evidence(
    detector: str, problem: DetectionProblem, k: int, dt: float, burst: str, finding: BurstFinding, judgement: Judgement, complaint: str,
    sure: float,
) -> Evidence:
    """Return the evidence for one finding: nothing is detected when the burst or the quiet data cannot be trusted."""
    reason = complaint or judgement.reason
    detected = not reason and finding.statistic > finding.threshold
    best = likeliest(finding) if detected else None
    named = best is not None and finding.weights.get(best.fault, 0.0) >= sure
    return Evidence(
        detector=detector, machine=problem.machine, k=k, seconds=k * dt, burst=burst, output=finding.output,
        statistic=finding.statistic, threshold=finding.threshold, detected=detected,
        fault=best.fault if named and best else None,
        severity=given_detection(best, problem.severity_range) if best and np.isfinite(best.sd) and not finding.early else None,
        weights=dict(finding.weights) if detected else {}, trustworthy=not reason, reason=reason,
        p_white=judgement.p_white, parts={**finding.parts, **(_bounds(finding.fits) if finding.early else _fit_parts(finding.fits))},
    )


def likeliest(finding: BurstFinding) -> Fit | None:
    """Return the fit of the fault with the largest weight; None when `NONE` weighs more or there are no fits."""
    if not finding.weights:
        return None
    name = max(finding.weights, key=lambda n: finding.weights[n])
    return next((f for f in finding.fits if f.fault == name and name != NONE), None)


def _fit_parts(fits: Sequence[Fit]) -> dict[str, float]:
    parts = {f"severity.{f.fault}": f.severity for f in fits}
    return {**parts, **{f"sd.{f.fault}": f.sd for f in fits}}


def _bounds(fits: Sequence[Fit]) -> dict[str, float]:
    """Return losses that are hardly exceeded, for estimates that are too severe on average."""
    return {f"bound.{f.fault}": max(f.severity - BOUND * f.sd, -1.0) for f in fits if np.isfinite(f.sd)}


def burst_detector(
    name: str, problem: DetectionProblem, statistic: BurstStatistic, gate: Gate, sure: float, frozen: int,
    nuisances: Nuisances = NO_NUISANCES, regressing: bool = True,
) -> BurstDetector:
    """Return a burst detector with the filters of the problem's faults and a gate that waits for them to settle.

    A statistic that is not ``regressing`` makes no use of the faults' regressors: they are then computed only when the quiet
    data need an explanation.
    """
    explain = shared_regressors(problem)
    gate = replace(gate, settle=explain.settling(), estimated=problem.noise_samples)
    front = front_end(problem, explain if regressing else without_faults(problem), gate, nuisances)
    return BurstDetector(name, problem, statistic, front, explain, sure, frozen)
