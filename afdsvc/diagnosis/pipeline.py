"""From blocks to evidence, live and offline alike: decisions depend on the blocks alone."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from afdsvc.api.bursts import Burst
from afdsvc.api.detection import DetectionProblem, Detector, Noise, ResidualBlock
from afdsvc.api.evidence import Evidence
from afdsvc.api.signals import Block, of_role
from afdsvc.detect.features.innovations import ResidualFilter
from afdsvc.detect.features.noise_calibration import calibrate_noise
from afdsvc.detect.features.whiteness_gate import Gate
from afdsvc.detect.thresholds.power import tail_point
from afdsvc.diagnosis.data_quality import Expectation, IntakeState, StreamFinding, judge, longest_still
from afdsvc.errors import AfdsvcError, Refused
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.retune.design import retuned_problem

log = logging.getLogger(__name__)
LONGEST_SETTLING = 20_000
REMEMBERED = 64  # bursts known by name
TUNINGS = 4  # loops with a Q known by name
JUDGED = ("diagnose", "isolate")  # purposes of bursts that detectors are designed for; others have far too many lines


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What one block led to: evidence, findings about the stream, and the whitened residual (None when unusable)."""

    evidence: tuple[Evidence, ...]
    findings: tuple[StreamFinding, ...]
    residual: Array | None
    lost_samples: int = 0


def remember(bursts: dict[str, Burst], burst: Burst) -> None:
    """Add a burst to those known by name; the oldest is forgotten when there are many."""
    bursts[burst.name] = burst
    while len(bursts) > REMEMBERED:
        bursts.pop(next(iter(bursts)))


@dataclass
class Pipeline:
    """Residual generation and detectors of one machine.

    After every start and every interruption the residual filter settles for a while before detectors see it: its initial
    state is unknown. Bursts are known by name from the requests (`announce`); blocks of an unknown burst are not judged, nor are
    those of a burst made for something else than detection. The same holds for every Q beside the controller: ``redesign`` returns
    detectors for the loop with it (`announce_tuning`), which take over with the first block that bears its name.
    """

    problem: DetectionProblem
    detectors: Sequence[Detector]
    expected: Expectation
    bursts: dict[str, Burst] = field(default_factory=dict)
    redesign: Callable[[DetectionProblem], Sequence[Detector]] | None = None

    def __post_init__(self) -> None:
        self._loops: dict[str, tuple[DetectionProblem, Sequence[Detector]]] = {"": (self.problem, self.detectors)}
        self._tuning = ""
        self._intake = IntakeState()
        self._states: dict[str, Any] = {d.name: d.start() for d in self.detectors}
        self._broken: dict[str, str] = {}
        self._x: Array | None = None
        self._settled_at = 0
        self._filter = ResidualFilter(self.problem.innovations)
        self._settle = min(self._filter.settling(1e-3), LONGEST_SETTLING)
        self._gap = True
        self._burst: tuple[str, int] = ("", 0)

    @property
    def dt(self) -> float:
        """Sample time in seconds."""
        return self.problem.plant.dt

    @property
    def ready_at(self) -> int | None:
        """Sample from which a burst can be judged: the filters have settled and the gate's quiet window is full.

        None before the first usable block, and after an interruption until the next one.
        """
        return None if self._x is None else self._settled_at + self._settle + Gate().window

    def announce(self, burst: Burst) -> None:
        """Make a burst known before its blocks come; the memory of old ones is bounded."""
        remember(self.bursts, burst)

    def announce_tuning(self, name: str, Q: StateSpace) -> DetectionProblem:
        """Make a Q known before its blocks come, and return the problem of the loop with it; raises `Refused` where detectors cannot follow."""
        if self.redesign is None:
            raise Refused("the detectors of this machine cannot be designed anew, so no Q can run beside its controller")
        problem = retuned_problem(self._loops[""][0], Q)
        self._loops[name] = problem, self.redesign(problem)
        for old in [known for known in self._loops if known not in ("", name, self._tuning)][:-TUNINGS]:
            del self._loops[old]
        return problem

    def step(self, block: Block) -> Outcome:
        """Return what the block leads to; a detector that fails is disabled with a finding and the others continue."""
        self._intake, judged = judge(self.expected, self._intake, block)
        if judged.gap:
            self._x, self._gap = None, True
        if not judged.usable:
            self._gap = True
            return Outcome((), judged.findings, None, judged.lost_samples)
        r = self._residual(block)
        self._follow_burst(block)
        self._follow_tuning(block)
        if block.k0 + len(block) <= self._settled_at or block.tuning not in self._loops:
            return Outcome((), judged.findings, r, judged.lost_samples)
        evidence, failures = self._judge_residual(block, r)
        return Outcome(tuple(evidence), (*judged.findings, *failures), r, judged.lost_samples)

    def _residual(self, block: Block) -> Array:
        if self._x is None:
            self._x = self._filter.start()
            self._settled_at = block.k0 + self._settle
        self._x, r = self._filter.step(self._x, block.role("y"), block.role("u"))
        return r

    def _follow_burst(self, block: Block) -> None:
        if block.burst != self._burst[0]:
            self._burst = (block.burst, block.k0)

    def _follow_tuning(self, block: Block) -> None:
        """Let the detectors of the loop that runs now take over; they begin when its transient has passed."""
        if block.tuning == self._tuning:
            return
        self._tuning, self._gap, self._settled_at = block.tuning, True, block.k0 + self._settle
        if block.tuning in self._loops:
            self.problem, self.detectors = self._loops[block.tuning]
            self._states, self._broken = {d.name: d.start() for d in self.detectors}, {}

    def _judge_residual(self, block: Block, r: Array) -> tuple[list[Evidence], list[StreamFinding]]:
        seen = self._seen(block, r)
        self._gap = False
        evidence: list[Evidence] = []
        failures: list[StreamFinding] = []
        for detector in self.detectors:
            if detector.name in self._broken:
                continue
            try:
                self._states[detector.name], found = detector.step(self._states[detector.name], seen)
                evidence += found
            except Exception as error:
                log.exception("detector '%s' failed", detector.name)
                self._broken[detector.name] = f"{type(error).__name__}: {error}"
                failures.append(StreamFinding("plugin_failed", f"detector '{detector.name}' failed and is disabled: {error}"))
        return evidence, failures

    def _seen(self, block: Block, r: Array) -> ResidualBlock:
        name, start = self._burst
        known = self.bursts.get(name) if name else None
        if known is not None and known.purpose not in JUDGED:
            known = None
        aux = {c.label: block.values[:, i] for i, c in enumerate(block.channels) if c.role == "aux"}
        return ResidualBlock(
            block.k0,
            block.dt,
            r,
            block.role("beta"),
            block.role("u"),
            block.role("y"),
            block.role("alpha" if of_role(block.channels, "alpha") else "ref"),
            known,
            name,
            start,
            self._gap or bool(name and known is None),
            aux,
        )


