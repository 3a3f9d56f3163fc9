"""Recordings made ready for simulation: columns sorted by role and matched to the model, gaps marked, loop reconstructed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from afdsvc.api.model import Model
from afdsvc.api.signals import Trace
from afdsvc.dataset.angles import turn, unwrapped
from afdsvc.dataset.glitches import Glitch, glitches
from afdsvc.dataset.held import interval, taken
from afdsvc.dataset.screening import require_sizes
from afdsvc.errors import BadInput
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import Array, StateSpace

BY_CHANCE, PAIRS = 0.01, 4000  # how often a seam drawn at random may be as smooth as one across which signals go on, and how many are drawn
SAME_RATE = 1e-4  # relative difference of sample times below which they are the same: times are often written with six digits


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One recording as arrays: ``U (n, m)``, ``Y (n, p)`` (NaN where missing), ``AUX (n, a)``, ``REF (n, p)``.

    ``W (n, m)`` is what was added to the controller's output: ``u - K (y - ref)`` where the controller is known and the inputs and
    outputs have no gaps, else the recorded bursts where no controller is stated. ``period`` is the number of samples after which the excitation repeats (0 when
    it does not), ``settled`` the sample from which it does. ``commanded`` says that an excitation ``alpha`` was recorded, so
    a controller made the input. ``clock`` is the time laws see at the first sample [s]; None: ``t0``. ``glitches`` are the readings of every
    output that were taken for such, and are missing in ``Y``. ``controller`` is the known one at the sample time.
    ``steady`` says that the outputs repeat from the first sample on, too: the machine ran with this excitation before. ``wraps`` counts the jumps by a
    turn that were taken out of every output. ``every`` is how many samples a reading of each output is held, ``taken (n, p)`` the samples at which the
    readings were taken; None where all are taken at every sample.
    """

    name: str
    dt: float
    t0: float
    U: Array
    Y: Array
    AUX: Array
    REF: Array
    aux: tuple[str, ...]
    W: Array | None = None
    period: int = 0
    settled: int = 0
    commanded: bool = False
    clock: float | None = None
    glitches: tuple[tuple[Glitch, ...], ...] = ()
    controller: StateSpace | None = None
    steady: bool = False
    wraps: tuple[int, ...] = ()
    every: tuple[int, ...] = ()
    taken: NDArray[np.intp] | None = None

    def __len__(self) -> int:
        return len(self.U)

    def shown(self, y: Array) -> Array:
        """Return outputs ``(n, p)`` as the sensors show them, held between readings."""
        return y if self.taken is None else np.take_along_axis(y, self.taken, axis=0)

    @property
    def begins(self) -> float:
        """The time that laws see at the first sample [s]."""
        return self.t0 if self.clock is None else self.clock

    @property
    def fresh(self) -> Array:
        """The readings ``(n, p)`` of the samples at which they were taken, NaN elsewhere."""
        return self.Y if self.taken is None else np.where(self.taken == np.arange(len(self))[:, None], self.Y, np.nan)

    def amplified(self, gain: Array) -> Run:
        """Return the run with inputs times ``gain (m,)``, in a loop what comes to them from outside: ``W`` and what the controller makes of references."""
        if self.W is None:
            return replace(self, U=gain * self.U)
        external = self.W if self.controller is None else _outside(self.controller, self.W, self.REF)
        return replace(self, U=gain * self.U, W=self.W + (gain - 1) * external)

    def span(self, start: int, stop: int) -> Run:
        """Return some samples as a run of its own, whose controller starts at rest: W holds what its state still gave."""
        cut = slice(start, stop)
        clock = None if self.clock is None else self.clock + start * self.dt
        part = replace(
            self, t0=self.t0 + start * self.dt, U=self.U[cut], Y=self.Y[cut], AUX=self.AUX[cut], REF=self.REF[cut],
            W=None if self.W is None else self.W[cut], settled=max(0, self.settled - start), clock=clock, glitches=(),
            steady=self.steady or 0 < self.settled + self.period <= start, taken=None if self.taken is None else np.maximum(self.taken[cut] - start, 0),
        )
        if start == 0 or self.W is None or self.controller is None:
            return part
        return replace(part, W=_outside(self.controller, part.U, _bridged(part.Y) - part.REF))


