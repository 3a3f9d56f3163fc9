"""What is fitted and what is held out: the recordings sorted into the two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from afdsvc.dataset.experiment import Run

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
    """Return the roles: the holdout as given, else the last recording, or the last third of a single one."""
    if holdout:
        return Split(tuple(runs), tuple(holdout))
    if len(runs) > 1:
        return Split(tuple(runs[:-1]), (runs[-1],))
    first, last = _parts(runs[0], 1 - HELD_SHARE)
    return Split((first,), (last,))


def _parts(run: Run, share: float) -> tuple[Run, Run]:
    """Return the first ``share`` of a run and the rest; the cut falls on a whole period where one is near."""
    cut = int(len(run) * share)
    if run.period and len(run) >= 3 * run.period:
        cut = max(2, round(cut / run.period)) * run.period
        cut = min(cut, (len(run) // run.period - 1) * run.period + len(run) % run.period)
    return run.span(0, cut), run.span(cut, len(run))


def _span(run: Run) -> str:
    return f"{run.name}, {run.t0:g} to {run.t0 + len(run) * run.dt:g} s"
