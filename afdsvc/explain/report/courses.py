"""The recordings beside the simulations, before and after, and how well these fit what was held out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import welch

from afdsvc.dataset.experiment import Run
from afdsvc.dataset.periods import aperiodic_part
from afdsvc.explain.report.explanation import OutputFit, RecordingCourse, Spectrum
from afdsvc.explain.search.problem import Point, Problem
from afdsvc.explain.verdict.holdout import Player, nrmse
from afdsvc.lti.statespace import Array
from afdsvc.stats.portmanteau import portmanteau_test


def courses(player: Player, runs: Sequence[Run], role: str, before: Point, after: Point) -> tuple[RecordingCourse, ...]:
    """Return the recordings beside the simulations of both models."""
    both = (player.outputs(runs, p) for p in (before, after))
    return tuple(RecordingCourse(r.name, role, r.t0 + r.dt * np.arange(len(r)), r.Y, b, a) for r, b, a in zip(runs, *both, strict=True))


def fits(held: Sequence[RecordingCourse], names: Sequence[str], floor: Sequence[float] | None) -> tuple[OutputFit, ...]:
    """Return the errors of every output on the held-out recordings, and the noise's."""
    y, before, after = (np.vstack([getattr(c, k) for c in held]) for k in ("measured", "before", "after"))
    errors = zip(names, nrmse(y, before), nrmse(y, after), strict=True)
    spread = np.maximum(np.nanstd(y, axis=0), 1e-300)
    return tuple(OutputFit(n, float(b), float(a), None if floor is None else floor[j] / float(spread[j])) for j, (n, b, a) in enumerate(errors))


def white(problem: Problem, held: Sequence[RecordingCourse]) -> tuple[float, float]:
    """Return the p-values of Hosking's test on the weighted residuals before and after; 0 where a simulation left."""
    return _white(problem, [c.residual_before for c in held]), _white(problem, [c.residual_after for c in held])


def _white(problem: Problem, residuals: Sequence[Array]) -> float:
    if any(np.isinf(e).any() for e in residuals):
        return 0.0
    weighted = [problem.weighting(np.nan_to_num(e / problem.scale)) for e in residuals]
    return portmanteau_test(np.vstack([w - w.mean(0) for w in weighted]))


SEGMENT = 4096


def spectra(runs: Sequence[Run], courses: Sequence[RecordingCourse], outputs: Sequence[str]) -> tuple[Spectrum, ...]:
    """Return one `Spectrum` per output over the courses of these runs (Welch's method, Hann windows, half overlapped)."""
    dt = runs[0].dt
    n = min(SEGMENT, min(len(c.t) for c in courses))
    after = [c.residual_after for c in courses]
    pieces = [c.measured - np.nanmean(c.measured, axis=0) for c in courses], [c.residual_before for c in courses], after
    quiet = aperiodic_part(runs, after)
    noise = density(quiet, min(n, min(len(q) for q in quiet)), dt, n) if quiet else None
    m, b, a = (density(p, n, dt) for p in pieces)
    frequency: Array = np.asarray(np.fft.rfftfreq(n, dt), dtype=np.float64)
    return tuple(Spectrum(v, frequency, m[:, j], b[:, j], a[:, j], None if noise is None else noise[:, j]) for j, v in enumerate(outputs))


def density(pieces: Sequence[Array], n: int, dt: float, padded: int | None = None) -> Array:
    """Return the one-sided power density ``(padded or n) // 2 + 1`` frequencies by outputs; gaps count as zero."""
    step = max(n // 2, 1)
    known = [np.nan_to_num(x, nan=0.0, posinf=0.0, neginf=0.0) for x in pieces if len(x) >= n]
    found = [welch(x, 1 / dt, "hann", n, n - step, padded, False, axis=0)[1] for x in known]
    return np.asarray(np.average(found, axis=0, weights=[1 + (len(x) - n) // step for x in known]))