def prepare(model: Model, traces: Sequence[Trace]) -> list[Run]:
    """Return the traces as runs; raises `BadInput` naming the recording and column that are missing or do not fit."""
    if not traces:
        raise BadInput("no recording was given; expected at least one")
    other = next((t for t in traces if abs(t.dt / traces[0].dt - 1) > SAME_RATE), None)
    if other is not None:
        raise BadInput(
            f"recordings '{traces[0].name}' ({traces[0].dt:.6g} s) and '{other.name}' ({other.dt:.6g} s) differ in sample time; "
            "expected one: resample = {dt = SECONDS} in a mapping file brings them to it"
        )
    for trace in traces:
        require_sizes(trace)
    if (samples := sum(map(len, traces))) < FEWEST:
        raise BadInput(f"{', '.join(t.name for t in traces)}: {samples} samples; expected at least {FEWEST}")
    labels = tuple(sorted({c.label for t in traces for c in t.channels if c.role == "aux"}))
    return _on_one_clock([_run(model, trace, labels) for trace in traces])


def _on_one_clock(runs: Sequence[Run]) -> list[Run]:
    """Return the runs in the time that laws see: their own, where it is later than the end of the run before, else from there on."""
    found: list[Run] = []
    for r in runs:
        end = -np.inf if not found else found[-1].begins + len(found[-1]) * r.dt
        found.append(replace(r, clock=r.t0 if r.t0 > end - r.dt / 2 else end))
    return found


def joined(traces: Sequence[Trace]) -> list[Trace]:
    """Return the traces with parts of one recording put together: those with the same columns whose time, or whose signals where the clock
    begins anew, go on where the last one ends.

    Traces whose own excitation repeats stay apart: together they may have no period.
    """
    found: list[Trace] = []
    for t in traces:
        if found and _continues(found[-1], t):
            found[-1] = replace(found[-1], values=np.vstack([found[-1].values, t.values]))
        else:
            found.append(t)
    return found


def _continues(first: Trace, second: Trace) -> bool:
    if first.channels != second.channels or abs(second.dt / first.dt - 1) >= SAME_RATE or min(len(first), len(second)) < 3:
        return False
    later = abs(second.t0 - first.t0 - len(first) * first.dt) < first.dt / 2
    anew = abs(second.t0 - first.t0) < first.dt / 2
    return (later or (anew and _go_on(first, second))) and not (_repeats(first) or _repeats(second))


def _go_on(first: Trace, second: Trace) -> bool:
    """Return whether signals go on from one trace to the next, and the outputs do not begin again where they began before.

    How far values bend across the seam is ranked among the bends elsewhere, the largest rank counts. Ends and beginnings drawn at
    random must seldom have as small a one.
    """
    a, b = (np.hstack([t.role("u"), t.role("y")]) for t in (first, second))
    bends = np.sort(np.abs(np.vstack([np.diff(a, 2, axis=0), np.diff(b, 2, axis=0)])), axis=0)
    rng, outputs = np.random.default_rng(0), slice(first.role("u").shape[1], None)
    ends, begins = rng.integers(1, len(a), PAIRS), rng.integers(0, len(b) - 1, PAIRS)
    across = np.stack([a[[-2, *(ends - 1)]], a[[-1, *ends]], b[[0, *begins]], b[[1, *(begins + 1)]]])
    ranks = np.array([np.searchsorted(own, d) for own, d in zip(bends.T, np.abs(np.diff(across, 2, axis=0)).T, strict=True)]).max((0, 2))
    return bool((ranks[1:] <= ranks[0]).mean() < BY_CHANCE and (np.abs(b[0] - a[0]) > bends[-1])[outputs].any())


def _repeats(trace: Trace) -> bool:
    drive = _driver(trace, np.nan_to_num(trace.role("u")), np.nan_to_num(trace.role("ref")))
    return drive.size > 0 and repetition(drive)[0] > 0


