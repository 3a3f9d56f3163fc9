"""The nominal model as the search sees it: its free numbers, how far they may move, and the plant they make.

Free numbers ("nuisance parameters") of matrices are the entries of A, B, C, D that are neither 0 nor +-1, or those with a
stated standard deviation; of Python code the parameters with one. They are counted in units of that deviation, so their
prior is standard normal.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import root

from afdsvc.api.model import DEFAULT_RELATIVE_SD, Model
from afdsvc.dataset.experiment import Run
from afdsvc.dataset.units import is_acceleration
from afdsvc.errors import BadInput
from afdsvc.explain.simulate.dynamics import Program, linearised, program
from afdsvc.explain.simulate.steps import Steps, substep_matrices
from afdsvc.lti.sampling import continuous
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.lti.transfer_function import output_states

MOST_ENTRIES = 60  # free entries of a sampled black-box model above which only the gains of its inputs and outputs move
PYTHON_ANGLE = 0.2  # largest angle [rad] that a pole of Python code below the Nyquist frequency may turn in one Runge-Kutta step
STABLE_ANGLE = 1.0  # the same of faster poles, which no sample shows: steps are stable, and wrong by 2 % of what decays within them
PYTHON_SUBSTEPS = 200
FASTER = 8.0  # than stated, the fastest pole of Python code that is followed where a fit moves numbers of the model; one of the Nyquist frequency always is
DOUBLINGS = 40  # of a sample, after which Python code is where its inputs hold it
ROUNDED = 0.01  # of an entry: numbers in model files have two digits or more
RECENT = 64  # matrices of sub-steps kept: fits come back to the same numbers of the model
PARAMETER, INPUT_GAIN, OUTPUT_GAIN = "parameter", "input gain", "output gain"


@dataclass(frozen=True, slots=True)
class Entry:
    """One free number of the model: matrix, row, column, the standard deviation its owner states, and a name for people.

    ``matrix`` is A, B, C or D; "parameter" with ``row`` the number of the parameter; "input gain" with ``column`` the number
    of the input or "output gain" with ``row`` that of the output, both relative.
    """

    matrix: str
    row: int
    column: int
    sd: float
    name: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Nominal:
    """A nominal model at the sample time of the recordings.

    ``plant`` is continuous (dt 0), or discrete when no continuous one has this sampling. ``entries`` are the free numbers. ``felt (p, n)`` is what
    outputs that are accelerations feel of forces on the states: their rows of C and D follow those of A and B. For
    Python code, ``program``, ``plant`` is its linearisation at ``point``, a state and an input, and ``most`` how many sub-steps a sample takes at most
    for poles at that point, which numbers that a fit tries may make faster than samples can show. ``recent`` keeps matrices of sub-steps.
    """

    model: Model
    plant: StateSpace
    entries: tuple[Entry, ...]
    dt: float
    felt: Array
    point: tuple[Array, Array] | None = None
    program: Program | None = None
    most: int = PYTHON_SUBSTEPS
    recent: dict[tuple[bytes, int, int], Steps] = field(default_factory=dict, init=False, repr=False)

    @property
    def python(self) -> bool:
        """Whether the model is Python code, simulated as it is."""
        return self.program is not None

    @property
    def transfer(self) -> bool:
        """Whether the plant is a transfer function as it was stated, realised by `from_polynomials`."""
        return self.model.transfer and self.plant is self.model.plant

    @property
    def variable(self) -> str:
        """The variable of transfer functions."""
        return "z" if self.plant.discrete else "s"

    def at(self, theta: Array) -> StateSpace:
        """Return the plant with its free numbers moved by ``theta`` standard deviations, shape ``(len(entries),)``."""
        if self.program is not None and self.point is not None:
            return _linear(self.model, self.program, self.point, self.parameters(theta))
        parts = {"A": self.plant.A.copy(), "B": self.plant.B.copy(), "C": self.plant.C.copy(), "D": self.plant.D.copy()}
        for value, entry in zip(theta, self.entries, strict=True):
            _move(parts, entry, float(value))
        for mine, of in _tied(self.plant, self.felt):
            rows = np.flatnonzero(self.felt.any(1))
            parts[mine][rows] += self.felt[rows] @ (parts[of] - getattr(self.plant, of))
        return StateSpace(parts["A"], parts["B"], parts["C"], parts["D"], self.plant.dt)

    def parameters(self, theta: Array) -> Array:
        """Return the values of all parameters of Python code in the model's order; empty for matrices."""
        values = np.array([q.value for q in self.model.parameters.values()] if self.python else [], dtype=np.float64)
        for value, entry in zip(theta, self.entries, strict=True):
            if entry.matrix == PARAMETER:
                values[entry.row] += value * entry.sd
        return values

    def values(self, theta: Array) -> dict[str, float]:
        """Return values by name: of all parameters of Python code, or of the free entries of matrices (gains: 1 is nominal)."""
        if self.python:
            return dict(zip(self.model.parameters, self.parameters(theta).tolist(), strict=True))
        return {e.name: _start(self.plant, e) + float(v) * e.sd for v, e in zip(theta, self.entries, strict=True)}

    def steps(self, theta: Array, least: int = 1, degree: int = 0) -> Steps:
        """Return the matrices the simulation needs, in at least that many sub-steps, for inputs that are polynomials of a degree."""
        key = theta.tobytes(), least, degree
        found = self.recent.get(key)
        if found is None:
            plant = self.at(theta)
            if self.program and not plant.discrete:
                needed = max(least, self.substeps(float(np.abs(plant.poles()).max(initial=0.0))))
                found = substep_matrices(plant, self.dt, needed, np.inf, needed)
            else:
                found = substep_matrices(plant, self.dt, least, degree=degree)
            if len(self.recent) >= RECENT:
                self.recent.clear()
            self.recent[key] = found
        return found

    def substeps(self, fastest: float, beside: float = 1.0) -> int:
        """Return the sub-steps of a sample that Python code needs for a fastest pole [rad/s], which is ``beside`` times that at `point`."""
        angle, most = fastest * self.dt, min(self.most * max(beside, 1.0), PYTHON_SUBSTEPS)
        return int(min(np.ceil(max(min(angle, np.pi) / PYTHON_ANGLE, angle / STABLE_ANGLE)), most))

    def moved(self, theta: Array) -> Model:
        """Return the model with its free numbers moved, to be written out."""
        if not self.python:
            return replace(self.model, plant=self.at(theta), sample_time=self.plant.dt)
        values = self.values(theta)
        return replace(self.model, parameters={name: replace(q, value=values[name]) for name, q in self.model.parameters.items()})


