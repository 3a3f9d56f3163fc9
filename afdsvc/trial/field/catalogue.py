"""Families of machines, what each offers, and which laws make sense on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from afdsvc.api.model import Variable
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array
from afdsvc.trial.field import rig as plants
from afdsvc.trial.field.kinds import COMMAND_LAWS as AT_COMMAND
from afdsvc.trial.field.kinds import LAWS as AT_AXIS
from afdsvc.trial.field.kinds import PROCESS_LAWS as INSIDE
from afdsvc.trial.field.rig import Axis, Law, Matrices, Rig, spread
from afdsvc.trial.machine import filtered_pd

Generator = np.random.Generator
PENDULUM = '''"""Pendulum, angle from hanging down."""
import math


class machine:
    @staticmethod
    def f(t, x, u, p):
        q, w = x
        return [w, -p["g_over_l"] * math.sin(q) - p["damping"] * w]

    @staticmethod
    def h(t, x, u, p):
        return [x[0]]
'''
SECOND = '''"""Position servo: goal in, position out."""


class machine:
    @staticmethod
    def f(t, x, u, p):
        q, w = x
        return [w, p["drive"] * u[0] - p["stiffness"] * q - p["damping"] * w]

    @staticmethod
    def h(t, x, u, p):
        return [x[0]]
'''


def motor(g: Generator) -> Rig:
    """Return a DC motor with nothing but its speed measured, in rad/s or rpm."""
    tau, rpm = spread(g, 0.05, 0.8), bool(g.random() < 0.5)
    nominal = np.array([spread(g, 5.0, 60.0) * (9.55 if rpm else 1.0) / tau, 1.0 / tau])
    speed = Variable("speed", "rpm" if rpm else "rad/s")
    return Rig(
        family="motor", plant=plants.FIRST, inputs=(Variable("voltage", "V"),), outputs=(speed,), states=(speed,),
        axes=(Axis(1, 0, "state:speed"),), nominal=nominal, loose=np.ones(2), names=("gain", "damping"), build=first_order, order=2,
        tau=tau, fast=tau / 2, dt=tau / spread(g, 12, 60), level=spread(g, 3.0, 24.0), push=first_push,
    )


def first_order(c: Array) -> Matrices:
    """Return A, B, C, D of x' = -c1 x + c0 u, y = x."""
    return np.array([[-c[1]]]), np.array([[c[0]]]), np.eye(1), np.zeros((1, 1))


def first_push(c: Array, x: Array, u: Array) -> Array:
    """Return what the command does to the rate."""
    return np.asarray(c[0] * u[:, :1])


def second_order(c: Array) -> Matrices:
    """Return A, B, C, D of q'' = c0 u - c1 q - c2 q', y = q."""
    return np.array([[0.0, 1.0], [-c[1], -c[2]]]), np.array([[0.0], [c[0]]]), np.array([[1.0, 0.0]]), np.zeros((1, 1))


def second_push(c: Array, x: Array, u: Array) -> Array:
    """Return the force of command and spring together, the larger of the two parts."""
    parts = np.hstack([c[0] * u[:, :1], c[1] * x[:, :1]])
    return parts[:, [int(np.argmax(np.square(parts).mean(axis=0)))]]


def axis(g: Generator) -> Rig:
    """Return a geared axis under a sampled PD controller that half of the owners know."""
    tau, unit = spread(g, 0.2, 2.0), str(g.choice(["m", "mm", "rad"]))
    b, wc = spread(g, 0.05, 20.0), spread(g, 8.0, 20.0) / tau
    dt = spread(g, 0.03, 0.1) / wc
    K = filtered_pd(wc * wc / b, 1.4 * wc / b, 3 * dt, dt)
    q, v = Variable("position", unit), Variable("velocity", f"{unit}/s", rate_of="position")
    return Rig(
        family="axis", plant=plants.SECOND, inputs=(Variable("drive", "N"),), outputs=(q,), states=(q, v),
        axes=(Axis(0, 1, "state:velocity"),), nominal=np.array([b, 0.0, 1.0 / tau]), loose=np.array([1.0, 0.0, 1.0]),
        names=("gain", "stiffness", "damping"), build=second_order, order=2, tau=6.0 / wc, fast=1 / wc, dt=dt,
        level=spread(g, 0.02, 0.5) * (1000.0 if unit == "mm" else 1.0), push=second_push, controller=K,
        known_controller=bool(g.random() < 0.5),
    )


