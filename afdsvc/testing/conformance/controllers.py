"""Controllers: designed for the gas bearing at rest and turning; a plugin for other machines offers ``example`` settings."""

from __future__ import annotations

from typing import Any

import numpy as np

from afdsvc.api.control_plugins import DesignedController
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.lft import star
from afdsvc.lti.statespace import ComplexArray, StateSpace
from afdsvc.plants.gas_bearing import gas_bearing
from afdsvc.testing.conformance.named import settings_check, settings_of


def _designed(thing: Any, rpm: int = 0) -> tuple[StateSpace, DesignedController]:
    plant = gas_bearing(rpm).discrete()
    return plant, thing.design(plant, settings_of(thing))


def stabilises(thing: Any) -> None:
    """The loop with the plant is stable, at rest and turning, with alpha at zero."""
    for rpm in (0, 1100):
        plant, made = _designed(thing, rpm)
        loop = star(_seen(plant), made.interconnection, plant.inputs, plant.outputs)
        worst = float(np.abs(np.linalg.eigvals(loop.A)).max())
        assert worst < 1, f"at {rpm} rpm the loop has a pole of modulus {worst:.6g}"


def factors_are_coprime(thing: Any) -> None:
    """The factors satisfy the Bezout identity to 1e-8."""
    plant, made = _designed(thing)
    f = made.factorisation
    M, U, N, V, Mt, Nt, Ut, Vt = (_response(s) for s in (f.M, f.U, f.N, f.V, f.Mt, f.Nt, f.Ut, f.Vt))
    product = np.block([[Vt, -Ut], [-Nt, Mt]]) @ np.block([[M, U], [N, V]])
    rest = float(np.abs(product - np.eye(plant.inputs + plant.outputs)).max())
    assert rest < 1e-8, f"the Bezout identity holds to {rest:.2g} only"


def has_the_shape_of_jk(thing: Any) -> None:
    """J_K takes [y, alpha] and gives [u, beta], at the plant's sample time."""
    plant, made = _designed(thing)
    jk, ports = made.interconnection, plant.inputs + plant.outputs
    assert (jk.inputs, jk.outputs) == (ports, ports), f"J_K is {jk.outputs} x {jk.inputs}; expected {ports} x {ports}"
    assert jk.dt == plant.dt, f"J_K has sample time {jk.dt}; expected {plant.dt}"


def alpha_does_not_reach_beta(thing: Any) -> None:
    """In the nominal loop nothing of alpha arrives in beta: S = 0."""
    plant, made = _designed(thing)
    loop = star(_seen(plant), made.interconnection, plant.inputs, plant.outputs)
    response, m = _response(loop), plant.inputs
    leak = float(np.abs(response[:, plant.inputs + plant.outputs :, -m:]).max())
    assert leak < 1e-6, f"alpha arrives in beta with gain {leak:.2g} although the plant is as modelled"


def describes_itself(thing: Any) -> None:
    """Says in one line what it is."""
    _, made = _designed(thing)
    assert len(made.description.splitlines()) == 1, "description is empty or longer than a line"


def _response(system: StateSpace) -> ComplexArray:
    """The response at twenty frequencies below Nyquist."""
    return frequency_response(system, np.geomspace(1e-3, 0.9, 20) * np.pi / system.dt)


def _seen(plant: StateSpace) -> StateSpace:
    """The plant with its inputs and outputs seen from outside, to be closed with J_K."""
    m, n = plant.inputs, plant.order
    C = np.vstack([np.zeros((m, n)), plant.C, plant.C])
    D = np.vstack([np.eye(m), plant.D, plant.D])
    return StateSpace(plant.A, plant.B, C, D, plant.dt)


CHECKS = (
    settings_check(lambda thing, settings: thing.design(gas_bearing().discrete(), settings)),
    stabilises, factors_are_coprime, has_the_shape_of_jk, alpha_does_not_reach_beta, describes_itself,
)
