"""What every detector of a machine looks at, computed once per block whoever asks first.

A block is cut where bursts begin and end and filtered. Quiet samples are summed up for the gate and the last of them kept; of a burst the
checks are kept that say whether it may be judged.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np

from afdsvc.api.bursts import Burst
from afdsvc.api.detection import DetectionProblem, ResidualBlock
from afdsvc.detect.features.burst_noise import BurstNoise
from afdsvc.detect.features.data_checks import BurstChecks, PlayedLines, Runs
from afdsvc.detect.features.nuisances import Cleaning, Nuisances
from afdsvc.detect.features.shared_filter import Filters
from afdsvc.detect.features.whiteness_gate import NOTHING, Gate, GateState, Recent, finite
from afdsvc.lti.statespace import Array


@dataclass(frozen=True, slots=True, eq=False)
class Filtered:
    """Samples all inside or all outside a burst, and what the filters make of them ``(n, S, p)``; not ``usable`` with infinite ones."""

    piece: ResidualBlock
    series: Array
    usable: bool


def filtered(block: ResidualBlock, filters: Filters, state: Any) -> tuple[Any, tuple[Filtered, ...]]:
    """Return the state of the filters after a block and the series of its pieces; gaps and infinite samples put the filters to rest."""
    return block.memo(lambda: _filtered(block, filters, state), "filtered", filters, state)


def _filtered(block: ResidualBlock, filters: Filters, state: Any) -> tuple[Any, tuple[Filtered, ...]]:
    state, found = filters.start() if block.gap else state, []
    for piece in _pieces(block):
        state, series = filters.step(state, piece.r, piece.y, piece.u)
        found.append(Filtered(piece, series, finite(series)))
        state = state if found[-1].usable else filters.start()
    return state, tuple(found)


@dataclass(frozen=True, slots=True, eq=False)
class Played:
    """A burst as far as it was played."""

    burst: Burst
    name: str
    start: int
    asked: Array
    checks: BurstChecks
    lines: PlayedLines
    noise: BurstNoise


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """State of a front end: filters, gate, runs of constant values, the burst in progress, nuisances and the last of quiet data."""

    filters: Any
    gate: GateState
    runs: Runs
    played: Played | None = None
    cleaning: Cleaning | None = None
    recent: Recent = NOTHING


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """One piece of a block with its series, and what was seen before and after it."""

    before: Seen
    piece: ResidualBlock
    series: Array
    after: Seen


@dataclass(frozen=True, slots=True, eq=False)
class FrontEnd:
    """Front end of one machine with these filters, gate and nuisances; build one with `front_end`."""

    problem: DetectionProblem
    filters: Filters
    gate: Gate
    nuisances: Nuisances
    rest: Seen = field(init=False)

    def __post_init__(self) -> None:
        p = self.problem.plant.outputs
        object.__setattr__(self, "rest", Seen(self.filters.start(), self.gate.start(0, p), Runs.start(p)))

    def step(self, block: ResidualBlock, state: Seen) -> tuple[Seen, tuple[Stage, ...]]:
        """Return the state after a block and its pieces in their order."""
        return block.memo(lambda: self._step(block, state), "front end", self, state)

    def _step(self, block: ResidualBlock, state: Seen) -> tuple[Seen, tuple[Stage, ...]]:
        filters, pieces = filtered(block, self.filters, state.filters)
        state, stages = self._broken(state) if block.gap else state, []
        for found in pieces:
            before, state = state, self._piece(state, found)
            stages.append(Stage(before, found.piece, found.series, state))
        return replace(state, filters=filters), tuple(stages)

    def _broken(self, state: Seen) -> Seen:
        """Forget what was accumulated; a burst in progress can no longer be judged, but is followed to its end."""
        played = state.played and replace(state.played, checks=replace(state.played.checks, gap=True))
        return replace(state, gate=self.gate.restart(state.gate, "a gap in the samples"), played=played, cleaning=None, recent=NOTHING)

    def _piece(self, state: Seen, found: Filtered) -> Seen:
        piece, (runs, longest) = found.piece, state.runs.add(found.piece.y)
        gate, recent, cleaning = state.gate, state.recent, None
        if not found.usable:
            gate, recent = self.gate.restart(gate, "a sample that is not a finite number"), NOTHING
        elif piece.burst is None:
            cleaning, clean, kept = self.nuisances.clean(state.cleaning, piece, found.series[:, :1], self.gate.part)
            recent = recent.add(piece, self.gate.window + self.gate.settle)
            gate = self.gate.add(gate, clean if kept.all() else clean[kept])
        played = None if piece.burst is None else self._played(state.played, found, piece.burst, longest)
        return Seen(state.filters, gate, runs, played, cleaning, recent)

    def _played(self, played: Played | None, found: Filtered, burst: Burst, longest: Array) -> Played:
        piece = found.piece
        now = played if played is not None and piece.burst_start == played.start else self._begin(piece, burst)
        first = piece.k0 - now.start
        checks = now.checks.add(piece.y, piece.u, piece.r, piece.alpha, now.asked[first : first + len(piece)], longest)
        if checks.bad:
            return replace(now, checks=checks)
        lines, noise = now.lines.add(piece, first, burst, self.nuisances), now.noise.add(found.series[:, 0], piece, first, burst, self.nuisances)
        return replace(now, checks=checks, lines=lines, noise=noise)

    def _begin(self, piece: ResidualBlock, burst: Burst) -> Played:
        limits, (m, p) = self.problem.limits, (self.problem.plant.inputs, self.problem.plant.outputs)
        limit = np.full(m, np.inf) if limits is None else np.asarray(limits.input, dtype=float)
        checks, asked = BurstChecks(limit, gap=piece.k0 > piece.burst_start), burst.play(piece.dt)
        return Played(burst, piece.burst_name or burst.name, piece.burst_start, asked, checks, PlayedLines.start(m), BurstNoise.start(p))


def front_end(problem: DetectionProblem, filters: Filters, gate: Gate, nuisances: Nuisances) -> FrontEnd:
    """Return the front end that all detectors of a machine with these filters, gate and nuisances share."""
    return problem.once(lambda: FrontEnd(problem, filters, gate, nuisances), "front end", filters, gate, nuisances)


def _pieces(block: ResidualBlock) -> Iterator[ResidualBlock]:
    """Yield a block cut where its burst begins or ends; arrays are as the compiled loops want them."""
    edges = (0, len(block)) if block.burst is None else _edges(block, block.burst)
    r, beta, u, y, alpha = (_rows(a) for a in (block.r, block.beta, block.u, block.y, block.alpha))
    for i, (a, b) in enumerate(pairwise(edges)):
        if b > a:
            aux = {label: values[a:b] for label, values in block.aux.items()}
            yield ResidualBlock(
                block.k0 + a, block.dt, r[a:b], beta[a:b], u[a:b], y[a:b], alpha[a:b], block.burst if i == 1 else None,
                block.burst_name, block.burst_start, aux=aux,
            )


def _edges(block: ResidualBlock, burst: Burst) -> tuple[int, int, int, int]:
    """Return the edges of what lies before, inside and after the burst."""
    begin = min(max(block.burst_start - block.k0, 0), len(block))
    end = min(max(block.burst_start + burst.samples - block.k0, 0), len(block))
    return 0, begin, end, len(block)


def _rows(a: Array) -> Array:
    if a.dtype == np.float64 and a.flags.c_contiguous and a.flags.writeable:
        return a  # what `require` would find after ten times as long
    return np.require(a, np.float64, ("C", "W"))
