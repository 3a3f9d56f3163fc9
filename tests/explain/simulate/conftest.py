"""Small machines and recordings that the simulation is tested on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from afdsvc.api.model import Model, Quantity, Variable
from afdsvc.api.physics import Coefficient, Hypothesis, Signal
from afdsvc.dataset.experiment import Run
from afdsvc.explain.simulate.effects import PlacedEffect
from afdsvc.lti.statespace import Array, StateSpace


@pytest.fixture
def recording() -> Callable[..., Run]:
    def make(U: Array, outputs: int = 1, dt: float = 0.01, Y: Array | None = None, W: Array | None = None) -> Run:
        y = np.zeros((len(U), outputs)) if Y is None else Y
        return Run("made", dt, 0.0, np.ascontiguousarray(U), y, np.zeros((len(U), 0)), np.zeros_like(y), (), W)

    return make


@pytest.fixture
def model() -> Callable[..., Model]:
    """Make a model of matrices or of Python code; states named q, v, ... with v the rate of q when there are two."""

    def make(
        plant: StateSpace | None = None, code: Any = None, sizes: tuple[int, int, int] = (2, 1, 1), sample_time: float = 0.0,
        parameters: dict[str, float] | None = None, **rest: Any,
    ) -> Model:
        n, m, p = (plant.order, plant.inputs, plant.outputs) if plant is not None else sizes
        states = (Variable("q"), Variable("v", rate_of="q")) if n == 2 else tuple(Variable(f"x{k}") for k in range(n))
        return Model(
            "test", tuple(Variable(f"u{k}") for k in range(m)), tuple(Variable(f"y{k}") for k in range(p)), states, plant, code,
            sample_time, {k: Quantity(v, relative_sd=0.1) for k, v in (parameters or {}).items()}, **rest,
        )

    return make


@pytest.fixture
def effect() -> Callable[..., PlacedEffect]:
    """Make an effect of a law at a stage; signals as kind, number and, where they are to come, samples ahead."""

    def make(
        law: Any, stage: str, reads: Sequence[tuple[Any, ...]], writes: Sequence[tuple[str, int]], values: Sequence[float], family: str = "",
        memory: int = 0, substeps: int = 1,
    ) -> PlacedEffect:
        def signals(pairs: Sequence[tuple[Any, ...]]) -> tuple[Signal, ...]:
            return tuple(Signal(*pair) for pair in pairs)

        parameters = tuple(Coefficient(f"p{k}", "", -1e9, 1e9, 1.0) for k in range(len(values)))
        hypothesis = Hypothesis(
            "law", "machine", family, stage, law, signals(reads), signals(writes), parameters, ((0.0,) * len(values),), memory, substeps  # type: ignore[arg-type]
        )
        return PlacedEffect(hypothesis, np.array(values, dtype=float))

    return make


@pytest.fixture
def excitation() -> Array:
    """A held input of several frequencies, 600 samples every 0.01 s, shape ``(600, 1)``."""
    t = 0.01 * np.arange(600)
    return (np.sin(3 * t) + 0.7 * np.sin(7.3 * t + 1) + 0.3 * np.sign(np.sin(1.1 * t)))[:, None]