def nominal(model: Model, dt: float, inputs: Array | None = None) -> Nominal:
    """Return the nominal model for recordings sampled every ``dt`` seconds.

    Python code is linearised at the origin, or with ``inputs (m,)`` at the state that balances them, if there is one. Raises
    `BadInput` when a discrete model has another sample time and no continuous counterpart, or when the code fails.
    """
    if model.dynamics is not None:
        return _python(model, dt, inputs)
    if model.plant is None:
        raise BadInput(f"model '{model.name}' has neither matrices nor a simulator; expected one of the two")
    plant, sds = model.plant, dict(model.entry_sd)
    sampled = plant.discrete
    if sampled and abs(plant.dt / dt - 1) > 1e-6:
        plant, sds = _continuous(model.name, plant, dt), {}
    sensed = felt(model, plant)
    accelerations, tied = np.flatnonzero(sensed.any(1)), [mine for mine, _ in _tied(plant, sensed)]
    entries = tuple(e for e in _entries(plant, sds) if not (e.matrix in tied and e.row in accelerations))
    if sampled and len(entries) > MOST_ENTRIES:
        entries = _gains(model, plant, entries)
    return Nominal(model, plant, entries, dt, sensed)


def felt(model: Model, plant: StateSpace) -> Array:
    """Return what every output feels at once of a force on each velocity ``(p, n)``, per unit of the acceleration it causes; zero but for accelerations.

    An output is one by its unit, and where its rows of C and D are those of velocities in A and B, or those of C alone: where a base moves, what is read
    in space and what moves against the base differ in D.
    """
    found, smooth = np.zeros((plant.outputs, plant.order)), (continuous(plant) if plant.discrete else plant)
    if smooth is None or len(model.states) != plant.order:
        return found
    moving = np.flatnonzero([v.rate_of is not None for v in model.states])
    rows = np.hstack([smooth.A, smooth.B])[moving]
    for i, y in enumerate(model.outputs):
        if is_acceleration(y.unit):
            row = np.hstack([smooth.C[i], smooth.D[i]])
            whole = _shares(row, rows)
            found[i, moving] = whole if whole.any() else _shares(row[: plant.order], rows[:, : plant.order])
    return found


