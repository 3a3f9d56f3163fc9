"""What a residual may depend on: groups of columns that would be a disturbance at one place, made of the machine's motion."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import signal

from afdsvc.api.physics import Axis, Machine
from afdsvc.explain.locate_columns import bent, clocks, dynamics, low_pass, moves, plays, rate, rates, rms, signs
from afdsvc.explain.locate_lines import steady
from afdsvc.explain.locate_sweep import push
from afdsvc.explain.locate_view import View
from afdsvc.lti.statespace import Array
from afdsvc.stats.tones import tones

LAGS = (30.0, 300.0)  # over the fastest excited angular frequency: time constants of low-passes
PEAKS, DAMPING = 2, 0.03  # how many peaks of the residual are tried as resonances, and how damped
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
    for number, axis in enumerate(machine.axes if moves([s.x for s in view.motion]) else ()):
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
    if not moves(u):
        return
    yield place.group("the level of the input", ["input", "amplitude"], bent(u))
    yield place.group("the history of the input", ["input", "amplitude", "history"], plays(u))
    yield place.group("the frequency of the input", ["input", "frequency"], dynamics(u), linear=True)
    yield from _resonances(place, u, "input", ["input", "frequency"])
    yield place.group("slow parts of the input", ["input", "frequency"], _low_passed(place, u), linear=True)
    yield place.group("the rate of the input", ["input", "rate of the input", "amplitude"], rates(u))
    yield place.group("the sign of the input's rate", ["input", "sign of the input's rate"], signs([rate(x) for x in u]))
    yield from _with_aux(place, u, "input")


def _of_axis(place: _Place, axis: Axis, others: Sequence[Axis]) -> Iterator[Group]:
    q, v = _state(place.view, axis.position.index), _state(place.view, axis.rate.index)
    yield place.group("the position", ["position", "amplitude"], bent(q))
    yield place.group("the velocity", ["velocity", "amplitude"], bent(v))
    yield place.group("the sign of the velocity", ["velocity", "velocity sign"], signs(v))
    yield place.group("the history of the position", ["position", "velocity sign", "history"], plays(q))
    for what, x in (("position", q), ("velocity", v)):
        yield place.group(f"the {what} in proportion", [what], [c[:, None] / rms(x) for c in x], linear=True)
    for other in others:
        for what, k in (("position", other.position.index), ("velocity", other.rate.index)):
            x = _state(place.view, k)
            name = place.machine.states[k].name
            yield place.group(f"the {what} '{name}' of another axis", [f"{what} {name}"], [c[:, None] / rms(x) for c in x], linear=True)
            yield from _speed_times(place, x, f"{what} {name}")
    yield from _with_aux(place, q, "position")
    yield from _with_aux(place, v, "velocity")
    yield from _without_motion(place)


def _of_output(place: _Place, j: int) -> Iterator[Group]:
    y = [s.y[:, j] for s in place.view.motion]
    if moves(y):
        yield place.group("the reading", ["position", "amplitude"], bent(y))
        yield place.group("the frequency of the reading", ["frequency"], dynamics(y), linear=True)
        yield from _resonances(place, y, "reading", ["frequency"])
        yield from _with_aux(place, y, "position")
    for k, port in enumerate(place.machine.outputs):
        x = [s.y[:, k] for s in place.view.motion]
        if k != j and moves(x):
            yield place.group(f"the reading '{port.name}'", [f"output {port.name}"], [c[:, None] / rms(x) for c in x], linear=True)
    yield from _without_motion(place)


def _without_motion(place: _Place) -> Iterator[Group]:
    """Yield what may act whether the machine is excited or not: a constant, time, auxiliary signals, the rotor's angle."""
    runs = place.view.runs
    yield place.group("a constant", ["constant"], [np.ones((len(r), 1)) for r in runs], "time")
    if place.output is not None:  # slow motion looks the same wherever it enters
        yield place.group("time, each recording apart", ["time"], clocks([len(r) for r in runs]), "time")
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


def _rotation(place: _Place) -> Iterator[Group]:
    angle, speed = _column(place, ANGLE), _column(place, SPEED)
    if angle is None:
        return
    once, *more = ([np.column_stack([np.cos(k * a), np.sin(k * a)]) for a in angle] for k in range(1, 4))
    yield place.group("the rotor's angle", ["rotor angle"], once, "rotation")
    for word, columns in zip(("twice", "three times"), more, strict=True):
        yield place.group(f"{word} the rotor's angle", ["rotor angle"], columns, "rotation")
    if speed is not None and rms(speed) > 0 and np.std([s.mean() for s in speed]) > 1e-3 * rms(speed):
        growing = [c * (s[:, None] / rms(speed)) ** 2 for c, s in zip(once, speed, strict=True)]
        yield place.group("the rotor's angle, growing with its speed squared", ["rotor angle", "speed"], growing, "rotation")


def _with_aux(place: _Place, x: Sequence[Array], word: str) -> Iterator[Group]:
    for name, z in _aux(place):
        columns = [(a * b)[:, None] / rms(x) for a, b in zip(z, x, strict=True)]
        yield place.group(f"'{name}' times the {word}", [name, word], columns)


def _speed_times(place: _Place, x: Sequence[Array], word: str) -> Iterator[Group]:
    speed = _column(place, SPEED)
    if speed is not None and rms(speed) > 0:
        columns = [(s * c)[:, None] / (rms(speed) * rms(x)) for s, c in zip(speed, x, strict=True)]
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


def _low_passed(place: _Place, x: Sequence[Array]) -> list[Array]:
    dt = place.machine.dt
    poles = [float(np.exp(-dt * place.machine.bandwidth / lag)) for lag in LAGS]
    size = rms(x)
    return [np.column_stack([c, *(low_pass(c, pole) for pole in poles)]) / size for c in x]


def _resonances(place: _Place, x: Sequence[Array], word: str, words: Sequence[str]) -> Iterator[Group]:
    """Yield a signal and what narrow filters make of it where the residual's spectrum stands out: displacement and velocity."""
    dt = place.machine.dt
    for omega in place.machine.peaks[:PEAKS]:
        turn = omega * dt
        if not 0.0 < turn < 2.5:
            continue
        radius = float(np.exp(-DAMPING * turn))
        a = [1.0, -2 * radius * np.cos(turn), radius**2]
        filtered = [np.asarray(signal.lfilter([0.0, 1.0], a, c)) for c in x]
        own, size = rms(x), rms(filtered)
        columns = [np.column_stack([c / own, f / size, rate(f) / (turn * size)]) for c, f in zip(x, filtered, strict=True)]
        yield place.group(f"a resonance of the {word} near {omega / (2 * np.pi):.3g} Hz", words, columns, linear=True)
