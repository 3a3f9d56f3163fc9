"""Where simulation and recordings differ: per output the band, the share and the signals of the predictable residual;
the same in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from afdsvc.api.evidence import p_value_text
from afdsvc.api.physics import Size
from afdsvc.dataset.experiment import Run
from afdsvc.dataset.units import is_velocity, with_unit
from afdsvc.explain.gap.decision import flexible_prediction
from afdsvc.explain.gap.finding import Gap
from afdsvc.explain.locate.residual import signal_names, signals
from afdsvc.explain.report.explanation import Located
from afdsvc.explain.search.fit import Fit
from afdsvc.explain.search.machine import bandwidth
from afdsvc.explain.search.problem import Problem
from afdsvc.lti.statespace import Array
from afdsvc.stats.spectral_peaks import repeating

TAIL = 0.05  # share of the power outside the band, on either side
MATTERS = 0.2  # share lost without a group, over the largest, from which the group is named
SURE = 1e-3  # p-value of a kind of line
LEAST = 0.02  # share of an output's residual below which it is not listed


def located(problem: Problem, fit: Fit, horizon: float, gap: Gap, rng: np.random.Generator) -> tuple[Located, ...]:
    """Return one place per output whose residual is predictable, the largest share first; none where there is no gap."""
    if not gap.present:
        return ()
    residual = signals(problem, fit.point, horizon)
    predicted = flexible_prediction(residual, *signal_names(problem), rng)
    outputs = [v.name for v in problem.nominal.model.outputs]
    found = [
        _place(problem, gap, j, name, [p[:, j] for p in predicted], [np.nan_to_num(s.residual[:, [j]]) for s in residual])
        for j, name in enumerate(outputs) if gap.within_reach[j] > LEAST
    ]
    return tuple(sorted(found, key=lambda place: -place.share_of_residual_power))


def _place(problem: Problem, gap: Gap, j: int, name: str, predicted: Sequence[Array], residual: Sequence[Array]) -> Located:
    runs, inputs = problem.runs, problem.nominal.model.inputs
    share = gap.within_reach[j]
    low, high = band(max(predicted, key=lambda x: float(x @ x)), runs[0].dt)
    follows = [group for group, lost in gap.depends_on if lost > MATTERS * max(gap.depends_on[0][1], 1e-300)]
    kind, lines = _lines(runs, residual)
    said = f"output {name}: {100 * share:.0f} % of the residual's power is predictable ({p_value_text(gap.p_value)}), 90 % of that from {low:.4g} to {high:.4g} Hz"
    if follows:
        said += f"; it follows {', '.join(follows)}"
    return Located(name, inputs[0].name if len(inputs) == 1 else None, (low, high), share, tuple(follows), said + lines, kind)


def _lines(runs: Sequence[Run], residual: Sequence[Array]) -> tuple[str, str]:
    """Return at which kind of line the residual repeats with the excitation, and that in words; "predictable" where nothing repeats."""
    found = repeating(runs, residual, 2 * bandwidth(runs))
    if found is None or found.total.p > SURE:
        return "predictable", ""
    power = {k: s.power for k, s in found.kinds.items() if s.p < SURE and s.power > 0}
    if not power:
        return "repeating", ""
    parts = ", ".join(f"{100 * v / sum(power.values()):.0f} % at {k} lines" for k, v in power.items())
    distorted = [k for k in ("odd", "even") if k in power]
    return max(distorted, key=lambda k: power[k]) if distorted else "linear", f"; of what repeats with the excitation, {parts}"


def band(x: Array, dt: float) -> tuple[float, float]:
    """Return the frequencies [Hz] between which 90 % of a signal's power lies."""
    power = np.abs(np.fft.rfft(x - x.mean())) ** 2
    share = np.cumsum(power)
    if not share[-1] > 0:
        return 0.0, 0.5 / dt
    low, high = np.searchsorted(share, [TAIL * share[-1], (1 - TAIL) * share[-1]])
    return float(low / (len(x) * dt)), float(high / (len(x) * dt))


POWERS = np.arange(0.0, 4.05, 0.1)
GROWTH = ((0.3, "has the same size at every value of {0}"), (0.75, "grows with the root of {0}"), (1.4, "grows in proportion to {0}"), (2.5, "grows with the square of {0}"))
UNEVEN = 1.3  # ratio of the sizes in both directions from which it is said
ASIDE = 0.05  # reach to one side of zero, over that to the other, below which nothing is said of that direction
POOR = 0.35  # error of the best power law, over the curve's rms, from which no form is stated


def described(x: Array, y: Array, band: Array, adds: bool, of: Size, unit: str = "") -> str:
    """Return a curve ``y (k,)`` [unit] at ``x (k,)`` in words; ``adds`` for an input or a sensor, whose curve is read against ``x``."""
    return _gains(x, y) if adds else _force(x, y, band, "the speed" if is_velocity(of.unit) else of.name, unit)


def _gains(x: Array, y: Array) -> str:
    """Return the slope of a curve in its middle and at both ends."""
    slope = np.diff(y) / np.diff(x)
    middle = float(np.interp(0.0 if x[0] < 0 < x[-1] else float(x.mean()), (x[1:] + x[:-1]) / 2, slope))
    return f"passes small changes {middle:.3g} times, {float(slope[0]):.3g} times at the lower and {float(slope[-1]):.3g} times at the upper end"


def _force(x: Array, y: Array, band: Array, what: str, unit: str) -> str:
    """Return the power law, with a size for either direction, that fits best."""
    weight = 1 / np.maximum(band, 0.05 * np.abs(y).max() + 1e-300)
    fits = [_power(x, y, weight, n) for n in POWERS]
    n, size, error = POWERS[int(np.argmin([f[1] for f in fits]))], *min(fits, key=lambda f: f[1])
    rms = float(np.sqrt(np.average(y**2, weights=weight**2)))
    if error > POOR * rms:
        return f"a force of {with_unit(f'{float(y.min()):.3g} to {float(y.max()):.3g}', unit)} that no power of {what} describes"
    grows = next((words for limit, words in GROWTH if n < limit), "grows with the third power or more of {0}").format(what)
    up, down = float(size[0]), float(size[1])
    both = min(-x[0], x[-1]) > ASIDE * max(-x[0], x[-1]) and up * down != 0
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
