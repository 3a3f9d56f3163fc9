"""Formulas as printed and as they must read, both evaluated: the corrected one holds, the printed one misses by far.

Source: A. K. Sekunda, "Fault Diagnosis and Identification of Electro-Mechanical Systems", PhD thesis, DTU 2017, with its
publications P1 to P6; the list in words is docs/explanation/errata.md.
"""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.lti.coprime import Factorisation, controller_factorisation, observer_factorisation
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.lft import star
from afdsvc.lti.riccati import kalman_predictor_gain, lqr
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.whitening import whitening_filter
from afdsvc.lti.yjbk import (
    closed_loop,
    controller_from,
    deviation_system,
    interconnection,
    plant_from,
    plant_interconnection,
)
from afdsvc.plants.gas_bearing import gas_bearing

inv = np.linalg.inv
I = np.eye(2)


def systems(dt: float, kind: str) -> tuple[Factorisation, StateSpace]:
    """A plant with two inputs and outputs and feedthrough, a controller, and a changed plant."""
    rng = np.random.default_rng(6)
    A = rng.standard_normal((4, 4))
    A = 0.95 * A / np.abs(np.linalg.eigvals(A)).max() if dt else A - (np.linalg.eigvals(A).real.max() + 0.3) * np.eye(4)
    G = StateSpace.of(A, rng.standard_normal((4, 2)), rng.standard_normal((2, 4)), 0.2 * rng.standard_normal((2, 2)), dt)
    f = observer_factorisation(G, lqr(G, np.eye(4), I), kalman_predictor_gain(G, np.eye(4), I))
    if kind == "general":
        f = controller_factorisation(
            G, controller_from(f, StateSpace.of([[0.3 if dt else -2.0]], [[1.0, 0.5]], [[0.2], [0.4]], None, dt))
        )
    return f, StateSpace(G.A, G.B * [1.05, 0.97], G.C, G.D * [1.05, 0.97], dt)


@pytest.fixture(params=[(0.0, "observer"), (0.1, "observer"), (0.0, "general"), (0.1, "general")], ids=str)
def case(request: pytest.FixtureRequest) -> tuple[dict[str, np.ndarray], Factorisation, StateSpace]:
    f, true = systems(*request.param)
    x = [1.3]
    values = {n: frequency_response(getattr(f, n), x)[0] for n in ("M", "N", "U", "V", "Mt", "Nt", "Ut", "Vt", "K")}
    values["G"], values["Gt"] = frequency_response(f.plant, x)[0], frequency_response(true, x)[0]
    values["S"] = frequency_response(deviation_system(f, true), x)[0]
    return values, f, true


def holds(found: np.ndarray, corrected: np.ndarray, printed: np.ndarray, by: float = 1e-3) -> None:
    assert np.abs(found - corrected).max() < 1e-9 * max(1.0, np.abs(found).max())
    assert np.abs(found - printed).max() > by


def test_2_10_order_of_the_left_factors(case) -> None:  # type: ignore[no-untyped-def]
    v, f, _ = case
    Q = StateSpace.gain([[0.2, -0.1], [0.3, 0.1]], f.plant.dt)
    k, q = frequency_response(controller_from(f, Q), [1.3])[0], Q.D
    corrected = inv(v["Vt"] + q @ v["Nt"]) @ (v["Ut"] + q @ v["Mt"])
    holds(k, corrected, inv(v["Ut"] + q @ v["Mt"]) @ (v["Vt"] + q @ v["Nt"]))


def test_2_14_unit_of_the_star_product(case) -> None:  # type: ignore[no-untyped-def]
    _, f, _ = case
    found = frequency_response(star(plant_interconnection(f), interconnection(f), 2, 2), [1.3])[0]
    holds(found, np.block([[0 * I, I], [I, 0 * I]]), np.eye(4))


def test_4_37_deviation_by_v_not_vt(case) -> None:  # type: ignore[no-untyped-def]
    v, _, _ = case
    inner = inv(I - v["Gt"] @ v["K"]) @ (v["Gt"] - v["G"])
    holds(v["S"], inv(v["V"]) @ inner @ v["M"], inv(v["Vt"]) @ inner @ v["M"])
    assert np.abs(v["Mt"] @ (v["Gt"] - v["G"]) @ inv(I - v["K"] @ v["Gt"]) @ inv(v["Vt"]) - v["S"]).max() < 1e-9


def test_p4_9_p5_41_and_p1_9_true_plant_from_the_left(case) -> None:  # type: ignore[no-untyped-def]
    v, f, true = case
    g = frequency_response(plant_from(f, deviation_system(f, true)), [1.3])[0]
    assert np.abs(g - v["Gt"]).max() < 1e-9 * max(1, np.abs(g).max())
    left, right = v["Mt"] + v["S"] @ v["Ut"], v["Nt"] + v["S"] @ v["Vt"]
    holds(g, inv(left) @ right, inv(right) @ left)
    holds(g, inv(left) @ right, inv(left) @ inv(right))


