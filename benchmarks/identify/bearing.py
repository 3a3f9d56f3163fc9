"""The simulated gas bearing in its loop, as the studies use it."""

from __future__ import annotations

import numpy as np

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.lti.coprime import Factorisation, observer_factorisation
from afdsvc.lti.riccati import kalman_predictor_gain, lqr
from afdsvc.lti.simulate import simulate
from afdsvc.lti.stability import is_stable
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.lti.yjbk import closed_loop, deviation_system
from afdsvc.plants.gas_bearing import NOISE_VARIANCE, gas_bearing

PLANT = gas_bearing(0)
TRUE = PLANT.discrete()


def controller(nominal: StateSpace, observer_noise: float = 0.01, effort: float = 1.0) -> Factorisation:
    """P5's observer and state feedback, designed for a nominal model."""
    F = lqr(nominal, 1e-4 * np.diag([0, 0, 1.0, 1, 0, 0]), effort * np.eye(2))
    return observer_factorisation(nominal, F, kalman_predictor_gain(nominal, observer_noise * np.eye(6), np.eye(2)))


def stabilises(fact: Factorisation, true: StateSpace) -> bool:
    return is_stable(deviation_system(fact, true).A, true.dt)


def binary(rng: np.random.Generator, samples: int, amplitude: float, hold: int = 4) -> Array:
    coins = rng.choice([-1.0, 1.0], size=(-(-samples // hold), 2))
    return amplitude * np.repeat(coins, hold, axis=0)[:samples]


def run(fact: Factorisation, true: StateSpace, alpha: Array, rng: np.random.Generator, noise: float = 1.0) -> tuple[InputOutputData, InputOutputData]:
    """Return the recording of (u, y) and that of (alpha, beta); noise variances of P5 times ``noise**2``."""
    count = len(alpha)
    d = noise * np.sqrt(NOISE_VARIANCE) * rng.standard_normal((count, 2))
    out, _ = simulate(closed_loop(fact, true).system, np.hstack([d, np.zeros((count, 4)), alpha]))
    return InputOutputData.of(out[:, 4:6], out[:, 2:4], true.dt), InputOutputData.of(alpha, out[:, 6:], true.dt)
