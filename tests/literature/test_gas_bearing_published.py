"""Figures printed for the active gas bearing, each with its tolerance.

Source: A. K. Sekunda, "Fault Diagnosis and Identification of Electro-Mechanical Systems", PhD thesis, DTU 2017, chapter 3
and publication P5. Where print and mathematics disagree the corrected statement is tested beside the printed one; the
list is in docs/explanation/errata.md.
"""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.errors import NotStabilising
from afdsvc.lti.coprime import Factorisation, observer_factorisation, proportional_factorisation
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.lft import fault_signature
from afdsvc.lti.riccati import kalman_predictor_gain, lqr
from afdsvc.lti.stability import closed_loop_matrix
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.whitening import whitening_filter
from afdsvc.lti.yjbk import interconnection
from afdsvc.plants.gas_bearing import gas_bearing

FAULTS = ("horizontal_actuator", "vertical_actuator", "horizontal_sensor", "vertical_sensor")


def plant(parameters: str = "table_0_1") -> StateSpace:
    return gas_bearing(parameters=parameters).discrete()


def gains(G: StateSpace) -> tuple[np.ndarray, np.ndarray]:
    F = lqr(G, 1e-4 * np.diag([0, 0, 1, 1, 0, 0]), np.eye(2))
    return F, kalman_predictor_gain(G, 0.01 * np.eye(6), np.eye(2))


def largest_pole(G: StateSpace, k: float) -> float:
    return float(np.abs(np.linalg.eigvals(closed_loop_matrix(G, StateSpace.gain(k * np.eye(2), G.dt)))).max())


def modes(G: StateSpace) -> tuple[np.ndarray, np.ndarray]:
    """Natural frequencies [rad/s] and damping ratios of the oscillating poles, by frequency."""
    s = np.log(G.poles()[G.poles().imag > 0]) / G.dt
    order = np.argsort(np.abs(s))
    return np.abs(s)[order], (-s.real / np.abs(s))[order]


# --- P5 (11), (12): the printed LQR gains ------------------------------------------------------------------------------
PRINTED_F = np.array([[-0.08, 2.36], [2.5, 0.10], [0.00, 0.00], [0.00, 0.00], [0.04, -5.16], [-5.70, 0.04]])
PRINTED_L = np.array([[-0.17, 0.00], [0.00, -0.19], [-3.99, 1.94], [2.62, -15.77], [-0.02, 0.00], [0.00, -0.02]])


def test_state_feedback_of_p5_12_to_every_printed_digit() -> None:
    """The columns are printed in the order (vertical, horizontal): swapped they are the LQR gain of table 0.1."""
    F, _ = gains(plant())
    assert np.abs(F.T[:, ::-1] - PRINTED_F).max() < 0.005 + 1e-12


def test_printed_column_order_does_not_stabilise() -> None:
    G = plant()
    as_printed, swapped = PRINTED_F.T, PRINTED_F.T[::-1]
    assert np.abs(np.linalg.eigvals(G.A + G.B @ as_printed)).max() == pytest.approx(1.395, abs=0.002)
    # the velocity gains are rounded away in print, so what remains damps less than the full gain, but stabilises
    assert np.abs(np.linalg.eigvals(G.A + G.B @ swapped)).max() < 1


def test_observer_gain_of_p5_11_within_the_rounding_of_table_0_1() -> None:
    """The velocity entries move by up to 0.3 with the last digit of the table, the others are exact as printed."""
    _, L = gains(plant())
    assert np.abs(L[[0, 1, 4, 5]] - PRINTED_L[[0, 1, 4, 5]]).max() < 0.005 + 1e-12
    assert L[2, 1] == pytest.approx(1.94, abs=0.01)
    assert L[3, 0] == pytest.approx(2.62, abs=0.005)
    assert L[2, 0] == pytest.approx(-3.99, abs=0.3)
    assert L[3, 1] == pytest.approx(-15.77, abs=0.15)


# --- natural frequencies, damping, gain ranges ---------------------------------------------------------------------
@pytest.mark.parametrize(
    ("parameters", "omega", "zeta", "modulus"),
    [
        ("table_0_1", (1337.5, 1388.2), (0.1065, 0.0786), 0.97842),
        ("equations_3_9", (1317.7, 1367.3), (0.1018, 0.0820), 0.97783),
        ("table_0_2", (1337.7, 1389.6), (0.0861, 0.0804), 0.97790),
    ],
)
def test_modes(parameters: str, omega: tuple[float, float], zeta: tuple[float, float], modulus: float) -> None:
    G = plant(parameters)
    found = modes(G)
    assert found[0] == pytest.approx(omega, abs=0.1)
    assert found[1] == pytest.approx(zeta, abs=1e-4)
    assert np.abs(G.poles()).max() == pytest.approx(modulus, abs=1e-5)


