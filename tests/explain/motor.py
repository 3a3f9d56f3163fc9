"""A motor with dry friction simulated by its own code: event-free implicit Euler steps, nothing shared with the product."""

from __future__ import annotations

import numpy as np

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.lti.statespace import StateSpace

DT = 0.01


def model(damping: float = 2.0) -> Model:
    """Return the motor without friction, speed measured only: ``w' = -d w + 50 u``."""
    plant = StateSpace(np.array([[-damping]]), np.array([[50.0]]), np.array([[1.0]]), np.zeros((1, 1)))
    return Model("motor", (Variable("voltage", "V"),), (Variable("speed", "rpm"),), (Variable("speed", "rpm"),), plant)


def recording(friction: float, seed: int, n: int = 1500, noise: float = 1.0, name: str = "staircase") -> Trace:
    """Return a recording under random steps; ``friction`` is the deceleration [rpm/s] by dry friction, ``noise`` coloured, in rpm."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-6, 6, n // 100 + 1), 100)[:n]
    fine, w, y = 20, 0.0, np.empty(n)
    h = DT / fine
    for k in range(n):
        y[k] = w
        for _ in range(fine):
            free = (w + 50.0 * h * u[k]) / (1 + 2.0 * h)
            w = np.sign(free) * max(abs(free) - friction * h, 0.0)
    colour = np.zeros(n)
    for k in range(1, n):
        colour[k] = 0.9 * colour[k - 1] + np.sqrt(1 - 0.81) * rng.normal()
    channels = (Channel("u_voltage", "V"), Channel("y_speed", "rpm"))
    return Trace(name, DT, channels, np.column_stack([u, y + noise * colour]))
