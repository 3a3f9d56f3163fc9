"""Units, signs and clocks by the data: the measured gain of every path against the model's, and the best whole-sample shift."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from afdsvc.dataset.experiment import Run
from afdsvc.dataset.sample_checks import CheckFinding
from afdsvc.dataset.split import still
from afdsvc.explain.check.comparison import SHARE
from afdsvc.explain.check.lines import ComplexArray, ExcitedLines
from afdsvc.explain.simulate.nominal import Nominal
from afdsvc.lti.statespace import Array

FACTORS = {  # factors that wrong units make
    1e3: "1000", 1e-3: "1/1000", 1e6: "1e6", 1e-6: "1e-6", 1e2: "100", 1e-2: "1/100", np.pi / 180: "pi/180 (degrees for radians)",
    180 / np.pi: "180/pi (radians for degrees)", 2 * np.pi: "2 pi", 0.5 / np.pi: "1/(2 pi)", 10.0: "10", 0.1: "1/10",
    np.pi / 30: "pi/30 (rad/s for rpm)", 30 / np.pi: "30/pi (rpm for rad/s)",
}
ALIKE = 1.35  # ratio within which a measured factor counts as one of those
FAR = 3.0  # ratio to the model's gain from which it is reported
SURE, SURER = 0.5, 0.7  # shares of an output's lines that the scaled model must explain for a factor to be reported, and to stop
STOP = 20.0  # ratio from which a wrong unit stops: nearer to one, a model may just be a bad one
TINY = 0.01  # size of an output's lines over what the model says, below which it is another signal if it does not follow the model either
VISIBLE = 0.1  # share of an output an input must cause for its factor to be reported
SHIFTS = 400  # samples by which clocks may be out of step, in recordings that are long enough


@dataclass(frozen=True, slots=True)
class _Path:
    """The factor of one path against the model, the power the model says it has, and the share of the output explained."""

    output: int
    input: int
    factor: float
    power: float
    explained: float


def gains(nominal: Nominal, lines: ExcitedLines, runs: Sequence[Run]) -> Iterator[CheckFinding]:
    """Yield what the measured gains say about units and signs, and the best shift about clocks."""
    if len(lines.angle) < 2:
        return
    terms = lines.parts
    paths = [p for j in range(terms.shape[1]) for p in _paths(terms[:, j], lines.Y[:, j], j)]
    reported = {p.output for p in paths} | set(np.flatnonzero(still(np.concatenate([r.Y for r in runs]))).tolist())
    wrong = [*_factors(nominal, paths), *_others(nominal, lines, reported)]
    yield from wrong
    if paths and not wrong:
        yield CheckFinding("ok", "units", "the measured gains agree with the model's within a factor of three, signs included")
    elif not wrong and len(reported) < len(nominal.model.outputs):
        said = "the model follows less than half of what the inputs cause in any output, so units and signs cannot be compared with it"
        yield CheckFinding("warning", "units", f"{said}; expected its numbers in seconds and its own units: a point as decimal sign, the highest power first")
    if not wrong:
        for j in range(terms.shape[1]):
            yield from _shift(nominal, terms[:, j], lines, j, runs)


def _paths(terms: ComplexArray, y: ComplexArray, j: int) -> Iterator[_Path]:
    """Yield the paths to output ``j``, from real factors fitted to its lines, each weighed by its own size."""
    weight = 1 / np.sqrt(np.abs(y) ** 2 + np.mean(np.abs(y) ** 2) + 1e-300)
    X, target = terms * weight[:, None], y * weight
    power = (np.abs(X) ** 2).sum(0)
    if not power.sum() > 0:
        return
    c, rest = _real_fit(X, target)
    total = max(float((np.abs(target) ** 2).sum()), 1e-300)
    visible = np.flatnonzero(c**2 * power > VISIBLE * total)
    explained = 1 - rest / total
    if explained > SURE:
        yield from (_Path(j, int(i), float(c[i]), float(power[i]), explained) for i in visible)


def _real_fit(X: ComplexArray, y: ComplexArray) -> tuple[Array, float]:
    """Return real coefficients and the sum of squares left."""
    scale = np.maximum(np.sqrt((np.abs(X) ** 2).sum(0)), 1e-300)
    stacked = np.vstack([(X / scale).real, (X / scale).imag])
    target = np.concatenate([y.real, y.imag])
    c = np.linalg.lstsq(stacked, target, rcond=1e-9)[0]
    rest = target - stacked @ c
    return c / scale, float(rest @ rest)


def _factors(nominal: Nominal, paths: list[_Path]) -> Iterator[CheckFinding]:
    """Yield one finding per channel whose factor is far from one, the input blamed when all its paths share the factor."""
    blamed: set[tuple[int, int]] = set()
    for i, v in enumerate(nominal.model.inputs):
        own = [p for p in paths if p.input == i]
        outputs = {p.output for p in paths}
        if len(outputs) > 1 and len(own) > 1 and all(_off(p.factor) and _same(p.factor, own[0].factor) for p in own):
            blamed |= {(p.output, p.input) for p in own}
            yield _finding(f"u_{v.name}", 1 / own[0].factor, min(p.explained for p in own))
    for j, v in enumerate(nominal.model.outputs):
        here = [p for p in paths if p.output == j and (p.output, p.input) not in blamed]
        main = max(here, key=lambda p: p.power, default=None)  # a small path may be far off for crosstalk alone
        own = [main] if main is not None and _off(main.factor) else []
        if own:
            alone = len(here) == 1 and sum(p.input == own[0].input for p in paths) == 1
            other = f"u_{nominal.model.inputs[own[0].input].name}"
            also = f" (or {other}, by the inverse: there is only one path)" if alone else ""
            yield _finding(f"y_{v.name}", own[0].factor, own[0].explained, also)


def _others(nominal: Nominal, lines: ExcitedLines, reported: Collection[int]) -> Iterator[CheckFinding]:
    """Yield a finding per output that hardly moves where the model says it does, and in another way."""
    measured, simulated = (np.sqrt((np.abs(x) ** 2).sum(0)) for x in (lines.Y, lines.parts.sum(2)))
    for j, v in enumerate(nominal.model.outputs):
        if j not in reported and measured[j] < TINY * simulated[j]:
            said = f"y_{v.name} moves {measured[j] / simulated[j]:.2g} times as much as the model says and does not follow it"
            yield CheckFinding("stop", "units", f"{said}; expected the column and the unit of '{v.name}': are columns exchanged? explain --trust-units (trust_units=True) goes on where they are right")


def _off(factor: float) -> bool:
    return factor < 0 or not 1 / FAR < factor < FAR


def _same(a: float, b: float) -> bool:
    return a * b > 0 and abs(np.log(a / b)) < np.log(2.0)


def _finding(channel: str, factor: float, explained: float, also: str = "") -> CheckFinding:
    far = {abs(float(np.log(abs(factor) / value))): text for value, text in FACTORS.items()}
    known = [far[min(far)]] if min(far) < np.log(ALIKE) else []
    size = abs(factor)
    turned, scaled = factor < 0, not 1 / FAR < size < FAR
    stop = explained > SURER and (turned or not 1 / STOP < size < STOP)
    what = [f"{size:.4g} times what the model says{f', about {known[0]}' if known else ''}"] if scaled else []
    what += [f"of the opposite sign (factor {factor:.3g})"] if turned else []
    mend = f"expected the model's {'unit' if scaled else 'sign'}" + ("; explain --trust-units (trust_units=True) goes on where both are right" if stop else "")
    return CheckFinding("stop" if stop else "warning", "units", f"{channel} is {' and '.join(what)}{also}; {mend}")


def _shift(nominal: Nominal, terms: ComplexArray, lines: ExcitedLines, j: int, runs: Sequence[Run]) -> Iterator[CheckFinding]:
    y = lines.Y[:, j]
    weight = 1 / np.sqrt(np.abs(y) ** 2 + np.mean(np.abs(y) ** 2) + 1e-300)
    X = terms * weight[:, None]
    most = int(min(SHIFTS, SHARE * min(map(len, runs))))
    tried = sorted(range(-most, most + 1), key=abs)  # what repeats fits as well a period later
    left = [_real_fit(X, y * weight * np.exp(1j * lines.angle * s))[1] for s in tried]
    total = float((np.abs(y * weight) ** 2).sum())
    best = next(s for s, rest in zip(tried, left, strict=True) if rest <= min(left) + 1e-9 * total)
    if best == 0 or min(left) > 0.4 * left[0] or min(left) > 0.2 * total:
        return
    name = nominal.model.outputs[j].name
    how = "late" if best > 0 else "early"
    reason = "or there is a transport delay; where it is the clocks, shift one of the columns" if best > 0 else "for no machine answers before it is driven; shift one of the columns"
    yield CheckFinding(
        "warning", "synchronisation",
        f"y_{name} comes {abs(best)} samples {how} ({abs(best) * runs[0].dt:.3g} s) against the inputs compared with the model: clocks out of step, {reason}",
    )
