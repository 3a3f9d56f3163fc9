"""A number of the model that changes during the recordings is named, with the rate at which it does."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.api.model import Model, Quantity, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.explain.pipeline import explain
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics import BUILT_IN

DT, N, LOSS = 2.0, 900, 0.02
SOME = ("parameter_drift", "sensor_drift", "constant_load", "slow_mode")


class Plate:
    """A heated plate: degrees above the air around it, and the power that is led in."""

    @staticmethod
    def f(t, x, u, p):
        return [u[0] / p["capacity"] - p["loss"] * x[0]]

    @staticmethod
    def h(t, x, u, p):
        return [x[0]]


def fouling(seed: int, rate: float) -> Trace:
    """A plate that loses less heat as it fouls, exactly for a held power."""
    rng = np.random.default_rng(seed)
    u, x, seen = np.repeat(rng.uniform(0, 100, N // 30), 30), 30.0, []
    for k, power in enumerate(u):
        seen.append(x)
        loss = LOSS * np.exp(rate * k * DT)
        x = power / 50 / loss + (x - power / 50 / loss) * np.exp(-loss * DT)
    y = np.array(seen) + 0.2 * rng.standard_normal(N)
    return Trace(f"r{seed}", DT, (Channel("u_power", "W"), Channel("y_temperature", "K")), np.column_stack([u, y]))


@pytest.mark.parametrize("kind", ["code", "matrices"])
def test_a_plate_that_fouls_loses_less_with_time(kind):
    words = (Variable("power", "W"),), (Variable("temperature", "K"),), (Variable("temperature", "K"),)
    numbers = {"capacity": Quantity(51.0, "J/K", 0.03), "loss": Quantity(0.0205, "1/s", 0.05)}
    model = Model("plate", *words, None, Plate, 0.0, numbers) if kind == "code" else Model("plate", *words, StateSpace.of([[-0.0205]], [[1 / 51]], [[1]]))
    *given, held = (fouling(seed, -4e-4) for seed in (1, 2, 3))
    found = explain(model, given, [held], [p() for p in BUILT_IN if p.name in SOME], experiment=False)
    first = found.named[0]
    assert (first.physics, first.site) == ("parameter_drift", "parameter:loss" if kind == "code" else "state:temperature")
    assert first.weight >= 0.8
    assert first.parameters["rate"].value == pytest.approx(-4e-4, rel=0.1)
    assert found.fit[0].after_nrmse < 0.2 * found.fit[0].before_nrmse
