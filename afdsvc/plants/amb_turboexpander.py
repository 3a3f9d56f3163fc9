"""The 700 kW turboexpander on active magnetic bearings: an unstable, flexible, rotating machine.

Given by publication P1 of A. K. Sekunda, "Fault Diagnosis and Identification of Electro-Mechanical Systems", PhD thesis,
Technical University of Denmark, 2017: 40 nodes of 4 degrees of freedom (320 states), Bernoulli-Euler beams with
gyroscopics, two radial bearings with forces ``K_i i + K_s s``, sensors close to them and not at them, 31,500 rpm, 8 states
after reduction, four currents in and four displacements out. The paper prints no geometry, no bearing constants and no
noise. Every number marked "chosen" is one an engineer would accept for a machine of this size, and no more than that.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.linalg import eigh

from afdsvc.api.plant import PhysicalPlant
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array
from afdsvc.plants.rotor import magnetic_rotor
from afdsvc.plants.rotor.finite_elements import Disc, Element, rotor_matrices
from afdsvc.plants.rotor.magnetic_rotor import Instrumentation, MagneticBearing, MagneticRotor, rotor_plant
from afdsvc.plants.rotor.modes import RIGID

NODES = 40  # P1
NOMINAL_RPM = 31500  # P1
STATES = 8  # P1: the rigid body motions alone

# Chosen, all of it from here on: the shaft (number of elements of 9 mm, diameter in mm) from the expander to the compressor.
# The first bending mode (21,900 rad/s backward, 23,500 forward) lies just above the 20,000 rad/s up to which the paper's
# figure shows the 8-state model to agree; the tilting mode stays unstable at full speed, as the paper's plant is.
LENGTH = 0.009
SHAFT = ((4, 60), (3, 85), (8, 100), (9, 110), (8, 100), (3, 85), (4, 60))
WHEELS = (  # aluminium, about 130 and 145 mm across
    Disc(2, 1.0, 1.2e-3, 2.1e-3),
    Disc(37, 1.3, 1.9e-3, 3.4e-3),
)
DAMPING_SHARE = 0.002  # of critical, of the first bending mode; stiffness-proportional
BIAS_CURRENT = 4.0  # A; the control current stays below it
GAP = 0.5e-3  # m, magnetic air gap
CURRENT_GAIN = 150.0  # N/A
STIFFNESS = -CURRENT_GAIN * BIAS_CURRENT / GAP  # N/m: K_s / K_i = bias / gap for a linearised pair of magnets
CLEARANCE = 250.0  # um to the touch-down bearings, half the air gap
DISPLACEMENT_LIMIT = CLEARANCE / 2  # um; a burst ends well before contact
NOISE_SD = 0.5  # um
SAMPLE_TIME = 1e-4  # s
BALANCE_GRADE = 2.5  # mm/s, ISO 21940 for turbines

BEARINGS = (
    MagneticBearing("a", 11, 8, STIFFNESS, CURRENT_GAIN),
    MagneticBearing("b", 28, 31, STIFFNESS, CURRENT_GAIN),
)
# LQG: an ampere weighs like 32 um, the observer a Kalman filter for disturbing currents (the controller's own defaults).
# PID: stiffness two and a half times what the bearings take away.
RECOMMENDED: dict[str, dict[str, float]] = {
    "lqg": {"input_weight": 1000.0},
    "pid": {"proportional": 0.02, "integral_seconds": 0.2, "derivative_seconds": 2.4e-3, "filter_seconds": 1e-4},
}


@lru_cache(maxsize=8)
def turboexpander_rotor(rpm: float = NOMINAL_RPM, shear: bool = False) -> MagneticRotor:
    """Return the full rotor; ``shear`` makes Timoshenko beams of the paper's Bernoulli-Euler ones."""
    elements = [Element(LENGTH, mm * 1e-3, shear=shear) for count, mm in SHAFT for _ in range(count)]
    free = rotor_matrices(elements, WHEELS)
    first = _first_bending(free.K, free.M)
    return magnetic_rotor.magnetic_rotor(free.damped(2 * DAMPING_SHARE / first), BEARINGS, rpm)


def _first_bending(K: Array, M: Array) -> float:
    """Return the first bending frequency of the free shaft at rest [rad/s]."""
    return float(np.sqrt(eigh(K, M, eigvals_only=True, subset_by_index=[RIGID, RIGID])[0]))


def amb_turboexpander(
    rpm: float = NOMINAL_RPM,
    states: int = STATES,
    sample_time: float = SAMPLE_TIME,
    shear: bool = False,
    balance_grade: float = BALANCE_GRADE,
) -> PhysicalPlant:
    """Return the turboexpander reduced to ``states``: 8 are the paper's rigid rotor, every further 4 keep a bending pair.

    Currents [A] and displacements [um] are ordered ``a_x, a_y, b_x, b_y``; a is the bearing beside the expander wheel.
    ``balance_grade`` [mm/s] of ISO 21940 is that of the balancing, done at ``rpm``; 0 is a perfect rotor. Raises `BadInput`
    for a number of states that splits a pair of modes.
    """
    if not np.isfinite(rpm):
        raise BadInput(f"rpm {rpm}; expected a finite speed")
    return rotor_plant(
        turboexpander_rotor(float(rpm), shear),
        Instrumentation(sample_time, NOISE_SD, DISPLACEMENT_LIMIT, BIAS_CURRENT),
        name="turboexpander on magnetic bearings",
        states=states,
        balance_grade=balance_grade,
        source="A. K. Sekunda, PhD thesis, DTU 2017, publication P1; geometry and constants chosen",
        recommended=RECOMMENDED,
    )
