"""Physical structure: free parameters, their bounds, and the matrices built from them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from afdsvc.api.dynamics import array_function
from afdsvc.api.model import Model
from afdsvc.api.plant import PhysicalPlant
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array, StateSpace

_MATRICES = ("A", "B", "C", "D")


@dataclass(frozen=True, slots=True)
class FreeParameter:
    """A number to be estimated: nominal value, unit, standard deviation of what is believed, and hard bounds."""

    name: str
    value: float
    unit: str = ""
    sd: float = 0.0
    lower: float = float("-inf")
    upper: float = float("inf")

    @property
    def scale(self) -> float:
        """A typical size of a change: the prior's standard deviation, else a twentieth of the value, else 1."""
        return self.sd or abs(self.value) / 20 or 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Structure:
    """Parameters and the function from their values (in order) to a system, continuous or discrete.

    ``process_inputs (n, q)`` are the directions in which process noise enters the *sampled* state equation (None: there
    is none), ``process_names`` their names.
    """

    parameters: tuple[FreeParameter, ...]
    build: Callable[[Array], StateSpace]
    process_inputs: Array | None = None
    process_names: tuple[str, ...] = ()

    @property
    def values(self) -> Array:
        """Nominal values, shape ``(q,)``."""
        return np.asarray([p.value for p in self.parameters])

    @property
    def scales(self) -> Array:
        """Typical changes, shape ``(q,)``."""
        return np.asarray([p.scale for p in self.parameters])


def physical_structure(
    plant: PhysicalPlant, free: Sequence[str] | None = None, process_states: Sequence[str] = ()
) -> Structure:
    """Return the structure of a physical plant with the parameters named in ``free`` to be estimated (all when None).

    ``process_states`` names the states that process noise enters, each with its own intensity. Raises `BadInput` for
    unknown names.
    """
    values = plant.values()
    names = list(values) if free is None else list(free)
    for name in names:
        if name not in values:
            raise BadInput(f"plant '{plant.name}' has no parameter '{name}'; it has {', '.join(values)}")
    parameters = tuple(_quantity(name, plant.parameters[name]) for name in names)

    def build(theta: Array) -> StateSpace:
        return plant.build({**values, **dict(zip(names, map(float, theta), strict=True))})

    return Structure(parameters, build, *_process(process_states, [s.name for s in plant.states]))


def model_structure(model: Model, process_states: Sequence[str] = ()) -> Structure:
    """Return the structure of a MODEL: its physical parameters when a Python simulator uses them, else matrix entries.

    Entries move within their stated standard deviations (entries without one stay). A simulator is linearised around
    rest. Raises `BadInput` when nothing may move.
    """
    process = _process(process_states, [s.name for s in model.states])
    if model.dynamics is not None:
        return Structure(*_dynamics(model), *process)
    if model.plant is None:
        raise BadInput(f"model '{model.name}' has neither matrices nor a simulator; nothing can be fitted")
    places = [
        (k, i, j) for k in _MATRICES for i, j in np.argwhere(np.asarray(model.entry_sd.get(k, np.zeros((0, 0)))) > 0)
    ]
    if not places:
        raise BadInput(f"model '{model.name}' leaves no entry uncertain; give [uncertainty] or use method 'hansen'")
    nominal = model.plant
    parameters = tuple(
        FreeParameter(f"{k}[{i + 1},{j + 1}]", float(getattr(nominal, k)[i, j]), "", float(model.entry_sd[k][i, j]))
        for k, i, j in places
    )

    def build(theta: Array) -> StateSpace:
        changed = {k: getattr(nominal, k).copy() for k in _MATRICES}
        for (k, i, j), value in zip(places, theta, strict=True):
            changed[k][i, j] = value
        return StateSpace(changed["A"], changed["B"], changed["C"], changed["D"], nominal.dt)

    return Structure(parameters, build, *process)


def _quantity(name: str, quantity: object) -> FreeParameter:
    value, unit, relative = (getattr(quantity, k) for k in ("value", "unit", "relative_sd"))
    return FreeParameter(name, float(value), str(unit), abs(float(value)) * float(relative))


def _dynamics(model: Model) -> tuple[tuple[FreeParameter, ...], Callable[[Array], StateSpace]]:
    if not model.parameters:
        raise BadInput(f"model '{model.name}' names no [parameters]; a simulator without them cannot be fitted")
    n, m = len(model.states), len(model.inputs)
    f, h = array_function(model, "f", n), array_function(model, "h", len(model.outputs))

    def build(theta: Array) -> StateSpace:
        A, B = _slopes(lambda x, u: f(0.0, x, u, theta), n, m)
        C, D = _slopes(lambda x, u: h(0.0, x, u, theta), n, m)
        return StateSpace(A, B, C, D, model.sample_time)

    parameters = tuple(_quantity(name, quantity) for name, quantity in model.parameters.items())
    _require_slopes(model, build(np.array([p.value for p in parameters])))
    return parameters, build


def _require_slopes(model: Model, plant: StateSpace) -> None:
    """Raise `BadInput` where a simulator has no finite slope at rest."""
    for which, slopes in (("f", np.hstack([plant.A, plant.B])), ("h", np.hstack([plant.C, plant.D]))):
        if not np.isfinite(slopes).all():
            raise BadInput(
                f"model '{model.name}': {which}(t, x, u, p) has no finite slope where states and inputs are zero, and it is linearised there; "
                "expected states and inputs stated as differences from an operating point, or code that can be evaluated at zero"
            )


def _slopes(function: Callable[[Array, Array], Array], n: int, m: int, step: float = 1e-6) -> tuple[Array, Array]:
    """Return the derivatives with respect to state and input at rest, by central differences."""

    def column(k: int) -> Array:
        z = np.zeros(n + m)
        z[k] = step
        ahead, behind = (function(s * z[:n], s * z[n:]) for s in (1.0, -1.0))
        return (ahead - behind) / (2 * step)

    with np.errstate(all="ignore"):
        columns = np.stack([column(k) for k in range(n + m)], axis=1)
    return columns[:, :n], columns[:, n:]


def _process(states: Sequence[str], known: Sequence[str]) -> tuple[Array | None, tuple[str, ...]]:
    if not states:
        return None, ()
    for name in states:
        if name not in known:
            raise BadInput(f"process noise on state '{name}': the plant has {', '.join(known)}")
    return np.eye(len(known))[:, [known.index(name) for name in states]], tuple(states)
