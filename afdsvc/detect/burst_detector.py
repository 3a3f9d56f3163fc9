"""The frame around every burst detector: follow the bursts, keep the gate, judge once at the end of each burst.

What is computed from the samples of a burst is a `BurstStatistic`; everything a detector needs besides (quiet data,
missing, frozen or saturated signals, evidence in words) is here and the same for all.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, Protocol

import numpy as np

from afdsvc.api.bursts import Burst
from afdsvc.api.detection import DetectionProblem, ResidualBlock
from afdsvc.api.evidence import Evidence
from afdsvc.detect.features.burst_noise import BurstNoise
from afdsvc.detect.features.data_checks import BurstChecks, PlayedLines, Runs
from afdsvc.detect.features.nuisances import NONE as NO_NUISANCES
from afdsvc.detect.features.nuisances import Cleaning, Nuisances
from afdsvc.detect.features.quiet_window import NOTHING, Recent
from afdsvc.detect.features.regressors import Regressors, regressors
from afdsvc.detect.features.shared_filter import Filters, shared
from afdsvc.detect.features.whiteness_gate import Gate, GateState, Judgement, finite
from afdsvc.detect.isolation import NONE, Fit
from afdsvc.detect.statistics.conditional_severity import given_detection
from afdsvc.errors import AfdsvcError
from afdsvc.lti.statespace import Array
from afdsvc.stats.memo import Once, at_rest, counted, stepped

BOUND = 2.0  # standard errors beyond an early estimate where the severity hardly lies


@dataclass(frozen=True, slots=True)
class Finding:
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

    def step(self, sums: Any, samples: BurstSamples) -> tuple[Any, Finding | None]:
        """Return the sums after the samples, and a finding when the burst need not be waited for."""
        ...

    def decide(self, sums: Any, burst: Burst, dt: float) -> Sequence[Finding]:
        """Return what the burst shows, once all its samples were seen."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Playing:
    """A burst in progress; ``refused`` says why the statistic cannot judge it, "" where it can."""

    burst: Burst
    name: str
    start: int
    asked: Array
    checks: BurstChecks
    sums: Any
    shown: PlayedLines
    noise: BurstNoise
    decided: bool = False
    refused: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class BurstDetectorState:
    """State of a burst detector: filters, gate, runs of constant values, the burst in progress, nuisances of quiet data."""

    filters: Any
    gate: GateState
    runs: Runs
    playing: Playing | None = None
    cleaning: Cleaning | None = None
    recent: Recent = NOTHING


