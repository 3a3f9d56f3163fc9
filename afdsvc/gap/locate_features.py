"""What a residual may depend on: groups of columns that would be a disturbance at one place, made of the machine's motion."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from scipy import signal

from afdsvc.api.physics import Axis, Machine
from afdsvc.gap.lines import tones
from afdsvc.gap.locate_lines import steady
from afdsvc.gap.locate_sweep import push
from afdsvc.gap.locate_view import View
from afdsvc.lti.statespace import Array

KNOTS = (0.01, 0.12, 0.3, 0.5, 0.7, 0.88, 0.99)
RADII = (0.15, 0.4, 0.8, 1.4)  # of the rms: how far a play operator lags
LAGS = (30.0, 300.0)  # over the fastest excited angular frequency: time constants of low-passes
ANGLE, SPEED = "angle", "speed"


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Columns per run, ``(n, b)`` each, as a disturbance at a site: ``states (order,)`` and ``outputs (p,)`` it enters by.

    ``depends_on`` are the words of the answer, ``law`` the words of the sentence, ``kind`` "motion" (anything driven by the
    excitation), "rotation", "tone" (of angular frequency ``omega``) or "time".
    """

    site: str
    law: str
    depends_on: tuple[str, ...]
    columns: tuple[Array, ...]
    states: Array
    outputs: Array
    kind: str = "motion"
    linear: bool = False
    input: int | None = None
    output: int | None = None
    omega: float = 0.0

    @property
    def size(self) -> int:
        """How many columns."""
        return int(self.columns[0].shape[1])


@dataclass(frozen=True, slots=True, eq=False)
class _Place:
    """A site while its groups are made: where it is and what enters by it."""

    view: View
    machine: Machine
    site: str
    states: Array
    outputs: Array
    input: int | None = None
    output: int | None = None

    def group(
        self, law: str, words: Sequence[str], columns: Sequence[Array], kind: str = "motion", linear: bool = False
    ) -> Group:
        """Return a group here."""
        return Group(
            self.site, law, tuple(words), tuple(columns), self.states, self.outputs, kind, linear, self.input, self.output
        )


def groups(view: View, machine: Machine) -> list[Group]:
    """Return every group at every site where it makes sense and its signal moves."""
    simulator, theta = view.objective.simulator, view.point.theta
    by_input, by_rate = push(simulator, theta)
    p, n = view.base.nominal.plant.outputs, view.base.nominal.plant.order
    D = view.base.nominal.at(theta).D
    found: list[Group] = []
    for port in machine.inputs:
        place = _Place(view, machine, f"input:{port.name}", by_input[:, port.index], D[:, port.index], input=port.index)
        found += _of_input(place, port.index)
    for number, axis in enumerate(machine.axes if _moves([s.x for s in view.motion]) else ()):
        i = axis.rate.index
        place = _Place(view, machine, f"state:{axis.rate.name}", by_rate[:, i], np.zeros(p), input=None)
        found += _of_axis(place, axis, [a for k, a in enumerate(machine.axes) if k != number])
    for port in machine.outputs:
        unit = np.eye(p)[port.index]
        place = _Place(view, machine, f"output:{port.name}", np.zeros(n), unit, output=port.index)
        found += _of_output(place, port.index)
    found += _tones(view, machine)
    return [g for g in found if all(np.isfinite(c).all() for c in g.columns) and any(c.any() for c in g.columns)]


def _of_input(place: _Place, i: int) -> Iterator[Group]:
    u = [s.u[:, i] for s in place.view.motion]
    yield from _without_motion(place)
    if not _moves(u):
        return
    yield place.group("the level of the input", ["input", "amplitude"], _bent(u))
    yield place.group("the history of the input", ["input", "amplitude", "history"], _plays(u))
    yield place.group("the frequency of the input", ["input", "frequency"], _dynamics(u), linear=True)
    yield place.group("slow parts of the input", ["input", "frequency"], _low_passed(place, u), linear=True)
    yield place.group("the rate of the input", ["input", "rate of the input", "amplitude"], _rates(u))
    yield place.group("the sign of the input's rate", ["input", "sign of the input's rate"], _signs([_rate(x) for x in u]))
    yield from _with_aux(place, u, "input")


