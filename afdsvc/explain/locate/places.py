"""Where simulation and recordings differ: per output the band, the share and the signals of the predictable residual."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from afdsvc.dataset.experiment import Run
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
    said = f"output {name}: {100 * share:.0f} % of the residual's power is predictable (p = {gap.p_value:.2g}), 90 % of that from {low:.4g} to {high:.4g} Hz"
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