def _tied(plant: StateSpace, sensed: Array) -> list[tuple[str, str]]:
    """Return the matrices whose rows of accelerations hold the numbers of other matrices, with these: C those of A, D those of B unless a base moves."""
    rows = sensed.any(1)
    if plant.discrete or not rows.any():
        return []
    return [("C", "A"), *([("D", "B")] if np.allclose(plant.D[rows], sensed[rows] @ plant.B, rtol=ROUNDED) else [])]


def _shares(row: Array, rows: Array) -> Array:
    """Return the shares of some rows that add up to a row, every entry to `ROUNDED`; zeros where there are none, or too few entries to show it."""
    found, scale = np.zeros(len(rows)), np.abs(rows).max(0, initial=0.0)
    scale[scale == 0] = 1.0
    together = [r for r, other in enumerate(rows) if (other * row).any()]
    for chosen in (*([r] for r in together), together):
        part = rows[chosen]
        shares = np.linalg.lstsq((part / scale).T, row / scale, rcond=None)[0]
        if np.count_nonzero(row) > len(chosen) and (np.abs(row - shares @ part) <= ROUNDED * (np.abs(shares) @ np.abs(part))).all():
            found[chosen] = shares
            break
    return found


def mean_input(runs: Sequence[Run]) -> Array | None:
    """Return the mean of the inputs ``(m,)`` over all samples; None where there are none."""
    return np.asarray(np.vstack([r.U for r in runs]).mean(0)) if runs[0].U.shape[1] else None


def _python(model: Model, dt: float, inputs: Array | None) -> Nominal:
    if model.sample_time and abs(model.sample_time / dt - 1) > 1e-6:
        raise BadInput(
            f"model '{model.name}' is Python code with a step of {model.sample_time:g} s and the recording is sampled every {dt:g} s; "
            "one of the two must be resampled"
        )
    values = np.array([q.value for q in model.parameters.values()], dtype=np.float64)
    code = program(model)
    point = _point(model, code, values, inputs, dt)
    sds = [abs(q.value) * q.relative_sd for q in model.parameters.values()]
    entries = tuple(Entry(PARAMETER, k, 0, sd, name) for k, (name, sd) in enumerate(zip(model.parameters, sds, strict=True)) if sd > 0)
    plant = _linear(model, code, point, values)
    found = Nominal(model, plant, entries, dt, felt(model, plant), point, code)
    fastest = 0.0 if plant.discrete else float(np.abs(plant.poles()).max(initial=0.0))
    return replace(found, most=found.substeps(max(FASTER * fastest, np.pi / dt)))


def _point(model: Model, code: Program, values: Array, inputs: Array | None, dt: float) -> tuple[Array, Array]:
    """Return the state and input to linearise at.

    Where no balance is found from the origin, as that of a tank whose outflow has no slope there, it is sought from where the machine goes.
    """
    rest = np.zeros(len(model.states))
    if inputs is None:
        return rest, np.zeros(len(model.inputs))
    rate, u = code.rate, np.asarray(inputs, dtype=np.float64)

    def imbalance(x: Array) -> Array:
        return rate(0.0, x, u, values) - (x if model.sample_time else 0.0)

    def slope(x: Array) -> Array:
        return linearised(code.rate_address, len(x), x, u, values)[0] - (np.eye(len(x)) if model.sample_time else 0.0)

    found = root(imbalance, rest)
    if not found.success:
        found = root(imbalance, _gone(imbalance, slope, rest, dt))
    return (np.asarray(found.x) if found.success and np.isfinite(found.x).all() else rest), u


def _gone(rate: Callable[[Array], Array], slope: Callable[[Array], Array], start: Array, dt: float) -> Array:
    """Return where a machine goes under a constant input, by implicit steps of doubling length; the start where it diverges.

    Pseudo-transient continuation (C. T. Kelley, D. E. Keyes, SIAM J. Numer. Anal. 35, 1998).
    """
    x = start
    for k in range(DOUBLINGS):
        step = np.linalg.lstsq(np.eye(len(x)) / (dt * 2.0**k) - slope(x), rate(x), rcond=None)[0] if np.isfinite(rate(x)).all() else np.inf
        if not np.isfinite(step).all():
            return start
        x = x + step
    return np.asarray(x)


