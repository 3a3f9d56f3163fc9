"""The machines of the trials, and the settings of one trial.

- Gas bearing: constants, LQG weights and noise variances (0.12 and 0.15 um^2) of A. K. Sekunda, PhD thesis, Technical University of
  Denmark, 2017, publication P5, table 0.1; an own assembly of the matrices.
- Positioning axis: a carriage on a guide under a sampled PD controller; all constants are invented.
- Rotor on magnetic bearings, unstable without control: the parallel motion of `afdsvc.plants.amb_turboexpander` (mass, stiffness and
  current gain of its two bearings together, its sensor noise), assembled anew; the speed differs from recording to recording.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from afdsvc.api.model import Variable
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.plants import amb_turboexpander as amb
from afdsvc.plants import gas_bearing as gas
from afdsvc.trial.machine import MachineAxis, RecordingPlan, TrialMachine, additive, filtered_pd, lqg, proportional

BEARING_KNOWN_TO = 0.02  # relative standard deviation of every physical constant
BEARING_GAIN = 0.2  # V/um, the damping sign for the constants of table 0.1
_BEARING_STATES = (
    Variable("horizontal", "um"),
    Variable("vertical", "um"),
    Variable("horizontal_rate", "um/s", rate_of="horizontal"),
    Variable("vertical_rate", "um/s", rate_of="vertical"),
    Variable("horizontal_valve", "V"),
    Variable("vertical_valve", "V"),
)
_BEARING_NAMES = tuple(f"{word}_{i}{j}" for word in "KDB" for i in "hv" for j in "hv") + ("P_h", "P_v", "C_h", "C_v")
_BEARING_PLAN = RecordingPlan(
    period=0.5,
    periods=5,
    preroll=0.3,
    band=(2.0, 600.0),
    levels=(1.25, 2.5, 1.9, 2.2),
    speeds=(115.2, 172.8, 144.0, 130.0),
)


def gas_bearing_machine(controller: str = "lqg", injection: str = "youla") -> TrialMachine:
    """Return the bearing under ``lqg`` or ``proportional`` control; alpha enters the observer (``youla``) or is ``added``."""
    table = gas.TABLE_0_1
    nominal = np.concatenate([np.ravel(table[k]) for k in "KDB"] + [np.ravel(table["P"]), np.ones(2)])
    A, B, C = _bearing_plant(nominal)
    if controller == "lqg":
        loop, K = lqg(A, B, C, gas.SAMPLE_TIME, np.array([0, 0, 1e-4, 1e-4, 0, 0]), 0.01)
    elif controller == "proportional":
        K = proportional(BEARING_GAIN, 2, gas.SAMPLE_TIME)
        loop = additive(K)
    else:
        raise BadInput(f"the gas bearing has no controller '{controller}'; lqg or proportional is expected")
    return TrialMachine(
        name="gas bearing",
        inputs=(Variable("horizontal", "V"), Variable("vertical", "V")),
        outputs=(Variable("horizontal", "um"), Variable("vertical", "um")),
        states=_BEARING_STATES,
        axes=(MachineAxis(0, 2, 0, 0), MachineAxis(1, 3, 1, 1)),
        theta_names=_BEARING_NAMES,
        nominal=nominal,
        theta_sd=np.full(nominal.size, BEARING_KNOWN_TO),
        build=_bearing_plant,
        controller=K,
        loop=additive(K) if injection == "added" else loop,
        sigma=np.sqrt(gas.NOISE_VARIANCE),
        reach=gas.DISPLACEMENT_LIMIT + 6 * float(np.sqrt(max(gas.NOISE_VARIANCE))),
        dt=gas.SAMPLE_TIME,
        substeps=5,
        aux=("speed", "angle", "pressure", "temperature"),
        recording=_BEARING_PLAN,
        changes=_bearing_changes(),
    )


def _bearing_plant(theta: Array) -> tuple[Array, Array, Array]:
    """Return A, B, C: q'' = K q + D q' + B a, a' = P (u - a), y = C q."""
    K, D, B = (theta[4 * i : 4 * i + 4].reshape(2, 2) for i in range(3))
    A = np.zeros((6, 6))
    A[0:2, 2:4] = np.eye(2)
    A[2:4] = np.hstack([K, D, B])
    A[4:6, 4:6] = -np.diag(theta[12:14])
    drive = np.zeros((6, 2))
    drive[4:6] = np.diag(theta[12:14])
    sense = np.zeros((2, 6))
    sense[:, 0:2] = np.diag(theta[14:16])
    return A, drive, sense


def _bearing_changes() -> dict[tuple[str, str], dict[str, float]]:
    """Return what changes with each named parameter: constants and exponents."""
    out: dict[tuple[str, str], dict[str, float]] = {}
    for i, axis in (("h", "horizontal"), ("v", "vertical")):
        rows = {word: {f"{word}_{i}{j}": 1.0 for j in "hv"} for word in "KDB"}
        site = f"state:{axis}_rate"
        out[site, "stiffness"] = rows["K"]
        out[site, "damping"] = rows["D"]
        out[site, "mass"] = {name: -1.0 for row in rows.values() for name in row}
        out[f"input:{axis}", "actuator gain"] = {f"B_{j}{i}": 1.0 for j in "hv"}
        out[f"output:{axis}", "sensor gain"] = {f"C_{i}": 1.0}
    return out


AXIS_MASS, AXIS_DAMPING = 62.0, 310.0  # kg, N s/m
AXIS_KNOWN_TO = 0.02
_AXIS_PLAN = RecordingPlan(
    period=2.0,
    periods=5,
    preroll=0.5,
    band=(0.5, 120.0),
    levels=(1.0e-3, 2.0e-3, 1.5e-3, 1.75e-3),
    speeds=(0.0, 0.0, 0.0, 0.0),
    reference=0.5,
)


def positioning_axis() -> TrialMachine:
    """Return the axis: force [N] in, position [m] out, 1 kHz, references in ``ref_position``."""
    K = filtered_pd(kp=1.55e5, kd=4.4e3, tau=4e-3, dt=1e-3)
    nominal = np.array([AXIS_MASS, AXIS_DAMPING, 1.0, 1.0])
    return TrialMachine(
        name="positioning axis",
        inputs=(Variable("force", "N"),),
        outputs=(Variable("position", "m"),),
        states=(Variable("q", "m"), Variable("v", "m/s", rate_of="q")),
        axes=(MachineAxis(0, 1, 0, 0),),
        theta_names=("mass", "damping", "motor", "scale"),
        nominal=nominal,
        theta_sd=np.array([AXIS_KNOWN_TO, AXIS_KNOWN_TO, AXIS_KNOWN_TO, 0.0]),
        build=_axis_plant,
        controller=K,
        loop=additive(K),
        sigma=np.array([2e-5]),
        reach=0.05,
        dt=1e-3,
        substeps=8,
        aux=("supply", "temperature"),
        recording=_AXIS_PLAN,
        changes={
            ("state:v", "mass"): {"mass": 1.0},
            ("state:v", "damping"): {"damping": 1.0},
            ("input:force", "actuator gain"): {"motor": 1.0},
            ("output:position", "sensor gain"): {"scale": 1.0},
        },
    )


def _axis_plant(theta: Array) -> tuple[Array, Array, Array]:
    mass, damping, motor, scale = theta
    A = np.array([[0.0, 1.0], [0.0, -damping / mass]])
    return A, np.array([[0.0], [motor / mass]]), np.array([[scale, 0.0]])


CHOICES = {
    "machine": ("gas_bearing", "positioning_axis"),
    "controller": ("lqg", "proportional"),
    "injection": ("youla", "added"),
    "excitation": ("multisine", "one_level", "sine", "operation"),
    "measure": ("auto", "commands", "loop"),
    "noise": ("white", "coloured", "process", "quieter", "louder"),
}


@dataclass(frozen=True, slots=True)
class Options:
    """Settings of one trial; the names are those of `CHOICES`.

    ``controller`` and ``injection`` (alpha through the observer as in J_K, or added to the command) concern the bearing.
    ``noise``: white as the model says, coloured of the same variance, driving the states too (process), or white of half
    or twice the stated standard deviation. ``dirty`` hides four small unrelated effects (rho 0.04 each) besides.
    ``parameter_error`` is the standard deviation of the plant's own errors in units of the stated one. ``known_controller``
    says whether the MODEL.toml carries the controller. ``periods`` of the excitation are recorded (0: as the machine has it).
    ``measure`` is how rho is measured (`afdsvc.trial.generate.effect_visibility`); auto: by commands where the plant is stable.
    """

    machine: str = "gas_bearing"
    controller: str = "lqg"
    injection: str = "youla"
    excitation: str = "multisine"
    noise: str = "white"
    dirty: bool = False
    parameter_error: float = 1.0
    known_controller: bool = True
    periods: int = 0
    measure: str = "auto"

    def __post_init__(self) -> None:
        for name, allowed in CHOICES.items():
            if getattr(self, name) not in allowed:
                raise BadInput(f"option {name} is '{getattr(self, name)}'; one of {', '.join(allowed)} is expected")

    def build(self) -> TrialMachine:
        """Return the machine."""
        if self.machine == "positioning_axis":
            return positioning_axis()
        return gas_bearing_machine(self.controller, self.injection)

    def measured(self, machine: TrialMachine) -> str:
        """Return how rho is measured on the machine."""
        if self.measure != "auto":
            return self.measure
        return "commands" if machine.stable else "loop"


ROTOR_MASS = 21.2  # kg
ROTOR_KNOWN_TO = 0.02
_ROTOR_PLAN = RecordingPlan(
    period=0.2,
    periods=5,
    preroll=0.2,
    band=(10.0, 1000.0),
    levels=(5.0, 10.0, 7.5, 8.5),
    speeds=(3298.7, 2750.0, 3000.0, 3150.0),
)
_ROTOR_CHANGES = (
    ("state:{}_rate", "stiffness", "k"),
    ("input:{}", "actuator gain", "b"),
    ("output:{}", "sensor gain", "c"),
)
_ROTOR_NAMES = ("k_x", "k_y", "b_x", "b_y", "c_x", "c_y")


def rotor() -> TrialMachine:
    """Return the rotor under a PD controller on each axis: two currents [A] in, two displacements [um] out, 10 kHz."""
    pull, push = -2 * amb.STIFFNESS / ROTOR_MASS, 2e6 * amb.CURRENT_GAIN / ROTOR_MASS
    nominal = np.array([pull, pull, push, push, 1.0, 1.0])
    one = filtered_pd(kp=0.02, kd=4e-5, tau=1e-4, dt=amb.SAMPLE_TIME)
    A, B, C, D = (np.kron(np.eye(2), M) for M in (one.A, one.B, one.C, one.D))
    K = StateSpace.of(A, B, C, D, one.dt)
    return TrialMachine(
        name="rotor on magnetic bearings",
        inputs=(Variable("x", "A"), Variable("y", "A")),
        outputs=(Variable("x", "um"), Variable("y", "um")),
        states=(
            Variable("x", "um"), Variable("y", "um"),
            Variable("x_rate", "um/s", rate_of="x"), Variable("y_rate", "um/s", rate_of="y"),
        ),
        axes=(MachineAxis(0, 2, 0, 0), MachineAxis(1, 3, 1, 1)),
        theta_names=_ROTOR_NAMES,
        nominal=nominal,
        theta_sd=np.array([ROTOR_KNOWN_TO] * 4 + [0.0, 0.0]),
        build=_rotor_plant,
        controller=K,
        loop=additive(K),
        sigma=np.full(2, amb.NOISE_SD),
        reach=amb.DISPLACEMENT_LIMIT,
        dt=amb.SAMPLE_TIME,
        substeps=2,
        aux=("speed", "angle"),
        recording=_ROTOR_PLAN,
        changes={(site.format(a), name): {f"{k}_{a}": 1.0} for site, name, k in _ROTOR_CHANGES for a in "xy"},
    )


def _rotor_plant(theta: Array) -> tuple[Array, Array, Array]:
    """Return A, B, C: q'' = k q + b u, y = c q; k is positive, the magnets pull."""
    A, B, C = np.zeros((4, 4)), np.zeros((4, 2)), np.zeros((2, 4))
    A[:2, 2:], A[2:, :2] = np.eye(2), np.diag(theta[:2])
    B[2:], C[:, :2] = np.diag(theta[2:4]), np.diag(theta[4:])
    return A, B, C


@dataclass(frozen=True, slots=True)
class RotorOptions(Options):
    """Options of a trial on the rotor: ``machine``, ``controller`` and ``injection`` of `Options` do not count."""

    def build(self) -> TrialMachine:
        """Return the rotor."""
        return rotor()
