"""Columns on times of their own brought to one even grid: order, duplicates, gaps, jitter and rate, with a note on every change.

Nothing is filled in. A gap ends a piece, and what was done to the samples of a piece is one sentence each.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from afdsvc.errors import BadInput
from afdsvc.files.tables.time_base import FLAT, JITTER, STOP, reach, resampled, shortest_step
from afdsvc.lti.statespace import Array

SAME_STEP, SAME_PHASE = 1e-4, 1e-3  # relative differences of sample times, and of phases in samples, taken for rounding
SHORTEST = 50  # samples; what is shorter says nothing of a machine


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Columns ``(n,)`` by signal that were sampled together, at times ``t (n,)`` s; ``name`` is where they come from."""

    name: str
    t: Array
    columns: Mapping[str, Array]


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """Samples ``values (n, c)`` at ``start + k dt`` s, columns in the order of the groups."""

    start: float
    dt: float
    values: Array

    @property
    def end(self) -> float:
        """Time of the last sample [s]."""
        return self.start + (len(self.values) - 1) * self.dt


def aligned(
    groups: Sequence[Group], where: str, dt: float | None = None, gap: float = 1.5, regular: bool = False
) -> tuple[list[Piece], list[str]]:
    """Return pieces on one grid, columns of all groups side by side, and what was done to get there.

    ``dt`` is the sample time [s]; without it that of the slowest group with a signal the model reads: groups of ``aux_`` columns
    alone are interpolated linearly where they are slower. ``gap`` is the step, in sample times, from which on
    samples are missing; ``regular`` says that stamps jitter and the sampling did not. Raises `BadInput`, beginning with
    ``where``, when nothing usable is left.
    """
    remarks: list[str] = []
    evened = [_evened(_ordered(group, where, remarks), where, gap, regular, remarks) for group in groups]
    read = [k for k, group in enumerate(groups) if not all(signal.startswith("aux_") for signal in group.columns)] or range(len(groups))
    slowest = max(read, key=lambda k: evened[k][0].dt)
    step = dt or evened[slowest][0].dt
    for k in set(range(len(groups))) - set(read):
        evened[k] = _interpolated(groups[k], evened[k], evened[slowest][0].start, step, remarks)
    if all(_same_grid(found, evened[0], step) for found in evened):
        pieces = _side_by_side(evened)
    else:
        pieces = _resampled(groups, evened, step, remarks)
    kept = [p for p in pieces if len(p.values) >= SHORTEST]
    if not kept:
        longest = max((len(p.values) for p in pieces), default=0)
        slow = f", at the rate of the slowest signal, {groups[slowest].name}" if dt is None and any(found[0].dt < step * (1 - SAME_STEP) for found in evened) else ""
        raise BadInput(
            f"{where}: the longest stretch without a gap has {longest} samples of {step:.6g} s{slow}; expected at least {SHORTEST}. Where values are stored "
            "when they change, state [resample] dt = ... and hold = true in the mapping file; where samples are missing, a larger [resample] gap "
            "bridges them; a recording that is too short must be taken again"
        )
    if len(kept) < len(pieces):
        lost = sum(len(p.values) for p in pieces if len(p.values) < SHORTEST)
        remarks.append(f"stretches shorter than {SHORTEST} samples are left out: {len(pieces) - len(kept)}, with {lost} samples in all")
    return kept, remarks


def held_pieces(groups: Sequence[Group], where: str, dt: float) -> tuple[list[Piece], list[str]]:
    """Return one piece every ``dt`` [s] of values that hold until the next one, and what was done; raises `BadInput` as `aligned` does."""
    remarks: list[str] = []
    known = [_ordered(Group(f"{g.name}, {name}", g.t[ok := np.isfinite(v)], {name: v[ok]}), where, remarks) for g in groups for name, v in g.columns.items()]
    start, end = max(g.t[0] for g in known), max(g.t[-1] for g in known)
    count = int((end - start) / dt * (1 + 1e-12)) + 1
    if count < SHORTEST:
        raise BadInput(f"{where}: {max(count, 0)} samples of {dt:.6g} s from when every signal has a value; expected at least {SHORTEST}")
    t = start + dt * np.arange(count)
    columns = [values[np.searchsorted(g.t, t, side="right") - 1] for g in known for values in g.columns.values()]
    return [Piece(start, dt, np.column_stack(columns))], [*remarks, f"a value holds until the next one; one sample every {dt:.6g} s"]


