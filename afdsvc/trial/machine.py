"""What the generator knows of a machine: names, axes, true constants, controller and how it is recorded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm, solve_discrete_are

from afdsvc.api.model import Variable
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array, StateSpace


@dataclass(frozen=True, slots=True)
class MachineAxis:
    """A direction of motion: numbers of its position, velocity, output and input."""

    position: int
    velocity: int
    output: int
    input: int


@dataclass(frozen=True, slots=True)
class RecordingPlan:
    """How the machine is recorded: seconds of one period, periods kept, seconds before the record begins, lowest and
    highest excited frequency [Hz], and the rms of the outputs in their unit for train (two levels), select and holdout.
    ``ref_share`` is the share of the excitation that comes through the reference (0 without one)."""

    period: float
    periods: int
    preroll: float
    band: tuple[float, float]
    levels: tuple[float, float, float, float]
    speeds: tuple[float, float, float, float]
    reference: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class TrialMachine:
    """A machine whose recordings are made up.

    ``build`` returns continuous A, B, C (D is zero) for the physical constants ``theta``, of which ``nominal`` are those in
    the MODEL.toml and ``theta_sd`` their relative standard deviations. ``controller`` maps ``y - ref`` to u (positive
    feedback), ``loop`` is the same with inputs ``[y - ref, alpha]``. ``sigma`` is the noise of each output,
    ``reach`` the largest reading a sound machine may show.
    ``changes`` maps a site and the name of a parameter to the constants that change with it, with their exponents.
    """

    name: str
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    states: tuple[Variable, ...]
    axes: tuple[MachineAxis, ...]
    theta_names: tuple[str, ...]
    nominal: Array
    theta_sd: Array
    build: Callable[[Array], tuple[Array, Array, Array]]
    controller: StateSpace
    loop: StateSpace
    sigma: Array
    reach: float
    dt: float
    substeps: int
    aux: tuple[str, ...]
    recording: RecordingPlan
    changes: dict[tuple[str, str], dict[str, float]]

    @property
    def rotating(self) -> bool:
        """Whether there is a rotor, so that speed and angle are recorded."""
        return "speed" in self.aux

    @property
    def stable(self) -> bool:
        """Whether the nominal plant is stable without its controller."""
        A, _, _ = self.build(self.nominal)
        return bool(np.linalg.eigvals(A).real.max() < 0)

    def input_site(self, i: int) -> str:
        """Return the site of input i."""
        return f"input:{self.inputs[i].name}"

    def output_site(self, i: int) -> str:
        """Return the site of output i."""
        return f"output:{self.outputs[i].name}"

    def force_site(self, axis: int) -> str:
        """Return the site of forces on an axis: the state they accelerate."""
        return f"state:{self.states[self.axes[axis].velocity].name}"

    def index(self, site: str) -> int:
        """Return the number of the input, axis or output a site names (0 for the machine); raises `BadInput`."""
        if site == "machine":
            return 0
        for place in (self.input_site, self.force_site, self.output_site):
            count = {"input_site": len(self.inputs), "force_site": len(self.axes)}.get(place.__name__, len(self.outputs))
            for i in range(count):
                if place(i) == site:
                    return i
        raise BadInput(f"machine '{self.name}' has no site '{site}'")

    def constant(self, name: str) -> int:
        """Return the number of a physical constant."""
        return self.theta_names.index(name)

    def with_controller(self, controller: StateSpace, loop: StateSpace) -> TrialMachine:
        """Return the machine under another controller."""
        return replace(self, controller=controller, loop=loop)

    def matrices(self, theta: Array) -> tuple[Array, Array, Array]:
        """Return contiguous A, B, C."""
        a, b, c = self.build(theta)
        return np.ascontiguousarray(a), np.ascontiguousarray(b), np.ascontiguousarray(c)


def sampled_plant(A: Array, B: Array, dt: float) -> tuple[Array, Array]:
    """Return A and B of the plant sampled with a zero-order hold."""
    n, m = B.shape
    both = expm(np.block([[A, B], [np.zeros((m, n + m))]]) * dt)
    return both[:n, :n], both[:n, n:]


def lqg(A: Array, B: Array, C: Array, dt: float, state_weight: Array, process_weight: float) -> tuple[StateSpace, StateSpace]:
    """Return the loop ``[y, alpha] -> u`` in observer form and K alone (``y -> u``), unit input and measurement weights.

    Observer x+ = A x + B u + L (C x - y), u = F x + alpha: alpha goes into the observer too, as in J_K.
    """
    Ad, Bd = sampled_plant(A, B, dt)
    n, m, p = A.shape[0], B.shape[1], C.shape[0]
    X = solve_discrete_are(Ad, Bd, np.diag(state_weight), np.eye(m))
    F = -np.linalg.solve(np.eye(m) + Bd.T @ X @ Bd, Bd.T @ X @ Ad)
    Y = solve_discrete_are(Ad.T, C.T, process_weight * np.eye(n), np.eye(p))
    L = -np.linalg.solve(np.eye(p) + C @ Y @ C.T, C @ Y @ Ad.T).T
    inner = Ad + Bd @ F + L @ C
    K = StateSpace.of(inner, -L, F, np.zeros((m, p)), dt)
    return StateSpace.of(inner, np.hstack([-L, Bd]), F, np.hstack([np.zeros((m, p)), np.eye(m)]), dt), K


def additive(K: StateSpace) -> StateSpace:
    """Return ``u = K (y - ref) + alpha`` as one system."""
    m = K.outputs
    return StateSpace(K.A, np.hstack([K.B, np.zeros((K.order, m))]), K.C, np.hstack([K.D, np.eye(m)]), K.dt)


def proportional(gain: float, channels: int, dt: float) -> StateSpace:
    """Return u = gain y on every channel."""
    return StateSpace.gain(gain * np.eye(channels), dt)


def filtered_pd(kp: float, kd: float, tau: float, dt: float) -> StateSpace:
    """Return u = -(kp + kd s / (tau s + 1)) y, the derivative by backward differences."""
    a, b = tau / (tau + dt), kd / (tau + dt)
    return StateSpace.of([[a]], [[a * b - b]], [[-1.0]], [[-(kp + b)]], dt)
