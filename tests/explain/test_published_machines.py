"""Machines that others published as equations, distinguished from a linear model and recordings alone."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.explain.pipeline import explain
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics import afdsvc_physics

RATE, PERIOD, PERIODS, NOISE = 750.0, 2048, 3, 8e-3
MASS, DAMPING, STIFFNESS, ALPHA, BETA, GAMMA, DELTA = 2.0, 10.0, 5e4, 5e4, 1e3, 0.8, -1.1


@njit
def slope(s, u):  # type: ignore[no-untyped-def]
    x, v, z = s
    dz = ALPHA * v - BETA * (GAMMA * abs(v) * z + DELTA * v * abs(z))
    return np.array([v, (u - DAMPING * v - STIFFNESS * x - z) / MASS, dz])


@njit
def bouc_wen_oscillator(u):  # type: ignore[no-untyped-def]
    """Return the position [m] of the hysteretic benchmark of Noel and Schoukens (2016), Runge-Kutta in twenty steps a sample."""
    s, y, h = np.zeros(3), np.empty(len(u)), 1 / RATE / 20
    for i in range(len(u)):
        y[i] = s[0]
        for _ in range(20):
            a = slope(s, u[i])
            b = slope(s + h / 2 * a, u[i])
            c = slope(s + h / 2 * b, u[i])
            s = s + h / 6 * (a + 2 * b + 2 * c + slope(s + h * c, u[i]))
    return y


def recording(seed: int, rms: float) -> Trace:
    """An odd random-phase multisine from 5 to 150 Hz, as in the benchmark; force in N, position in mm."""
    rng = np.random.default_rng(seed)
    lines = np.arange(1, PERIOD // 2, 2)
    lines = lines[(lines * RATE / PERIOD > 5) & (lines * RATE / PERIOD < 150)]
    spectrum = np.zeros(PERIOD // 2 + 1, complex)
    spectrum[lines] = np.exp(2j * np.pi * rng.random(len(lines)))
    u = np.fft.irfft(spectrum, PERIOD)
    u = np.tile(rms * u / u.std(), PERIODS)
    y = 1e3 * bouc_wen_oscillator(u) + NOISE * rng.standard_normal(len(u))
    return Trace(f"r{seed}", 1 / RATE, (Channel("u_force"), Channel("y_position")), np.column_stack([u, y]))


def linear(stiffness: float, known: float) -> Model:
    A = np.array([[0, 1.0], [-stiffness / MASS, -DAMPING / MASS]])
    plant = StateSpace(A, np.array([[0.0], [1e3 / MASS]]), np.array([[1.0, 0]]), np.zeros((1, 1)))
    states = (Variable("q", "mm"), Variable("v", "mm/s", rate_of="q"))
    sd = {"A": known * np.abs(A) * (np.abs(A) != 1), "B": known * np.abs(plant.B)}
    return Model("oscillator", (Variable("force", "N"),), (Variable("position", "mm"),), states, plant, entry_sd=sd, output_sd=np.array([NOISE]))


@pytest.mark.long
def test_the_hysteretic_benchmark_is_reported_and_fitted_to_the_noise():
    """From the model linearised at rest, known to 30 %: one loop, and on the held-out recording nearly the noise floor."""
    model = linear(STIFFNESS + ALPHA, 0.3)
    answer = explain(model, [recording(1, 50.0), recording(2, 25.0), recording(4, 37.0)], [recording(3, 50.0)], afdsvc_physics(), experiment=False)
    assert (answer.named[0].physics, answer.named[0].site) == ("hysteresis", "state:v")
    assert {n.physics for n in answer.named if n.effect == 1} == {"hysteresis"}
    assert answer.fit[0].before_nrmse > 1
    assert answer.fit[0].after_nrmse < 1.5 * answer.fit[0].noise_floor_nrmse
    loop = answer.point.effects[0].values
    assert -MASS * loop[0] / loop[1] == pytest.approx(ALPHA, rel=0.05)  # the stiffness of the loop at rest
