"""Star product, fault directions and S(theta) against formulas written out at single frequencies."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.errors import BadInput, IllConditioned
from afdsvc.lti.coprime import observer_factorisation
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.lft import (
    FaultDirection,
    actuator_gain,
    augment,
    fault_signature,
    sensor_gain,
    signature_interconnection,
    star,
)
from afdsvc.lti.riccati import kalman_predictor_gain, lqr
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.yjbk import deviation_system, interconnection

OMEGA = np.linspace(0.05, 3.1, 20)


def system(seed: int, outputs: int, inputs: int, order: int, dt: float = 1.0, feedthrough: float = 0.3) -> StateSpace:
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((order, order))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    B, C = rng.standard_normal((order, inputs)), rng.standard_normal((outputs, order))
    return StateSpace.of(A, B, C, feedthrough * rng.standard_normal((outputs, inputs)), dt)


def plant() -> StateSpace:
    return system(1, outputs=2, inputs=3, order=4)


def directions(G: StateSpace) -> list[FaultDirection]:
    rng = np.random.default_rng(9)
    parameter = FaultDirection(
        "parameter",
        rng.standard_normal((4, 1)),
        np.array([[0.4], [0.0]]),
        rng.standard_normal((1, 4)),
        rng.standard_normal((1, 3)),
        np.array([[-0.2]]),
    )
    return [actuator_gain(G, "pump", 1), parameter, sensor_gain(G, "gauge", 0), actuator_gain(G, "valve", 2)]


def faulty(G: StateSpace, pump: float, parameter: float, gauge: float, valve: float) -> StateSpace:
    """The plant with all faults, put together by hand: parameter inside, actuators before, sensor behind."""
    p = directions(G)[1]
    through = parameter / (1 - parameter * p.Dzw[0, 0])
    A, B = G.A + through * p.Bw @ p.Cz, G.B + through * p.Bw @ p.Dzu
    C, D = G.C + through * p.Dyw @ p.Cz, G.D + through * p.Dyw @ p.Dzu
    actuators, sensors = np.diag([1.0, 1 + pump, 1 + valve]), np.diag([1 + gauge, 1.0])
    return StateSpace(A, B @ actuators, sensors @ C, sensors @ D @ actuators, G.dt)


def test_star_product_is_redheffers_at_every_frequency() -> None:
    P, Q = system(2, outputs=3, inputs=4, order=3), system(3, outputs=5, inputs=3, order=2)
    joined = frequency_response(star(P, Q, down=2, up=3), OMEGA)
    for k, (p, q) in enumerate(zip(frequency_response(P, OMEGA), frequency_response(Q, OMEGA), strict=True)):
        P11, P12, P21, P22 = p[:1, :1], p[:1, 1:], p[1:, :1], p[1:, 1:]
        Q11, Q12, Q21, Q22 = q[:3, :2], q[:3, 2:], q[3:, :2], q[3:, 2:]
        X, Y = np.linalg.inv(np.eye(3) - Q11 @ P22), np.linalg.inv(np.eye(2) - P22 @ Q11)
        wanted = np.block([[P11 + P12 @ X @ Q11 @ P21, P12 @ X @ Q12], [Q21 @ Y @ P21, Q22 + Q21 @ Y @ P22 @ Q12]])
        assert np.abs(joined[k] - wanted).max() < 1e-11


def test_star_product_refuses_what_does_not_fit_or_is_not_well_posed() -> None:
    with pytest.raises(BadInput, match="do not fit"):
        star(system(1, 2, 2, 1), system(1, 1, 1, 1), down=2, up=1)
    one = StateSpace.gain([[1.0]], 1.0)
    with pytest.raises(IllConditioned, match="not well posed"):
        star(one, one, 1, 1)


@pytest.mark.parametrize("theta", [(-0.5, 0.0, 0.0, 0.0), (0.0, -0.3, 0.0, 0.0), (-1.0, 0.4, -0.6, -0.2)])
def test_augmented_plant_equals_the_faulty_plant_built_by_hand(theta: tuple[float, ...]) -> None:
    G = plant()
    augmented = augment(G, directions(G))
    assert augmented.fault_names == ("pump", "parameter", "gauge", "valve")
    found, wanted = augmented.close(theta), faulty(G, *theta)
    for name in "ABCD":
        assert np.abs(getattr(found, name) - getattr(wanted, name)).max() < 1e-14


def test_severity_zero_is_the_identity_to_the_last_bit() -> None:
    G = plant()
    healthy = augment(G, directions(G)).close({})
    assert all(np.array_equal(getattr(healthy, name), getattr(G, name)) for name in "ABCD")


def test_severities_by_name_and_their_refusals() -> None:
    augmented = augment(plant(), directions(plant()))
    by_name, by_order = augmented.close({"gauge": -0.5}), augmented.close([0, 0, -0.5, 0])
    assert np.array_equal(by_name.C, by_order.C)
    with pytest.raises(BadInput, match="'brake' is not known; the plant has pump, parameter, gauge, valve"):
        augmented.close({"brake": -0.5})
    with pytest.raises(BadInput, match="expected 4 finite numbers"):
        augmented.close([-0.5])
    part = augmented.reordered(["valve", "gauge"])
    wanted = augmented.close({"valve": -0.3, "gauge": -0.1})
    assert np.array_equal(part.close([-0.3, -0.1]).D, wanted.D)


def test_repeated_and_misshapen_directions_are_refused() -> None:
    G = plant()
    with pytest.raises(BadInput, match="two faults have the name pump"):
        augment(G, [actuator_gain(G, "pump", 0), actuator_gain(G, "pump", 1)])
    with pytest.raises(BadInput, match="two faults have the site input 1"):
        augment(G, [actuator_gain(G, "a", 1), actuator_gain(G, "b", 1)])
    with pytest.raises(BadInput, match=r"fault 'pump': Bw has shape \(4, 1\)"):
        augment(system(1, 2, 3, 5), [actuator_gain(G, "pump", 0)])
    with pytest.raises(BadInput, match="output number 2 does not exist"):
        sensor_gain(G, "x", 2)


@pytest.mark.parametrize("theta", [(-0.5, 0.0, 0.0, 0.0), (-0.2, 0.3, -0.4, -0.1)])
def test_signature_is_formula_2_19_and_the_deviation_of_the_faulty_plant(theta: tuple[float, ...]) -> None:
    """Thesis (2.19): S = Mt Gyw th (I - (Gzw + Gzu U Mt Gyw) th)^-1 Gzu M."""
    G = plant()
    F, L = lqr(G, np.eye(4), np.eye(3)), kalman_predictor_gain(G, np.eye(4), np.eye(2))
    f, augmented = observer_factorisation(G, F, L), augment(G, directions(G))
    J = interconnection(f)
    S = frequency_response(fault_signature(augmented, J, theta), OMEGA)
    a = frequency_response(augmented.system, OMEGA)
    Gzw, Gzu, Gyw = a[:, :4, :4], a[:, :4, 4:], a[:, 4:, :4]
    M, U, Mt = (frequency_response(getattr(f, name), OMEGA) for name in ("M", "U", "Mt"))
    th = np.diag(theta)
    wanted = Mt @ Gyw @ th @ np.linalg.inv(np.eye(4) - (Gzw + Gzu @ U @ Mt @ Gyw) @ th) @ Gzu @ M
    assert np.abs(S - wanted).max() < 1e-11
    by_plant = deviation_system(f, faulty(G, *theta))
    assert np.abs(frequency_response(by_plant, OMEGA) - wanted).max() < 1e-11
    assert fault_signature(augmented, J, theta).order == 2 * G.order
    loop = frequency_response(signature_interconnection(augmented, J), OMEGA)
    closed = loop[:, 4:, :4] @ th @ np.linalg.inv(np.eye(4) - loop[:, :4, :4] @ th) @ loop[:, :4, 4:]
    assert np.abs(closed - wanted).max() < 1e-11
    assert np.abs(loop[:, 4:, 4:]).max() < 1e-12  # the healthy loop is silent


def signature_derivative(augmented, J_K: StateSpace, name: str) -> StateSpace:
    """Return ``dS/dtheta_i`` at theta = 0, which is ``Mt Gyw e_i e_i' Gzu M``, as a system from alpha to beta."""
    loop, k = signature_interconnection(augmented, J_K), augmented.channels
    own = list(range(loop.inputs))[augmented.channels_of(name)]
    rest_in, rest_out = list(range(k, loop.inputs)), list(range(k, loop.outputs))
    return loop.select(rest_out, own) @ loop.select(own, rest_in)


@pytest.mark.parametrize("name", ["pump", "parameter", "gauge", "valve"])
def test_derivative_of_the_signature_against_differences(name: str) -> None:
    G = plant()
    f = observer_factorisation(G, lqr(G, np.eye(4), np.eye(3)), kalman_predictor_gain(G, np.eye(4), np.eye(2)))
    augmented, J, h = augment(G, directions(G)), interconnection(f), 1e-5
    up, down = (frequency_response(fault_signature(augmented, J, {name: s}), OMEGA) for s in (h, -h))
    derivative = frequency_response(signature_derivative(augmented, J, name), OMEGA)
    assert np.abs((up - down) / (2 * h) - derivative).max() < 1e-8 * np.abs(derivative).max()
