"""The nominal model: the content of a MODEL.toml as a value."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from afdsvc.lti.statespace import Array, StateSpace


@dataclass(frozen=True, slots=True)
class Quantity:
    """A physical parameter: value, unit and relative standard deviation."""

    value: float
    unit: str = ""
    relative_sd: float = 0.05


@dataclass(frozen=True, slots=True)
class Variable:
    """A named input, output or state; ``rate_of`` names the state this one is the time derivative of."""

    name: str
    unit: str = ""
    rate_of: str | None = None


class Dynamics(Protocol):
    """A Python simulator: ``dx/dt = f(t, x, u, p)`` (or ``x+ = f``) and ``y = h(t, x, u, p)``, ``p`` by name."""

    f: Callable[[float, Array, Array, Mapping[str, float]], Array]
    h: Callable[[float, Array, Array, Mapping[str, float]], Array]


class SteppedPlant(Protocol):
    """A simulator that only steps: an FMI unit, a Python function. It may be begun anew as often as one likes.

    Outputs follow the inputs by one step: what `advance` returns is there before the next inputs are known.
    """

    def begin(self) -> Array:
        """Start at rest, forgetting everything before, and return the outputs there, shape ``(p,)``."""
        ...

    def advance(self, u: Array, dt: float) -> Array:
        """Hold the inputs ``u (m,)`` for ``dt`` seconds and return the outputs at the end, ``(p,)``, all finite.

        Raises `BadInput` naming the simulator when it fails.
        """
        ...

    def states(self) -> Array:
        """Return the states one may look at, shape ``(n,)``; ``n`` is 0 where there are none."""
        ...

    def close(self) -> None:
        """Release what is held; harmless when called twice."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """A nominal model: linear matrices or a Python simulator, with names, uncertainty, noise and controller.

    ``plant`` is the linear system (``dt`` 0 when continuous); for a model with ``dynamics`` it is None.
    ``entry_sd`` holds absolute standard deviations of the entries of A, B, C, D (same shapes), as stated in the model file.
    ``output_sd`` is the standard deviation of the output noise, shape ``(p,)``, or None when not stated.
    ``controller`` closes the loop in positive feedback ``u = K (y - ref)``; None when unknown.
    ``origin`` is the path the model came from ("" when made in memory) and ``raw`` the text it was read from.
    ``opened`` opens the simulator behind a model that only steps; ``plant`` is then what was found of it by small pushes.
    """

    name: str
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    states: tuple[Variable, ...]
    plant: StateSpace | None
    dynamics: Dynamics | None = None
    sample_time: float = 0.0
    parameters: Mapping[str, Quantity] = field(default_factory=dict)
    entry_sd: Mapping[str, Array] = field(default_factory=dict)
    output_sd: Array | None = None
    process_cov: Array | None = None
    controller: StateSpace | None = None
    origin: str = ""
    raw: str = ""
    extra: Mapping[str, Any] = field(default_factory=dict)
    opened: Callable[[], SteppedPlant] | None = None
