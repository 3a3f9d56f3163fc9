"""Input and output arrays of one or several recordings, checked for identification."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Trace
from afdsvc.dataset.experiment import Run
from afdsvc.dataset.sample_checks import CheckFinding
from afdsvc.dataset.units import unit_in_words, unknown_unit
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array


@dataclass(frozen=True, slots=True, eq=False)
class InputOutputData:
    """One uniformly sampled experiment: ``u (N, m)``, ``y (N, p)``, sample time ``dt`` [s], and where it came from.

    Build one with `InputOutputData.of`, which checks shapes and refuses missing samples.
    """

    u: Array
    y: Array
    dt: float
    name: str = "recording"

    @classmethod
    def of(cls, u: ArrayLike, y: ArrayLike, dt: float, name: str = "recording") -> InputOutputData:
        """Return a checked recording; raises `BadInput` naming the signal, the value found and the value expected."""
        inputs, outputs = _columns(u, "input", name), _columns(y, "output", name)
        if inputs.shape[0] != outputs.shape[0]:
            raise BadInput(
                f"{name}: {inputs.shape[0]} input samples and {outputs.shape[0]} output samples; expected equal counts"
            )
        if not (np.isfinite(dt) and dt > 0):
            raise BadInput(f"{name}: sample time {dt} s; expected a positive number")
        return cls(inputs, outputs, float(dt), name)

    def __len__(self) -> int:
        return int(self.u.shape[0])

    def centred(self) -> InputOutputData:
        """Return the recording with the mean of every signal removed: the operating point is not part of the model."""
        return InputOutputData(self.u - self.u.mean(axis=0), self.y - self.y.mean(axis=0), self.dt, self.name)

    def span(self, start: int, stop: int) -> InputOutputData:
        """Return samples ``start`` to ``stop`` (exclusive)."""
        return InputOutputData(self.u[start:stop], self.y[start:stop], self.dt, self.name)


def together(recordings: InputOutputData | Iterable[InputOutputData]) -> list[InputOutputData]:
    """Return the recordings as a list that can be fitted together; raises `BadInput` when they do not belong
    together."""
    several = [recordings] if isinstance(recordings, InputOutputData) else list(recordings)
    if not several:
        raise BadInput("no recording was handed in; expected at least one")
    first = several[0]
    for other in several[1:]:
        if other.u.shape[1] != first.u.shape[1] or other.y.shape[1] != first.y.shape[1]:
            raise BadInput(
                f"{other.name} has {other.u.shape[1]} inputs and {other.y.shape[1]} outputs, "
                f"{first.name} has {first.u.shape[1]} and {first.y.shape[1]}; expected equal counts"
            )
        if not np.isclose(other.dt, first.dt, rtol=1e-4):
            raise BadInput(
                f"{other.name} is sampled every {other.dt} s, {first.name} every {first.dt} s; expected one sample time"
            )
    return several


def scales(recordings: Sequence[InputOutputData]) -> tuple[Array, Array]:
    """Return the root mean square of every input ``(m,)`` and output ``(p,)`` over all recordings; 1 where it is
    zero."""
    count = sum(len(r) for r in recordings)
    powers = [sum((getattr(r, side) ** 2).sum(axis=0) for r in recordings) / count for side in ("u", "y")]
    return _positive(np.sqrt(powers[0])), _positive(np.sqrt(powers[1]))


def scale_recordings(recordings: Sequence[InputOutputData], u_scale: Array, y_scale: Array) -> list[InputOutputData]:
    """Return the recordings divided by the scales, so that units do not decide what is numerically small."""
    return [InputOutputData(r.u / u_scale, r.y / y_scale, r.dt, r.name) for r in recordings]


def _positive(scale: Array) -> Array:
    return np.where(scale > 0, scale, 1.0)


def _columns(signal: ArrayLike, side: str, name: str) -> Array:
    array = np.asarray(signal, dtype=np.float64)
    array = array[:, None] if array.ndim == 1 else array
    if array.ndim != 2 or array.shape[1] == 0:
        raise BadInput(f"{name}: {side} has shape {array.shape}; expected (samples, channels)")
    if not np.isfinite(array).all():
        row, column = np.argwhere(~np.isfinite(array))[0]
        raise BadInput(
            f"{name}: {side} {column} is not a number at sample {row}; cut the recording there or fill the gap"
        )
    return array


def check_columns(model: Model, traces: Sequence[Trace], runs: Sequence[Run]) -> Iterator[CheckFinding]:
    """Yield what there is to say on columns and sampling; missing ones were refused before."""
    seconds = sum(len(r) for r in runs) * runs[0].dt
    yield CheckFinding(
        "ok", "columns",
        f"{len(runs)} recording{'s' * (len(runs) != 1)}, {seconds:.4g} s at {1 / runs[0].dt:.6g} Hz; inputs {_names(model.inputs)}, outputs {_names(model.outputs)}",
    )
    yield from _unused(model, traces)
    yield from _units(model, traces)
    yield from _bridged(traces)
    yield from _sampling(model, runs[0].dt)


def _names(variables: Sequence[Variable]) -> str:
    return ", ".join(f"{v.name} [{unit_in_words(v.unit)}]" if v.unit else v.name for v in variables) or "none"


def _unused(model: Model, traces: Sequence[Trace]) -> Iterator[CheckFinding]:
    known = {f"u_{v.name}" for v in model.inputs} | {f"y_{v.name}" for v in model.outputs}
    extra = sorted({c.name for t in traces for c in t.channels if c.role in ("u", "y") and c.name not in known})
    if extra:
        yield CheckFinding("warning", "columns", f"columns {', '.join(extra)} are in the recordings but not in the model and are not used")


def _units(model: Model, traces: Sequence[Trace]) -> Iterator[CheckFinding]:
    units = {f"u_{v.name}": v.unit for v in model.inputs} | {f"y_{v.name}": v.unit for v in model.outputs}
    for name, unit in units.items():
        if wrong := unknown_unit(unit):
            yield CheckFinding("warning", "units", f"the model's {name}: {wrong}: which laws are tried depends on whether it is a speed, a position or a force")
    for trace in traces:
        for channel in trace.channels:
            unit = units.get(channel.name, "")
            if unit and channel.unit and unit != channel.unit:
                yield CheckFinding(
                    "warning", "units", f"{trace.name}: {channel.name} is recorded in {channel.unit}; the model has it in {unit}"
                )


def _bridged(traces: Sequence[Trace]) -> Iterator[CheckFinding]:
    for trace in traces:
        for channel in trace.channels:
            missing = int((~np.isfinite(trace.column(channel.name))).sum()) if channel.role in ("aux", "ref") else 0
            if missing:
                yield CheckFinding(
                    "warning", "gaps", f"{trace.name}: {channel.name} lacks {missing} of {len(trace)} samples; they are interpolated linearly"
                )


def _sampling(model: Model, dt: float) -> Iterator[CheckFinding]:
    plant, K = model.plant, model.controller
    if plant is not None and plant.discrete and abs(plant.dt / dt - 1) > 1e-6:
        yield CheckFinding(
            "warning", "sampling",
            f"the model is sampled every {plant.dt:g} s, the recordings every {dt:g} s: the model is resampled by way of its "
            "continuous counterpart",
        )
    if K is not None and K.order and K.discrete and abs(K.dt / dt - 1) > 1e-6:
        yield CheckFinding(
            "warning", "sampling",
            f"the controller is sampled every {K.dt:g} s, the recordings every {dt:g} s: the loop cannot be reconstructed and the "
            "controller is treated as unknown",
        )