def _ordered(group: Group, where: str, remarks: list[str]) -> Group:
    """Return the samples in the order of their times, each time once; duplicates and disorder are noted."""
    t, columns = group.t, dict(group.columns)
    bad = ~np.isfinite(t)
    order = np.argsort(np.where(bad, np.inf, t), kind="stable")[: len(t) - int(bad.sum())]
    late = int((np.diff(t[~bad]) < 0).sum())
    first = np.ones(len(order), dtype=bool)
    first[1:] = np.diff(t[order]) > 0
    kept = order[first]
    if bad.any():
        remarks.append(f"{int(bad.sum())} samples of {group.name} have no time stamp and are dropped")
    if late:
        remarks.append(f"{late} samples of {group.name} came out of order and were sorted by time")
    if len(kept) < len(order):
        remarks.append(f"{len(order) - len(kept)} samples of {group.name} have the time stamp of another and are dropped; the first is kept")
    if len(kept) < 2:
        raise BadInput(f"{where}: {group.name} has {len(kept)} samples; expected at least {SHORTEST}")
    return Group(group.name, t[kept], {name: values[kept] for name, values in columns.items()})


def _evened(group: Group, where: str, gap: float, regular: bool, remarks: list[str]) -> list[Piece]:
    """Return the group's stretches without gap, each on its own even grid of the group's one step."""
    steps = np.diff(group.t)
    step = float(np.median(steps))
    edges = [0, *(np.flatnonzero(steps > gap * step) + 1).tolist(), len(group.t)]
    spans = [(a, b) for a, b in pairwise(edges) if b - a >= 2]
    if len(edges) > 2:
        missing = float(steps[steps > gap * step].sum())
        remarks.append(
            f"{group.name} has {_count(len(edges) - 2, 'gap')} longer than {gap:g} sample times, {missing:.4g} s in all: "
            "they stay gaps that divide the recording"
        )
    if not spans:
        raise BadInput(f"{where}: {group.name} has a gap after every sample; expected even sampling")
    longest = max(spans, key=lambda s: s[1] - s[0])
    step = shortest_step(group.t[longest[0] : longest[1]])
    values = np.column_stack(list(group.columns.values()))
    worst, filled, pieces = 0.0, 0, []
    for a, b in spans:
        piece, miss = _on_grid(group.t[a:b], values[a:b], step, regular)
        pieces.append(piece)
        worst, filled = max(worst, miss), filled + len(piece.values) - (b - a)
    if worst > JITTER:
        remarks.append(_jitter(group.name, worst, step, regular))
    if filled > 0:
        remarks.append(f"{filled} missing samples of {group.name} were interpolated (each run shorter than a gap of the mapping)")
    return pieces


def _jitter(name: str, worst: float, step: float, regular: bool) -> str:
    said = f"the times of {name} miss an even grid of {step:.6g} s by up to {100 * worst:.0f} % of it"
    if regular:
        return f"{said}: by the mapping only the time stamps jitter, so the samples were placed on the grid unchanged"
    return f"{said}: the samples were interpolated linearly onto it"


def _on_grid(t: Array, values: Array, step: float, regular: bool) -> tuple[Piece, float]:
    """Return a stretch on an even grid, and by how much of a step its times miss it at worst."""
    k = np.arange(len(t))
    start = float(np.mean(t - step * k)) if regular else float(t[0])
    miss = float(np.abs(t - start - step * k).max() / step)
    if miss <= JITTER or regular:
        return Piece(start, step, values), miss
    grid = start + step * np.arange(int(np.floor((t[-1] - start) / step + 1e-9)) + 1)
    moved = np.column_stack([np.interp(grid, t, column) for column in values.T])
    phase = (t - start) / step
    return Piece(start, step, moved), float(np.abs(phase - np.round(phase)).max())


