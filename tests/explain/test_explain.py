"""The whole way, on a spring that is small and quick: consistent, named, and the document people read."""

from __future__ import annotations

import json
from collections.abc import Callable

import numpy as np
import pytest

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.errors import BadInput
from afdsvc.explain.explain import explain
from afdsvc.explain.explanation import Explanation
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics import afdsvc_physics

DT, PERIOD, PERIODS = 1e-3, 1000, 4
STIFFNESS, DAMPING, GAIN = 4e4, 30.0, 4e4


def spring() -> Model:
    plant = StateSpace(np.array([[0, 1.0], [-STIFFNESS, -DAMPING]]), np.array([[0.0], [GAIN]]), np.array([[1.0, 0]]), np.zeros((1, 1)))
    states = (Variable("q", "mm"), Variable("v", "mm/s", rate_of="q"))
    return Model("spring", (Variable("force", "N"),), (Variable("position", "mm"),), states, plant)


def multisine(rng: np.random.Generator, level: float) -> np.ndarray:
    """Odd lines up to 100 Hz, one in four left out, with random phases."""
    lines = np.array([k for i, k in enumerate(range(1, 100, 2)) if i % 4 != 3])
    t = np.arange(PERIOD) * DT
    u = np.cos(2 * np.pi * np.outer(t, lines) / (PERIOD * DT) + rng.uniform(0, 2 * np.pi, len(lines))).sum(1)
    return np.tile(level * u / u.std(), PERIODS)


def recorded(
    level: float, seed: int, extra: Callable[[float, float], float] = lambda q, v: 0.0, noise: float = 0.01, off: float = 1.02
) -> Trace:
    """Classical Runge-Kutta, five steps a sample, of a spring 2 % stiffer than stated, with an extra acceleration."""
    rng = np.random.default_rng(seed)
    u, y, q, v, h = multisine(rng, level), [], 0.0, 0.0, DT / 5

    def f(q: float, v: float, u: float) -> tuple[float, float]:
        return v, -off * STIFFNESS * q - DAMPING * v + GAIN * u + extra(q, v)

    for k in range(len(u)):
        y.append(q)
        for _ in range(5):
            a = f(q, v, u[k])
            b = f(q + h / 2 * a[0], v + h / 2 * a[1], u[k])
            c = f(q + h / 2 * b[0], v + h / 2 * b[1], u[k])
            d = f(q + h * c[0], v + h * c[1], u[k])
            q += h / 6 * (a[0] + 2 * b[0] + 2 * c[0] + d[0])
            v += h / 6 * (a[1] + 2 * b[1] + 2 * c[1] + d[1])
    values = np.column_stack([u, np.array(y) + noise * rng.standard_normal(len(u))])
    return Trace(f"r{seed}", DT, (Channel("u_force"), Channel("y_position")), values)


def cubic(q: float, v: float) -> float:
    return -1000.0 * q**3 * (1 + 1e-4 * q**2)


def four(**how: object) -> list[Trace]:
    return [recorded(level, seed, **how) for seed, level in enumerate((1.0, 0.5, 0.75, 0.8))]  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def answer() -> Explanation:
    """What is said about a concealed cubic spring."""
    *recordings, held = four(extra=cubic)
    return explain(spring(), recordings, [held], afdsvc_physics())


def test_a_concealed_cubic_spring_is_named_modelled_and_shown(answer):
    assert answer.verdict == "omitted_physics"
    first = answer.named[0]
    assert (first.physics, first.site) == ("cubic_stiffness", "state:v")
    told = first.parameters["stiffness"]
    assert told.sd is not None
    assert abs(told.value - 1000 / GAIN) < 4 * told.sd + 0.1 * 1000 / GAIN
    (fit,) = answer.fit
    assert fit.noise_floor_nrmse is not None
    assert fit.before_nrmse > 2 * fit.noise_floor_nrmse
    assert fit.after_nrmse < 1.02 * fit.noise_floor_nrmse
    assert answer.whiteness_p[0] < 1e-6 < 1e-3 < answer.whiteness_p[1]


def test_a_stiffness_inside_its_stated_uncertainty_is_consistent():
    *recordings, held = four()
    answer = explain(spring(), recordings, [held], afdsvc_physics())
    assert answer.verdict == "consistent"
    assert not answer.named


def test_the_document_is_the_one_people_were_promised(answer):
    table = answer.json("improved.toml", "report.html")
    again = json.loads(json.dumps(table, allow_nan=False))
    assert {"verdict", "located", "named", "rejected", "fit", "model", "report"} <= set(again)
    assert set(again["fit"]) == {"per_output", "heldout", "whiteness_p"}
    assert set(again["fit"]["per_output"]["position"]) == {"before", "after", "noise_floor_nrmse"}
    assert again["fit"]["per_output"]["position"]["after"]["r2"] > again["fit"]["per_output"]["position"]["before"]["r2"]
    assert again["fit"]["heldout"] == ["r3"]
    assert {"physics", "site", "weight", "parameters", "sentence"} <= set(again["named"][0])


def test_a_column_of_the_model_that_is_missing_is_named():
    trace = recorded(1.0, 0)
    cut = Trace("cut", DT, trace.channels[:1], trace.values[:, :1])
    with pytest.raises(BadInput, match="y_position"):
        explain(spring(), [cut], [], afdsvc_physics())
