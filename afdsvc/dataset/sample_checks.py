"""Checks of single channels: gaps, clipping, quantisation, drift."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import stats

from afdsvc.api.evidence import p_value_text
from afdsvc.api.model import Model
from afdsvc.dataset.experiment import Run
from afdsvc.dataset.glitches import Glitch, grid
from afdsvc.dataset.periods import fold
from afdsvc.lti.statespace import Array

Kind = Literal["ok", "warning", "stop"]


@dataclass(frozen=True, slots=True)
class CheckFinding:
    """What the check found about one ``topic``, as a sentence; "stop" forbids a conclusion, "warning" limits it."""

    kind: Kind
    topic: str
    sentence: str


STUCK = 0.002  # share of the samples at one extreme from which a signal counts as clipped
VISITS = 2  # how often a signal must come to its extreme: once is the end of a move
CROWDED = 3.0  # how many times as many samples lie at the extreme as on the next step inwards
COARSE = 0.3  # ratio of resolution step to the standard deviation of sample-to-sample differences above which quantisation is reported
DRIFT_P = 1e-6


def samples(model: Model, runs: Sequence[Run]) -> Iterator[CheckFinding]:
    """Yield findings about single channels."""
    for run in runs:
        for j, v in enumerate(model.outputs):
            alone = run.glitches[j] if run.glitches else ()
            yield from _gaps(run, f"y_{v.name}", run.Y[:, j], alone)
            if run.wraps and run.wraps[j]:
                yield CheckFinding("ok", "wraps", f"{run.name}: y_{v.name} is read within one turn; {run.wraps[j]} jumps by a turn are taken out")
            yield from _glitches(run, f"y_{v.name}", v.unit, alone)
            if run.every and run.every[j] > 1:
                yield CheckFinding(
                    "warning", "held readings",
                    f"{run.name}: y_{v.name} changes at one of {run.every[j]} samples only: it is read every {run.every[j] * run.dt:.4g} s and held in "
                    "between; the model's output is held alike",
                )
            yield from _still(run, f"y_{v.name}", v.unit, run.Y[:, j])
            yield from _clipped(run, f"y_{v.name}", v.unit, run.Y[:, j])
            yield from _drift(run, f"y_{v.name}", v.unit, j)
        for i, v in enumerate(model.inputs):
            yield from _clipped(run, f"u_{v.name}", v.unit, run.U[:, i])
    for j, v in enumerate(model.outputs):
        everything = np.concatenate([r.Y[:, j] for r in runs])
        yield from _dead(f"y_{v.name}", v.unit, everything)
        yield from _quantised(f"y_{v.name}", v.unit, everything)


def _dead(name: str, unit: str, x: Array) -> Iterator[CheckFinding]:
    x = x[np.isfinite(x)]
    if len(x) and np.ptp(x) == 0:
        yield CheckFinding(
            "stop", "dead",
            f"{name} reads {x[0] + 0.0:.6g} {unit} in every sample: the sensor is dead or not connected; "
            "use recordings in which it moves, or a model without it",
        )


def _gaps(run: Run, name: str, x: Array, alone: Sequence[Glitch]) -> Iterator[CheckFinding]:
    missing = ~np.isfinite(x)
    missing[[g.sample for g in alone]] = False
    if missing.any():
        at = float(run.t0 + run.dt * int(np.argmax(missing)))
        yield CheckFinding(
            "warning", "gaps",
            f"{run.name}: {name} lacks {int(missing.sum())} of {len(x)} samples, the first at {at:.6g} s; they are left out",
        )


def _glitches(run: Run, name: str, unit: str, found: Sequence[Glitch]) -> Iterator[CheckFinding]:
    if found:
        worst = max(found, key=lambda g: abs(g.height))
        yield CheckFinding(
            "warning", "glitches",
            f"{run.name}: {len(found)} of {run.Y.shape[0]} samples of {name} are isolated outliers, the largest at {run.t0 + run.dt * worst.sample:.6g} s "
            f"{abs(worst.height):.3g} {unit} from its neighbours: they are treated as glitches and left out",
        )


def _still(run: Run, name: str, unit: str, x: Array) -> Iterator[CheckFinding]:
    x = x[np.isfinite(x)]
    if np.ptp(x) == 0:
        yield CheckFinding("warning", "dead", f"{run.name}: {name} reads {x[0] + 0.0:.6g} {unit} in every sample: the sensor is dead there, or nothing moves")


def _clipped(run: Run, name: str, unit: str, x: Array) -> Iterator[CheckFinding]:
    x = x[np.isfinite(x)]
    if len(x) < 50 or np.median(np.abs(np.diff(x))) == 0:  # held or at rest, not clipped
        return
    for side, extreme in (("largest", float(x.max())), ("smallest", float(x.min()))):
        share = _share_at(x, extreme)
        if share > STUCK and share > CROWDED * _share_next(x, extreme) and _visits(x, extreme) >= VISITS:
            yield CheckFinding(
                "warning", "saturation",
                f"{run.name}: {100 * share:.2g} % of {name} sit at its {side} value {extreme:.6g} {unit}: it is clipped there, or held or at rest",
            )


def _share_at(x: Array, extreme: float) -> float:
    return float((np.abs(x - extreme) <= 1e-9 * np.ptp(x)).mean())


def _visits(x: Array, extreme: float) -> int:
    """Return how often a signal comes to an extreme from elsewhere."""
    there = np.abs(x - extreme) <= 1e-9 * np.ptp(x)
    return int((there[1:] & ~there[:-1]).sum())


def _share_next(x: Array, extreme: float) -> float:
    """Return the share of samples at the value next to the extreme, or in the next hundredth of the range if that is more."""
    inner = x[np.abs(x - extreme) > 1e-9 * np.ptp(x)]
    near = float(np.abs(inner - extreme).min())
    width = max(near * 1.001, 0.01 * float(np.ptp(x)))
    return float((np.abs(inner - extreme) <= width).sum() / len(x))


def _quantised(name: str, unit: str, x: Array) -> Iterator[CheckFinding]:
    x = x[np.isfinite(x)]
    step = grid(x) if np.ptp(x) > 0 else 0.0
    rough = float(np.sqrt(np.mean(np.diff(x, 4) ** 2) / 70)) if len(x) > 4 else 0.0
    if step and step > COARSE * rough:
        yield CheckFinding(
            "warning", "quantisation",
            f"{name} lies on steps of {step:.4g} {unit}, {step / np.ptp(x):.2g} of its range: smaller changes are not resolved",
        )


def _fifths(rest: Array) -> Array:
    length = rest.shape[1] // 5
    return np.asarray(rest[:, : 5 * length].reshape(-1, length).mean(1))


def _drift(run: Run, name: str, unit: str, j: int) -> Iterator[CheckFinding]:
    """Test the means of whole periods for a trend."""
    folded = fold(run, run.Y[:, [j]])
    if folded is None or len(folded) < 4:
        return
    pieces = folded[:, :, 0]
    rest = pieces - pieces.mean(0)
    means = _fifths(rest) if pieces.shape[1] >= 50 else rest.mean(1)
    t = np.arange(len(means), dtype=np.float64)
    slope, _, _, p, _ = stats.linregress(t, means)
    change = float(slope * len(means))
    if p < DRIFT_P and abs(change) > 0.1 * float(rest.std()):
        yield CheckFinding("warning", "drift", f"{run.name}: {name} drifts by {change:.3g} {unit} from start to end ({p_value_text(p)})")
