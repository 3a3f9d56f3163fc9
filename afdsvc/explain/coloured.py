"""Noise that is not white: named from what does not repeat with the excitation, output by output."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import stats

from afdsvc.dataset.experiment import Run
from afdsvc.explain.explanation import Estimate, Named
from afdsvc.explain.noise import toneless, wandering
from afdsvc.lti.statespace import Array
from afdsvc.stats.ar_noise import whiteness_p
from afdsvc.stats.first_order_noise import FirstOrder, first_order
from afdsvc.stats.tones import tones

SURE = 1e-6  # p-value of whiteness below which an output's noise counts as coloured
LAGS = 6
CHANCE = 1e-3  # that white noise of a machine, in which nothing else is found, is told coloured
BOTH = 0.05  # p-value in what does not repeat from which colour in the whole residual counts
ROUNDING = 1e-9  # of a reading's spread: noise below it is that of arithmetic, in recordings that were computed and not measured


def coloured(
    runs: Sequence[Run], residuals: Sequence[Array], outputs: Sequence[tuple[str, str]], effect: int, predicted: bool = False
) -> tuple[Named, ...]:
    """Return one name per output ``(name, unit)`` whose noise is coloured; none where nothing repeats, so noise is not known.

    ``effect`` is the number the first of them gets. Lines are taken out first: a tone is no noise. Of residuals that are
    ``predicted`` from the readings before, negative correlation is no colour: a prediction that corrects too much leaves it.
    """
    pieces = _noise(runs, _lineless(runs, residuals))
    found = []
    for j, (name, unit) in enumerate(outputs if pieces else ()):
        own = [p[:, [j]] for p in pieces]
        if predicted and _correlation(own)[1] <= 0:
            continue
        p_white = whiteness_p(own)
        if p_white < SURE and _measured(runs, j, _rms(own)):
            found.append(_named(name, unit, own, p_white, runs[0].dt))
    return _numbered(found, effect)


def faintly_coloured(runs: Sequence[Run], residuals: Sequence[Array], outputs: Sequence[tuple[str, str]]) -> tuple[Named, ...]:
    """Return one name per output whose noise has a first-order part too faint for `coloured`: for residuals in which nothing is left.

    It has to show in what does not repeat; or in the whole residual, and there with the same pole.
    """
    whole = _lineless(runs, residuals)
    pieces = _noise(runs, whole)
    found = []
    for j, (name, unit) in enumerate(outputs if pieces else ()):
        own = [p[:, j] for p in pieces]
        seen = _faint(own, [e[:, j] for e in whole], CHANCE / len(outputs))
        if seen is not None and _measured(runs, j, _rms(own)):
            found.append((seen.share, _faint_name(name, unit, seen, _rms(own), runs[0].dt)))
    return _numbered(found, 1)


def _numbered(found: Sequence[tuple[float, Named]], first: int) -> tuple[Named, ...]:
    """Return the names by falling share: a loop carries colour to other outputs, where its share is smaller."""
    in_order = sorted(found, key=lambda pair: -pair[0])
    return tuple(replace(named, effect=first + k) for k, (_, named) in enumerate(in_order))


def _measured(runs: Sequence[Run], j: int, rms: float) -> bool:
    """Whether noise of this rms at output ``j`` is more than the rounding of recordings that were computed."""
    return rms > ROUNDING * max(float(np.nanstd(r.Y[:, j])) for r in runs)


def _rms(pieces: Sequence[Array]) -> float:
    """Return the rms of pieces of any lengths about zero, which is their mean."""
    return float(np.sqrt(np.mean(np.concatenate(pieces) ** 2)))


def _faint(noise: Sequence[Array], whole: Sequence[Array], chance: float) -> FirstOrder | None:
    """Return the first-order part of the noise where it is no accident."""
    best = first_order(noise)
    if best.p < chance / 2:
        return best
    best = first_order(whole)
    beside = first_order(noise, best.pole)
    return best if best.p < chance / 2 and stats.norm.sf(beside.z) < BOTH else None


def _faint_name(name: str, unit: str, seen: FirstOrder, sd: float, dt: float) -> Named:
    rms = sd * float(np.sqrt(seen.share))
    seconds = -dt / float(np.log(seen.pole))
    told = {"rms": Estimate(rms, rms * seen.sd / (2 * seen.share), unit), "correlation time": Estimate(seconds, None, "s")}
    sentence = (
        f"noise of sensor {name}: {100 * seen.share:.2g} +- {100 * seen.sd:.1g} % of its power is coloured (first-order test, "
        f"p = {seen.p:.1g}), rms {rms:.3g} {unit} with a correlation time of {seconds:.3g} s beside white noise"
    )
    return Named("coloured_noise", f"output:{name}", 1.0, told, sentence, 1, 0.0, "noise")


def _lineless(runs: Sequence[Run], residuals: Sequence[Array]) -> list[Array]:
    lines = [t.omega for t in tones(runs, residuals)]
    return [_without(r, e, lines) for r, e in zip(runs, residuals, strict=True)]


def _noise(runs: Sequence[Run], residuals: Sequence[Array]) -> list[Array]:
    """Return what does not repeat, without what towers out of its spectrum."""
    return toneless([p - p.mean(0) for p in wandering(runs, residuals)])


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
    if r[1] <= 0:
        return 0.0, _alternating(name, unit, r, sum(len(x) for x in pieces), p_white)
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


def _alternating(name: str, unit: str, r: Array, n: int, p_white: float) -> Named:
    """Return the name for noise whose neighbours tend to opposite signs, which has no correlation time."""
    told = {"rms": Estimate(float(np.sqrt(r[0])), None, unit), "correlation of neighbours": Estimate(float(r[1] / r[0]), float(n**-0.5), "")}
    sentence = f"noise of sensor {name}: coloured (whiteness p = {p_white:.1g}), rms {np.sqrt(r[0]):.3g} {unit}; neighbouring samples correlate by {r[1] / r[0]:.2g}"
    return Named("coloured_noise", f"output:{name}", 1.0, told, sentence, 1, 0.0, "noise")


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
