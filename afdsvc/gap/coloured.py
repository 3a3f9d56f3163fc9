"""Noise that is not white: named from what does not repeat with the excitation, output by output."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from afdsvc.gap.explanation import Estimate, Named
from afdsvc.gap.lines import tones
from afdsvc.gap.noise import toneless, wandering
from afdsvc.gap.runs import Run
from afdsvc.gap.whitening import whiteness_p
from afdsvc.lti.statespace import Array

SURE = 1e-6  # p-value of whiteness below which an output's noise counts as coloured
LAGS = 6
ROUNDING = 1e-9  # of a reading's spread: noise below it is that of arithmetic, in recordings that were computed and not measured


def coloured(runs: Sequence[Run], residuals: Sequence[Array], outputs: Sequence[tuple[str, str]], effect: int) -> tuple[Named, ...]:
    """Return one name per output ``(name, unit)`` whose noise is coloured; none where nothing repeats, so noise is not known.

    ``effect`` is the number the first of them gets. Lines are taken out first: a tone is no noise.
    """
    lines = [t.omega for t in tones(runs, residuals)]
    calm = [_without(r, e, lines) for r, e in zip(runs, residuals, strict=True)]
    pieces = toneless([p - p.mean(0) for p in wandering(runs, calm)])
    if not pieces:
        return ()
    found: list[tuple[float, Named]] = []
    for j, (name, unit) in enumerate(outputs):
        own = [p[:, [j]] for p in pieces]
        p_white = whiteness_p(own)
        if p_white < SURE and np.std(own) > ROUNDING * max(float(np.nanstd(r.Y[:, j])) for r in runs):
            found.append(_named(name, unit, own, p_white, runs[0].dt))
    found.sort(key=lambda pair: -pair[0])  # a loop carries colour to other outputs, where its share is smaller
    return tuple(replace(named, effect=effect + k) for k, (_, named) in enumerate(found))


def _without(run: Run, e: Array, lines: Sequence[float]) -> Array:
    """Return a residual with tones at these angular frequencies taken out by least squares."""
    if not lines:
        return e
    t = run.dt * np.arange(len(e))
    waves = np.column_stack([f(w * t) for w in lines for f in (np.sin, np.cos)])
    return np.asarray(e - waves @ np.linalg.lstsq(waves, e, rcond=None)[0])


def _named(name: str, unit: str, pieces: Sequence[Array], p_white: float, dt: float) -> tuple[float, Named]:
    """Return the share of the noise's power that is coloured, and the name."""
    r = _correlation(pieces)
    pole, power = _first_order(r)
    sd = float(np.sqrt(power))
    seconds = -dt / np.log(pole)
    told = {"rms": Estimate(sd, None, unit), "correlation time": Estimate(float(seconds), None, "s")}
    share = float(np.clip(power / r[0], 0.0, 1.0))
    sentence = (
        f"noise of sensor {name}: coloured (whiteness p = {p_white:.1g}), rms {sd:.3g} {unit} with a correlation time of "
        f"{seconds:.3g} s beside white noise; {100 * share:.0f} % of the noise's power"
    )
    return share, Named("coloured_noise", f"output:{name}", 1.0, told, sentence, 1, 0.0, "noise")


def _correlation(pieces: Sequence[Array]) -> Array:
    """Return the autocovariance at lags 0 to `LAGS`."""
    n = sum(len(x) for x in pieces)
    return np.array([sum(float((x[lag:, 0] * x[: len(x) - lag, 0]).sum()) for x in pieces) / n for lag in range(LAGS + 1)])


def _first_order(r: Array) -> tuple[float, float]:
    """Return pole and power of first-order noise beside white noise: ``r_k = power pole^k`` for k > 0, by log regression."""
    k = np.arange(1, LAGS + 1)
    good = r[1:] > 0
    if good.sum() < 2:
        return 0.5, float(max(abs(r[1]) * 2, 1e-12 * r[0]))
    slope, level = np.polyfit(k[good], np.log(r[1:][good]), 1, w=r[1:][good])
    pole = float(np.clip(np.exp(slope), 0.05, 0.9999))
    return pole, float(min(np.exp(level), r[0]))
