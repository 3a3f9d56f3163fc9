"""A machine whose speed changes: every speed has its own model, thresholds and detectors, and none is used at another.

Speeds are rounded to multiples of a spacing; at each the machine is commissioned when it first runs there. While the speed is further
from that of the model than half the spacing (and a tenth, so that it does not flutter) nothing is judged. Once it has kept
still for a while, the parts for the new speed take over and begin anew.

Making parts takes seconds. A service has that done beside its worker (``later``): blocks wait here meanwhile and are judged
when the parts are there, a few with every block that comes. What is decided is the same either way.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from afdsvc.api.bursts import Burst
from afdsvc.api.detection import DetectionProblem
from afdsvc.api.signals import Block
from afdsvc.diagnosis.data_quality import StreamFinding
from afdsvc.diagnosis.pipeline import Outcome, Pipeline, remember
from afdsvc.errors import AfdsvcError, BadInput, Refused
from afdsvc.lti.statespace import Array, StateSpace

RPM = 30 / np.pi  # rpm per rad/s
SLACK = 0.6  # of the spacing: how far the speed may be from that of the model in use
STILL = 0.25  # of the spacing: how far the speed may move while it counts as still
WAITING = 2_000  # blocks that wait for parts; with more of them the worker waits itself
CATCH_UP = 8  # blocks judged for every block that comes, while some wait


@dataclass
class SpeedPipeline:
    """The pipeline of a machine that records ``aux_speed``.

    ``design(speed)`` returns the pipeline for a speed [rad/s]; it raises `AfdsvcError` where there is no model. ``spacing``
    [rad/s] is that of the speeds with a model, ``still_seconds`` how long a new speed must last, ``speed`` where the machine begins.
    ``later`` runs a design in another thread (`concurrent.futures.Executor.submit`); None: here and now.
    """

    design: Callable[[float], Pipeline]
    spacing: float
    speed: float
    still_seconds: float = 1.0
    bursts: dict[str, Burst] = field(default_factory=dict)
    later: Callable[[Callable[[], Pipeline]], Future[Pipeline]] | None = None

    def __post_init__(self) -> None:
        self._node = self._nearest(self.speed)
        self._pipeline: Pipeline | None = self.design(self._node)
        self._problem = self._pipeline.problem
        self._held, self._from = 0.0, self._node
        self._without = float("nan")  # the speed last found to have no model
        self._coming: tuple[float, Future[Pipeline]] | None = None
        self._waiting: deque[Block] = deque()

    @property
    def problem(self) -> DetectionProblem:
        """The detection problem at the speed the machine was last commissioned at; raises `Refused` while there is none."""
        if self._pipeline is None:
            raise Refused(f"the speed has left {self._node * RPM:.0f} rpm and is not steady yet; a burst could not be evaluated")
        return self._problem

    @property
    def dt(self) -> float:
        """Sample time, the same at every speed."""
        return self._problem.plant.dt

    @property
    def ready_at(self) -> int | None:
        """Sample from which a burst can be judged, None while that is not known."""
        return None if self._pipeline is None else self._pipeline.ready_at

    def announce(self, burst: Burst) -> None:
        """Make a burst known before its blocks come."""
        remember(self.bursts, burst)
        if self._pipeline is not None:
            self._pipeline.announce(burst)

    def announce_tuning(self, name: str, Q: StateSpace) -> DetectionProblem:
        """Raise `Refused`: what is proved of Q holds at one speed."""
        raise Refused("the speed of this machine is followed ('speed_step_rpm'), and what is proved of Q holds at one speed only")

    def step(self, block: Block) -> Outcome:
        """Return what a block leads to; between two speeds that is nothing but a sentence."""
        if self._coming is None and not self._waiting:
            return self._judge(block)
        self._waiting.append(block)
        if self._coming is not None and not self._coming[1].done() and len(self._waiting) < WAITING:
            return Outcome((), (), None)
        return self._catch_up()

    def _catch_up(self) -> Outcome:
        """Judge some of the blocks that wait; a residual is handed out only where it belongs to the block that came last."""
        findings: list[StreamFinding] = []
        if self._coming is not None:
            node, coming = self._coming
            self._coming = None
            findings.append(self._commission(node, coming.result))
        outcomes: list[Outcome] = []
        while self._waiting and self._coming is None and len(outcomes) < CATCH_UP:
            outcomes.append(self._judge(self._waiting.popleft()))
        return Outcome(
            tuple(e for o in outcomes for e in o.evidence),
            (*findings, *(f for o in outcomes for f in o.findings)),
            outcomes[-1].residual if outcomes and not self._waiting else None,
            sum(o.lost_samples for o in outcomes),
        )

    def _judge(self, block: Block) -> Outcome:
        try:
            speed = block.column("aux_speed")
        except BadInput as missing:
            return Outcome((), (StreamFinding("bad_block", f"block {block.seq} of '{block.machine}': {missing}"),), None)
        findings: list[StreamFinding] = []
        if self._pipeline is not None and not np.abs(speed - self._node).max() <= SLACK * self.spacing:
            findings.append(self._leave(block))
        if self._pipeline is not None:
            return self._pipeline.step(block)
        findings += self._wait(block, speed)
        return Outcome((), tuple(findings), None)

    def _leave(self, block: Block) -> StreamFinding:
        self._pipeline, self._held, self._from = None, 0.0, float("nan")
        lost = f"; burst {block.burst} is not judged" if block.burst else ""
        return StreamFinding("speed", f"the speed leaves {self._node * RPM:.0f} rpm: decisions are suspended until it is steady{lost}")

    def _wait(self, block: Block, speed: Array) -> list[StreamFinding]:
        """Count how long the speed has kept still; commission the machine where it has."""
        if not np.abs(speed - self._from).max() <= STILL * self.spacing:
            self._held, self._from = 0.0, float(speed[-1])
            return []
        self._held += len(block) * block.dt
        if self._held < self.still_seconds or block.burst:
            return []
        self._held, node = 0.0, self._nearest(float(speed[-1]))
        if node == self._without:
            return []
        if self.later is None:
            return [self._commission(node, partial(self.design, node))]
        self._coming = node, self.later(partial(self.design, node))
        return []

    def _commission(self, node: float, made: Callable[[], Pipeline]) -> StreamFinding:
        try:
            pipeline = made()
        except AfdsvcError as error:
            self._without = node
            return StreamFinding("speed", f"at {node * RPM:.0f} rpm no decision is possible: {error}")
        for burst in self.bursts.values():
            pipeline.announce(burst)
        self._node, self._pipeline, self._problem, self._without = node, pipeline, pipeline.problem, float("nan")
        return StreamFinding("speed", f"model, thresholds and detectors are those of {node * RPM:.0f} rpm now")

    def _nearest(self, speed: float) -> float:
        return self.spacing * round(speed / self.spacing)
