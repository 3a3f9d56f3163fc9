"""Random stable plants and their poor models, as publication P2 uses them to show closed-loop identification.

Source: A. K. Sekunda, "Fault Diagnosis and Identification of Electro-Mechanical Systems", PhD thesis, Technical
University of Denmark, 2017, publication P2 section 4: 2 inputs, 2 outputs, 4 states, ``A_model = 0.7 A_real`` (eq. 37).

The discrete, unstable second-order plant of publication P4, with faults on its two input gains.

Source: A. K. Sekunda, "Fault Diagnosis and Identification of Electro-Mechanical Systems", PhD thesis, Technical
University of Denmark, 2017, publication P4 eqs. 53-59 (sample time 1 ms, output noise variance 0.11, pole at 1.1568).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from afdsvc.api.model import Quantity, Variable
from afdsvc.api.plant import PhysicalPlant
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array, StateSpace

MODEL_FACTOR = 0.7


def random_stable(
    generator: np.random.Generator, order: int = 4, inputs: int = 2, outputs: int = 2, dt: float = 0.0
) -> tuple[StateSpace, StateSpace]:
    """Return a random stable plant and its model with ``A_model = 0.7 A_real``; continuous unless ``dt`` [s] is given.

    Poles have moduli up to 0.95 (discrete) or real parts from -3 to -0.1 rad/s (continuous), some in complex pairs, in
    a random orthogonal basis; B and C are standard normal, D is zero. Raises `BadInput` for sizes below one.
    """
    if min(order, inputs, outputs) < 1:
        raise BadInput(
            f"a plant of order {order} with {inputs} inputs and {outputs} outputs; expected at least one each"
        )
    basis = np.linalg.qr(generator.standard_normal((order, order)))[0]
    A = basis @ _modes(generator, order, dt) @ basis.T
    B, C = generator.standard_normal((order, inputs)), generator.standard_normal((outputs, order))
    true = StateSpace.of(A, B, C, None, dt)
    return true, StateSpace.of(MODEL_FACTOR * A, B, C, None, dt)


def _modes(generator: np.random.Generator, order: int, dt: float) -> Array:
    """Return a block diagonal matrix of complex pairs, one real pole last when the order is odd."""
    A = np.zeros((order, order))
    for i in range(0, order - 1, 2):
        a, b = _pole(generator, dt)
        A[i : i + 2, i : i + 2] = [[a, b], [-b, a]]
    if order % 2:
        A[-1, -1] = _pole(generator, dt)[0]
    return A


def _pole(generator: np.random.Generator, dt: float) -> tuple[float, float]:
    if dt > 0:
        radius, angle = generator.uniform(0.2, 0.95), generator.uniform(0.1, np.pi - 0.1)
        return float(radius * np.cos(angle)), float(radius * np.sin(angle))
    return float(-generator.uniform(0.1, 3.0)), float(generator.uniform(0.2, 5.0))


SAMPLE_TIME = 1e-3
NOISE_VARIANCE = 0.11
ENTRIES = {"a11": 1.0, "a12": -0.3, "a21": -0.5, "a22": 0.2, "b1": 2.0, "b2": 3.0, "c1": -1.0, "c2": 4.0}


def unstable_second_order() -> PhysicalPlant:
    """Return the plant; its faults are the parameters ``b1`` and ``b2``, its uncertain parameter ``a11``."""
    return PhysicalPlant(
        name="unstable second-order plant",
        inputs=(Variable("input"),),
        outputs=(Variable("output"),),
        states=(Variable("first"), Variable("second")),
        parameters={name: Quantity(value) for name, value in ENTRIES.items()},
        build=_build,
        sample_time=SAMPLE_TIME,
        output_cov=np.array([[NOISE_VARIANCE]]),
        output_limit=np.array([np.inf]),
        input_limit=np.array([np.inf]),
        fault_sites={"actuator": ("input", 0), "sensor": ("output", 0)},
        usual_faults=("b1", "b2"),
        source="A. K. Sekunda, PhD thesis, DTU 2017, publication P4",
    )


def _build(p: Mapping[str, float]) -> StateSpace:
    A = [[p["a11"], p["a12"]], [p["a21"], p["a22"]]]
    return StateSpace.of(A, [[p["b1"]], [p["b2"]]], [[p["c1"], p["c2"]]], [[0.0]], SAMPLE_TIME)
