"""The discrete, unstable second-order plant of publication P4, with faults on its two input gains.

Source: A. K. Sekunda, "Fault Diagnosis and Identification of Electro-Mechanical Systems", PhD thesis, Technical
University of Denmark, 2017, publication P4 eqs. 53-59 (sample time 1 ms, output noise variance 0.11, pole at 1.1568).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from afdsvc.api.model import Quantity, Variable
from afdsvc.api.plant import PhysicalPlant
from afdsvc.lti.statespace import StateSpace

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
