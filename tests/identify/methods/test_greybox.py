"""Grey-box prediction errors: the gradient is exact, the truth is found in closed loop, the standard errors are honest."""

import numpy as np
import pytest
from scipy import stats

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.errors import BadInput
from afdsvc.identify.methods.greybox import GreyboxOptions, Likelihood, fit_greybox, greybox_band
from afdsvc.identify.parameters.structure import FreeParameter, Structure, physical_structure
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace
from afdsvc.plants.gas_bearing import gas_bearing

PLANT = gas_bearing(0)
FREE = [name for name in PLANT.parameters if name != "mass"]
RATES = ("horizontal_rate", "vertical_rate")
TRUTH = np.array([PLANT.parameters[name].value for name in FREE])


@pytest.fixture(scope="module")
def record(bearing, observer_loop, run_loop, binary):
    """A closed-loop recording of the bearing, with or without process noise on both velocities."""
    fact = observer_loop(bearing)

    def make(seed, samples=5000, process=0.0, amplitude=4.0):
        rng = np.random.default_rng(seed)
        w = np.zeros((samples, 6))
        w[:, 2:4] = process * rng.standard_normal((samples, 2))
        through, _ = simulate(StateSpace(bearing.A, np.eye(6), bearing.C, np.zeros((2, 6)), bearing.dt), w)
        d = through + np.sqrt([0.12, 0.15]) * rng.standard_normal((samples, 2))
        return run_loop(fact, bearing, amplitude * binary(rng, samples), d)[0]

    return make


def _deviations(fit):
    return (np.array([e.value for e in fit.parameters]) - TRUTH) / np.array([e.sd for e in fit.parameters])


@pytest.mark.parametrize("process", [(), RATES])
def test_gradient_equals_difference_quotients_of_the_likelihood(record, process):
    structure = physical_structure(PLANT, FREE, process)
    likelihood = Likelihood(structure, [record(1, 1500, 200.0), record(2, 700, 200.0)], prior=True)
    z = likelihood.start(structure.values * (1 + 0.03 * np.random.default_rng(3).standard_normal(14)))
    for _ in range(3):  # settle the initial states, in which the cost is quadratic
        at = likelihood.local(z)
    for i in range(len(z)):
        h = np.zeros(len(z))
        h[i] = 1e-4
        quotient = (likelihood.local(z + h).cost - likelihood.local(z - h).cost) / 2e-4
        assert at.gradient[i] == pytest.approx(quotient, rel=2e-5, abs=2e-5 * np.abs(at.gradient).max())


def test_truth_is_found_from_afar_with_process_noise_in_closed_loop(record):
    structure = physical_structure(PLANT, FREE, RATES)
    start = structure.values * (1 + 0.1 * np.random.default_rng(4).standard_normal(14))
    fit = fit_greybox(structure, [record(5, 5000, 200.0), record(6, 3000, 200.0)], start=start)
    assert np.abs(_deviations(fit)).max() < 4
    assert fit.notes[0].startswith("converged")
    noise = {text.rsplit(": ", 1)[0]: float(text.rsplit(": ", 1)[1]) for text in fit.notes if text.startswith("sd of")}
    assert noise["sd of the noise on output 0"] == pytest.approx(np.sqrt(0.12), rel=0.05)
    assert noise["sd of the process noise on vertical_rate"] == pytest.approx(200, rel=0.15)


def test_ignoring_process_noise_in_closed_loop_is_worse(record):
    recordings = [record(7, 6000, 400.0, amplitude=2.0)]
    errors = []
    for process in (RATES, ()):
        fit = fit_greybox(physical_structure(PLANT, FREE, process), recordings, GreyboxOptions(steps=25))
        errors.append(np.abs([e.value for e in fit.parameters] - TRUTH) / np.abs(TRUTH))
        if process:
            assert np.abs(_deviations(fit)).max() < 4
    diagonal = [
        FREE.index(name) for name in ("stiffness_hh", "stiffness_vv", "damping_hh", "damping_vv", "gain_hh", "gain_vv")
    ]
    assert errors[1][diagonal].max() > 3 * errors[0][diagonal].max()


def test_standard_errors_cover(record):
    """25 recordings, 14 parameters: squared deviations are chi-squared, tested at 0.1 % (500 recordings in a study)."""
    structure = physical_structure(PLANT, FREE)
    deviations = np.array([_deviations(fit_greybox(structure, [record(100 + s, 3000)])) for s in range(25)])
    inside = (np.abs(deviations) < 1.96).mean()
    assert 0.90 < inside < 0.99
    # every parameter by itself: 25 squared deviations sum to chi-squared with 25 degrees of freedom
    p_values = stats.chi2.sf((deviations**2).sum(axis=0), 25)
    assert p_values.min() > 1e-3 / 14
    assert p_values.max() < 1 - 1e-3 / 14


def test_two_recordings_know_what_both_know(record):
    """Information adds up: with a second recording of the same length every standard error falls by the root of two."""
    structure = physical_structure(PLANT, FREE)
    one, both = (fit_greybox(structure, [record(300 + s, 2000) for s in range(count)]) for count in (1, 2))
    ratio = np.array([b.sd / a.sd for a, b in zip(one.parameters, both.parameters, strict=True)])
    assert np.median(ratio) == pytest.approx(np.sqrt(0.5), rel=0.05)
    assert (_deviations(both) ** 2).sum() < stats.chi2.ppf(0.999, 14)


