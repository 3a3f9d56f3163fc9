"""A rotor on magnetic bearings at speed, as the generator makes it up: unstable without control, 31,500 rpm, currents in.

The parallel motion of the turboexpander of `afdsvc.plants.amb_turboexpander` (mass, stiffness and current gain of its two
bearings together, its sensor noise), assembled here anew; the speed differs from recording to recording.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from afdsvc.api.model import Variable
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.plants.amb_turboexpander import CURRENT_GAIN, DISPLACEMENT_LIMIT, NOISE_SD, SAMPLE_TIME, STIFFNESS
from afdsvc.trial.machines.machine import MachineAxis, RecordingPlan, TrialMachine, additive, filtered_pd
from afdsvc.trial.options import Options

MASS = 21.2  # kg
KNOWN_TO = 0.02
_RECORDING = RecordingPlan(
    period=0.2,
    periods=5,
    preroll=0.2,
    band=(10.0, 1000.0),
    levels=(5.0, 10.0, 7.5, 8.5),
    speeds=(3298.7, 2750.0, 3000.0, 3150.0),
)
_CHANGES = (
    ("state:{}_rate", "stiffness", "k"),
    ("input:{}", "actuator gain", "b"),
    ("output:{}", "sensor gain", "c"),
)
_NAMES = ("k_x", "k_y", "b_x", "b_y", "c_x", "c_y")


def rotor() -> TrialMachine:
    """Return the rotor under a PD controller on each axis: two currents [A] in, two displacements [um] out, 10 kHz."""
    pull, push = -2 * STIFFNESS / MASS, 2e6 * CURRENT_GAIN / MASS
    nominal = np.array([pull, pull, push, push, 1.0, 1.0])
    one = filtered_pd(kp=0.02, kd=4e-5, tau=1e-4, dt=SAMPLE_TIME)
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
        theta_names=_NAMES,
        nominal=nominal,
        theta_sd=np.array([KNOWN_TO] * 4 + [0.0, 0.0]),
        build=_build,
        controller=K,
        loop=additive(K),
        sigma=np.full(2, NOISE_SD),
        reach=DISPLACEMENT_LIMIT,
        dt=SAMPLE_TIME,
        substeps=2,
        aux=("speed", "angle"),
        recording=_RECORDING,
        changes={(site.format(a), name): {f"{k}_{a}": 1.0} for site, name, k in _CHANGES for a in "xy"},
    )


def _build(theta: Array) -> tuple[Array, Array, Array]:
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
