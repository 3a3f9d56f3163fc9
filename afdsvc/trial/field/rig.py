"""A machine of the field trials: its compiled plant, what its owner knows of it, and what a law on it is.

Without laws each plant is exactly its nominal model. ``c`` are the plant's constants, ``v`` the commands after the laws on their held
values, ``w`` disturbances of the rates (one per state of the plant), ``t`` absolute time; states of the laws follow the plant's in ``X``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np

from afdsvc.api.model import Variable
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.trial.effect import Effect
from afdsvc.trial.laws.field import branch, characteristic, flow, force

FIRST, SECOND, PENDULUM, TANKS, IMPOSED, TWO_MASS, LEVITATION, STORES, MODES = range(9)


@numba.njit(cache=True, error_model="numpy")
def _first(c, v, w, t, X, dX, law):  # type: ignore[no-untyped-def]
    """Speed or current x' = -c1 x + c0 u, and the angle it turns: X = x, angle."""
    u = flow(law, 0, v[0], X[1], X, dX)
    dX[0] = characteristic(law, 0, X[0], u, -c[1], c[0], X, dX) + force(law, 0, X[1], X[0], c[0] * u, t, X, dX)
    dX[0] += branch(law, 0, X[0], X, dX) + w[0]
    dX[1] = X[0]


@numba.njit(cache=True, error_model="numpy")
def _second(c, v, w, t, X, dX, law):  # type: ignore[no-untyped-def]
    """q'' = c0 u - c1 q - c2 q': X = q, q'."""
    load = c[0] * flow(law, 0, v[0], X[0], X, dX) - c[1] * X[0]
    dX[0] = X[1]
    dX[1] = load - c[2] * X[1] + force(law, 0, X[0], X[1], load, t, X, dX) + w[1]


@numba.njit(cache=True, error_model="numpy")
def _pendulum(c, w, t, X, dX, law):  # type: ignore[no-untyped-def]
    """q'' = -c0 sin q - c1 q': X = q, q'; no input."""
    load = -c[0] * math.sin(X[0])
    dX[0] = X[1]
    dX[1] = load - c[1] * X[1] + force(law, 0, X[0], X[1], load, t, X, dX) + w[1]


@numba.njit(cache=True, error_model="numpy")
def _tanks(c, v, w, X, dX, law):  # type: ignore[no-untyped-def]
    """h1' = c0 u - c1 h1, h2' = c2 h1 - c3 h2 about an operating point; half of what the first spills meets the second."""
    u = flow(law, 0, v[0], 0.0, X, dX)
    out1 = characteristic(law, 0, X[0], 0.0, c[1], 0.0, X, dX)
    out2 = characteristic(law, 1, X[1], 0.0, c[3], 0.0, X, dX)
    spilt = branch(law, 0, X[0], X, dX)
    dX[0] = c[0] * u - out1 + spilt + w[0]
    dX[1] = c[2] / c[1] * out1 - 0.5 * spilt - out2 + branch(law, 1, X[1], X, dX) + w[1]


@numba.njit(cache=True, error_model="numpy")
def _two_mass(c, v, w, t, X, dX, law):  # type: ignore[no-untyped-def]
    """Motor and load on a shaft: X = motor speed, twist, load speed, motor angle."""
    u = flow(law, 0, v[0], X[3], X, dX)
    shaft = characteristic(law, 0, X[1], 0.0, c[2], 0.0, X, dX) + c[3] * (X[0] - X[2])
    dX[0] = c[0] * u - c[1] * X[0] - shaft + force(law, 0, X[3], X[0], c[0] * u, t, X, dX) + w[0]
    dX[1] = X[0] - X[2]
    dX[2] = c[4] * shaft - c[5] * X[2] + force(law, 1, X[3] - X[1], X[2], c[4] * shaft, t, X, dX) + w[2]
    dX[3] = X[0]


@numba.njit(cache=True, error_model="numpy")
def _levitation(c, v, w, t, X, dX, law):  # type: ignore[no-untyped-def]
    """y'' = c0 y + c1 i - c2 y' about the operating point: X = y, y'."""
    i = flow(law, 0, v[0], X[0], X, dX)
    load = characteristic(law, 0, X[0], i, c[0], c[1], X, dX)
    dX[0] = X[1]
    dX[1] = load - c[2] * X[1] + force(law, 0, X[0], X[1], load, t, X, dX) + w[1]


