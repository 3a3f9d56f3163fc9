"""Blocks joined to traces, one for each uninterrupted stretch of each session."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from afdsvc.api.signals import Block, Channel, Trace
from afdsvc.errors import BadInput

Stream = tuple[str, str, tuple[Channel, ...], float]


def traces_of(blocks: Iterable[Block], name: str, t0: float = 0.0) -> list[Trace]:
    """Return one trace per machine, session, set of channels and uninterrupted stretch, in order of appearance.

    Late blocks are put in their place, repeated ones dropped. ``t0`` [s] is the time of sample 0. The notes of a trace
    name machine, session, index (``k0``) and Unix time (``t0_ns``) of its first sample, and samples ``lost`` before it.
    Raises `BadInput` when blocks overlap with different samples: two rigs spoke under one name.
    """
    streams: dict[Stream, list[Block]] = {}
    for block in blocks:
        streams.setdefault((block.machine, block.session, block.channels, block.dt), []).append(block)
    return [_trace(run, lost, name, t0) for found in streams.values() for run, lost in _runs(found)]


def _runs(blocks: list[Block]) -> Iterator[tuple[list[Block], int]]:
    """Yield stretches without gap, each with the number of samples missing before it."""
    run: list[Block] = []
    lost = 0
    for block in sorted(blocks, key=lambda b: b.k0):
        end = run[-1].k0 + len(run[-1]) if run else block.k0
        if block.k0 < end:
            _refuse_overlap(run[-1], block)
        elif block.k0 == end:
            run.append(block)
        else:
            yield run, lost
            run, lost = [block], block.k0 - end
    if run:
        yield run, lost


def _refuse_overlap(one: Block, other: Block) -> None:
    if one.k0 != other.k0 or one.values.tobytes() != other.values.tobytes():
        raise BadInput(
            f"machine '{one.machine}', session '{one.session}': blocks {one.seq} and {other.seq} both hold sample "
            f"{other.k0}, with different contents; expected one rig per machine id"
        )


def _trace(run: list[Block], lost: int, name: str, t0: float) -> Trace:
    first = run[0]
    notes = {
        "machine": first.machine, "session": first.session, "k0": str(first.k0), "t0_ns": str(first.t0_ns),
        "lost": str(lost),
    }  # fmt: skip
    values = np.concatenate([block.values for block in run])
    return Trace(name, first.dt, first.channels, values, t0 + first.k0 * first.dt, notes)
