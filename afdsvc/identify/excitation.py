"""Does the input move enough, and in enough ways, to support a model of some order?

A model of order n with p outputs needs inputs that are persistently exciting of order ``n + l + 1``, l the number of
samples after which the outputs show every state, at least n/p (Willems, Rapisarda, Markovsky and De Moor, Systems and
Control Letters 54, 2005). One spectral line gives order 2, so lines are counted: peaks of the windowed spectrum, and
for bands the number of lines the recording can resolve in them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from afdsvc.errors import BadInput
from afdsvc.identify.compression import compress_size, factor_of
from afdsvc.identify.recordings import Recording, scaled, scales
from afdsvc.lti.statespace import Array

#: Power of a spectral bin, relative to the strongest, above which it counts as excited.
LINE_LEVEL = 1e-5
#: Movement, relative to that of the plant's input, below which an excitation counts as none (filter transients remain).
LEAST_MOVEMENT = 3e-3
#: Share of an input's power that the other inputs may explain (95 % would still separate them, poorly).
DEPENDENCE_LIMIT = 0.999


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


def excitation(recordings: Sequence[Recording]) -> Excitation:
    """Return what the inputs of the recordings offer together (the mean does not count)."""
    lines, bands = zip(*(_lines(recordings, j) for j in range(recordings[0].u.shape[1])), strict=True)
    return Excitation(tuple(lines), tuple(bands), tuple(_dependence(recordings)))


def require_excitation(
    recordings: Sequence[Recording],
    order: int,
    names: Sequence[str],
    outputs: int,
    band_hz: tuple[float, float],
    scale: Array | None = None,
) -> Excitation:
    """Return the excitation when it supports the order; raises `BadInput` naming the input and the burst to play
    instead.

    ``names`` are those of the inputs, ``band_hz`` the band in which the plant acts, ``scale (m,)`` the size of the
    plant's inputs: what moves less than `LEAST_MOVEMENT` of it does not move.
    """
    least = LEAST_MOVEMENT * scale if scale is not None else np.zeros(len(names))
    for j, name in enumerate(names):
        if not any(np.ptp(r.u[:, j]) > least[j] for r in recordings):
            raise BadInput(f"input '{name}' never moves; {advice(order, outputs, band_hz)}")
    found, wanted = excitation(recordings), needed_order(order, outputs)
    for name, lines in zip(names, found.lines, strict=True):
        if 2 * lines < wanted:
            raise BadInput(
                f"input '{name}' holds {lines} spectral line{'s' if lines != 1 else ''} (persistent excitation "
                "of order "
                f"{2 * lines}); order {order} needs {wanted}: {advice(order, outputs, band_hz)}"
            )
    for name, share in zip(names, found.dependence, strict=True):
        if share > DEPENDENCE_LIMIT:
            raise BadInput(
                f"the other inputs explain {100 * share:.3g} % of input '{name}' (at most "
                f"{100 * DEPENDENCE_LIMIT:.3g} %), so their "
                f"effects cannot be told apart; excite one input after the other, or {advice(order, outputs, band_hz)}"
            )
    return found


def advice(order: int, outputs: int, band_hz: tuple[float, float]) -> str:
    """Return in words which burst would support the order."""
    lines = max(2 * needed_order(order, outputs), 20)
    low, high = band_hz
    return (
        f"play a multisine with at least {lines} lines between {low:.3g} and {high:.3g} Hz on every input "
        f"(multisine_burst), or a random binary burst of at least {lines / max(high - low, 1e-9) * 2:.3g} s "
        "(random_binary_burst)"
    )


def _lines(recordings: Sequence[Recording], j: int) -> tuple[int, tuple[float, float]]:
    """Return the spectral lines of one input and the band they fill, best recording for the count, union for the
    band."""
    best, low, high = 0, np.inf, 0.0
    for r in recordings:
        count, bottom, top = _spectrum_lines(r.u[:, j] - r.u[:, j].mean(), r.dt)
        best = max(best, count)
        if count:
            low, high = min(low, bottom), max(high, top)
    return best, (float(min(low, high)), float(high))


def _spectrum_lines(u: Array, dt: float) -> tuple[int, float, float]:
    power = np.abs(np.fft.rfft(u * np.blackman(len(u)))) ** 2
    if not power.max() > 0:
        return 0, 0.0, 0.0
    above = np.flatnonzero(power > LINE_LEVEL * power.max())
    # A single line of a Blackman window fills up to 7 bins above -50 dB; bins further on are further lines.
    runs = np.split(above, np.flatnonzero(np.diff(above) > 1) + 1)
    count = sum(max(1, round(len(run) / 7)) for run in runs)
    step = 1 / (len(u) * dt)
    return count, float(above[0] * step), float(above[-1] * step)


def _dependence(recordings: Sequence[Recording]) -> list[float]:
    """Return for every input the share of its power explained by a filter of 21 lags of the others."""
    m = recordings[0].u.shape[1]
    if m == 1:
        return [0.0]
    lags, bare = 21, [Recording(r.u, np.zeros((len(r), 0)), r.dt, r.name) for r in recordings if len(r) >= 21]
    if not bare:
        return [0.0] * m
    bare = scaled(bare, scales(bare)[0], np.zeros(0))
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