def _linear(model: Model, code: Program, point: tuple[Array, Array], values: Array) -> StateSpace:
    """Return the linearisation of Python code, or the linear part the code itself offers; zero where it has no slope."""
    if model.plant is not None and model.plant.order == len(model.states):
        return model.plant
    A, B = linearised(code.rate_address, len(model.states), *point, values)
    C, D = linearised(code.output_address, len(model.outputs), *point, values)
    return StateSpace(A, B, C, D, model.sample_time)


def _continuous(name: str, plant: StateSpace, dt: float) -> StateSpace:
    found = continuous(plant)
    if found is None:
        raise BadInput(
            f"model '{name}' is sampled every {plant.dt:g} s and the recording every {dt:g} s; a pole on the "
            "negative real axis or at zero forbids another sample time, so one of the two must be resampled"
        )
    return found


def _entries(plant: StateSpace, stated: Mapping[str, Array]) -> tuple[Entry, ...]:
    found: list[Entry] = []
    for name in ("A", "B", "C", "D"):
        matrix: Array = getattr(plant, name)
        sd = np.asarray(stated[name], float) if name in stated else np.where(np.abs(matrix) == 1, 0.0, DEFAULT_RELATIVE_SD * np.abs(matrix))
        if sd.shape != matrix.shape:
            raise BadInput(f"uncertainty of {name} has shape {sd.shape}; expected {matrix.shape}")
        found += [Entry(name, int(i), int(j), float(sd[i, j]), f"{name}[{i + 1},{j + 1}]") for i, j in np.argwhere(sd > 0)]
    return tuple(found)


def _gains(model: Model, plant: StateSpace, entries: tuple[Entry, ...]) -> tuple[Entry, ...]:
    """Return one gain per input and output, each known as well as the entries are at the median."""
    relative = [e.sd / abs(start) for e in entries if (start := _start(plant, e))]
    sd = float(np.median(relative)) if relative else DEFAULT_RELATIVE_SD
    return (
        *(Entry(INPUT_GAIN, 0, j, sd, f"gain of {v.name}") for j, v in enumerate(model.inputs)),
        *(Entry(OUTPUT_GAIN, i, 0, sd, f"gain of {v.name}") for i, v in enumerate(model.outputs)),
    )


def _move(parts: dict[str, Array], entry: Entry, value: float) -> None:
    if entry.matrix == INPUT_GAIN:
        for name in ("B", "D"):
            parts[name][:, entry.column] *= 1 + value * entry.sd
    elif entry.matrix == OUTPUT_GAIN:
        for name in ("C", "D"):
            parts[name][entry.row] *= 1 + value * entry.sd
    else:
        parts[entry.matrix][entry.row, entry.column] += value * entry.sd


def entry_name(nominal: Nominal, entry: Entry) -> str:
    """Return a free number in the model's names: an entry of a matrix such as ``A[velocity, position]``, a parameter or a gain as it is called."""
    if entry.matrix not in ("A", "B", "C", "D"):
        return entry.name
    model = nominal.model
    if nominal.transfer and entry.matrix in "AB":
        return _coefficient_name(nominal, entry)
    rows = model.states if entry.matrix in "AB" else model.outputs
    columns = model.states if entry.matrix in "AC" else model.inputs
    row = rows[entry.row].name if entry.row < len(rows) else str(entry.row)
    column = columns[entry.column].name if entry.column < len(columns) else str(entry.column)
    return f"{entry.matrix}[{row}, {column}]"


def _coefficient_name(nominal: Nominal, entry: Entry) -> str:
    """Return a free number of a transfer function as the coefficient it is."""
    model = nominal.model
    i, own = next((i, own) for i, own in enumerate(output_states(nominal.plant)) if own.start <= entry.row < own.stop)
    power = entry.column - own.start if entry.matrix == "A" and entry.column > own.start else own.stop - 1 - entry.row
    of = f"den of {model.outputs[i].name}" if entry.matrix == "A" else f"num from {model.inputs[entry.column].name} to {model.outputs[i].name}"
    return f"{of}, {nominal.variable}^{power}" if own.stop - own.start > 1 else of


def _start(plant: StateSpace, entry: Entry) -> float:
    return 1.0 if entry.matrix in (INPUT_GAIN, OUTPUT_GAIN) else float(getattr(plant, entry.matrix)[entry.row, entry.column])