def _of_axis(place: _Place, axis: Axis, others: Sequence[Axis]) -> Iterator[Group]:
    q, v = _state(place.view, axis.position.index), _state(place.view, axis.rate.index)
    yield place.group("the position", ["position", "amplitude"], _bent(q))
    yield place.group("the velocity", ["velocity", "amplitude"], _bent(v))
    yield place.group("the sign of the velocity", ["velocity", "velocity sign"], _signs(v))
    yield place.group("the history of the position", ["position", "velocity sign", "history"], _plays(q))
    for what, x in (("position", q), ("velocity", v)):
        yield place.group(f"the {what} in proportion", [what], [c[:, None] / _rms(x) for c in x], linear=True)
    for other in others:
        for what, k in (("position", other.position.index), ("velocity", other.rate.index)):
            x = _state(place.view, k)
            name = place.machine.states[k].name
            yield place.group(f"the {what} '{name}' of another axis", [f"{what} {name}"], [c[:, None] / _rms(x) for c in x], linear=True)
            yield from _speed_times(place, x, f"{what} {name}")
    yield from _with_aux(place, q, "position")
    yield from _with_aux(place, v, "velocity")
    yield from _without_motion(place)


def _of_output(place: _Place, j: int) -> Iterator[Group]:
    y = [s.y[:, j] for s in place.view.motion]
    if _moves(y):
        yield place.group("the reading", ["position", "amplitude"], _bent(y))
        yield place.group("the frequency of the reading", ["frequency"], _dynamics(y), linear=True)
        yield from _with_aux(place, y, "position")
    for k, port in enumerate(place.machine.outputs):
        x = [s.y[:, k] for s in place.view.motion]
        if k != j and _moves(x):
            yield place.group(f"the reading '{port.name}'", [f"output {port.name}"], [c[:, None] / _rms(x) for c in x], linear=True)
    yield from _without_motion(place)


def _without_motion(place: _Place) -> Iterator[Group]:
    """Yield what may act whether the machine is excited or not: a constant, time, auxiliary signals, the rotor's angle."""
    runs = place.view.runs
    yield place.group("a constant", ["constant"], [np.ones((len(r), 1)) for r in runs], "time")
    yield place.group("time, each recording apart", ["time"], _clocks([len(r) for r in runs]), "time")
    for name, z in _aux(place):
        yield place.group(f"'{name}'", [name], [c[:, None] for c in z], "time")
    yield from _rotation(place)


def _tones(view: View, machine: Machine) -> Iterator[Group]:
    """Yield the lines of the residual that the excitation does not make, each at the output that shows it best; free phases."""
    n = view.base.nominal.plant.order
    apart = [(tone.omega, tone.output) for tone in tones(view.runs, view.raw)]
    for omega, j in [*apart, *steady(view.runs, view.raw)[:4]]:
        port = machine.outputs[j]
        place = _Place(view, machine, f"output:{port.name}", np.zeros(n), np.eye(len(machine.outputs))[j], output=j)
        yield replace(place.group(f"a tone of {omega / (2 * np.pi):.4g} Hz", ["time"], _waves(view, omega), "tone"), omega=omega)


def _waves(view: View, omega: float) -> list[Array]:
    """Return cosine and sine for every run apart, zero in the others."""
    out = []
    for i, run in enumerate(view.runs):
        t = omega * run.dt * np.arange(len(run))
        columns = np.zeros((len(run), 2 * len(view.runs)))
        columns[:, 2 * i], columns[:, 2 * i + 1] = np.cos(t), np.sin(t)
        out.append(columns)
    return out


def _clocks(lengths: Sequence[int]) -> list[Array]:
    """Return a level, a slope and a bend of its own for every run, zero in the others."""
    out = []
    for i, n in enumerate(lengths):
        t = np.arange(n) / n - 0.5
        columns = np.zeros((n, 3 * len(lengths)))
        columns[:, 3 * i : 3 * i + 3] = np.column_stack([np.ones(n), t, t**2 - 1 / 12])
        out.append(columns)
    return out


def _rotation(place: _Place) -> Iterator[Group]:
    angle, speed = _column(place, ANGLE), _column(place, SPEED)
    if angle is None:
        return
    once, *more = ([np.column_stack([np.cos(k * a), np.sin(k * a)]) for a in angle] for k in range(1, 4))
    yield place.group("the rotor's angle", ["rotor angle"], once, "rotation")
    for word, columns in zip(("twice", "three times"), more, strict=True):
        yield place.group(f"{word} the rotor's angle", ["rotor angle"], columns, "rotation")
    if speed is not None and _rms(speed) > 0 and np.std([s.mean() for s in speed]) > 1e-3 * _rms(speed):
        growing = [c * (s[:, None] / _rms(speed)) ** 2 for c, s in zip(once, speed, strict=True)]
        yield place.group("the rotor's angle, growing with its speed squared", ["rotor angle", "speed"], growing, "rotation")