@numba.njit(cache=True, error_model="numpy")
def _stores(c, v, w, X, dX, law):  # type: ignore[no-untyped-def]
    """Two stores of heat over the surroundings: T1' = c0 u - c1 (T1 - T2), T2' = c2 (T1 - T2) - c3 T2."""
    u = flow(law, 0, v[0], 0.0, X, dX)
    dX[0] = c[0] * u - c[1] * (X[0] - X[1]) + branch(law, 0, X[0], X, dX) + w[0]
    dX[1] = c[2] * (X[0] - X[1]) - characteristic(law, 0, X[1], 0.0, c[3], 0.0, X, dX)
    dX[1] += branch(law, 1, X[1], X, dX) + w[1]


@numba.njit(cache=True, error_model="numpy")
def _modes(c, v, w, X, dX, law):  # type: ignore[no-untyped-def]
    """Two damped modes; constants of each: frequency, damping ratio, gain of its own command, gain of the other's."""
    first, second = flow(law, 0, v[0], X[0], X, dX), flow(law, 1, v[1], X[2], X, dX)
    for k in range(2):
        own, other = (first, second) if k == 0 else (second, first)
        o, g = 2 * k, 4 * k
        dX[o] = X[o + 1]
        dX[o + 1] = c[g] ** 2 * (c[g + 2] * own + c[g + 3] * other - X[o]) - 2.0 * c[g + 1] * c[g] * X[o + 1] + w[o + 1]


@numba.njit(cache=True, error_model="numpy")
def _imposed(c, v, t, X, dX, law):  # type: ignore[no-untyped-def]
    """Return the force c0 v + c1 q that answers an imposed speed v, with the forces of all laws against it: X = q."""
    return c[0] * v[0] + c[1] * X[0] - force(law, 0, X[0], v[0], c[0] * v[0], t, X, dX)


@numba.njit(cache=True, error_model="numpy")
def rates(plant, c, v, w, t, X, dX, law):  # type: ignore[no-untyped-def]
    """Fill dX with the rates of the plant's states and of the laws'."""
    if plant == FIRST:
        _first(c, v, w, t, X, dX, law)
    elif plant == SECOND:
        _second(c, v, w, t, X, dX, law)
    elif plant == PENDULUM:
        _pendulum(c, w, t, X, dX, law)
    elif plant == TANKS:
        _tanks(c, v, w, X, dX, law)
    elif plant == IMPOSED:
        dX[0] = v[0]
    elif plant == TWO_MASS:
        _two_mass(c, v, w, t, X, dX, law)
    elif plant == LEVITATION:
        _levitation(c, v, w, t, X, dX, law)
    elif plant == STORES:
        _stores(c, v, w, X, dX, law)
    else:
        _modes(c, v, w, X, dX, law)


@numba.njit(cache=True, error_model="numpy")
def outputs(plant, c, v, t, X, dX, law, y):  # type: ignore[no-untyped-def]
    """Fill y with the plant's outputs before any sensor; for an imposed motion dX gets the rates of its laws."""
    if plant == IMPOSED:
        y[0] = _imposed(c, v, t, X, dX, law)
    elif plant == TANKS or plant == STORES:
        y[0] = X[1]
        if y.size > 1:
            y[1] = X[0]
    else:
        y[0] = X[0]
        if y.size > 1:
            y[1] = X[2]


Matrices = tuple[Array, Array, Array, Array]


@dataclass(frozen=True, slots=True)
class Axis:
    """Where forces act: numbers of position and speed among the plant's states (speed -1: imposed by the input), and the site."""

    position: int
    speed: int
    site: str


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """A drawn machine.

    ``plant`` chooses the compiled rates; ``nominal`` are its constants as the owner believes them, of which ``loose`` says how
    uncertain each is (1: as uncertain as its catalogue, 0: exact). ``build`` returns the owner's A, B, C, D for given constants
    and ``code`` the same as Python text ("" for matrices). ``order`` counts the plant's states, of which the model names the
    first ``len(states)``. ``tau`` [s] is the time the machine takes, ``fast`` [s] the shortest time in it, ``dt`` the sampling
    time. ``level`` is the size of the excitation (of the references for a machine in closed loop). ``swing`` is the size of the
    initial state of a free decay. ``push`` returns the driving force of each axis for constants, states and commands.
    """

    family: str
    plant: int
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    states: tuple[Variable, ...]
    axes: tuple[Axis, ...]
    nominal: Array
    loose: Array
    names: tuple[str, ...]
    build: Callable[[Array], Matrices]
    order: int
    tau: float
    fast: float
    dt: float
    level: float
    push: Callable[[Array, Array, Array], Array]
    code: str = ""
    swing: Array | None = None
    controller: StateSpace | None = None
    known_controller: bool = True
    black_box: bool = False
    offsets: bool = False

    @property
    def loop(self) -> bool:
        """Whether simulations are compared in closed loop: there is a controller and the model's owner knows it."""
        return self.controller is not None and self.known_controller

    @property
    def substeps(self) -> int:
        """Integration steps per sample: at least 4, at least 25 in the shortest time."""
        return int(np.clip(np.ceil(25.0 * self.dt / self.fast), 4, 40))

    @property
    def stacked(self) -> Array:
        """``[A B; C D]`` of the controller, a zero for none."""
        K = self.controller
        return np.zeros((1, 1)) if K is None else np.ascontiguousarray(np.block([[K.A, K.B], [K.C, K.D]]))