def test_band_is_that_of_the_parameters(record, bearing):
    structure, omega = physical_structure(PLANT, FREE), np.geomspace(50, 10_000, 20)
    truth, covered = frequency_response(bearing, omega), []
    for seed in range(8):
        fit = fit_greybox(structure, [record(200 + seed, 3000)])
        covered.append(greybox_band(structure, fit, omega).covers(truth).mean())
    assert np.mean(covered) > 0.85


def test_unstable_plant_in_its_loop():
    """P4's plant (pole 1.1568) from closed-loop data: its parameters within four standard errors."""
    rng, samples = np.random.default_rng(8), 4000
    u, y, x = np.zeros((samples, 1)), np.zeros((samples, 1)), np.zeros(2)
    A, B, C = np.array([[1.2, -0.05], [1.0, 0.0]]), np.array([1.0, 0.0]), np.array([0.3, -0.1])
    r, v = rng.standard_normal(samples), 0.3 * rng.standard_normal(samples)
    for k in range(samples):
        y[k] = C @ x + v[k]
        u[k] = -1.5 * y[k] + r[k]
        x = A @ x + B * u[k, 0]
    structure = Structure(
        (FreeParameter("a1", 1.15, sd=0.05), FreeParameter("a2", -0.04, sd=0.02), FreeParameter("c", 0.25, sd=0.05)),
        lambda th: StateSpace.of([[th[0], th[1]], [1, 0]], [[1.0], [0]], [[th[2], -0.1]], [[0.0]], 1.0),
    )
    fit = fit_greybox(structure, [InputOutputData.of(u, y, 1.0)])
    for e, truth in zip(fit.parameters, (1.2, -0.05, 0.3), strict=True):
        assert abs(e.value - truth) < 4 * e.sd
        assert e.sd < 0.05


def _first_order(parameters, build):
    rng = np.random.default_rng(9)
    u = rng.standard_normal((2000, 1))
    y, _ = simulate(StateSpace.of([[0.8]], [[0.5]], [[1.0]], [[0.0]], 1.0), u)
    recording = InputOutputData.of(u, y + 0.1 * rng.standard_normal((2000, 1)), 1.0)
    return Structure(tuple(FreeParameter(name, value, sd=0.1) for name, value in parameters), build), [recording]


def test_parameter_without_influence_and_parameters_that_act_alike_are_named():
    structure, recordings = _first_order(
        [("pole", 0.7), ("dead", 3.0)], lambda th: StateSpace.of([[th[0]]], [[0.5]], [[1.0]], [[0.0]], 1.0)
    )
    with pytest.raises(BadInput, match="parameter 'dead' has no influence on these recordings"):
        fit_greybox(structure, recordings)
    structure, recordings = _first_order(
        [("pole", 0.7), ("gain", 0.5), ("sensor", 1.0)],
        lambda th: StateSpace.of([[th[0]]], [[th[1]]], [[th[2]]], [[0.0]], 1.0),
    )
    with pytest.raises(BadInput, match="cannot be separated by these recordings") as reported:
        fit_greybox(structure, recordings)
    assert {"gain", "sensor"} <= set(str(reported.value).replace(",", "").split())


def test_prior_separates_what_the_data_cannot():
    structure, recordings = _first_order(
        [("pole", 0.7), ("gain", 0.5), ("sensor", 1.0)],
        lambda th: StateSpace.of([[th[0]]], [[th[1]]], [[th[2]]], [[0.0]], 1.0),
    )
    fit = fit_greybox(structure, recordings, GreyboxOptions(prior=True))
    values = {e.name: e for e in fit.parameters}
    assert values["pole"].value == pytest.approx(0.8, abs=4 * values["pole"].sd)
    assert values["gain"].value * values["sensor"].value == pytest.approx(0.5, abs=0.02)
    assert 0.04 < values["gain"].sd < 0.1  # what the belief leaves


def test_several_starts_find_the_minimum_one_start_misses():
    """A sine-wave likelihood: the frequency of a lightly damped mode, started far off, has many local minima."""

    def build(th):
        return StateSpace.of(
            0.97 * np.array([[np.cos(th[0]), np.sin(th[0])], [-np.sin(th[0]), np.cos(th[0])]]),
            [[1.0], [0]],
            [[1.0, 0]],
            [[0.0]],
            1.0,
        )

    rng = np.random.default_rng(10)
    u = rng.standard_normal((1000, 1))
    y, _ = simulate(build([0.5]), u)
    structure = Structure((FreeParameter("angle", 1.0, "rad", 0.4, 0.05, 3.0),), build)
    recordings = [InputOutputData.of(u, y + 0.1 * y.std() * rng.standard_normal(y.shape), 1.0)]
    one = fit_greybox(structure, recordings)
    several = fit_greybox(structure, recordings, GreyboxOptions(starts=12, spread=1.5), rng)
    assert abs(one.parameters[0].value - 0.5) > 0.05
    assert several.parameters[0].value == pytest.approx(0.5, abs=5 * several.parameters[0].sd)
    assert "starting points reached the best minimum" in several.notes[1]
    with pytest.raises(BadInput, match="12 starting points need a random generator"):
        fit_greybox(structure, recordings, GreyboxOptions(starts=12))


def test_bounds_hold_and_a_start_outside_is_named():
    structure, recordings = _first_order(
        [("pole", 0.7)], lambda th: StateSpace.of([[th[0]]], [[0.5]], [[1.0]], [[0.0]], 1.0)
    )
    bounded = Structure((FreeParameter("pole", 0.7, sd=0.1, lower=0.6, upper=0.75),), structure.build)
    assert fit_greybox(bounded, recordings).parameters[0].value == pytest.approx(0.75)
    with pytest.raises(BadInput, match="lies outside its bounds"):
        fit_greybox(bounded, recordings, start=np.array([0.9]))
