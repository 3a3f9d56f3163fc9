"""The active gas bearing as the generator makes it up: the published constants, an own assembly of the matrices.

Source of the constants: A. K. Sekunda, PhD thesis, Technical University of Denmark, 2017, publication P5, table 0.1; the
weights of the LQG controller and the noise variances (0.12 and 0.15 um^2) are those of publication P5 too.
"""

from __future__ import annotations

import numpy as np

from afdsvc.api.model import Variable
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array
from afdsvc.plants.gas_bearing import DISPLACEMENT_LIMIT, NOISE_VARIANCE, SAMPLE_TIME, TABLE_0_1
from afdsvc.trial.machines.machine import MachineAxis, RecordingPlan, TrialMachine, additive, lqg, proportional

KNOWN_TO = 0.02  # relative standard deviation of every physical constant
GAIN = 0.2  # V/um, the damping sign for the constants of table 0.1
_STATES = (
    Variable("horizontal", "um"),
    Variable("vertical", "um"),
    Variable("horizontal_rate", "um/s", rate_of="horizontal"),
    Variable("vertical_rate", "um/s", rate_of="vertical"),
    Variable("horizontal_valve", "V"),
    Variable("vertical_valve", "V"),
)
_NAMES = tuple(f"{word}_{i}{j}" for word in "KDB" for i in "hv" for j in "hv") + ("P_h", "P_v", "C_h", "C_v")
_RECORDING = RecordingPlan(
    period=0.5,
    periods=5,
    preroll=0.3,
    band=(2.0, 600.0),
    levels=(1.25, 2.5, 1.9, 2.2),
    speeds=(115.2, 172.8, 144.0, 130.0),
)


def gas_bearing_machine(controller: str = "lqg", injection: str = "youla") -> TrialMachine:
    """Return the bearing under ``lqg`` or ``proportional`` control; alpha enters the observer (``youla``) or is ``added``."""
    table = TABLE_0_1
    nominal = np.concatenate([np.ravel(table[k]) for k in "KDB"] + [np.ravel(table["P"]), np.ones(2)])
    A, B, C = _build(nominal)
    if controller == "lqg":
        loop, K = lqg(A, B, C, SAMPLE_TIME, np.array([0, 0, 1e-4, 1e-4, 0, 0]), 0.01)
    elif controller == "proportional":
        K = proportional(GAIN, 2, SAMPLE_TIME)
        loop = additive(K)
    else:
        raise BadInput(f"the gas bearing has no controller '{controller}'; lqg or proportional is wanted")
    return TrialMachine(
        name="gas bearing",
        inputs=(Variable("horizontal", "V"), Variable("vertical", "V")),
        outputs=(Variable("horizontal", "um"), Variable("vertical", "um")),
        states=_STATES,
        axes=(MachineAxis(0, 2, 0, 0), MachineAxis(1, 3, 1, 1)),
        theta_names=_NAMES,
        nominal=nominal,
        theta_sd=np.full(nominal.size, KNOWN_TO),
        build=_build,
        controller=K,
        loop=additive(K) if injection == "added" else loop,
        sigma=np.sqrt(NOISE_VARIANCE),
        reach=DISPLACEMENT_LIMIT + 6 * float(np.sqrt(max(NOISE_VARIANCE))),
        dt=SAMPLE_TIME,
        substeps=5,
        aux=("speed", "angle", "pressure", "temperature"),
        recording=_RECORDING,
        changes=_changes(),
    )


def _build(theta: Array) -> tuple[Array, Array, Array]:
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


def _changes() -> dict[tuple[str, str], dict[str, float]]:
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
