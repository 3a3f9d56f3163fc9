"""Choice by samples left out: order, feedthrough, feedback; public recordings against figures of other tools."""

import re

import numpy as np
import pytest

import afdsvc
from afdsvc.dataset.arrays import InputOutputData
from afdsvc.identify.cross_validation import choose_candidate, feedback_of, fitted_candidate
from afdsvc.identify.numerics.innovations_form import fitted_errors
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace


def _resonator(D=0.0):
    return StateSpace.of([[1.5, -0.7], [1.0, 0.0]], [[1.0], [0.0]], [[0.5, 0.3]], [[D]], dt=1.0)


def _recorded(system, samples=3000, seed=0, noise=0.1):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((samples, system.inputs))
    y = simulate(system, u)[0]
    return [InputOutputData.of(u, y + noise * y.std() * rng.standard_normal(y.shape), 1.0)]


@pytest.mark.parametrize("D", [0.0, 2.0])
def test_order_and_feedthrough_are_found(D):
    choice = choose_candidate(_recorded(_resonator(D)), 12)
    assert choice.candidate.order == 2
    assert choice.candidate.feedthrough is (D != 0)
    # what no model can explain: noise of a hundredth of the power
    assert choice.loss == pytest.approx(0.01 / 1.01, rel=0.1)
    said = f"leaves {100 * choice.loss:.3g} % of the outputs' power unexplained in simulations of 3 stretches left out in turn; "
    assert re.search(re.escape(said) + r"(that is )?the least of \d+ candidates", choice.sentence), choice.sentence
    found = fitted_candidate(choice.candidate, _recorded(_resonator(D))).system
    omega = np.linspace(0.05, 3, 40)
    truth = frequency_response(_resonator(D), omega)
    assert np.abs(frequency_response(found, omega) - truth).max() < 0.02 * np.abs(truth).max()
    assert {c.order for c in choice.others if c.refined} >= {1}  # refined models of fewer states were tried


@pytest.mark.parametrize("D", [0.0, 2.0])
def test_methods_that_feedback_does_not_bias_are_preferred_at_the_right_order(D):
    found = [choose_candidate(_recorded(_resonator(D), seed=seed), 12, feedback=True).candidate for seed in range(4)]
    assert [c.order for c in found] == [2] * 4
    assert {c.consistent for c in found} == {1 if D else 2}


def test_a_stretch_with_much_noise_does_not_decide_the_order_alone():
    """A weak mode beside a strong one, noise five times as large in the first third: the weak mode is found all the same."""
    weak, orders = StateSpace.of([[-0.6, -0.72], [1.0, 0.0]], [[1.0], [0.0]], [[0.12, 0.084]], [[0.0]], dt=1.0), []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        u = rng.standard_normal((3000, 1))
        y = simulate(_resonator(), u)[0] + simulate(weak, u)[0]
        loud = np.where(np.arange(3000) < 1000, 5.0, 1.0)[:, None]
        record = InputOutputData.of(u, y + 0.2 * y.std() * loud * rng.standard_normal(y.shape), 1.0)
        orders.append(choose_candidate([record], 12).candidate.order)
    assert set(orders) <= {4, 5}


def test_the_order_is_not_bounded_by_a_nominal_model(oscillators):
    """Six states, found from a model that has none to speak of; the search says where it ended."""
    rng = np.random.default_rng(2)
    big = oscillators(9)
    u = rng.standard_normal((4000, 2))
    y = simulate(big, u)[0]
    found = afdsvc.identify(u, y + 0.05 * y.std(axis=0) * rng.standard_normal(y.shape), dt=1.0, groups=0)
    assert found.order == 6


def test_the_last_choice_rests_on_all_samples():
    (r,) = (recording.centred() for recording in _recorded(_resonator(), 1200))
    choice = choose_candidate([r], 6, order=2)
    found = afdsvc.identify(r.u, r.y, dt=1.0, groups=0, order=2).result.fit
    assert found.order_reason == choice.sentence
    assert np.allclose(found.system.poles(), fitted_candidate(choice.candidate, [r]).system.poles())


