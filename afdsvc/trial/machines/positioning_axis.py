"""A positioning axis: a carriage on a guide, pushed by a motor, held on its reference by a sampled PD controller.

All constants are invented, of the size of a small machine tool axis; nothing is taken from a measured one.
"""

from __future__ import annotations

import numpy as np

from afdsvc.api.model import Variable
from afdsvc.lti.statespace import Array
from afdsvc.trial.machines.machine import MachineAxis, RecordingPlan, TrialMachine, additive, filtered_pd

MASS, DAMPING = 62.0, 310.0  # kg, N s/m
KNOWN_TO = 0.02
_RECORDING = RecordingPlan(
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
    nominal = np.array([MASS, DAMPING, 1.0, 1.0])
    return TrialMachine(
        name="positioning axis",
        inputs=(Variable("force", "N"),),
        outputs=(Variable("position", "m"),),
        states=(Variable("q", "m"), Variable("v", "m/s", rate_of="q")),
        axes=(MachineAxis(0, 1, 0, 0),),
        theta_names=("mass", "damping", "motor", "scale"),
        nominal=nominal,
        theta_sd=np.array([KNOWN_TO, KNOWN_TO, KNOWN_TO, 0.0]),
        build=_build,
        controller=K,
        loop=additive(K),
        sigma=np.array([2e-5]),
        reach=0.05,
        dt=1e-3,
        substeps=8,
        aux=("supply", "temperature"),
        recording=_RECORDING,
        changes={
            ("state:v", "mass"): {"mass": 1.0},
            ("state:v", "damping"): {"damping": 1.0},
            ("input:force", "actuator gain"): {"motor": 1.0},
            ("output:position", "sensor gain"): {"scale": 1.0},
        },
    )


def _build(theta: Array) -> tuple[Array, Array, Array]:
    mass, damping, motor, scale = theta
    A = np.array([[0.0, 1.0], [0.0, -damping / mass]])
    return A, np.array([[0.0], [motor / mass]]), np.array([[scale, 0.0]])