def _interpolated(group: Group, found: list[Piece], phase: float, step: float, remarks: list[str]) -> list[Piece]:
    """Return pieces slower than ``step`` [s] interpolated linearly onto its grid, which has a sample at ``phase`` [s], and held for one of
    their own sample times at both ends; others as they are."""
    if found[0].dt <= step * (1 + SAME_STEP):
        return found
    remarks.append(f"{group.name} was sampled every {found[0].dt:.6g} s and interpolated linearly to {step:.6g} s, the first and last value held for as long at most")
    finer = []
    for p in found:
        first, last = (int(turn((t - phase) / step + slack)) for turn, t, slack in ((np.ceil, p.start - p.dt, -1e-6), (np.floor, p.end + p.dt, 1e-6)))
        grid, known = phase + step * np.arange(first, last + 1), p.start + p.dt * np.arange(len(p.values))
        finer.append(Piece(float(grid[0]), step, np.column_stack([np.interp(grid, known, column) for column in p.values.T])))
    return finer


def _same_grid(found: list[Piece], first: list[Piece], step: float) -> bool:
    """Whether a group lies on the requested grid already, and on the same one as the first group."""
    if abs(found[0].dt - step) > SAME_STEP * step:
        return False
    phases = [(p.start - first[0].start) / step for p in (*found, *first)] if found is not first else [0.0]
    return bool(np.abs(np.array(phases) - np.round(phases)).max() < SAME_PHASE)


def _side_by_side(evened: Sequence[list[Piece]]) -> list[Piece]:
    """Return what all groups have in common; every value stays as it is."""
    pieces = []
    for start, end in _overlaps(evened):
        dt = evened[0][0].dt
        n = round((end - start) / dt) + 1
        parts = [_covering(found, start, end) for found in evened]
        firsts = [round((start - p.start) / dt) for p in parts]
        pieces.append(Piece(start, dt, np.hstack([p.values[a : a + n] for p, a in zip(parts, firsts, strict=True)])))
    return pieces


def _resampled(groups: Sequence[Group], evened: Sequence[list[Piece]], dt: float, remarks: list[str]) -> list[Piece]:
    """Return what all groups have in common on a grid of ``dt``, through one kernel for all."""
    evened = [_without_nan(group.name, found, remarks) for group, found in zip(groups, evened, strict=True)]
    period = max(dt, *(p.dt for found in evened for p in found))
    margin, pieces = reach(period), []
    for start, end in _overlaps(evened):
        count = int(np.floor((end - start - 2 * margin) / dt + 1e-9)) + 1
        times = np.asarray(start + margin + dt * np.arange(max(count, 0)), dtype=np.float64)
        parts = [_covering(found, start, end) for found in evened]
        columns = [resampled(p.values, p.start, p.dt, times, period) for p in parts]
        pieces.append(Piece(start + margin, dt, np.hstack(columns)))
    rates = ", ".join(f"{1 / found[0].dt:.6g} Hz ({g.name})" for g, found in zip(groups, evened, strict=True))
    remarks.append(
        f"resampled from {rates} to {1 / dt:.6g} Hz by one linear-phase low-pass filter for all columns: flat to {FLAT / period:.4g} Hz, "
        f"80 dB down from {STOP / period:.4g} Hz on; {margin:.4g} s at both ends of each piece are dropped, where the filter lacks "
        "neighbours, and inputs that were held between samples run smoothly now"
    )
    return pieces


def _without_nan(name: str, pieces: list[Piece], remarks: list[str]) -> list[Piece]:
    """Return the pieces cut where a sample is not a number: a filter would spread it."""
    cut = []
    for p in pieces:
        good = np.isfinite(p.values).all(axis=1)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(int)))
        cut += [Piece(p.start + a * p.dt, p.dt, p.values[a:b]) for a, b in edges.reshape(-1, 2).tolist()]
    lost = sum(len(p.values) for p in pieces) - sum(len(p.values) for p in cut)
    if lost:
        remarks.append(f"{lost} samples of {name} are NaN and stay gaps")
    if not cut:
        raise BadInput(f"{name} holds no numbers; expected samples")
    return cut


def _overlaps(evened: Sequence[list[Piece]]) -> list[tuple[float, float]]:
    """Return the spans that every group covers with one piece."""
    spans = [(p.start, p.end) for p in evened[0]]
    for found in evened[1:]:
        both = [(max(a, p.start), min(b, p.end)) for a, b in spans for p in found]
        spans = [(a, b) for a, b in both if b > a]
    return spans


def _covering(pieces: list[Piece], start: float, end: float) -> Piece:
    slack = 1e-6 * (end - start) + 1e-9
    return next(p for p in pieces if p.start <= start + slack and p.end >= end - slack)


def _count(n: int, what: str) -> str:
    return f"{n} {what}{'s' if n != 1 else ''}"
