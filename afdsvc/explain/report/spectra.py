"""Spectra of the residual before and after, output by output, for people to look at."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from afdsvc.dataset.experiment import Run
from afdsvc.dataset.periods import aperiodic_part
from afdsvc.explain.report.explanation import RecordingCourse, Spectrum
from afdsvc.lti.statespace import Array

SEGMENT = 4096


def spectra(runs: Sequence[Run], courses: Sequence[RecordingCourse], outputs: Sequence[str]) -> tuple[Spectrum, ...]:
    """Return one `Spectrum` per output over the courses of these runs (Welch's method, Hann windows, half overlapped)."""
    dt = runs[0].dt
    n = min(SEGMENT, min(len(c.t) for c in courses))
    parts = {
        "measured": [c.measured - np.nanmean(c.measured, axis=0) for c in courses],
        "before": [c.residual_before for c in courses],
        "after": [c.residual_after for c in courses],
    }
    densities = {k: density(v, n, dt) for k, v in parts.items()}
    quiet = aperiodic_part(runs, parts["after"])
    noise = density(quiet, min(n, min(len(q) for q in quiet)), dt, n) if quiet else None
    frequency: Array = np.asarray(np.fft.rfftfreq(n, dt), dtype=np.float64)
    return tuple(
        Spectrum(
            name, frequency, densities["measured"][:, j], densities["before"][:, j], densities["after"][:, j],
            None if noise is None else noise[:, j],
        )
        for j, name in enumerate(outputs)
    )


def density(pieces: Sequence[Array], n: int, dt: float, padded: int | None = None) -> Array:
    """Return the one-sided power density ``(padded or n) // 2 + 1`` frequencies by outputs; gaps count as zero."""
    length = padded or n
    window = np.hanning(n)[:, None]
    total: Array = np.zeros((length // 2 + 1, pieces[0].shape[1]))
    count = 0
    for x in pieces:
        x = np.nan_to_num(x, nan=0.0, posinf=0.0, neginf=0.0)
        for start in range(0, len(x) - n + 1, max(n // 2, 1)):
            total += np.abs(np.fft.rfft(x[start : start + n] * window, length, axis=0)) ** 2
            count += 1
    return total * 2 * dt / max(count * float((window**2).sum()), 1e-300)