def test_p3_12_p3_31_p1_11_noise_and_references_on_beta(case) -> None:  # type: ignore[no-untyped-def]
    v, f, true = case
    loop = closed_loop(f, true)
    path = {i: frequency_response(loop.path("beta", i), [1.3])[0] for i in ("d", "r1", "r2")}
    holds(path["d"], v["Mt"] + v["S"] @ v["Ut"], v["Mt"] + v["S"] @ v["Vt"])  # P3 (12), (15), (17), P4 (17), P1 (11)
    holds(path["r1"], v["Mt"] + v["S"] @ v["Ut"], v["Nt"] + v["S"] @ v["Ut"])  # P3 (31)
    holds(path["r2"], v["Nt"] + v["S"] @ v["Vt"], v["Mt"] + v["S"] @ v["Vt"])  # P3 (31), P1 (11)
    holds(path["r1"] - v["Mt"], v["S"] @ v["Ut"], path["r1"] - v["Nt"])  # P3 (32) subtracts Nt
    holds(path["r2"] - v["Nt"], v["S"] @ v["Vt"], path["r2"] - v["Mt"])  # P3 (34) subtracts Mt


def test_p2_17_sign_of_the_kernel(case) -> None:  # type: ignore[no-untyped-def]
    v, _, _ = case
    holds(v["Mt"] @ v["G"], v["Nt"], -v["Nt"])


def test_p2_36_noise_on_the_measured_output(case) -> None:  # type: ignore[no-untyped-def]
    """The printed column is right for the noise-free output; the measured one has V (Mt + S Ut)."""
    v, f, true = case
    loop = closed_loop(f, true)
    y, y_m = (frequency_response(loop.path(o, "d"), [1.3])[0] for o in ("y", "y_m"))
    printed = (v["N"] + v["V"] @ v["S"]) @ v["Ut"]
    assert np.abs(y - printed).max() < 1e-9
    holds(y_m, v["V"] @ (v["Mt"] + v["S"] @ v["Ut"]), printed)


def test_5_16_all_pass_not_constant() -> None:
    """For an unstable plant H = W^-1 Mt is neither constant nor diagonal; H R H* = Xi is constant."""
    rng = np.random.default_rng(3)
    A = rng.standard_normal((3, 3))
    G = StateSpace.of(
        1.3 * A / np.abs(np.linalg.eigvals(A)).max(), rng.standard_normal((3, 2)), rng.standard_normal((2, 3)), None, 0.1
    )
    f = observer_factorisation(G, lqr(G, np.eye(3), I), kalman_predictor_gain(G, np.eye(3), I))
    R = 0.11 * I
    W, Xi = whitening_filter(f, R)
    omega = np.linspace(1, 31, 12)
    H = frequency_response(W, omega) @ frequency_response(f.Mt, omega)
    assert np.abs(H @ R @ np.conj(np.swapaxes(H, 1, 2)) - Xi).max() < 1e-9
    assert np.abs(H - H[0]).max() > 0.1
    assert np.abs(H[:, 0, 1]).max() > 0.01


@pytest.mark.parametrize("kind", ["observer", "general"])
def test_5_18_noise_that_comes_with_a_fault_passes_the_inverse_filter(kind: str) -> None:
    """(5.18) prints W S Ut: r = W^-1 beta, so the fault's share of the noise is W^-1 S Ut."""
    f, true = systems(0.1, kind)
    filter_, _ = whitening_filter(f, 0.1 * I)
    w, mt, s, ut, beta = (
        frequency_response(x, [1.3])[0]
        for x in (filter_, f.Mt, deviation_system(f, true), f.Ut, closed_loop(f, true).path("beta", "d"))
    )
    holds(w @ beta - w @ mt, w @ s @ ut, inv(w) @ s @ ut, by=1e-4)


def test_3_6_actuator_first() -> None:
    """G_bearing = G_rb G_act: the body has coupled axes, so the printed order is another system."""
    p = gas_bearing(form="second_order_actuators")
    found = frequency_response(p.continuous(), [1340.0])[0]
    fast = {f"{word}_{axis}": 1e9 for word in ("pole", "second_pole") for axis in "hv"}
    body = frequency_response(p.continuous(**fast), [1340.0])[0]
    value = {n: q.value for n, q in p.parameters.items()}
    s = 1340.0j
    actuator = np.diag([1 / ((1 + s / value[f"pole_{a}"]) * (1 + s / value[f"second_pole_{a}"])) for a in "hv"])
    assert np.abs(found - body @ actuator).max() < 1e-5 * np.abs(found).max()
    assert np.abs(found - actuator @ body).max() > 1e-3 * np.abs(found).max()


def test_p5_19_fault_lft_of_the_gas_bearing() -> None:
    """With actuators before and sensors behind the plant: Gzw = [0 0; G 0], Gzu = [I; G], Gyw = [G I], Gyu = G."""
    faults = gas_bearing().faults()
    a, g = frequency_response(faults.system, [62.0])[0], frequency_response(faults.plant, [62.0])[0]
    O = np.zeros((2, 2))
    wanted = np.block([[O, O, I], [g, O, g], [g, I, g]])
    assert np.abs(a - wanted).max() < 1e-12
