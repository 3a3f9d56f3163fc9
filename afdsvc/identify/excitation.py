"""Persistent excitation: do the inputs support a model of the requested order?

A model of order n with p outputs needs inputs that are persistently exciting of order ``n + l + 1``, l the number of
samples after which the outputs show every state, at least n/p (Willems, Rapisarda, Markovsky and De Moor, Systems and
Control Letters 54, 2005). One spectral line gives order 2, so lines are counted: peaks of the windowed spectrum, and
for bands the number of lines the recording can resolve in them. Several bursts count together, each judged over the
time it lasts (van Waarde et al., IEEE Control Systems Letters 4, 2020).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from afdsvc.dataset.arrays import InputOutputData, scale_recordings, scales
from afdsvc.errors import BadInput
from afdsvc.identify.numerics.compression import compress_size, factor_of
from afdsvc.identify.settings import SETTINGS
from afdsvc.lti.statespace import Array

#: A single line of a Blackman window fills up to 7 bins above -50 dB; bins further on are further lines.
_LINE_BINS = 7
#: Movement, relative to the liveliest two-hundredth of a recording, below which an input pauses; inside a recording for
#: at least five of those (a slow sine is smaller than that for three of them when it crosses zero).
QUIET_LEVEL, _PAUSE_BLOCKS, _SHORTEST = 0.05, 5, 16


@dataclass(frozen=True, slots=True, eq=False)
class Excitation:
    """What the inputs offer: spectral lines (thus persistent excitation) and band [Hz] of every input.

    ``dependence`` is the share of every input's power that the others explain.
    """

    lines: tuple[int, ...]
    band_hz: tuple[tuple[float, float], ...]
    dependence: tuple[float, ...]

    @property
    def persistent_order(self) -> int:
        """Order of persistent excitation of the poorest input."""
        return 2 * min(self.lines)


def needed_order(order: int, outputs: int) -> int:
    """Return the order of persistent excitation that a model of this order needs."""
    return order + -(-order // outputs) + 1


def supported_order(persistent: int, outputs: int) -> int:
    """Return the largest order of a model that persistent excitation of some order can carry."""
    return max((n for n in range(persistent) if needed_order(n, outputs) <= persistent), default=0)


def excitation(recordings: Sequence[InputOutputData]) -> Excitation:
    """Return what the inputs of the recordings offer together (the mean does not count)."""
    lines, bands = zip(*(_lines(recordings, j) for j in range(recordings[0].u.shape[1])), strict=True)
    return Excitation(tuple(lines), tuple(bands), tuple(_dependence(recordings)))


def require_excitation(
    recordings: Sequence[InputOutputData],
    order: int,
    names: Sequence[str],
    outputs: int,
    band_hz: tuple[float, float],
    scale: Array | None = None,
) -> Excitation:
    """Return the excitation when it supports the order; raises `BadInput` naming the input and the burst to play
    instead.

    ``names`` are those of the inputs, ``band_hz`` the band in which the plant acts, ``scale (m,)`` the size of the
    plant's inputs: what moves less than `IdentificationSettings.least_movement` of it does not move.
    """
    least = SETTINGS.least_movement * scale if scale is not None else np.zeros(len(names))
    for j, name in enumerate(names):
        if not any(np.ptp(r.u[:, j]) > least[j] for r in recordings):
            raise BadInput(f"input '{name}' never moves; {_advice(order, outputs, band_hz)}")
    found, needed = excitation(recordings), needed_order(order, outputs)
    for name, lines in zip(names, found.lines, strict=True):
        if 2 * lines < needed:
            raise BadInput(
                f"input '{name}' holds {lines} spectral line{'s' if lines != 1 else ''}: persistent excitation of order "
                f"{2 * lines}, expected {needed} for a model of order {order}; "
                f"{_advice(order, outputs, band_hz)}"
            )
    for name, share in zip(names, found.dependence, strict=True):
        if share > SETTINGS.largest_dependence:
            raise BadInput(
                f"the other inputs explain {100 * share:.3g} % of input '{name}' (at most "
                f"{100 * SETTINGS.largest_dependence:.3g} %), so their "
                f"effects cannot be separated; excite one input after the other, or {_advice(order, outputs, band_hz)}"
            )
    return found


def _advice(order: int, outputs: int, band_hz: tuple[float, float]) -> str:
    """Return in words which burst would support the order."""
    lines = max(2 * needed_order(order, outputs), 20)
    low, high = band_hz
    seconds = max(2 * lines / max(high - low, 1e-9), 10 / low)
    return (
        "play a broad burst instead (afdsvc burst --purpose identify): a multisine with at least "
        f"{lines} lines between {low:.3g} and {high:.3g} Hz on every input, or (--purpose identify_binary) random "
        f"binary steps for at least {seconds:.3g} s"
    )


def _lines(recordings: Sequence[InputOutputData], j: int) -> tuple[int, tuple[float, float]]:
    """Return the spectral lines of one input over all stretches in which it moves, and the band they fill."""
    found = [_stretch_lines(r.u[a:b, j] - r.u[:, j].mean(), r.dt) for r in recordings for a, b in _stretches(r.u[:, j])]
    held, low, high = np.zeros(0), np.inf, 0.0
    for centres, width, (bottom, top) in sorted(found, key=lambda f: -len(f[0])):
        new = centres if not held.size else centres[_distance(held, centres) > width / 2]
        held = np.sort(np.concatenate([held, new]))
        if centres.size:
            low, high = min(low, bottom), max(high, top)
    return len(held), (float(min(low, high)), float(high))


def _stretches(u: Array) -> list[tuple[int, int]]:
    """Return where an input moves: a burst is judged on its own, not with the silence around it.

    Switching a sine on and off spreads it over many bins of a long recording, but it remains one line.
    """
    size = max(1, len(u) // 200)
    starts = np.arange(0, len(u), size)
    power = np.add.reduceat((u - u.mean()) ** 2, starts) / np.diff([*starts, len(u)])
    silent = power <= QUIET_LEVEL**2 * power.max()
    runs = np.split(np.arange(len(starts)), np.flatnonzero(np.diff(silent.astype(int))) + 1)
    ends = (0, len(starts) - 1)
    pauses = [r for r in runs if silent[r[0]] and (len(r) >= _PAUSE_BLOCKS or r[0] in ends or r[-1] in ends)]
    if not power.max() > 0:
        return []
    edges = [0, *(edge for run in pauses for edge in (run[0] * size, (run[-1] + 1) * size)), len(u)]
    pairs = zip(edges[::2], np.minimum(edges[1::2], len(u)), strict=True)
    return [(int(a), int(b)) for a, b in pairs if b - a >= _SHORTEST]


def _stretch_lines(u: Array, dt: float) -> tuple[Array, float, tuple[float, float]]:
    """Return the frequencies [Hz] of the lines of a stretch, the width of a line, and the band they fill."""
    step = 1 / (len(u) * dt)
    power = np.abs(np.fft.rfft(u * np.blackman(len(u)))) ** 2
    if not power.max() > 0:
        return np.zeros(0), _LINE_BINS * step, (0.0, 0.0)
    above = np.flatnonzero(power > SETTINGS.line_level * power.max())
    centres = []
    for run in np.split(above, np.flatnonzero(np.diff(above) > 1) + 1):
        count = max(1, round(len(run) / _LINE_BINS))
        centres.append(run[0] + (np.arange(count) + 0.5) * len(run) / count - 0.5)
    return np.concatenate(centres) * step, _LINE_BINS * step, (float(above[0] * step), float(above[-1] * step))


def _distance(held: Array, centres: Array) -> Array:
    """Return how far each of the centres is from the nearest one held (both sorted)."""
    place = np.searchsorted(held, centres)
    left, right = held[np.maximum(place - 1, 0)], held[np.minimum(place, len(held) - 1)]
    return np.asarray(np.minimum(np.abs(centres - left), np.abs(centres - right)))


def _dependence(recordings: Sequence[InputOutputData]) -> list[float]:
    """Return for every input the share of its power explained by a filter of 21 lags of the others."""
    m = recordings[0].u.shape[1]
    if m == 1:
        return [0.0]
    lags, bare = 21, [InputOutputData(r.u, np.zeros((len(r), 0)), r.dt, r.name) for r in recordings if len(r) >= 21]
    if not bare:
        return [0.0] * m
    bare = scale_recordings(bare, scales(bare)[0], np.zeros(0))
    compress_size(bare, lags)
    views = [np.lib.stride_tricks.sliding_window_view(r.u, lags, axis=0).swapaxes(1, 2) for r in bare]
    factor = factor_of(lambda: (v[a : a + 4096].reshape(-1, lags * m) for v in views for a in range(0, len(v), 4096)))
    shares = []
    for j in range(m):
        own = factor[:, (lags // 2) * m + j]
        others = np.delete(factor, np.s_[j::m], axis=1)
        left = own - others @ linalg.lstsq(others, own, cond=1e-8)[0]
        shares.append(float(1 - (left @ left) / (own @ own)) if own @ own > 0 else 0.0)
    return shares