def _run(model: Model, trace: Trace, labels: tuple[str, ...]) -> Run:
    U = np.column_stack([np.zeros((len(trace), 0)), *(trace.column(f"u_{v.name}") for v in model.inputs)])
    Y = np.column_stack([trace.column(f"y_{v.name}") for v in model.outputs])
    n = len(trace)
    if n < SHORTEST:
        raise BadInput(f"{trace.name}: {n} samples; expected at least {SHORTEST}")
    if not np.isfinite(U).all():
        at = int(np.argwhere(~np.isfinite(U).all(1))[0, 0])
        raise BadInput(f"{trace.name}: an input is missing at sample {at}; expected inputs without gaps (cut the recording there)")
    _check_readings(trace, model, Y)
    REF = np.column_stack([_optional(trace, f"ref_{v.name}", n) for v in model.outputs])
    Y, REF, wraps = _within_a_turn(model, Y, REF)
    AUX = np.column_stack([np.zeros((n, 0)), *(_optional(trace, f"aux_{a}", n) for a in labels)])
    drive = _driver(trace, U, REF)
    period, settled = repetition(drive)
    u, y, aux, ref = (np.array(a, dtype=np.float64, order="C") for a in (U, Y, AUX, REF))
    commanded, every = bool(trace.role("alpha").size), tuple(interval(column) for column in y.T)
    read = np.column_stack([taken(column, k) for column, k in zip(y.T, every, strict=True)]) if max(every) > 1 else None
    controller = _controller(model, trace.dt, U, Y)
    added = _recorded(model, trace) if controller is None else _outside(controller, U, Y - REF)  # it saw the glitches
    alone = tuple(glitches(column, drive, period) for column in y.T)
    for j, found in enumerate(alone):
        y[[g.sample for g in found], j] = np.nan
    return Run(
        trace.name, trace.dt, trace.t0, u, y, aux, ref, labels, added, period, settled, commanded, glitches=alone, controller=controller,
        steady=_steady(y, period, settled), wraps=wraps, every=every, taken=read,
    )


def _within_a_turn(model: Model, Y: Array, REF: Array) -> tuple[Array, Array, tuple[int, ...]]:
    """Return outputs and references without jumps of angles by a turn, the references at the nearest turn of what they are for, and how many jumps there were."""
    turns = [turn(v.unit) for v in model.outputs]
    found = [unwrapped(y, one) for y, one in zip(Y.T, turns, strict=True)]
    refs = []
    for (y, jumps), ref, one in zip(found, REF.T, turns, strict=True):
        smooth = unwrapped(ref, one)[0]
        refs.append(smooth + one * np.round(np.nanmean(y - smooth) / one) if jumps and ref.any() else ref)
    return np.column_stack([y for y, _ in found]), np.column_stack(refs), tuple(jumps for _, jumps in found)