def test_proportional_controller_of_p5_10_damps_with_the_opposite_sign() -> None:
    """P5 prints K = -0.2 with u = K y: unstable on table 0.1 (modulus 1.0094); +0.2 raises the damping as described."""
    G = plant()
    with pytest.raises(NotStabilising):
        proportional_factorisation(G, -0.2)
    assert largest_pole(G, -0.2) == pytest.approx(1.0094, abs=1e-4)
    closed = closed_loop_matrix(G, StateSpace.gain(0.2 * np.eye(2), G.dt))
    zeta = modes(StateSpace.of(closed, np.eye(6), np.eye(6), None, G.dt))[1]
    assert np.sort(zeta) == pytest.approx([0.246, 0.287], abs=1e-3)


def test_printed_sign_is_right_for_the_earlier_parameters() -> None:
    G = plant("equations_3_9")
    closed = closed_loop_matrix(G, StateSpace.gain(-0.2 * np.eye(2), G.dt))
    zeta = modes(StateSpace.of(closed, np.eye(6), np.eye(6), None, G.dt))[1]
    assert np.sort(zeta) == pytest.approx([0.286, 0.315], abs=1e-3)


@pytest.mark.parametrize(
    ("parameters", "low", "high"),
    [("table_0_1", -0.132, 0.407), ("equations_3_9", -0.306, 0.103), ("table_0_2", -0.132, 0.389)],
)
def test_stable_range_of_the_proportional_gain(parameters: str, low: float, high: float) -> None:
    G = plant(parameters)
    for inside in (low + 0.001, high - 0.001):
        assert largest_pole(G, inside) < 1
    for outside in (low - 0.001, high + 0.001):
        assert largest_pole(G, outside) > 1


def test_table_0_2_as_printed_is_unstable_and_no_scalar_gain_helps() -> None:
    G = plant("table_0_2_as_printed")
    assert modes(G)[1].min() == pytest.approx(-0.0760, abs=1e-4)
    assert min(largest_pole(G, k) for k in np.linspace(-2, 2, 401)) == pytest.approx(1.0068, abs=2e-4)
    assert plant("table_0_2").is_stable()


def test_lqg_loop_survives_every_single_fault() -> None:
    G, p = plant(), gas_bearing()
    f = observer_factorisation(G, *gains(G))
    assert f.K.is_stable()
    poles = np.linalg.eigvals(closed_loop_matrix(G, f.K))
    assert np.abs(poles).max() == pytest.approx(0.99206, abs=1e-5)
    slow = np.sort(-np.log(np.abs(poles)) / G.dt)[:2]
    assert slow == pytest.approx([40, 42], abs=1)
    faults = p.faults()
    for name in FAULTS:
        for severity in (-0.5, -1.0):
            assert np.abs(np.linalg.eigvals(closed_loop_matrix(faults.close({name: severity}), f.K))).max() < 1


# --- the fault signatures at 62 rad/s, P5 section 5 ------------------------------------------------------------------
GAINS = {  # r <- alpha at theta = -0.5, K = +0.2, fictitious F = the LQR gain, whitened; None is structurally zero
    ("horizontal", "horizontal"): (0.98967, 0.000304, 0.98959, None),
    ("horizontal", "vertical"): (0.02506, 0.00606, None, 0.02670),
    ("vertical", "horizontal"): (0.00594, 0.05031, 0.05218, None),
    ("vertical", "vertical"): (0.00015, 1.00341, None, 1.00340),
}
AXES = ("horizontal", "vertical")


def signatures(G: StateSpace, f: Factorisation, omega: float) -> dict[str, np.ndarray]:
    """Whitened residual per unit of excitation for half of every fault, ``(output, input)``."""
    p, J = gas_bearing(), interconnection(f)
    W, _ = whitening_filter(f, p.output_cov)
    w, faults = frequency_response(W, [omega])[0], p.faults()
    return {name: w @ frequency_response(fault_signature(faults, J, {name: -0.5}), [omega])[0] for name in FAULTS}


