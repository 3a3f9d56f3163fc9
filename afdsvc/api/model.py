"""The nominal model: the content of a MODEL.toml as a value."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from afdsvc.errors import BadInput
from afdsvc.lti.python_control import as_state_space, is_transfer_function
from afdsvc.lti.statespace import Array, StateSpace

DEFAULT_RELATIVE_SD = 0.05  # of parameters and entries whose owner states none


@dataclass(frozen=True, slots=True)
class Quantity:
    """A physical parameter: value, unit and relative standard deviation."""

    value: float
    unit: str = ""
    relative_sd: float = DEFAULT_RELATIVE_SD


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

    `load` reads one from a MODEL.toml, `Model.from_system` takes one from a linear system.

    Parameters
    ----------
    name : str
        Its name.
    inputs, outputs, states : tuple of Variable
        Names and units.
    plant : StateSpace or None
        The linear system (``dt`` 0 when continuous); None for a model with ``dynamics``.
    dynamics : Dynamics, optional
        The Python simulator.
    sample_time : float
        Of simulator and controller, in seconds; 0 when continuous.
    parameters : dict of str to Quantity
        Physical parameters.
    entry_sd : dict of str to array
        Standard deviations of the entries of A, B, C, D, in the units of the entries, same shapes.
    output_sd : array (p,), optional
        Standard deviation of the noise of each output.
    process_cov : array (n, n), optional
        Covariance of the noise that drives the states.
    controller : StateSpace, optional
        Closes the loop in positive feedback ``u = K (y - ref)``.
    origin, raw : str
        The path the model came from ("" when made in memory), and the text it was read from.
    extra : dict
        Further content of the file.
    opened : callable, optional
        Opens the simulator behind a model that only steps; ``plant`` is then what was found of it by small pushes.
    transfer : bool
        Whether it was stated as a transfer function: ``plant`` is then as `from_polynomials` makes it, and results are shown as one.
    sd_stated : bool
        False where ``entry_sd`` is the default share of the entries: detection takes such a model as certain.

    Examples
    --------
    >>> import afdsvc
    >>> motor = afdsvc.Model.from_system(([12.0], [0.08, 1]), {"voltage": "V"}, {"speed": "rad/s"})
    >>> motor.outputs[0].name, motor.plant.A.tolist(), motor.controller
    ('speed', [[-12.5]], None)
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
    transfer: bool = False
    sd_stated: bool = False

    def __repr__(self) -> str:
        ins, outs = (", ".join(f"{v.name} [{v.unit}]" if v.unit else v.name for v in role) or "none" for role in (self.inputs, self.outputs))
        kind = f"{'linear' if self.dynamics is None and self.opened is None else 'simulator'} of order {len(self.states)}"
        return f"<Model '{self.name}': inputs {ins}; outputs {outs}; {kind}, {f'every {self.sample_time:g} s' if self.sample_time else 'continuous'}>"

    @classmethod
    def from_system(
        cls, system: Any, inputs: Names = (), outputs: Names = (), states: Names = (), *,
        name: str = "model", relative_sd: float | None = None, output_sd: Sequence[float] | None = None, controller: Any = None,
    ) -> Model:  # fmt: skip
        """Return a model of a linear system of python-control or scipy.signal.

        Parameters
        ----------
        system : control.StateSpace, control.TransferFunction, scipy.signal.lti, tuple
            The plant; a tuple is ``(num, den)``, ``(zeros, poles, gain)``, ``(A, B, C)`` or ``(A, B, C, D)`` in continuous time.
        inputs, outputs, states : str, list of str, or dict of str to str
            Names, or names with their units. Without names they are ``u1``, ``y1``; states that are an output as it stands, or
            the rate of one, are known as that.
        relative_sd : float
            How well entries are known that are neither 0 nor +-1, as a share of them; not given: 0.05 for fits, and detection takes the
            model as certain.
        output_sd : sequence of float, optional
            Standard deviation of the noise of each output, in its unit.
        controller : same kinds as `system`, optional
            The controller that ran, in positive feedback ``u = K (y - ref)``.

        Returns
        -------
        Model

        Raises
        ------
        BadInput
            For anything that is not a proper linear system, and for names that are too many or too few.

        Examples
        --------
        >>> import afdsvc, control
        >>> motor = afdsvc.Model.from_system(control.tf(12.0, [0.08, 1]), {"voltage": "V"}, {"speed": "rad/s"})
        >>> motor.plant.A.tolist(), motor.states[0]
        ([[-12.5]], Variable(name='speed', unit='rad/s', rate_of=None))
        """
        plant, transfer = as_state_space(system), is_transfer_function(system)
        if not all(np.isfinite(part).all() for part in (plant.A, plant.B, plant.C, plant.D)):
            raise BadInput("the system holds nan or inf; expected finite numbers")
        plant = plant if states else _scaled_as_outputs(plant)
        ins, outs = (_variables(n, count, role) for n, count, role in ((inputs, plant.inputs, "u"), (outputs, plant.outputs, "y")))
        named = _variables(states, plant.order, "x") if states else default_states(plant, outs)
        share = DEFAULT_RELATIVE_SD if relative_sd is None else relative_sd
        sd = {k: np.where(np.isin(getattr(plant, k), (0.0, 1.0, -1.0)), 0.0, share * np.abs(getattr(plant, k))) for k in "ABCD"}
        noise = None if output_sd is None else np.asarray(output_sd, dtype=np.float64)
        K = None if controller is None else as_state_space(controller)
        return cls(name, ins, outs, named, plant, sample_time=plant.dt, entry_sd=sd, output_sd=noise, controller=K, transfer=transfer, sd_stated=relative_sd is not None)


def _scaled_as_outputs(plant: StateSpace) -> StateSpace:
    """Return the plant with every state that alone makes an output scaled to be that output."""
    scale = np.ones(plant.order)
    for row in plant.C:
        if np.count_nonzero(row) == 1:
            scale[np.flatnonzero(row)[0]] = row[np.flatnonzero(row)[0]]
    return StateSpace(plant.A * scale[:, None] / scale, plant.B * scale[:, None], plant.C / scale, plant.D, plant.dt)


Names = str | Sequence[str] | Mapping[str, str]


def _variables(names: Names, count: int, role: str) -> tuple[Variable, ...]:
    """Return variables of some names with their units; raises `BadInput` where there are not as many as the system has."""
    names = [names] if isinstance(names, str) else names
    units = dict(names) if isinstance(names, Mapping) else dict.fromkeys(names or [f"{role}{k + 1}" for k in range(count)], "")
    if len(units) != count:
        what = {"u": "inputs", "y": "outputs", "x": "states"}[role]
        raise BadInput(f"{what} {', '.join(units)}: {len(units)} names; expected {count}, as many as the system has")
    return tuple(Variable(name, unit) for name, unit in units.items())


def default_states(plant: StateSpace, outputs: Sequence[Variable]) -> tuple[Variable, ...]:
    """Return the states of a model that names none: ``x1``, ``x2``, ... where nothing more is known of them.

    A state that is an output as it stands has its name and unit; in continuous time the state that is its rate, by the rows of A and B,
    is known as that. So laws of force find where to act.
    """
    found = [Variable(f"x{i + 1}") for i in range(plant.order)]
    for v, row, through in zip(outputs, plant.C, plant.D, strict=True):
        if np.count_nonzero(row) == 1 and row.max() == 1 and not through.any():
            found[int(np.argmax(row))] = v
    for i, row in enumerate(plant.A if not plant.discrete else ()):
        rate = int(np.argmax(row))
        if np.count_nonzero(row) == 1 and row[rate] == 1 and not plant.B[i].any() and rate > i and found[rate].name == f"x{rate + 1}":
            unit = found[i].unit
            found[rate] = Variable(f"{found[i].name}_rate", f"{unit}/s" if unit.replace("°", "").isalpha() else "", found[i].name)
    unique = len({v.name for v in found}) == len(found)
    return tuple(found) if unique else tuple(Variable(f"x{i + 1}") for i in range(plant.order))

