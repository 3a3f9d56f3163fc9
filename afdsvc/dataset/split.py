"""What is fitted and what is held out: the recordings sorted into the two."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from afdsvc.api.model import Variable
from afdsvc.dataset.experiment import FEWEST, Run
from afdsvc.dataset.units import with_unit
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array

HELD_SHARE = 1 / 3  # of a single recording


@dataclass(frozen=True, slots=True)
class Split:
    """Runs to fit, and runs to report on."""

    train: tuple[Run, ...]
    heldout: tuple[Run, ...]

    @property
    def heldout_names(self) -> tuple[str, ...]:
        """What was never used in fitting, by recording and, where it is a part of one, its span in seconds."""
        names = [r.name for r in self.train]
        return tuple(_span(r) if r.name in names else r.name for r in self.heldout)


def split(runs: Sequence[Run], holdout: Sequence[Run]) -> Split:
    """Return the roles: the holdout as given, else the last recording in which every output moves, or the last third of the only one.

    Raises `BadInput` where what is given to be held out has fewer than `FEWEST` samples.
    """
    if holdout:
        if (samples := sum(map(len, holdout))) < FEWEST:
            raise BadInput(f"{', '.join(r.name for r in holdout)}: {samples} samples to be held out; expected at least {FEWEST}")
        return Split(tuple(runs), tuple(holdout))
    last = [r for r in runs if len(r) >= FEWEST and not still(r.Y).any()] or [runs[-1]]
    others = tuple(r for r in runs if r is not last[-1])
    if len(last) > 1:
        return Split(others, (last[-1],))
    first, rest = _parts(last[0], 1 - HELD_SHARE)
    return Split((*others, first), (rest,))


def still(y: Array) -> Array:
    """Return which columns of ``y (T, p)`` hold one value, readings that are missing aside."""
    return np.asarray(np.nanmax(y, axis=0) == np.nanmin(y, axis=0))


def still_readings(outputs: Sequence[Variable], y: Array) -> Iterator[tuple[str, str]]:
    """Yield the name of every output ``y (T, p)`` that holds one value, and what to say of it."""
    for v, value, dead in zip(outputs, np.nanmin(y, axis=0), still(y), strict=True):
        if dead:
            yield v.name, f"reads {with_unit(f'{value + 0.0:.6g}', v.unit)} in every sample; expected recordings in which it moves"


def _parts(run: Run, share: float) -> tuple[Run, Run]:
    """Return the first ``share`` of a run and the rest; the cut falls on a whole period where one is near."""
    cut = int(len(run) * share)
    if run.period and len(run) >= 3 * run.period:
        cut = max(2, round(cut / run.period)) * run.period
        cut = min(cut, (len(run) // run.period - 1) * run.period + len(run) % run.period)
    return run.span(0, cut), run.span(cut, len(run))


def _span(run: Run) -> str:
    return f"{run.name}, {run.t0:g} to {run.t0 + len(run) * run.dt:g} s"