def servo(g: Generator) -> Rig:
    """Return a servo of which only goal and angle are recorded: its own loop is part of the machine."""
    w, zeta = spread(g, 6.0, 40.0), spread(g, 0.35, 1.1)
    q, v = Variable("angle", "rad"), Variable("rate", "rad/s", rate_of="angle")
    return Rig(
        family="servo", plant=plants.SECOND, inputs=(Variable("goal", "rad"),), outputs=(q,), states=(q, v),
        axes=(Axis(0, 1, "state:rate"),), nominal=np.array([w * w, w * w, 2 * zeta * w]), loose=np.array([0.3, 0.3, 1.0]),
        names=("drive", "stiffness", "damping"), build=second_order, order=2, tau=3.0 / w, fast=1 / w,
        dt=spread(g, 0.03, 0.25) / w, level=spread(g, 0.3, 1.5), push=second_push, code=SECOND if g.random() < 0.5 else "",
    )


def arm(g: Generator) -> Rig:
    """Return an arm lifted by a fan: voltage in, angle out, lightly damped."""
    w, zeta, level = spread(g, 3.0, 10.0), spread(g, 0.08, 0.35), spread(g, 1.0, 10.0)
    gain = w * w * spread(g, 0.3, 0.9) / level
    q, v = Variable("angle", "rad"), Variable("rate", "rad/s", rate_of="angle")
    return Rig(
        family="arm", plant=plants.SECOND, inputs=(Variable("fan", "V"),), outputs=(q,), states=(q, v),
        axes=(Axis(0, 1, "state:rate"),), nominal=np.array([gain, w * w, 2 * zeta * w]), loose=np.array([1.0, 0.15, 1.0]),
        names=("gain", "stiffness", "damping"), build=second_order, order=2, tau=3.0 / w, fast=1 / w,
        dt=spread(g, 0.03, 0.15) / w, level=level, push=second_push,
    )


def pendulum(g: Generator) -> Rig:
    """Return a pendulum let go from some angle: no input, a Python model with its sine."""
    w, zeta = spread(g, 2.0, 8.0), spread(g, 0.002, 0.02)
    q, v = Variable("angle", "rad"), Variable("rate", "rad/s", rate_of="angle")
    return Rig(
        family="pendulum", plant=plants.PENDULUM, inputs=(), outputs=(q,), states=(q, v), axes=(Axis(0, 1, "state:rate"),),
        nominal=np.array([w * w, 2 * zeta * w]), loose=np.array([0.05, 1.0]), names=("g_over_l", "damping"),
        build=lambda c: second_order(np.array([0.0, *c])), order=2, tau=4.0 / w, fast=1 / w, dt=spread(g, 0.03, 0.2) / w,
        level=0.0, push=lambda c, x, u: c[0] * np.sin(x[:, :1]), code=PENDULUM, swing=np.array([spread(g, 0.4, 1.6), 0.0]),
    )


def two_mass(g: Generator) -> Rig:
    """Return motor and load on a shaft; the load's speed is measured too on half of the machines."""
    tau, ratio, w = spread(g, 0.3, 1.2), spread(g, 0.4, 2.5), spread(g, 15.0, 60.0)
    k = w * w / (1 + ratio)
    c = np.array([spread(g, 5.0, 80.0), 1 / tau, k, 2 * spread(g, 0.01, 0.05) * w / (1 + ratio), ratio, 0.7 / tau])
    names = ("motor_speed", "twist", "load_speed")
    states = tuple(Variable(n, "rad" if n == "twist" else "rad/s") for n in names)
    outputs = (states[0], states[2]) if g.random() < 0.5 else states[:1]
    return Rig(
        family="two_mass", plant=plants.TWO_MASS, inputs=(Variable("torque", "N m"),), outputs=outputs, states=states,
        axes=(Axis(3, 0, "state:motor_speed"), Axis(3, 2, "state:load_speed")), nominal=c,
        loose=np.array([1.0, 1.0, 0.15, 1.0, 0.3, 1.0]), names=("gain", "motor_damping", "stiffness", "loss", "ratio", "load_damping"),
        build=lambda c: _shaft(c, len(outputs)), order=4, tau=tau, fast=1 / w, dt=spread(g, 0.06, 0.2) / w,
        level=spread(g, 0.2, 5.0), push=lambda c, x, u: np.column_stack([c[0] * u[:, 0], c[4] * c[2] * x[:, 1]]),
    )


