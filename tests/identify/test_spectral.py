"""Direct spectral identification in closed loop tends to the controller's inverse; the indirect one to the plant."""

import numpy as np
import pytest

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.errors import BadInput
from afdsvc.identify.numerics.impulse_fit import approach
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.python_control import factorise
from afdsvc.lti.statespace import StateSpace
from benchmarks.identify.spectral import direct_spectral, indirect_spectral

GAIN = 0.2 * np.eye(2)


@pytest.fixture(scope="module")
def spectra(bearing, run_loop, binary):
    fact = factorise(bearing, StateSpace.gain(GAIN, bearing.dt))

    def make(amplitude, noise, samples=60_000, segment=500):
        rng = np.random.default_rng(1)
        record, alpha, _ = run_loop(
            fact, bearing, amplitude * binary(rng, samples), noise * rng.standard_normal((samples, 2))
        )
        omega, direct = direct_spectral(record, segment)
        _, indirect = indirect_spectral(record, alpha, segment)
        band = (omega > 300) & (omega < 4000)
        return omega[band], direct[band], indirect[band]

    return make


def _distance(a, b):
    return np.median(np.linalg.norm(a - b, 2, axis=(1, 2)) / np.linalg.norm(b, 2, axis=(1, 2)))


def test_noise_dominates_direct_gives_the_inverse_controller(spectra):
    omega, direct, _ = spectra(0.02, 1.0)
    inverse = np.broadcast_to(np.linalg.inv(GAIN), direct.shape)
    assert _distance(direct, inverse) < 0.05


def test_noise_dominates_and_the_hansen_scheme_still_finds_the_plant(bearing, run_loop, binary):
    """The same recording, noise of seven times the excited motion: the direct ratio tells of 1/K, S of the plant."""
    nominal = StateSpace(0.97 * bearing.A, bearing.B, bearing.C, bearing.D, bearing.dt)
    fact, rng = factorise(nominal, StateSpace.gain(GAIN, bearing.dt)), np.random.default_rng(2)
    record, alpha, beta = run_loop(fact, bearing, 0.06 * binary(rng, 100_000), rng.standard_normal((100_000, 2)))
    found = approach(fact, [InputOutputData.of(alpha, beta, bearing.dt)], nominal)
    omega, direct = direct_spectral(record, 500)
    band = (omega > 300) & (omega < 4000)
    ours, truth = (frequency_response(g, omega[band]) for g in (found, bearing))
    inverse = np.broadcast_to(np.linalg.inv(GAIN), truth.shape)
    assert _distance(direct[band], inverse) < 0.25
    assert _distance(direct[band], truth) > 3
    assert _distance(ours, truth) < 0.4
    assert _distance(ours, inverse) > 0.7


def test_excitation_dominates_both_give_the_plant(spectra, bearing):
    omega, direct, indirect = spectra(1.0, 0.003)
    truth = frequency_response(bearing, omega)
    assert _distance(direct, truth) < 0.06
    assert _distance(indirect, truth) < 0.06


def test_mixture_is_the_formula_of_the_thesis_corrected(spectra, bearing):
    """SISO form of Eq 4.7 corrected: (G Pv + K* Pd) / (Pv + |K|^2 Pd), here with matrices, white d and binary v."""
    omega, direct, indirect = spectra(0.5, 0.35, 400_000, 2000)
    truth = frequency_response(bearing, omega)
    # spectrum of a coin flipped every fourth sample, per sample
    hold = np.abs(np.sin(2 * omega * bearing.dt) / np.sin(omega * bearing.dt / 2)) ** 2 / 4
    Pv, Pd = (0.5**2 * hold)[:, None, None], 0.35**2
    expected = (truth * Pv + GAIN * Pd) @ np.linalg.inv(Pv * np.eye(2) + GAIN @ GAIN * Pd)
    bias = expected - truth
    along = [np.vdot(bias, found - truth).real / np.vdot(bias, bias).real for found in (direct, indirect)]
    assert along[0] == pytest.approx(1.0, abs=0.15)  # the bias predicted, which more samples do not remove
    assert along[1] == pytest.approx(0.0, abs=0.15)


def test_short_recordings_and_strange_externals_are_named():
    record = InputOutputData.of(np.zeros((100, 1)), np.zeros((100, 1)), 1.0)
    with pytest.raises(BadInput, match="100 samples for segments of 50"):
        direct_spectral(record, 50)
    with pytest.raises(BadInput, match="external signal of shape"):
        indirect_spectral(record, np.zeros((100, 2)), 20)
