"""Parameters through S(theta): the thesis' example, both norms, and agreement with the direct likelihood."""

import numpy as np
import pytest

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.errors import BadInput
from afdsvc.identify.methods.greybox import fit_greybox
from afdsvc.identify.methods.indirect import fit_indirect
from afdsvc.identify.parameters.structure import FreeParameter, Structure, physical_structure
from afdsvc.lti.coprime import observer_factorisation
from afdsvc.lti.python_control import factorise
from afdsvc.lti.riccati import kalman_predictor_gain, lqr
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.whitening import whitening_filter
from afdsvc.plants.gas_bearing import gas_bearing

PLANT = gas_bearing(0)
CHANGED = {"stiffness_hh": 0.98, "damping_hh": 1.1, "gain_vv": 0.95, "pole_h": 1.05}
TRUTH = {name: PLANT.parameters[name].value * factor for name, factor in CHANGED.items()}


@pytest.fixture(scope="module")
def bearing_case(observer_loop, run_loop, binary):
    fact = observer_loop(PLANT.discrete())

    def make(seed, samples=5000, spikes=0.0):
        rng = np.random.default_rng(seed)
        d = np.sqrt([0.12, 0.15]) * rng.standard_normal((samples, 2))
        record, alpha, beta = run_loop(fact, PLANT.discrete(**TRUTH), 3 * binary(rng, samples), d)
        beta = beta + (rng.random(beta.shape) < spikes) * 20 * rng.standard_normal(beta.shape)
        return record, InputOutputData.of(alpha, beta, PLANT.sample_time)

    return fact, make


def _deviations(fit):
    return np.array([(e.value - TRUTH[e.name]) / e.sd for e in fit.parameters])


def test_bearing_stiffness_halved_on_a_rigid_rotor_in_unstable_magnetic_bearings(run_loop):
    """P1: theta of a negative bearing stiffness, 0.5 s of random binary excitation at 1 kHz, noise free and with 2 % noise."""
    mass, stiffness, current = 10.0, 8e5, 150.0

    def rotor(theta):
        k = stiffness * (1 + theta[0]) / mass
        return StateSpace.of([[0, 1], [k, 0]], [[0], [current / mass]], [[1, 0]], [[0.0]])

    structure = Structure((FreeParameter("theta", 0.0, "1", 0.2),), rotor)
    nominal, true = sample_zoh(rotor([0.0]), 1e-3), sample_zoh(rotor([-0.5]), 1e-3)
    F = lqr(nominal, np.diag([1e6, 1.0]), np.eye(1))
    fact = observer_factorisation(nominal, F, kalman_predictor_gain(nominal, np.diag([1e-10, 1e-4]), 1e-10 * np.eye(1)))
    rng = np.random.default_rng(1)
    eta = rng.choice([-1.0, 1.0], size=(500, 1))
    quiet, alpha, clean = run_loop(fact, true, eta, np.zeros((500, 1)))
    exact = fit_indirect(structure, fact, [InputOutputData.of(alpha, clean, 1e-3)])
    assert exact.parameters[0].value == pytest.approx(-0.5, abs=1e-6)
    _, _, noisy = run_loop(fact, true, eta, 0.02 * quiet.y.std() * rng.standard_normal((500, 1)))
    found = fit_indirect(structure, fact, [InputOutputData.of(alpha, noisy, 1e-3)]).parameters[0]
    assert abs(found.value + 0.5) < 4 * found.sd
    assert found.sd < 0.02


@pytest.mark.parametrize("norm", [1, 2])
def test_truth_within_the_standard_errors(bearing_case, norm):
    fact, make = bearing_case
    structure = physical_structure(PLANT, list(CHANGED))
    whitener, _ = whitening_filter(fact, PLANT.output_cov)
    deviations = np.array(
        [_deviations(fit_indirect(structure, fact, [make(s, 2000)[1]], norm, whitener)) for s in range(4)]
    )
    assert np.abs(deviations).max() < 4
    assert 0.25 < (deviations**2).mean() < 2.45  # chi-squared with 16 degrees of freedom: 0.1 % to 99.9 %


def test_the_1_norm_shrugs_off_spikes(bearing_case):
    fact, make = bearing_case
    structure, signals = physical_structure(PLANT, list(CHANGED)), make(3, spikes=0.02)[1]
    robust, square = (fit_indirect(structure, fact, [signals], norm) for norm in (1, 2))
    for a, b in zip(robust.parameters, square.parameters, strict=True):
        assert a.sd < 0.4 * b.sd
    assert np.abs(_deviations(robust)).max() < 4


def test_agrees_with_the_direct_likelihood(bearing_case):
    """Same recording, two routes: u, y with a noise model, and alpha, beta through S. Closer than their errors."""
    fact, make = bearing_case
    record, signals = make(4)
    structure = physical_structure(PLANT, list(CHANGED))
    whitener, _ = whitening_filter(fact, PLANT.output_cov)
    direct, through_S = fit_greybox(structure, [record]), fit_indirect(structure, fact, [signals], 2, whitener)
    for a, b in zip(direct.parameters, through_S.parameters, strict=True):
        assert abs(a.value - b.value) < 1.5 * max(a.sd, b.sd)
        assert 0.5 < a.sd / b.sd < 1.5


def test_deviation_and_plant_belong_together(bearing_case):
    from afdsvc.identify.methods.hansen import rebuilt_plant
    from afdsvc.lti.frequency import frequency_response

    fact, make = bearing_case
    fit = fit_indirect(physical_structure(PLANT, list(CHANGED)), fact, [make(5, 3000)[1]])
    omega = np.geomspace(10, 10_000, 20)
    rebuilt = frequency_response(rebuilt_plant(fact, fit.deviation), omega)
    assert np.abs(rebuilt - frequency_response(fit.system, omega)).max() < 1e-8


def test_bad_norm_dead_parameter_and_unstable_start_are_named(bearing_case):
    fact, make = bearing_case
    signals = [make(6, 2000)[1]]
    with pytest.raises(BadInput, match="norm 3; expected 1 or 2"):
        fit_indirect(physical_structure(PLANT, list(CHANGED)), fact, signals, 3)
    dead = Structure((FreeParameter("nothing", 1.0),), lambda th: PLANT.continuous())
    with pytest.raises(BadInput, match="parameter 'nothing' has no influence"):
        fit_indirect(dead, fact, signals)
    loop = factorise(PLANT.discrete(), StateSpace.gain(0.2 * np.eye(2), PLANT.sample_time))
    with pytest.raises(BadInput, match="the controller does not stabilise that plant"):
        fit_indirect(physical_structure(PLANT, ["gain_hh"]), loop, signals, start=np.array([-4.3e6 * 3]))
