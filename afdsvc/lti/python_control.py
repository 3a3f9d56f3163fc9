"""The public interface for systems of python-control.

Each function takes and returns `control.StateSpace` (transfer functions, numbers and arrays are converted) in positive
feedback ``u = K y``. All four use the same choice of coprime factors (`afdsvc.lti.python_control.factorise`), so beta of
`augmented_controller` is the output of `deviation` and the input of `whitening`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from afdsvc.errors import BadInput, IllConditioned
from afdsvc.lti.coprime import Factorisation, controller_factorisation, observer_form, proportional_factorisation
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.lti.transfer_function import from_polynomials, from_roots
from afdsvc.lti.whitening import whitening_filter
from afdsvc.lti.yjbk import deviation_system, interconnection


def factorise(plant: StateSpace, controller: StateSpace) -> Factorisation:
    """Return coprime factors of the plant and the controller that stabilises it (positive feedback ``u = K y``).

    1. a static controller P: ``F = (I - P D)^-1 P C``, so V = I, Vt is static and beta = y - N alpha;
    2. a controller of the plant's order: its observer form when well conditioned, so J_K has the plant's order;
    3. any other: the general form, of order n + n_K, with the cheapest gains keeping half the loop's stability margin.

    Raises `NotStabilising` with the offending pole, `BadInput` when the widths do not fit.
    """
    expected = (plant.inputs, plant.outputs)
    if (controller.outputs, controller.inputs) != expected:
        raise BadInput(
            f"the controller has {controller.outputs} outputs and {controller.inputs} inputs; a plant with "
            f"{plant.inputs} "
            f"inputs and {plant.outputs} outputs needs {expected[0]} and {expected[1]}"
        )
    if not controller.order:
        return proportional_factorisation(plant, controller.D)
    if controller.order == plant.order:
        try:
            return observer_form(plant, controller)
        except IllConditioned:
            pass  # the general form has twice the order and no such condition
    return controller_factorisation(plant, controller)


UNSPECIFIED = 1.0  # stands in for python-control's dt=True: discrete, sample time not said


@dataclass(frozen=True, slots=True, eq=False)
class CoprimeFactors:
    """The eight coprime factors as `control.StateSpace`: ``G = N M^-1 = Mt^-1 Nt``, ``K = U V^-1 = Vt^-1 Ut``.

    ``[Vt -Ut; -Nt Mt] [M U; N V] = I``, all eight stable.
    """

    M: Any
    N: Any
    U: Any
    V: Any
    Mt: Any
    Nt: Any
    Ut: Any
    Vt: Any


def coprime(plant: Any, controller: Any) -> CoprimeFactors:
    """Return the coprime factors of a plant and a controller that stabilises it.

    Raises `NotStabilising` with the offending pole, `BadInput` for anything that is not a proper linear system or does
    not fit.
    """
    G, K, dt = _pair(plant, controller)
    f = factorise(G, K)
    return CoprimeFactors(**{name: to_control(getattr(f, name), dt) for name in CoprimeFactors.__slots__})


def augmented_controller(plant: Any, controller: Any) -> Any:
    """Return J_K: inputs ``[y, alpha]``, outputs ``[u, beta]``; with alpha = 0 it is the controller."""
    G, K, dt = _pair(plant, controller)
    return to_control(interconnection(factorise(G, K)), dt)


def deviation(true_plant: Any, plant: Any, controller: Any) -> Any:
    """Return S, from alpha to beta, of J_K of the nominal ``plant`` on ``true_plant``; zero when they are equal."""
    G, K, dt = _pair(plant, controller)
    true, _, _ = _pair(true_plant, controller, "true plant")
    return to_control(deviation_system(factorise(G, K), _same_time(true, G)), dt)


def whitening(plant: Any, controller: Any, output_cov: ArrayLike, process_cov: ArrayLike | None = None) -> tuple[Any, Array]:
    """Return the filter from beta to the white residual r, and the covariance of r, shape ``(p, p)``.

    ``output_cov (p, p)`` is the covariance of the measurement noise, ``process_cov (n, n)`` of noise on the states.
    """
    G, K, dt = _pair(plant, controller)
    filter_, covariance = whitening_filter(factorise(G, K), output_cov, process_cov)
    return to_control(filter_, dt), covariance


def from_control(system: Any, name: str = "system") -> tuple[StateSpace, Any]:
    """Return a python-control system (or number, array, transfer function) as `StateSpace`, and its dt as given.

    Raises `BadInput` for a system that is not proper, not linear or not a system.
    """
    import control

    if isinstance(system, (int, float, np.ndarray, np.number, list, tuple)):
        return StateSpace.gain(np.atleast_2d(np.asarray(system, dtype=np.float64))), None
    if isinstance(system, control.TransferFunction):
        system = _realise(system, name)
    if not isinstance(system, control.StateSpace):
        raise BadInput(
            f"the {name} is a {type(system).__name__}; expected a control.StateSpace (or transfer function, or gain)"
        )
    dt = system.dt
    return StateSpace.of(system.A, system.B, system.C, system.D, _seconds(dt)), dt


def as_state_space(system: Any) -> StateSpace:
    """Return a system of python-control or scipy.signal (object, or tuple of 2, 3 or 4 parts as there) as `StateSpace`.

    Transfer functions are realised by `from_polynomials`, so that the first state of each output has its unit. Raises `BadInput` for
    anything else.
    """
    if isinstance(system, StateSpace):
        return system
    if getattr(system, "dt", None) is True:
        raise BadInput("the system has its sample time unspecified (dt=True); give dt in seconds")
    if isinstance(system, tuple) and 2 <= len(system) <= 4:
        return _of_parts(system, 0.0)
    if all(hasattr(system, part) for part in "ABCD"):
        return StateSpace.of(system.A, system.B, system.C, system.D, _seconds(system.dt))
    if hasattr(system, "num") and hasattr(system, "den"):
        num, den = ([[p]] if np.ndim(p[0]) == 0 else [[np.asarray(e) for e in row] for row in p] for p in (system.num, system.den))
        return from_polynomials(num, den, _seconds(system.dt))
    if all(hasattr(system, part) for part in ("zeros", "poles", "gain")) and not callable(system.zeros):
        return from_roots(system.zeros, system.poles, float(system.gain), _seconds(system.dt))
    raise BadInput(f"the system is a {type(system).__name__}; expected one of python-control or scipy.signal, or (num, den), (zeros, poles, gain), (A, B, C), (A, B, C, D)")


def is_transfer_function(system: Any) -> bool:
    """Whether `as_state_space` takes a system as numerators and denominators, or as zeros, poles and a gain."""
    if isinstance(system, tuple):
        return len(system) == 2 or (len(system) == 3 and np.ndim(system[2]) == 0)
    return not isinstance(system, StateSpace) and not all(hasattr(system, part) for part in "ABCD")


def _of_parts(parts: tuple[Any, ...], dt: float) -> StateSpace:
    if len(parts) == 2:
        num, den = (np.atleast_1d(np.asarray(p, dtype=np.float64)) for p in parts)
        return from_polynomials([[num]], [[den]], dt)
    if len(parts) == 3 and np.ndim(parts[2]) == 0:
        return from_roots(parts[0], parts[1], float(parts[2]), dt)
    if len(parts) == 4:
        parts = tuple(np.atleast_2d(part) if np.ndim(part) == 0 else part for part in parts)
    if not all(np.ndim(part) == 2 for part in parts):
        raise BadInput(f"the parts of the system have {', '.join(str(np.ndim(part)) for part in parts)} dimensions; expected matrices (A, B, C) or (A, B, C, D), or (zeros, poles, gain)")
    A, B, C, D = parts if len(parts) == 4 else (*parts, np.zeros((len(parts[2]), np.shape(parts[1])[-1])))
    return StateSpace.of(A, B, C, D, dt)


def to_control(system: StateSpace, dt: Any) -> Any:
    """Return a system as `control.StateSpace` with the given dt, states kept as they are."""
    import control

    return control.StateSpace(system.A, system.B, system.C, system.D, dt, remove_useless_states=False)


def _realise(system: Any, name: str) -> Any:
    import control

    worst = max(
        len(np.trim_zeros(n, "f")) - len(np.trim_zeros(d, "f"))
        for ns, ds in zip(system.num, system.den, strict=True)
        for n, d in zip(ns, ds, strict=True)
    )
    if worst > 0:
        raise BadInput(f"the {name} is not proper: a numerator is {worst} degrees above its denominator; add {worst} poles")
    return control.ss(system)


def _seconds(dt: Any) -> float:
    if dt is None or (not isinstance(dt, bool) and dt == 0):
        return 0.0
    return UNSPECIFIED if dt is True else float(dt)


def _pair(plant: Any, controller: Any, name: str = "plant") -> tuple[StateSpace, StateSpace, Any]:
    """Return both systems on one time base, and the dt to give back."""
    G, dt_plant = from_control(plant, name)
    K, dt_controller = from_control(controller, "controller")
    dt = _joint_dt(dt_plant, dt_controller, name)
    seconds = _seconds(dt)
    return StateSpace(G.A, G.B, G.C, G.D, seconds), StateSpace(K.A, K.B, K.C, K.D, seconds), dt


def _joint_dt(a: Any, b: Any, name: str) -> Any:
    """Return the time base two systems share, by python-control's rules: None fits any, True any discrete one."""
    if a is None or b is None:
        return b if a is None else a
    if (a is True and _seconds(b) > 0) or (b is True and _seconds(a) > 0):
        return b if a is True else a
    if _seconds(a) != _seconds(b):
        raise BadInput(f"the {name} has dt {a} and the controller dt {b}; expected one time base")
    return a


def _same_time(true: StateSpace, nominal: StateSpace) -> StateSpace:
    if true.dt != nominal.dt and true.order:
        raise BadInput(f"the true plant has sample time {true.dt} s and the nominal one {nominal.dt} s; expected one")
    return StateSpace(true.A, true.B, true.C, true.D, nominal.dt)
