"""A curve in words: how it grows, whether it changes sign with the direction, and how well that fits."""

from __future__ import annotations

import numpy as np

from afdsvc.api.physics import Size
from afdsvc.dataset.units import is_velocity
from afdsvc.lti.statespace import Array

POWERS = np.arange(0.0, 4.05, 0.1)
GROWTH = ((0.3, "has the same size at every value of {0}"), (0.75, "grows with the root of {0}"), (1.4, "grows in proportion to {0}"), (2.5, "grows with the square of {0}"))
UNEVEN = 1.3  # ratio of the sizes in both directions from which it is said
POOR = 0.35  # error of the best power law, over the curve's rms, from which no form is stated


def described(x: Array, y: Array, band: Array, adds: bool, of: Size) -> str:
    """Return a curve ``y (k,)`` at ``x (k,)`` in words; ``adds`` for an input or a sensor, whose curve is read against ``x``."""
    return _gains(x, y) if adds else _force(x, y, band, "the speed" if is_velocity(of.unit) else of.name)


def _gains(x: Array, y: Array) -> str:
    """Return the slope of a curve in its middle and at both ends."""
    slope = np.diff(y) / np.diff(x)
    middle = float(np.interp(0.0 if x[0] < 0 < x[-1] else float(x.mean()), (x[1:] + x[:-1]) / 2, slope))
    return f"passes small changes {middle:.3g} times, {float(slope[0]):.3g} times at the lower and {float(slope[-1]):.3g} times at the upper end"


def _force(x: Array, y: Array, band: Array, what: str) -> str:
    """Return the power law, with a size for either direction, that fits best."""
    weight = 1 / np.maximum(band, 0.05 * np.abs(y).max() + 1e-300)
    fits = [_power(x, y, weight, n) for n in POWERS]
    n, size, error = POWERS[int(np.argmin([f[1] for f in fits]))], *min(fits, key=lambda f: f[1])
    rms = float(np.sqrt(np.average(y**2, weights=weight**2)))
    if error > POOR * rms:
        return f"a force of {float(y.min()):.3g} to {float(y.max()):.3g} that no power of {what} describes"
    grows = next((words for limit, words in GROWTH if n < limit), "grows with the third power or more of {0}").format(what)
    up, down = float(size[0]), float(size[1])
    both = x[0] < 0 < x[-1] and up * down != 0
    sign = "" if not both else f", changes sign with {'the direction' if what == 'the speed' else what}" if up * down < 0 else ", keeps its sign"
    ratio = abs(up / down) if both else 1.0
    uneven = f" and is {max(ratio, 1 / ratio):.2g} times as large {'forwards' if ratio > 1 else 'backwards'}" if max(ratio, 1 / ratio) > UNEVEN else ""
    return f"a force that {grows}{sign}{uneven}, +-{100 * error / rms:.0f} %"


def _power(x: Array, y: Array, weight: Array, n: float) -> tuple[Array, float]:
    """Return the sizes for positive and negative ``x`` of ``|x|^n``, and the weighted rms error."""
    shape = (np.abs(x) / np.abs(x).max()) ** n * (x != 0)
    columns = np.column_stack([np.where(x > 0, shape, 0.0), np.where(x < 0, shape, 0.0)])
    size: Array = np.asarray(np.linalg.lstsq(columns * weight[:, None], y * weight, rcond=None)[0], dtype=np.float64)
    return size, float(np.sqrt(np.average((y - columns @ size) ** 2, weights=weight**2)))