Design = Callable[[Noise, int], Pipeline]


class Stream(Protocol):
    """Anything that turns blocks into evidence."""

    def announce(self, burst: Burst) -> None:
        """Make a burst known before its blocks come."""
        ...

    def announce_tuning(self, name: str, Q: StateSpace) -> DetectionProblem:
        """Make a Q known before its blocks come, and return the problem of the loop with it; raises `Refused` where that cannot be."""
        ...

    def step(self, block: Block) -> Outcome:
        """Return what a block leads to."""
        ...


class ExcitableStream(Stream, Protocol):
    """A stream of a machine that can be excited."""

    bursts: dict[str, Burst]

    @property
    def dt(self) -> float:
        """Sample time in seconds."""
        ...

    @property
    def ready_at(self) -> int | None:
        """Sample from which a burst can be judged, None while that is not known."""
        ...

    @property
    def problem(self) -> DetectionProblem:
        """The detection problem; raises `Refused` while there is none."""
        ...


@dataclass
class CalibratedPipeline:
    """A pipeline whose noise model comes from the machine's own first quiet samples.

    Until ``samples`` have come without interruption nothing is judged. ``design(noise, frozen_after)`` returns the pipeline.
    """

    plant: StateSpace
    expected: Expectation
    samples: int
    design: Design

    def __post_init__(self) -> None:
        self._intake = IntakeState()
        self._quiet: list[Block] = []
        self.bursts: dict[str, Burst] = {}
        self.pipeline: Pipeline | None = None

    @property
    def dt(self) -> float:
        """Sample time in seconds."""
        return self.plant.dt

    @property
    def ready_at(self) -> int | None:
        """Sample from which a burst can be judged; None until the noise is known."""
        return self.pipeline.ready_at if self.pipeline else None

    @property
    def problem(self) -> DetectionProblem:
        """The detection problem with the noise that was found; raises `Refused` until then."""
        if self.pipeline is None:
            raise Refused(f"the noise is being estimated from the first {self.samples * self.dt:g} quiet seconds")
        return self.pipeline.problem

    def announce(self, burst: Burst) -> None:
        """Make a burst known; the memory of old ones is bounded."""
        remember(self.bursts, burst)
        if self.pipeline:
            self.pipeline.announce(burst)

    def announce_tuning(self, name: str, Q: StateSpace) -> DetectionProblem:
        """Make a Q known; raises `Refused` until the noise is."""
        if self.pipeline is None:
            raise Refused("the noise is not known yet")
        return self.pipeline.announce_tuning(name, Q)

    def step(self, block: Block) -> Outcome:
        """Collect, then judge."""
        if self.pipeline is not None:
            return self.pipeline.step(block)
        self._intake, judged = judge(self.expected, self._intake, block)
        if (judged.gap and self._quiet) or block.burst:
            self._quiet = []
        if judged.usable and not block.burst:
            self._quiet.append(block)
        found = judged.findings
        if sum(map(len, self._quiet)) >= self.samples:
            found = (*found, self._calibrate())
        return Outcome((), found, None, judged.lost_samples)

    def _calibrate(self) -> StreamFinding:
        u, y = (np.vstack([b.role(role) for b in self._quiet]) for role in ("u", "y"))
        self._quiet = []
        try:
            self.pipeline, finding = calibrated(self.plant, u, y, self.design)
        except AfdsvcError as error:
            return StreamFinding("plugin_failed", f"the calibration failed and is repeated with the next data: {error}")
        for burst in self.bursts.values():
            self.pipeline.announce(burst)
        return finding


def calibrated(plant: StateSpace, u: Array, y: Array, design: Design) -> tuple[Pipeline, StreamFinding]:
    """Return the pipeline whose noise model comes from quiet samples ``u (n, m)``, ``y (n, p)``, and what was found.

    The longest run of equal samples seen here sets what counts as a frozen sensor later.
    """
    pipeline = design(calibrate_noise(plant, u, y), max(50, 4 * longest_still(y)))
    sd = ", ".join(f"{s:.3g}" for s in np.sqrt(np.diag(pipeline.problem.covariance)))
    known = (2 * len(y)) ** -0.5
    height = tail_point(pipeline.problem.false_alarms.per_burst)  # d ln Q(h) / d ln sd is about h^2
    sure = f"known to {100 * known:.2g} %, alarm rates therefore to a factor of {math.exp(height**2 * known):.2g}"
    return pipeline, StreamFinding("calibrated", f"noise calibrated on {len(y)} quiet samples: residual sd {sd} ({sure})")