def _steady(Y: Array, period: int, settled: int) -> bool:
    """Whether the second period repeats the first one in its first quarter nearly as well as in its last, where a start has died away."""
    if not period or settled:
        return False
    changed = np.nan_to_num(Y[period : 2 * period] - Y[:period]) ** 2
    quarter = max(1, period // 4)
    return bool((changed[:quarter].mean(0) <= 2 * changed[-quarter:].mean(0)).all())


def _check_readings(trace: Trace, model: Model, Y: Array) -> None:
    for v, y in zip(model.outputs, Y.T, strict=True):
        if np.isinf(y).any():
            raise BadInput(f"{trace.name}: y_{v.name} is infinite at sample {int(np.argmax(np.isinf(y)))}; expected a number, or nan for a gap")
        if not np.isfinite(y).any():
            raise BadInput(f"{trace.name}: y_{v.name} has no reading at all; expected recordings with readings of every output")


def _optional(trace: Trace, name: str, n: int) -> Array:
    """Return a column with its gaps bridged by straight lines, as the check says; zeros where there is none."""
    if not trace.has(name):
        return np.zeros(n)
    x = trace.column(name)
    seen = np.isfinite(x)
    if not seen.any():
        raise BadInput(f"{trace.name}: {name} has no value at all; leave the column out, or bring recordings that have it")
    return x if seen.all() else np.interp(np.arange(n), np.flatnonzero(seen), x[seen])


def _driver(trace: Trace, U: Array, REF: Array) -> Array:
    """Return the signal that would show the repetition of the excitation best: alpha, else the reference, else the input."""
    alpha = np.nan_to_num(trace.role("alpha"))
    for signal in (alpha, REF):
        if signal.size and np.ptp(signal, axis=0).max(initial=0.0) > 0:
            return signal
    return U


FEWEST, SHORTEST = 50, 16  # samples of all recordings together, and of one
EXACT = 1e-6  # difference between periods, over the power, of a signal that was computed and not measured


def repetition(signal: Array, tolerance: float = 0.02) -> tuple[int, int]:
    """Return the period in samples of a repeating signal ``(n, channels)`` and the sample from which it repeats; (0, 0) if none.

    A lag counts as a period when what differs over it, with the first quarter of the signal left out, is below
    ``tolerance`` of the signal's power; the shortest such lag is taken. At least two periods must fit.
    """
    x = signal - signal.mean(0)
    n = len(x)
    if not np.ptp(x, axis=0).max(initial=0.0) > 0:
        return 0, 0
    lags = _candidate_lags(x)
    for close in (min(EXACT, tolerance), tolerance):
        for lag in lags:
            period = _sharpen(x, lag)
            if _difference(x, period, n // 4) < close and _keeps(x, period, close):
                return period, _settled(x, period, tolerance)
    return 0, 0


def _candidate_lags(x: Array) -> list[int]:
    """Return lags at peaks of the unbiased autocorrelation above 0.7, shortest first."""
    n = len(x)
    spectrum = (np.abs(np.fft.rfft(x, 2 * n, axis=0)) ** 2).sum(1)
    ac = np.fft.irfft(spectrum)[:n] / np.arange(n, 0, -1)
    ac = ac / ac[0]
    first = int(np.argmax(ac < 0.3)) if (ac < 0.3).any() else n
    inner = np.arange(max(first, 8), n // 2 + 1)
    inner = inner[inner < n - 1]
    peaks = inner[(ac[inner] >= ac[inner - 1]) & (ac[inner] >= ac[inner + 1]) & (ac[inner] > 0.7)]
    return [int(p) for p in peaks[:400]]


def _sharpen(x: Array, lag: int) -> int:
    """Return the lag within 2 % that the signal repeats best at, by two passes of a finer and finer search."""
    for width, step in ((max(2, lag // 50), max(1, lag // 500)), (max(2, lag // 500), 1)):
        near = range(max(2, lag - width), lag + width + 1, step)
        lag = min(near, key=lambda k: _difference(x, k, len(x) // 4))
    return lag


def _keeps(x: Array, period: int, tolerance: float) -> bool:
    """Whether the signal still repeats after as many periods as fit: a sine nearly repeats over many a wrong period."""
    start = len(x) // 4
    most = (len(x) - start - 64) // period
    return most < 2 or _difference(x, most * period, start) < 2 * tolerance


def _difference(x: Array, lag: int, start: int) -> float:
    if len(x) - lag - start < 8:
        return np.inf
    d = x[start + lag :] - x[start:-lag]
    return float((d**2).sum() / (2 * (x[start:] ** 2).mean() * d.size + 1e-300))


def _settled(x: Array, period: int, tolerance: float) -> int:
    """Return the first sample after which every eighth of a period equals the one a period later."""
    block = max(period // 8, 1)
    last = 0
    for start in range(0, len(x) - period - block, block):
        a, b = x[start : start + block], x[start + period : start + period + block]
        if ((a - b) ** 2).sum() > 4 * tolerance * (x**2).mean() * a.size:
            last = start + block
    return last if last < len(x) // 2 else 0


def _controller(model: Model, dt: float, U: Array, Y: Array) -> StateSpace | None:
    """Return the controller at the sample time; None when it is unknown, does not fit, or readings it saw are missing."""
    K = None if model.controller is None or not np.isfinite(Y).all() else sampled(model.controller, dt)
    return K if K is not None and (K.outputs, K.inputs) == (U.shape[1], Y.shape[1]) else None


def _outside(controller: StateSpace, U: Array, error: Array) -> Array:
    """Return what was added to the controller's output, ``u - K (y - ref)``, the controller starting at rest."""
    return np.ascontiguousarray(U - simulate(controller, error)[0])


def _bridged(Y: Array) -> Array:
    """Return readings with what is missing bridged by straight lines."""
    at = np.arange(len(Y))
    return np.column_stack([np.interp(at, at[np.isfinite(y)], y[np.isfinite(y)]) if np.isfinite(y).any() else 0 * at for y in Y.T])


def _recorded(model: Model, trace: Trace) -> Array | None:
    """Return the bursts that were recorded where no controller is stated, one column for each input; None when one is missing."""
    if model.controller is not None:
        return None
    names = [f"alpha_{v.name}" for v in model.inputs]
    return np.column_stack([np.nan_to_num(trace.column(n)) for n in names]) if names and all(trace.has(n) for n in names) else None


def sampled(controller: StateSpace, dt: float) -> StateSpace | None:
    """Return the controller at the sample time; a continuous one is held; None when its own sample time differs."""
    if not controller.order:
        return StateSpace(controller.A, controller.B, controller.C, controller.D, dt)
    if controller.discrete:
        return controller if abs(controller.dt / dt - 1) < 1e-6 else None
    return sample_zoh(controller, dt)