def _shaft(c: Array, outputs: int) -> Matrices:
    A = np.array([[-c[1] - c[3], -c[2], c[3]], [1.0, 0.0, -1.0], [c[4] * c[3], c[4] * c[2], -c[4] * c[3] - c[5]]])
    return A, np.array([[c[0]], [0.0], [0.0]]), np.eye(3)[[0, 2][:outputs]], np.zeros((outputs, 1))


def damper(g: Generator) -> Rig:
    """Return a damper moved by an exciter: speed in, force out."""
    w, level = spread(g, 3.0, 30.0), spread(g, 0.02, 0.4)
    c = spread(g, 100.0, 5000.0)
    return Rig(
        family="damper", plant=plants.IMPOSED, inputs=(Variable("velocity", "m/s"),), outputs=(Variable("force", "N"),),
        states=(Variable("stroke", "m"),), axes=(Axis(0, -1, "output:force"),), nominal=np.array([c, spread(g, 0.05, 0.6) * c * w]),
        loose=np.ones(2), names=("damping", "stiffness"), order=1, tau=2.0 / w, fast=1 / w, dt=spread(g, 0.02, 0.1) / w, level=level,
        build=lambda c: (np.zeros((1, 1)), np.ones((1, 1)), np.array([[c[1]]]), np.array([[c[0]]])),
        push=lambda c, x, u: c[0] * u[:, :1],
    )


def tanks(g: Generator) -> Rig:
    """Return two tanks one above the other about an operating point; the upper level is measured too on a third of them."""
    tau = spread(g, 20.0, 200.0)
    a1, a2, level = 1.0 / tau, spread(g, 0.4, 1.5) / tau, spread(g, 0.5, 5.0)
    names = ("lower", "upper") if g.random() < 1 / 3 else ("lower",)
    lower, upper = Variable("lower", "m"), Variable("upper", "m")
    return Rig(
        family="tanks", plant=plants.TANKS, inputs=(Variable("pump", "V"),), outputs=tuple(Variable(n, "m") for n in names),
        states=(upper, lower), axes=(), nominal=np.array([a1 * spread(g, 0.05, 0.3) / level, a1, a1 * spread(g, 0.6, 1.2), a2]),
        loose=np.array([1.0, 0.5, 0.5, 0.5]), names=("pump", "outflow_1", "inflow_2", "outflow_2"), order=2, tau=tau, fast=tau / 2,
        build=lambda c: _cascade(np.array([[-c[1], 0.0], [c[2], -c[3]]]), c[0], len(names)), dt=tau / spread(g, 15, 60), level=level,
        push=_none, offsets=True,
    )


def stores(g: Generator) -> Rig:
    """Return a heated body in a housing that loses heat to the surroundings, about an operating point."""
    tau = spread(g, 30.0, 600.0)
    a12, a21, loss = 1 / tau, spread(g, 0.1, 0.6) / tau, spread(g, 0.1, 0.4) / tau
    level = spread(g, 5.0, 100.0)
    names = ("housing", "heater") if g.random() < 1 / 3 else ("housing",)
    body, housing = Variable("heater", "K"), Variable("housing", "K")
    return Rig(
        family="stores", plant=plants.STORES, inputs=(Variable("power", "W"),), outputs=tuple(Variable(n, "K") for n in names),
        states=(body, housing), axes=(), nominal=np.array([spread(g, 10.0, 60.0) * loss * a12 / a21 / level, a12, a21, loss]),
        loose=np.array([1.0, 0.5, 0.5, 0.5]), names=("heating", "exchange", "uptake", "loss"), order=2, tau=1.5 / loss, fast=tau / 2,
        build=lambda c: _cascade(np.array([[-c[1], c[1]], [c[2], -c[2] - c[3]]]), c[0], len(names)), dt=1 / loss / spread(g, 30, 120),
        level=level, push=_none, offsets=True,
    )


def _cascade(A: Array, gain: float, outputs: int) -> Matrices:
    return A, np.array([[gain], [0.0]]), np.array([[0.0, 1.0], [1.0, 0.0]])[:outputs], np.zeros((outputs, 1))


def _none(c: Array, x: Array, u: Array) -> Array:
    return np.zeros((u.shape[0], 0))


def coil(g: Generator) -> Rig:
    """Return a coil driven by a voltage, its current measured."""
    tau, resistance = spread(g, 2e-4, 5e-2), spread(g, 0.3, 30.0)
    current = Variable("current", "A")
    return Rig(
        family="coil", plant=plants.FIRST, inputs=(Variable("voltage", "V"),), outputs=(current,), states=(current,), axes=(),
        nominal=np.array([1 / (tau * resistance), 1 / tau]), loose=np.ones(2), names=("inverse_inductance", "decay"), build=first_order,
        order=2, tau=tau, fast=tau / 2, dt=tau / spread(g, 8, 40), level=spread(g, 2.0, 50.0), push=first_push,
    )


