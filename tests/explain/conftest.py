"""A spring on a mass with something left out of its model: small, quick, and integrated apart from the simulation under test."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.lti.statespace import StateSpace

DT, PERIOD = 2e-3, 400
STIFFNESS, DAMPING = 1e4, 20.0

Force = Callable[[float, float], float]
Recorded = Callable[..., Trace]


@pytest.fixture(scope="session")
def spring() -> Model:
    """A mass of 1 kg on a spring, position measured; the input is the force over the stiffness [mm]."""
    plant = StateSpace(np.array([[0, 1.0], [-STIFFNESS, -DAMPING]]), np.array([[0.0], [STIFFNESS]]), np.array([[1.0, 0]]), np.zeros((1, 1)))
    states = (Variable("q", "mm"), Variable("v", "mm/s", rate_of="q"))
    return Model("spring", (Variable("force", "N"),), (Variable("position", "mm"),), states, plant)


@pytest.fixture(scope="session")
def recorded() -> Recorded:
    """Return a recording of the spring under an odd multisine, or of its free decay, with an extra acceleration."""

    def make(seed: int, level: float = 1.0, extra: Force = lambda q, v: 0.0, noise: float = 0.01, periods: int = 4, decay: bool = False) -> Trace:
        rng = np.random.default_rng(seed)
        lines = np.array([k for i, k in enumerate(range(1, 60, 2)) if i % 4 != 3])
        t = np.arange(PERIOD) * DT
        u = np.cos(2 * np.pi * np.outer(t, lines) / (PERIOD * DT) + rng.uniform(0, 2 * np.pi, len(lines))).sum(1)
        u = np.tile(0 * u if decay else level * u / u.std(), periods)
        q, v, h, y = (3 * level if decay else 0.0), 0.0, DT / 5, []

        def slope(q: float, v: float, u: float) -> tuple[float, float]:
            return v, -STIFFNESS * q - DAMPING * v + STIFFNESS * u + extra(q, v)

        for now in u:
            y.append(q)
            for _ in range(5):
                a = slope(q, v, now)
                b = slope(q + h / 2 * a[0], v + h / 2 * a[1], now)
                c = slope(q + h / 2 * b[0], v + h / 2 * b[1], now)
                d = slope(q + h * c[0], v + h * c[1], now)
                q += h / 6 * (a[0] + 2 * b[0] + 2 * c[0] + d[0])
                v += h / 6 * (a[1] + 2 * b[1] + 2 * c[1] + d[1])
        measured = np.array(y) + noise * rng.standard_normal(len(u))
        if decay:
            return Trace(f"r{seed}", DT, (Channel("y_position"),), measured[:, None])
        return Trace(f"r{seed}", DT, (Channel("u_force"), Channel("y_position")), np.column_stack([u, measured]))

    return make