@dataclass(frozen=True, slots=True, eq=False)
class BurstDetector:
    """A detector that decides at the end of every burst. ``sure`` is the weight that singles a fault out.

    Quiet data are judged after the ``nuisances`` are taken out: unbalance is no reason to distrust a model. When they need an
    explanation the last quiet samples are looked at again with the filters ``explain``.
    """

    name: str
    problem: DetectionProblem
    statistic: BurstStatistic
    filters: Filters
    gate: Gate
    explain: Filters
    sure: float = 0.99
    frozen: int = 100
    nuisances: Nuisances = NO_NUISANCES

    def start(self) -> BurstDetectorState:
        """Return the initial state."""
        p = self.problem.plant.outputs
        return BurstDetectorState(at_rest(self.filters), self.gate.start(0, p), Runs.start(p))

    def step(self, state: BurstDetectorState, block: ResidualBlock) -> tuple[BurstDetectorState, Sequence[Evidence]]:
        """Return the state after the block and the decisions that fell inside it."""
        found: list[Evidence] = []
        if block.gap:
            state, evidence = self._broken(state, block, "a gap in the samples")
            found += evidence
        for piece in pieces(block):
            state, evidence = self._piece(state, piece)
            found += evidence
        return state, found

    def _broken(self, state: BurstDetectorState, block: ResidualBlock, because: str) -> tuple[BurstDetectorState, list[Evidence]]:
        """Forget what was accumulated; a burst in progress can no longer be judged, but is followed to its end."""
        playing = state.playing
        if playing is not None:
            playing = replace(playing, checks=replace(playing.checks, gap=True))
        gate = self.gate.restart(state.gate, because)
        return replace(state, filters=at_rest(self.filters), gate=gate, playing=playing, cleaning=None, recent=NOTHING), []

    def _piece(self, state: BurstDetectorState, piece: ResidualBlock) -> tuple[BurstDetectorState, list[Evidence]]:
        found: list[Evidence] = []
        if state.playing is not None and not _same_burst(state.playing, piece):
            found += self._judge(state, state.playing, piece.k0 - 1, piece.dt)
            state = replace(state, playing=None)
        runs, longest = counted(state.runs, piece)
        filters, series = stepped(self.filters, state.filters, piece)
        cleaning, gate, recent = None, state.gate, state.recent
        if not finite(series):
            filters, recent = at_rest(self.filters), NOTHING
            gate = self.gate.restart(gate, "a sample that is not a finite number")
        elif piece.burst is None:
            cleaning, clean, kept = self.nuisances.clean(state.cleaning, piece, series[:, :1], self.gate.part)
            recent = recent.add(piece, self.gate.window + self.gate.settle)
            gate = self.gate.add(gate, clean if kept.all() else clean[kept])
        state = BurstDetectorState(filters, gate, runs, state.playing, cleaning, recent)
        if piece.burst is not None:
            state, evidence = self._burst_piece(state, piece, piece.burst, series, longest)
            found += evidence
        return state, found

    def _burst_piece(
        self, state: BurstDetectorState, piece: ResidualBlock, burst: Burst, series: Array, longest: Array
    ) -> tuple[BurstDetectorState, list[Evidence]]:
        found: list[Evidence] = []
        now = state.playing or self._begin(piece, burst)
        first = piece.k0 - now.start
        asked = now.asked[first : first + len(piece)]
        checks = now.checks.add(piece.y, piece.u, piece.r, piece.alpha, asked, longest)
        shown = now.shown if checks.bad else now.shown.add(piece, first, burst, self.nuisances)
        noise = now.noise if checks.bad else now.noise.add(series[:, 0], piece, first, burst, self.nuisances)
        now = replace(now, checks=checks, shown=shown, noise=noise)
        if not (now.decided or now.refused or checks.bad or checks.gap):
            sums, early = self.statistic.step(now.sums, BurstSamples(first, piece.dt, series, piece))
            now = replace(now, sums=sums)
            if early is not None:
                found += self._early(state, now, early, piece)
                now = replace(now, decided=bool(found))
        if first + len(piece) >= burst.samples:
            found += [] if now.decided else self._judge(state, now, piece.k0 + len(piece) - 1, piece.dt)
            return replace(state, playing=None), found
        return replace(state, playing=now), found

    def _begin(self, piece: ResidualBlock, burst: Burst) -> Playing:
        asked = burst.play(piece.dt)
        limits = self.problem.limits
        limit = np.full(self.problem.plant.inputs, np.inf) if limits is None else np.asarray(limits.input, dtype=float)
        checks = BurstChecks(limit, gap=piece.k0 > piece.burst_start)
        shown, name = PlayedLines.start(self.problem.plant.inputs), piece.burst_name or burst.name
        try:
            sums, refused = self.statistic.start(burst, piece.dt), ""
        except AfdsvcError as error:
            sums, refused = None, str(error)
        return Playing(burst, name, piece.burst_start, asked, checks, sums, shown, BurstNoise.start(self.problem.plant.outputs), refused=refused)

    def _early(self, state: BurstDetectorState, now: Playing, finding: Finding, piece: ResidualBlock) -> list[Evidence]:
        """Report a finding before the burst has ended, unless something speaks against it (then the end decides)."""
        complaint = now.checks.complaint(now.checks.n, self.frozen, self.problem.input_names, self.problem.output_names)
        complaint = complaint or now.shown.complaint(self.problem, now.burst)
        judgement = self._judgement(state)
        if complaint or not judgement.ok:
            return []
        k = now.start + int(finding.parts.get("sample", now.checks.n - 1))
        return [evidence(self.name, self.problem, k, piece.dt, now.name, finding, judgement, "", self.sure)]

    def _judge(self, state: BurstDetectorState, now: Playing, k: int, dt: float) -> list[Evidence]:
        if now.decided:
            return []
        problem = self.problem
        complaint = now.checks.complaint(now.burst.samples, self.frozen, problem.input_names, problem.output_names)
        complaint = complaint or now.refused or now.shown.complaint(problem, now.burst)
        judgement, unusable = self._judgement(state), now.checks.bad or now.checks.gap or now.refused
        try:
            findings = [] if unusable else self.statistic.decide(now.sums, now.burst, dt)
        except AfdsvcError as error:
            findings, complaint = [], complaint or str(error)
        findings = findings or [Finding(float("nan"), float("nan"))]
        about = (self.name, problem, k, dt, now.name)
        return [evidence(*about, f, judgement, complaint or f.refused or self._loud(now, f), self.sure) for f in findings]

    def _loud(self, now: Playing, finding: Finding) -> str:
        """Return the sentence that the burst was louder or quieter than stated.

        "" when it was not, when the finding stands all the same, and for a statistic that knows no faults: it looks for just that.
        """
        share, p = now.noise.loudness(self.gate.level, self.gate.estimated)
        if share == 1.0 or not finding.fits or finding.statistic > max(share, 1.0) * finding.threshold:
            return ""
        return f"during the burst the residual beside its lines has {share**0.5:.3g} times the stated standard deviation (p = {p:.2g})"

    def _judgement(self, state: BurstDetectorState) -> Judgement:
        """Return whether the quiet data can be trusted, as they are or with one fault's share taken out."""
        found = self.gate.judge(state.gate)
        if found.ok or found.found is None:
            return found
        return state.recent.explained(self.gate, self.explain, self.nuisances) or found