def levitation(g: Generator) -> Rig:
    """Return a body under a magnet about its operating point, held by a sampled PD controller its owner knows."""
    w = spread(g, 20.0, 80.0)
    ky, ki = w * w, -spread(g, 2.0, 30.0)
    wc = spread(g, 1.6, 2.6) * w
    dt = spread(g, 0.03, 0.09) / wc
    K = filtered_pd((ky + wc * wc) / ki, 1.6 * wc / ki, 3 * dt, dt)
    q, v = Variable("gap", "m"), Variable("gap_rate", "m/s", rate_of="gap")
    return Rig(
        family="levitation", plant=plants.LEVITATION, inputs=(Variable("current", "A"),), outputs=(q,), states=(q, v),
        axes=(Axis(0, 1, "state:gap_rate"),), nominal=np.array([ky, ki, spread(g, 0.02, 0.2) * w]), loose=np.array([0.5, 0.5, 1.0]),
        names=("pull_of_gap", "pull_of_current", "damping"), build=_levitation_magnet, order=2, tau=6 / wc, fast=1 / wc, dt=dt,
        level=spread(g, 2e-4, 2e-3), push=lambda c, x, u: c[0] * x[:, :1], controller=K, offsets=True,
    )


def _levitation_magnet(c: Array) -> Matrices:
    A = np.array([[0.0, 1.0], [c[0], -c[2]]])
    return A, np.array([[0.0], [c[1]]]), np.array([[1.0, 0.0]]), np.zeros((1, 1))


def mirror(g: Generator) -> Rig:
    """Return a mirror on two piezo drives: a sampled black-box model whose states mean nothing."""
    w, level = spread(g, 300.0, 3000.0), spread(g, 2.0, 50.0)
    gain = spread(g, 0.05, 2.0)
    modes = [[w * s, spread(g, 0.05, 0.3), gain * s, gain * g.uniform(-0.1, 0.1)] for s in (1.0, spread(g, 0.8, 1.25))]
    turn = np.linalg.qr(g.standard_normal((4, 4)))[0] * np.exp(g.uniform(-1, 1, 4))
    names = tuple(f"{n}_{i}" for i in (1, 2) for n in ("frequency", "damping_ratio", "gain", "crosstalk"))
    return Rig(
        family="mirror", plant=plants.MODES, inputs=(Variable("piezo1", "V"), Variable("piezo2", "V")),
        outputs=(Variable("tip", "urad"), Variable("tilt", "urad")), states=tuple(Variable(f"x{i}", "") for i in range(1, 5)), axes=(),
        nominal=np.array(modes).ravel(), loose=np.tile([0.05, 0.5, 0.1, 0.5], 2), names=names, build=lambda c: _turned(c, turn),
        order=4, tau=4 / w, fast=1 / w, dt=spread(g, 0.08, 0.4) / w, level=level, push=_none, black_box=True,
    )


def _turned(c: Array, turn: Array) -> Matrices:
    """Return the two modes in states turned and scaled by a random matrix."""
    A, B, C = np.zeros((4, 4)), np.zeros((4, 2)), np.zeros((2, 4))
    for k, (w, zeta, own, other) in enumerate(c.reshape(2, 4)):
        o = 2 * k
        A[o : o + 2, o : o + 2] = [[0.0, 1.0], [-w * w, -2 * zeta * w]]
        B[o + 1, k], B[o + 1, 1 - k], C[k, o] = w * w * own, w * w * other, 1.0
    scaled = np.diag(np.tile([1.0, c[0]], 2)) @ turn
    back = np.linalg.inv(scaled)
    return back @ A @ scaled, back @ B, C @ scaled, np.zeros((2, 2))