def test_gains_of_the_fault_signatures_at_62_rad_s() -> None:
    """P5 figures 0.6 and 0.17: about one on the own axis, 0.0003 for the vertical actuator from the horizontal pair."""
    G = plant()
    found = signatures(G, proportional_factorisation(G, 0.2, gains(G)[0]), 62.0)
    for (source, seen), wanted in GAINS.items():
        for name, value in zip(FAULTS, wanted, strict=True):
            gain = abs(found[name][AXES.index(seen), AXES.index(source)])
            if value is None:
                assert gain < 1e-12, (source, seen, name)
            else:
                assert gain == pytest.approx(value, abs=6e-6), (source, seen, name)


def test_phases_of_the_fault_signatures_at_62_rad_s() -> None:
    """P5 (35) prints 125 for the horizontal actuator seen vertically: reproduced. The rest of (34), (35) is not."""
    G = plant()
    found = signatures(G, proportional_factorisation(G, 0.2, gains(G)[0]), 62.0)
    phase = {name: np.degrees(np.angle(found[name][:, 0])) % 360 for name in FAULTS}
    assert phase["horizontal_actuator"][1] == pytest.approx(125, abs=0.5)
    assert phase["horizontal_actuator"][0] == pytest.approx(125.3, abs=0.05)
    assert phase["vertical_actuator"] == pytest.approx([21.1, 200.6], abs=0.05)
    assert phase["horizontal_sensor"][0] == pytest.approx(125.2, abs=0.05)
    assert phase["vertical_sensor"][1] == pytest.approx(137.7, abs=0.05)


def test_phase_difference_of_an_actuator_fault_is_a_property_of_the_plant() -> None:
    """arg(G_vh / G_hh) = -0.6 deg whatever the controller and the factors, so the printed 32 deg cannot be."""
    G = plant()
    F, L = gains(G)
    g = frequency_response(G, [62.0])[0]
    wanted = np.degrees(np.angle(g[1, 0] / g[0, 0]))
    assert wanted == pytest.approx(-0.6, abs=0.05)
    for f in (proportional_factorisation(G, 0.2, F), proportional_factorisation(G, 0.2), observer_factorisation(G, F, L)):
        r = signatures(G, f, 62.0)["horizontal_actuator"][:, 0]
        assert np.degrees(np.angle(r[1] / r[0])) == pytest.approx(wanted, abs=1e-6)


def test_sensor_faults_are_invisible_in_the_other_axis_only_after_whitening() -> None:
    """The unwhitened beta leaks: 0.046 in beta_v for the horizontal sensor, nothing in r_v."""
    G = plant()
    f = proportional_factorisation(G, 0.2, gains(G)[0])
    beta = frequency_response(fault_signature(gas_bearing().faults(), interconnection(f), {FAULTS[2]: -0.5}), [62.0])[0]
    assert np.abs(beta[1]).max() > 1e-3
    assert np.abs(signatures(G, f, 62.0)[FAULTS[2]][1]).max() < 1e-12


@pytest.mark.parametrize(("omega", "efficiency"), [(1, 0.3411), (62, 0.3425), (125, 0.346), (1340, 0.704), (5000, 0.4995)])
def test_efficiency_of_the_horizontal_actuator_grows_as_published(omega: float, efficiency: float) -> None:
    """P5 (20) and figure 0.6a: |r| over the largest gain from alpha to y, horizontal to horizontal, severity -0.5."""
    G = plant()
    f = proportional_factorisation(G, 0.2, gains(G)[0])
    r = signatures(G, f, omega)["horizontal_actuator"][0, 0]
    N = frequency_response(f.N, [omega])[0]
    assert abs(r) / np.linalg.norm(N[:, 0]) == pytest.approx(efficiency, abs=5e-4)


@pytest.mark.parametrize(("controller", "probability"), [("proportional", 1.4e-2), ("lqg", 7e-10)])
def test_without_whitening_the_designed_false_alarm_probability_means_nothing(controller: str, probability: float) -> None:
    """A 62 rad/s template on beta, its threshold set for 2e-5 from the variance of beta, as if beta were white."""
    from scipy.linalg import solve_discrete_lyapunov
    from scipy.stats import norm

    G, R = plant(), gas_bearing().output_cov
    F, L = gains(G)
    f = proportional_factorisation(G, 0.2, F) if controller == "proportional" else observer_factorisation(G, F, L)
    Mt = f.Mt
    P = solve_discrete_lyapunov(Mt.A, Mt.B @ R @ Mt.B.T)
    variance = (Mt.C @ P @ Mt.C.T + Mt.D @ R @ Mt.D.T)[0, 0]
    m = frequency_response(Mt, [62.0])[0]
    density = (m @ R @ m.conj().T).real[0, 0]
    assert norm.sf(norm.isf(2e-5) * np.sqrt(variance / density)) == pytest.approx(probability, rel=0.05)