def spread(g: np.random.Generator, low: float, high: float) -> float:
    """Return a number between two, evenly in its logarithm."""
    return float(np.exp(g.uniform(np.log(low), np.log(high))))


def columns(x: Array, *numbers: int) -> Array:
    """Return some columns of x, contiguous."""
    return np.ascontiguousarray(x[:, list(numbers)])


@dataclass(frozen=True, slots=True, eq=False)
class Sizes:
    """Root mean squares with nothing hidden: commands u, outputs y; positions q, speeds v and driving forces per axis; largest
    position of each axis; states x."""

    u: Array
    y: Array
    q: Array
    v: Array
    push: Array
    x: Array


@dataclass(frozen=True, slots=True, eq=False)
class Spot:
    """One place of one machine: number ``i`` of the command, axis, characteristic, branch or output; a generator for shapes."""

    rig: Rig
    sizes: Sizes
    i: int
    g: np.random.Generator

    @property
    def u(self) -> float:
        """Size of the command."""
        return float(self.sizes.u[self.i])

    @property
    def y(self) -> float:
        """Size of the output."""
        return float(self.sizes.y[self.i])

    @property
    def travel(self) -> float:
        """Size of the axis' position."""
        return float(self.sizes.q[self.i])

    @property
    def speed(self) -> float:
        """Size of the axis' speed."""
        return float(self.sizes.v[self.i])

    @property
    def push(self) -> float:
        """Size of what drives the axis."""
        return float(self.sizes.push[self.i])

    def draw(self, low: float, high: float) -> float:
        """Return a number between two."""
        return float(self.g.uniform(low, high))

    def sign(self) -> float:
        """Return 1 or -1."""
        return float(self.g.choice([-1.0, 1.0]))

    def on_command(self, *args: Any, **more: Any) -> Effect:
        """Return an effect on the command; see `effect`."""
        return self.effect(f"input:{self.rig.inputs[self.i].name}", *args, **more)

    def on_axis(self, *args: Any, **more: Any) -> Effect:
        """Return a force on the axis; see `effect`."""
        return self.effect(self.rig.axes[self.i].site, *args, **more)

    def on_output(self, *args: Any, **more: Any) -> Effect:
        """Return an effect on the sensor; see `effect`."""
        return self.effect(f"output:{self.rig.outputs[self.i].name}", *args, **more)

    def inside(self, *args: Any, **more: Any) -> Effect:
        """Return an effect inside the process; see `effect`."""
        return self.effect("machine", *args, **more)

    def effect(self, site: str, code: int, *values: tuple[str, float, float], free: tuple[int, ...] = (0,), states: int = 0) -> Effect:
        """Return an effect here; every value is ``(name, value, power of the severity)``."""
        names, base, powers = zip(*values, strict=True)
        return Effect("", site, code, (self.i,), base, powers, names, ("",) * len(names), free, states)


@dataclass(frozen=True, slots=True)
class Law:
    """A law under the name the generator gives it.

    ``place``: command, axis, characteristic, branch, sensor, constant. ``accept`` are canonical names that are right (none: the law
    is outside of the vocabulary, so that "unexplained" is right too), ``partial`` those that are defensible, ``words`` parts of further
    names that are right. ``needs`` are features a family must have (`afdsvc.trial.field.catalogue.FEATURES`).
    """

    name: str
    place: str
    make: Callable[[Spot], Effect]
    accept: tuple[str, ...]
    partial: tuple[str, ...]
    words: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()

    @property
    def outside(self) -> bool:
        """Whether no canonical name is right."""
        return not self.accept

    @property
    def label(self) -> str:
        """The first right name, or "outside"."""
        return self.accept[0] if self.accept else "outside"
