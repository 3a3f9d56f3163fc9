"""A picture of two curves in characters, for a terminal."""

from __future__ import annotations

import numpy as np

from afdsvc.lti.statespace import Array

WIDTH, HEIGHT, SHOWN = 72, 9, 360  # columns, rows, samples of a close-up
MARKS = {(True, False): "·", (False, True): "+", (True, True): "#", (False, False): " "}
LEGEND = "· measured  + simulated  # both"


def close_up(measured: Array, simulated: Array, samples: int = SHOWN) -> slice:
    """Return the stretch where the two differ most."""
    if len(measured) <= samples:
        return slice(0, len(measured))
    power = np.concatenate([[0.0], np.cumsum(np.nan_to_num(measured - simulated) ** 2)])
    start = int(np.argmax(power[samples:] - power[:-samples]))
    return slice(start, start + samples)


def text_plot(measured: Array, simulated: Array) -> list[str]:
    """Return the rows of the picture, the scale on the left.

    >>> rows = text_plot(np.sin(np.arange(100) / 8), np.zeros(100))
    >>> len(rows), rows[0].split()[0]
    (9, '1')
    """
    both = np.concatenate([measured[np.isfinite(measured)], simulated])
    low, high = float(both.min()), float(both.max())
    marked = [_marked(curve, low, high) for curve in (measured, simulated)]
    rows = ["".join(MARKS[bool(a), bool(b)] for a, b in zip(*pair, strict=True)) for pair in zip(*marked, strict=True)]
    scale = [f"{high:.3g}", *[""] * (HEIGHT - 2), f"{low:.3g}"]
    return [f"{number:>9} {row}".rstrip() for number, row in zip(scale, rows, strict=True)]


def _marked(curve: Array, low: float, high: float) -> Array:
    """Return which cells ``(HEIGHT, WIDTH)`` a curve passes through, from the lowest to the highest value of every column."""
    cells = np.zeros((HEIGHT, WIDTH), dtype=bool)
    rows = np.round((high - curve) / max(high - low, 1e-300) * (HEIGHT - 1))
    for column, part in enumerate(np.array_split(rows, WIDTH)):
        seen = part[np.isfinite(part)]
        if len(seen):
            cells[int(seen.min()) : int(seen.max()) + 1, column] = True
    return cells