def _with_aux(place: _Place, x: Sequence[Array], word: str) -> Iterator[Group]:
    for name, z in _aux(place):
        columns = [(a * b)[:, None] / _rms(x) for a, b in zip(z, x, strict=True)]
        yield place.group(f"'{name}' times the {word}", [name, word], columns)


def _speed_times(place: _Place, x: Sequence[Array], word: str) -> Iterator[Group]:
    speed = _column(place, SPEED)
    if speed is not None and _rms(speed) > 0:
        columns = [(s * c)[:, None] / (_rms(speed) * _rms(x)) for s, c in zip(speed, x, strict=True)]
        yield place.group(f"the speed times the {word}", ["speed", word], columns)


def _aux(place: _Place) -> Iterator[tuple[str, list[Array]]]:
    """Yield every auxiliary signal that moves, but the angle, about its mean in units of its spread."""
    for name in place.view.runs[0].aux:
        values = _column(place, name)
        if name == ANGLE or values is None:
            continue
        together = np.concatenate(values)
        if together.std() > 1e-6 * max(float(np.abs(together).max()), 1e-300):
            yield name, [(v - together.mean()) / together.std() for v in values]


def _column(place: _Place, name: str) -> list[Array] | None:
    names = place.view.runs[0].aux
    return [r.AUX[:, names.index(name)] for r in place.view.runs] if name in names else None


def _state(view: View, i: int) -> list[Array]:
    return [s.x[:, i] for s in view.motion]


def _rms(x: Sequence[Array]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(list(x)) ** 2))) or 1.0


def _moves(x: Sequence[Array]) -> bool:
    return any(float(np.ptp(c, axis=0).max()) > 0 for c in x)


def _bent(x: Sequence[Array]) -> list[Array]:
    """Return a piecewise linear function of the signal with knots at its quantiles, as hat functions."""
    knots = np.unique(np.quantile(np.concatenate(list(x)), KNOTS))
    if len(knots) < 3:
        return [np.zeros((len(c), 1)) for c in x]
    return [np.column_stack([np.interp(c, knots, e) for e in np.eye(len(knots))]) for c in x]


def _signs(x: Sequence[Array]) -> list[Array]:
    width = 0.1 * _rms(x)
    return [np.tanh(c / width)[:, None] for c in x]


def _rate(x: Array) -> Array:
    return np.diff(x, prepend=x[:1])


def _rates(x: Sequence[Array]) -> list[Array]:
    d = [_rate(c) for c in x]
    size = _rms(d)
    return [np.column_stack([(c / size) * np.abs(c / size), (c / size) ** 3, np.abs(c / size)]) for c in d]


def _dynamics(x: Sequence[Array]) -> list[Array]:
    """Return the signal and its last two differences: what delay, lag and gain do to it, to second order."""
    parts: list[Callable[[Array], Array]] = [lambda c: c, _rate, lambda c: _rate(_rate(c))]
    sizes = [_rms([f(c) for c in x]) for f in parts]
    return [np.column_stack([f(c) / s for f, s in zip(parts, sizes, strict=True)]) for c in x]


def _low_passed(place: _Place, x: Sequence[Array]) -> list[Array]:
    dt = place.machine.dt
    poles = [float(np.exp(-dt * place.machine.bandwidth / lag)) for lag in LAGS]
    size = _rms(x)
    return [np.column_stack([c, *(_low_pass(c, pole) for pole in poles)]) / size for c in x]


def _low_pass(x: Array, pole: float) -> Array:
    return np.asarray(signal.lfilter([1 - pole], [1, -pole], x))


def _plays(x: Sequence[Array]) -> list[Array]:
    size = _rms(x)
    return [np.column_stack([_play(c, r * size) / size for r in RADII]) for c in x]


@njit(cache=True, nogil=True)
def _play(x, radius):  # type: ignore[no-untyped-def]
    """Return the play operator: the signal followed at a distance of at most ``radius``."""
    out = np.empty_like(x)
    at = 0.0
    for k, value in enumerate(x):
        at = min(max(at, value - radius), value + radius)
        out[k] = at
    return out
