"""A machine of a field trial as it was drawn: its names, constants, nominal model, and how it can be driven."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from afdsvc.api.model import Variable
from afdsvc.lti.statespace import Array, StateSpace

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

    def sampled_every(self, dt: float) -> Rig:
        """Return the machine sampled at another rate (not for one under a controller)."""
        return replace(self, dt=dt)


def spread(g: np.random.Generator, low: float, high: float) -> float:
    """Return a number between two, evenly in its logarithm."""
    return float(np.exp(g.uniform(np.log(low), np.log(high))))


def columns(x: Array, *numbers: int) -> Array:
    """Return some columns of x, contiguous."""
    return np.ascontiguousarray(x[:, list(numbers)])