def evidence(
    detector: str, problem: DetectionProblem, k: int, dt: float, burst: str, finding: Finding, judgement: Judgement, complaint: str,
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


def likeliest(finding: Finding) -> Fit | None:
    """Return the fit of the fault with the largest weight; None when `NONE` weighs more or there are no fits."""
    if not finding.weights:
        return None
    name = max(finding.weights, key=lambda n: finding.weights[n])
    return next((f for f in finding.fits if f.fault == name and name != NONE), None)


def pieces(block: ResidualBlock) -> tuple[ResidualBlock, ...]:
    """Cut a block where its burst begins or ends, should it span such an edge; arrays are as the compiled loops want
    them.
    """
    return _PIECES(_cut, block)


_PIECES = Once()


def _cut(block: ResidualBlock) -> tuple[ResidualBlock, ...]:
    return tuple(_pieces(block))


def _pieces(block: ResidualBlock) -> Iterator[ResidualBlock]:
    edges = (0, len(block)) if block.burst is None else _edges(block, block.burst)
    r, beta, u, y, alpha = (_rows(a) for a in (block.r, block.beta, block.u, block.y, block.alpha))
    for i, (a, b) in enumerate(pairwise(edges)):
        if b > a:
            aux = {label: values[a:b] for label, values in block.aux.items()}
            yield ResidualBlock(
                block.k0 + a, block.dt, r[a:b], beta[a:b], u[a:b], y[a:b], alpha[a:b], block.burst if i == 1 else None,
                block.burst_name, block.burst_start, aux=aux,
            )


def _rows(a: Array) -> Array:
    if a.dtype == np.float64 and a.flags.c_contiguous and a.flags.writeable:
        return a  # what `require` would find after ten times as long
    return np.require(a, np.float64, ("C", "W"))


def _edges(block: ResidualBlock, burst: Burst) -> tuple[int, int, int, int]:
    """Return the edges of what lies before, inside and after the burst."""
    begin = min(max(block.burst_start - block.k0, 0), len(block))
    end = min(max(block.burst_start + burst.samples - block.k0, 0), len(block))
    return 0, begin, end, len(block)


def _same_burst(playing: Playing, piece: ResidualBlock) -> bool:
    return piece.burst is not None and piece.burst_start == playing.start


def _fit_parts(fits: Sequence[Fit]) -> dict[str, float]:
    parts = {f"severity.{f.fault}": f.severity for f in fits}
    return {**parts, **{f"sd.{f.fault}": f.sd for f in fits}}


def _bounds(fits: Sequence[Fit]) -> dict[str, float]:
    """Return losses that are hardly exceeded, for estimates that are too severe on average."""
    return {f"bound.{f.fault}": max(f.severity - BOUND * f.sd, -1.0) for f in fits if np.isfinite(f.sd)}


def burst_detector(
    name: str,
    problem: DetectionProblem,
    statistic: BurstStatistic,
    gate: Gate,
    sure: float,
    frozen: int,
    filters: Regressors | None = None,
    nuisances: Nuisances = NO_NUISANCES,
    regressing: bool = True,
) -> BurstDetector:
    """Return a burst detector with the filters of the problem's faults and a gate that waits for them to settle.

    A statistic that is not ``regressing`` makes no use of the faults' regressors: they are then computed only when the quiet
    data need an explanation.
    """
    filters = regressors(problem) if filters is None else filters
    gate, explain = replace(gate, settle=filters.settling(), estimated=problem.noise_samples), shared(filters)
    streaming = explain if regressing else filters.without_faults()
    return BurstDetector(name, problem, statistic, streaming, gate, explain, sure, frozen, nuisances)
