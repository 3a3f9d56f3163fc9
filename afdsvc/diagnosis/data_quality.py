"""Data quality: order, gaps, shape, NaN and frozen sensors, checked before any detector uses a block."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from afdsvc.api.signals import Block, Channel
from afdsvc.lti.statespace import Array


@dataclass(frozen=True, slots=True)
class Expectation:
    """What a machine's blocks must look like. ``frozen_after`` equal samples in a row mean a frozen sensor (0: not checked)."""

    channels: tuple[Channel, ...]
    dt: float
    frozen_after: int = 50


@dataclass(frozen=True, slots=True, eq=False)
class IntakeState:
    """Where the stream stands: session, next expected sample and sequence number, run length per output, last outputs."""

    session: str = ""
    k: int = -1
    seq: int = -1
    run: Array | None = None
    last: Array | None = None
    frozen: tuple[bool, ...] = ()


@dataclass(frozen=True, slots=True)
class StreamFinding:
    """Something named about the stream: a kind of event, and one sentence."""

    kind: str
    message: str


@dataclass(frozen=True, slots=True, eq=False)
class CheckedBlock:
    """A block after the checks: ``usable`` for detectors or not, ``gap`` when the stream was interrupted before it."""

    usable: bool
    gap: bool
    findings: tuple[StreamFinding, ...]
    lost_samples: int = 0


def judge(expected: Expectation, state: IntakeState, block: Block) -> tuple[IntakeState, CheckedBlock]:
    """Return the state after the block and what is to be made of it."""
    wrong = _wrong_kind(expected, block)
    if wrong:
        return state, CheckedBlock(False, True, (StreamFinding("bad_block", wrong),))
    fresh = block.session != state.session
    if not fresh and block.k0 < state.k:
        what = f"block {block.seq} of '{block.machine}' starts at sample {block.k0}, expected {state.k}: out of order, left out"
        return state, CheckedBlock(False, False, (StreamFinding("bad_block", what),))
    lost = 0 if fresh else block.k0 - state.k
    findings = [_gap(block, state, lost)] if lost else []
    bad, why = _bad_samples(block)
    findings += why
    run, last, frozen, frozen_findings = _frozen(expected, state, block, fresh or lost > 0)
    new = IntakeState(block.session, block.k0 + len(block), block.seq + 1, run, last, frozen)
    return new, CheckedBlock(not bad and not any(frozen), fresh or lost > 0 or bad, (*findings, *frozen_findings), lost)


def _wrong_kind(expected: Expectation, block: Block) -> str:
    if block.channels != expected.channels:
        found, stated = (", ".join(c.name for c in cs) for cs in (block.channels, expected.channels))
        return f"block {block.seq} of '{block.machine}' has channels {found}; expected {stated}"
    if abs(block.dt - expected.dt) > 1e-9 * expected.dt:
        return f"block {block.seq} of '{block.machine}' is sampled at {block.dt:g} s; expected {expected.dt:g} s"
    return "" if len(block) else f"block {block.seq} of '{block.machine}' holds no samples"


def _gap(block: Block, state: IntakeState, lost: int) -> StreamFinding:
    blocks = block.seq - state.seq
    return StreamFinding("gap", f"{lost} samples ({blocks} blocks) of '{block.machine}' are missing before sample {block.k0}")


def _bad_samples(block: Block) -> tuple[bool, list[StreamFinding]]:
    """NaN in an input or output makes the whole block unusable; the channel and the first sample are named."""
    findings: list[StreamFinding] = []
    if np.isfinite(block.values).all():
        return False, findings
    for i, channel in enumerate(block.channels):
        if channel.role in ("u", "y") and not np.isfinite(block.values[:, i]).all():
            k = int(np.flatnonzero(~np.isfinite(block.values[:, i]))[0])
            count = int((~np.isfinite(block.values[:, i])).sum())
            findings.append(StreamFinding("bad_samples", f"'{channel.name}' is NaN at sample {block.k0 + k} ({count} in this block)"))
    return bool(findings), findings


def _frozen(
    expected: Expectation, state: IntakeState, block: Block, fresh: bool
) -> tuple[Array, Array, tuple[bool, ...], list[StreamFinding]]:
    """Count how long each output has not changed at all; real sensors have noise."""
    y = block.role("y")
    p = y.shape[1]
    before = None if fresh else state.last
    if not (y[1:] == y[:-1]).any() and (before is None or not (y[0] == before).any()):
        return np.zeros(p), y[-1].copy(), (False,) * p, []
    run = np.zeros(p) if fresh or state.run is None else state.run.copy()
    same = np.diff(y, axis=0, prepend=y[:1] * np.nan if before is None else before[None, :]) == 0
    longest = run.copy()
    for i in range(p):
        changes = np.flatnonzero(~same[:, i])
        longest[i] = max(_longest(same[:, i], int(run[i])), 0)
        run[i] = run[i] + len(y) if not len(changes) else len(y) - 1 - changes[-1]
    frozen = tuple(bool(expected.frozen_after and n >= expected.frozen_after) for n in longest)
    was = state.frozen if not fresh and state.frozen else (False,) * p
    names = [c.name for c in block.channels if c.role == "y"]
    frozen_findings = [
        StreamFinding("frozen_sensor", f"'{names[i]}' has not changed for {int(longest[i])} samples; the sensor looks frozen")
        for i in range(p)
        if frozen[i] and not was[i]
    ]
    return run, y[-1].copy(), frozen, frozen_findings


def _longest(same: Array, carried: int) -> int:
    """Return the longest run of True, counting ``carried`` samples before the first."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same.astype(np.int8), [0]])))
    runs = edges[1::2] - edges[::2]
    if not len(runs):
        return 0
    if same[0]:
        runs = runs.copy()
        runs[0] += carried
    return int(runs.max())


def longest_still(y: Array) -> int:
    """Return the longest run of unchanged samples in any column of ``y (n, p)``."""
    return max((_longest(column, 0) for column in (np.diff(y, axis=0) == 0).T), default=0)