FAMILIES: dict[str, Callable[[np.random.Generator], Rig]] = {
    "motor": motor, "axis": axis, "servo": servo, "arm": arm, "pendulum": pendulum,
    "two_mass": two_mass, "damper": damper, "tanks": tanks, "stores": stores, "coil": coil,
    "levitation": levitation, "mirror": mirror,
}
_ALL = {"white_box", "steady"}
FEATURES = {  # places where laws act, and what else a law may need
    "motor": _ALL | {"command", "axis", "sensor", "constant", "turning", "open_motor", "inertia"},
    "axis": _ALL | {"command", "axis", "sensor", "constant", "position", "turning", "inertia"},
    "servo": _ALL | {"command", "axis", "sensor", "constant", "position", "spring", "lever", "firmware", "turning", "inertia"},
    "arm": _ALL | {"command", "axis", "sensor", "constant", "position", "spring", "lever", "inertia"},
    "pendulum": {"axis", "sensor", "constant", "white_box", "spring"},
    "two_mass": _ALL | {"command", "axis", "sensor", "constant", "turning", "characteristic", "shaft"},
    "damper": {"axis", "sensor", "constant", "white_box", "position", "spring"},
    "tanks": _ALL | {"command", "sensor", "constant", "characteristic", "branch", "tanks"},
    "stores": _ALL | {"command", "sensor", "constant", "characteristic", "branch", "stores", "still"},
    "coil": _ALL | {"command", "sensor", "constant", "characteristic", "branch", "coil", "still"},
    "levitation": {"axis", "constant", "characteristic", "magnet", "white_box", "command"},
    "mirror": {"command", "sensor", "pair", "steady"},
}
LAWS: dict[str, Law] = {law.name: law for law in (*AT_COMMAND, *AT_AXIS, *INSIDE)}


def laws_at(family: str) -> list[Law]:
    """Return the laws that make sense on a family, in the order of the catalogue."""
    has = FEATURES[family]
    return [law for law in LAWS.values() if {law.place, *law.needs} <= has]


def places(rig: Rig, law: Law) -> int:
    """Return how many places of this sort the machine has; raises `BadInput` when the law makes no sense there."""
    if law not in laws_at(rig.family):
        raise BadInput(f"family '{rig.family}' has no place for law '{law.name}'")
    twice = 2 if law.name in ("root", "spill") else 1
    return {"command": len(rig.inputs), "axis": len(rig.axes), "sensor": len(rig.outputs)}.get(law.place, twice)


def apart(one: Law, other: Law) -> bool:
    """Return whether no name for one law is also a name for the other, so that both can be asked for at once."""
    return not (set(one.accept) & {*other.accept, *other.partial} or set(other.accept) & {*one.accept, *one.partial})


@dataclass(frozen=True, slots=True)
class FieldOptions:
    """Settings of one field trial: a family, the names of the hidden laws (none: nothing is hidden), kind of excitation."""

    family: str
    laws: tuple[str, ...] = ()
    repeating: bool = False

    def __post_init__(self) -> None:
        if self.family not in FAMILIES:
            raise BadInput(f"option family is '{self.family}'; expected one of {', '.join(FAMILIES)}")
        for law in self.laws:
            if law not in LAWS:
                raise BadInput(f"option laws names '{law}'; expected names from the catalogue")

    def as_json(self) -> dict[str, Any]:
        """Return the options as plain values."""
        return {"family": self.family, "laws": list(self.laws), "repeating": self.repeating}


NOTHING_SHARE, OUTSIDE_SHARE = 0.15, 1 / 3  # of the trials; of those in which something is hidden
COUNTS, CHANCES = (1, 2, 3), (0.6, 0.28, 0.12)  # laws in one machine
SHARES = (0.2, 0.9)  # of the held-out error
STREAM = 20  # separates the numbers drawn here from those of the other parts


def draws(seed: int) -> Iterator[tuple[FieldOptions, float, tuple[str, ...]]]:
    """Yield options, the share asked for, and the first right name of every law (or "outside"), without end."""
    g = np.random.default_rng([seed, STREAM])
    while True:
        for family in g.permutation(list(FAMILIES)):
            laws = () if g.random() < NOTHING_SHARE else _laws(str(family), g)
            options = FieldOptions(str(family), tuple(law.name for law in laws), bool(g.random() < 0.5))
            yield options, float(g.uniform(*SHARES)) if laws else 0.0, tuple(law.label for law in laws)


def _laws(family: str, g: np.random.Generator) -> tuple[Law, ...]:
    """Return one to three laws that make sense on the family and cannot be taken for one another."""
    outside = bool(g.random() < OUTSIDE_SHARE)
    possible = laws_at(family)
    first = [law for law in possible if law.outside == outside] or possible
    chosen = [first[int(g.integers(len(first)))]]
    for _ in range(int(g.choice(COUNTS, p=CHANCES)) - 1):
        others = [law for law in possible if law not in chosen and (outside or not law.outside) and all(apart(law, c) for c in chosen)]
        if others:
            chosen.append(others[int(g.integers(len(others)))])
    return tuple(chosen)
