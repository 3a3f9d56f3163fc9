"""Figures printed for the unstable second-order plant of publication P4.

Source: A. K. Sekunda, "Fault Diagnosis and Identification of Electro-Mechanical Systems", PhD thesis, DTU 2017, P4 section
6. The controller is an observer with LQ gains whose weights are not printed; the weights used here reproduce every printed
figure (others do so too).
"""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.lti.coprime import Factorisation, observer_factorisation
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.lft import fault_signature
from afdsvc.lti.riccati import kalman_predictor_gain, lqr
from afdsvc.lti.whitening import whitening_filter
from afdsvc.lti.yjbk import interconnection
from afdsvc.plants.examples import unstable_second_order

OMEGA, EXCITATION = 125.0, 0.1  # rad/s and amplitude of alpha


def factors() -> Factorisation:
    G = unstable_second_order().discrete()
    return observer_factorisation(G, lqr(G, np.eye(2), 0.1), kalman_predictor_gain(G, np.eye(2), 1.0))


def residual(name: str, omega: float) -> complex:
    """Whitened residual per unit of excitation for a loss of 10 %."""
    p, f = unstable_second_order(), factors()
    W, _ = whitening_filter(f, p.output_cov)
    S = fault_signature(p.faults(), interconnection(f), {name: -0.1})
    return complex(frequency_response(W, [omega])[0, 0, 0] * frequency_response(S, [omega])[0, 0, 0])


def test_poles_and_zero() -> None:
    G = unstable_second_order().discrete()
    assert np.sort(G.poles().real) == pytest.approx([0.043224, 1.156776], abs=1e-6)
    # zero of C (zI - A)^-1 B + 0: eigenvalue of the plant with its output held at zero
    zero = -(np.poly(G.A - G.B @ G.C) - np.poly(G.A))[1:]
    assert np.roots(zero)[0].real == pytest.approx(1.47, abs=0.005)


def test_gains_that_reproduce_the_figures() -> None:
    f = factors()
    assert f.K.C[0] == pytest.approx([-0.42358613653210947, 0.12522734840808059], abs=1e-9)
    assert -f.K.B[:, 0] == pytest.approx([0.2258225755654087, -0.12291511190184622], abs=1e-9)


def test_variance_of_the_whitened_residual() -> None:
    """Measured 0.14 in the paper from one run; exactly 0.11 times the squared unstable pole, 0.147194."""
    _, Xi = whitening_filter(factors(), unstable_second_order().output_cov)
    assert Xi[0, 0] == pytest.approx(0.11 * 1.1567764362830022**2, rel=1e-12)
    assert Xi[0, 0] == pytest.approx(0.147194, abs=1e-6)
    assert Xi[0, 0] == pytest.approx(0.14, abs=0.01)


@pytest.mark.parametrize(("fault", "degrees"), [("b1", 48.4), ("b2", 306.0)])
def test_phase_of_the_residual(fault: str, degrees: float) -> None:
    """Printed 48.4 and 306 degrees at 125 rad/s for 10 % faults; leads, not delays."""
    assert np.degrees(np.angle(residual(fault, OMEGA))) % 360 == pytest.approx(degrees, abs=0.15)


def test_amplitude_and_energy_of_the_residual() -> None:
    """A0 = 0.29 (with the excitation's 0.1 in it), nu = N A0^2 / 2 = 8.3 for N = 200."""
    A0 = EXCITATION * abs(residual("b1", OMEGA))
    assert A0 == pytest.approx(0.29, abs=0.005)
    assert 200 * A0**2 / 2 == pytest.approx(8.3, abs=0.1)


def test_threshold() -> None:
    """gamma = sqrt(sigma^2 nu) Q^-1(1e-4) = 4 with the printed variance 0.14."""
    from afdsvc.detect.thresholds.power import tail_point

    A0 = EXCITATION * abs(residual("b1", OMEGA))
    assert np.sqrt(0.14 * 200 * A0**2 / 2) * tail_point(1e-4) == pytest.approx(4.0, abs=0.05)


def test_excitation_frequency_is_the_upper_bound() -> None:
    """P4 (60): the hardest fault becomes easier with frequency over 10..125 rad/s; without the bound the best is 466."""
    f = factors()

    def efficiency(omega: float) -> float:
        return min(abs(residual(name, omega)) for name in ("b1", "b2")) / float(
            np.abs(frequency_response(f.N, [omega])[0, 0, 0])
        )

    inside = [efficiency(w) for w in np.linspace(10, 125, 24)]
    assert np.argmax(inside) == 23
    assert inside[-1] == pytest.approx(0.0358, abs=1e-4)
    assert efficiency(466.0) == pytest.approx(0.0751, abs=1e-4)
    assert efficiency(466.0) > max(efficiency(400.0), efficiency(540.0))


def test_second_fault_is_not_detectable_as_shown() -> None:
    """Figure 0.14b shows a 10 % loss of b2 detected; amplitude 0.06 in noise of variance 0.147 gives P_D below 2 %."""
    from afdsvc.detect.thresholds.power import detection_probability

    amplitude = EXCITATION * abs(residual("b2", OMEGA))
    assert amplitude == pytest.approx(0.0605, abs=1e-4)
    assert detection_probability(1e-4, amplitude * np.sqrt(200 / 2 / 0.147194)) == pytest.approx(0.016, abs=0.001)


def test_bias_by_the_uncertain_parameter() -> None:
    """One per cent of a11 causes a wave of 0.0425; the bias N A0 A_mu / 2 it can add is 1.2, not the printed 0.1."""
    p, f = unstable_second_order(), factors()
    W, _ = whitening_filter(f, p.output_cov)
    S = fault_signature(p.faults(["a11"]), interconnection(f), [0.01])
    A_mu = EXCITATION * abs((frequency_response(W, [OMEGA]) @ frequency_response(S, [OMEGA]))[0, 0, 0])
    assert A_mu == pytest.approx(0.0425, abs=1e-4)
    A0 = EXCITATION * abs(residual("b1", OMEGA))
    assert 200 * A0 * A_mu / 2 == pytest.approx(1.23, abs=0.01)
