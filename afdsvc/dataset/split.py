"""Split of the recordings into training, selection and held-out parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from afdsvc.dataset.experiment import Run

SELECT_SHARE = 1 / 3  # of what is not held out, when there are too few recordings to keep whole ones back
HELD_SHARE = 1 / 3  # of a single recording


@dataclass(frozen=True, slots=True)
class Split:
    """Runs to fit, to choose by, and to report on."""

    train: tuple[Run, ...]
    select: tuple[Run, ...]
    heldout: tuple[Run, ...]

    @property
    def heldout_names(self) -> tuple[str, ...]:
        """What was never used in fitting, by recording and, where it is a part of one, its span in seconds."""
        names = [r.name for r in (*self.train, *self.select)]
        return tuple(_span(r) if r.name in names else r.name for r in self.heldout)


def split(runs: Sequence[Run], holdout: Sequence[Run]) -> Split:
    """Return the roles: the holdout as given, else the last recording (the last third of a single one).

    Of three or more recordings left the last quarter (at least one) selects; of fewer, the last third of each.
    """
    left = list(runs)
    if holdout:
        held = list(holdout)
    elif len(left) > 1:
        held = [left.pop()]
    else:
        kept, last = parts(left[0], 1 - HELD_SHARE)
        left, held = [kept], [last]
    if len(left) >= 3:
        count = max(1, len(left) // 4)
        return Split(tuple(left[:-count]), tuple(left[-count:]), tuple(held))
    pairs = [parts(r, 1 - SELECT_SHARE) for r in left]
    return Split(tuple(a for a, _ in pairs), tuple(b for _, b in pairs), tuple(held))


def parts(run: Run, share: float) -> tuple[Run, Run]:
    """Return the first ``share`` of a run and the rest; the cut falls on a whole period where one is near."""
    cut = int(len(run) * share)
    if run.period and len(run) >= 3 * run.period:
        cut = max(2, round(cut / run.period)) * run.period
        cut = min(cut, (len(run) // run.period - 1) * run.period + len(run) % run.period)
    return run.span(0, cut), run.span(cut, len(run))


def _span(run: Run) -> str:
    return f"{run.name}, {run.t0:g} to {run.t0 + len(run) * run.dt:g} s"