def test_feedback_is_seen_and_an_open_loop_is_not_taken_for_one():
    rng = np.random.default_rng(3)
    open_loop = [feedback_of(_recorded(_resonator(2.0), 2000, seed)).p for seed in range(40)]
    assert np.mean(np.array(open_loop) < 0.01) <= 0.1  # 99.9 % limit of a binomial of 40 at 0.01 is 3; the feedthrough does not pass for feedback
    y, u, x, e = np.zeros(3000), np.zeros(3000), np.zeros(2), rng.standard_normal(3000)
    plant = _resonator()
    for k in range(2999):
        y[k] = float(plant.C[0] @ x) + e[k]
        x = plant.A @ x + plant.B[:, 0] * u[k]
        u[k + 1] = -0.15 * y[k] + 0.05 * rng.standard_normal()
    found = feedback_of([InputOutputData.of(u, y, 1.0)])
    assert found.p < 1e-6
    assert found.share > 0.5
    assert choose_candidate([InputOutputData.of(u, y, 1.0)], 6, feedback=True, closed_loop=True).candidate.consistent == 2


def test_steady_samples_saturation_and_gaps_are_fitted_and_said():
    (r,) = _recorded(_resonator(), 2000)
    u, y = r.u.clip(-1, 1), simulate(_resonator(), r.u.clip(-1, 1))[0]
    y += 0.05 * np.random.default_rng(1).standard_normal(y.shape)
    u, y = (np.vstack([np.zeros((100, 1)), part]) for part in (u, y))  # at rest for 100 samples
    y[900:910] = np.nan
    found = afdsvc.identify({"u_in": u[:, 0], "y_out": y[:, 0], "t": np.arange(2100.0)}, groups=0)
    assert found.order == 2
    notes = " ".join(found.result.warnings)
    assert "stands still for 99 samples" in notes
    assert "'u_in' sits at its highest value 1" in notes
    assert "samples are missing; fitted 2 stretches without gaps, 2090 of 2100 samples" in notes
    with pytest.raises(afdsvc.BadInput, match="samples of 'y_out' are missing"):
        afdsvc.identify({"u_in": u[:, 0], "y_out": y[:, 0], "t": np.arange(2100.0)}, screening=True)


#: Fit on the last 40 % by the CVA of another tool (sippy_unipi 1.0.1, BIC over orders 1 to 12, feedthrough), per cent. Automatic choices may be behind by five points on one
#: set, not by the 17 to 29 of a switch to a method without feedthrough; on pH no linear model of any tool simulates the held-out part, so a model is all that is asked.
PEERS = {"winding": 73.6, "thermic_res_wall": 83.5, "flutter": 21.2, "ballbeam": 90.0, "glassfurnace": 41.0}
COLUMNS = {"winding": (5, 7), "thermic_res_wall": (2, 3), "flutter": (1, 2), "ballbeam": (1, 2), "pHdata": (3, 4), "glassfurnace": (4, 10)}
"""Columns: up to the first number inputs (after time where there is one), up to the second outputs."""


@pytest.mark.parametrize("name", sorted(COLUMNS))
def test_public_sets_with_automatic_choices(name, measured):
    table = np.loadtxt(measured / "daisy" / f"{name}.dat")
    start = 1 if name in ("pHdata", "glassfurnace") else 0
    m, p = COLUMNS[name]
    cut = int(0.6 * len(table))
    z = (table - table[:cut].mean(axis=0)) / table[:cut].std(axis=0)
    found = afdsvc.identify(z[:cut, start:m], z[:cut, m:p], dt=1.0, groups=0).result.fit.system
    held = InputOutputData.of(z[cut:, start:m], z[cut:, m:p], 1.0)
    left = fitted_errors(found, held.u, held.y)  # a mode that grows a little may still be simulated this far
    fit = 100 * np.mean(1 - np.linalg.norm(left, axis=0) / np.linalg.norm(held.y - held.y.mean(axis=0), axis=0))
    assert fit > PEERS.get(name, -np.inf) - 5


def test_recordings_without_noise_get_no_states_for_rounding():
    choice = choose_candidate(_recorded(_resonator(), noise=0.0), 12)
    assert choice.candidate.order <= 3  # the operating point may take one
    assert choice.loss < 1e-15
