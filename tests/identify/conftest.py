"""Systems and recordings that several tests of identification share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.lti.coprime import Factorisation, observer_factorisation
from afdsvc.lti.riccati import kalman_predictor_gain, lqr
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.lti.yjbk import closed_loop
from afdsvc.plants.gas_bearing import gas_bearing


@pytest.fixture(scope="session")
def bearing() -> StateSpace:
    """The gas bearing of P5 table 0.1 at 5 kHz."""
    return gas_bearing(0).discrete()


@pytest.fixture(scope="session")
def observer_loop() -> Callable[[StateSpace], Factorisation]:
    """P5's observer-based controller designed for a plant of the bearing's form."""

    def design(plant: StateSpace) -> Factorisation:
        F = lqr(plant, 1e-4 * np.diag([0, 0, 1.0, 1, 0, 0]), np.eye(2))
        return observer_factorisation(plant, F, kalman_predictor_gain(plant, 0.01 * np.eye(6), np.eye(2)))

    return design


@pytest.fixture(scope="session")
def binary() -> Callable[[np.random.Generator, int, int, float], Array]:
    """Random binary excitation, flipped by a coin every fourth sample."""

    def make(rng: np.random.Generator, samples: int, inputs: int = 2, amplitude: float = 1.0) -> Array:
        coins = rng.integers(0, 2, size=(-(-samples // 4), inputs)) * 2.0 - 1.0
        return amplitude * np.repeat(coins, 4, axis=0)[:samples]

    return make


@pytest.fixture(scope="session")
def run_loop() -> Callable[..., tuple[InputOutputData, Array, Array]]:
    """Run a loop with excitation alpha (and references r1, r2) and output disturbance d: plant recording, alpha, beta."""

    def run(
        fact: Factorisation, true: StateSpace, alpha: Array, d: Array, r1: Array | None = None, r2: Array | None = None
    ) -> tuple[InputOutputData, Array, Array]:
        p, m = true.outputs, true.inputs
        zero_p, zero_m = np.zeros((len(alpha), p)), np.zeros((len(alpha), m))
        inputs = np.hstack([d, zero_p if r1 is None else r1, zero_m if r2 is None else r2, alpha])
        out, _ = simulate(closed_loop(fact, true).system, inputs)
        y_m, u, beta = out[:, p : 2 * p], out[:, 2 * p : 2 * p + m], out[:, 2 * p + m :]
        return InputOutputData.of(u, y_m, true.dt), alpha, beta

    return run
