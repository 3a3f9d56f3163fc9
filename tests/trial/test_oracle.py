"""The oracle reaches the noise floor, and rivals are distinguished from the truth as far as the data allow."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.trial import NOTHING, Options, generate_trial, oracle
from afdsvc.trial.effect import Truth
from afdsvc.trial.matching import UNDECIDABLE, rival_distance
from afdsvc.trial.oracle import prior, refit, residuals
from afdsvc.trial.simulation import replay

SHORT = Options(controller="proportional", periods=1)


@pytest.mark.parametrize("options", [SHORT, Options(machine="positioning_axis", periods=1)], ids=["bearing", "axis"])
def test_oracle_reaches_the_noise_and_the_nominal_model_does_not(options: Options) -> None:
    site = "state:horizontal_rate" if options is SHORT else "state:v"
    best = oracle(generate_trial("coulomb_friction", site, 1.0, np.random.default_rng(2), options))
    # 16 to 18 fitted values cost 17 parts in 10,000; the closed loop adds what it makes of the noise
    assert best.after == pytest.approx(best.floor, rel=0.02 if options is SHORT else 0.1)
    assert best.before > best.after + 0.5 * best.floor
    assert 0.2 < best.gain < 1


def test_oracle_of_nothing_repairs_the_constants_only() -> None:
    """What the nominal model leaves above the noise is the error of its constants, counted here without noise; all of it goes."""
    trial = generate_trial(NOTHING, None, 0.0, np.random.default_rng(2), SHORT)
    run, signals = trial.runs[-1], trial.played[-1]
    true, nominal = (replay(trial.machine, Truth(t), run.quiet(), signals.u).y for t in (trial.truth.theta, trial.machine.nominal))
    lost = float(np.square((true - nominal)[run.skip :] / trial.machine.sigma).mean(axis=0).sum())
    best = oracle(trial)
    assert lost > 0.05
    assert best.before - best.floor == pytest.approx(lost, abs=4 * np.sqrt(4 * lost / (run.alpha.shape[0] - run.skip)))
    assert abs(best.after - best.floor) < 0.02 * best.floor


def test_refit_does_not_depend_on_where_it_starts() -> None:
    trial = generate_trial("cubic_stiffness", "state:horizontal_rate", 0.5, np.random.default_rng(4), SHORT)
    lost = Truth(trial.truth.theta * 1.005, trial.truth.effects)
    found, other = refit(trial, refit(trial, lost)), refit(trial, trial.truth)
    apart_at_first, apart_at_last = (np.abs(a.theta / b.theta - 1).max() for a, b in ((lost, trial.truth), (found, other)))
    assert apart_at_last < 0.1 * apart_at_first
    assert found.effects[0].values[0] == pytest.approx(other.effects[0].values[0], rel=1e-2)
    assert found.effects[0].values[0] == pytest.approx(trial.truth.effects[0].values[0], rel=0.15)
    data = list(zip(trial.runs[:-1], trial.played[:-1], strict=True))
    costs = [np.square(residuals(trial, t, data)).sum() + prior(trial, t) for t in (found, trial.truth)]
    assert costs[0] < costs[1]


@pytest.mark.long
def test_refit_without_the_effect_stays_worse() -> None:
    trial = generate_trial("dead_zone", "input:horizontal", 0.5, np.random.default_rng(4), SHORT)
    bare = refit(trial, Truth(trial.truth.theta))
    data = list(zip(trial.runs[:-1], trial.played[:-1], strict=True))
    cost = [np.square(residuals(trial, t, data)).sum() for t in (bare, refit(trial, trial.truth))]
    assert cost[0] > cost[1] + 100


@pytest.fixture(scope="module")
def friction():
    return generate_trial("coulomb_friction", "state:horizontal_rate", 0.5, np.random.default_rng(2), SHORT)


@pytest.mark.long
def test_the_truth_is_no_rival(friction) -> None:
    assert rival_distance(friction, {"physics": "coulomb_friction", "site": "state:horizontal_rate"}) < UNDECIDABLE


def test_an_unknown_word_is_no_rival(friction) -> None:
    assert rival_distance(friction, {"physics": "phlogiston", "site": "machine"}) == float("inf")


@pytest.mark.long
def test_rival_of_another_family_is_far_apart(friction) -> None:
    assert rival_distance(friction, {"physics": "sensor_offset", "site": "output:horizontal"}) > 5 * UNDECIDABLE


@pytest.mark.long
def test_load_and_offset_cannot_be_distinguished_at_rest() -> None:
    """Both shift one output; only the weak static coupling between the axes (half a per cent) differs."""
    trial = generate_trial("sensor_offset", "output:horizontal", 0.3, np.random.default_rng(2), SHORT)
    assert rival_distance(trial, {"physics": "constant_load", "site": "state:horizontal_rate"}) < UNDECIDABLE


@pytest.mark.long
def test_parameter_change_is_a_rival_by_its_parameter() -> None:
    trial = generate_trial("parameter_change:actuator gain", "input:horizontal", 0.5, np.random.default_rng(2), SHORT)
    named = {"physics": "parameter_change", "site": "output:horizontal", "parameters": {"sensor gain": {}}}
    assert rival_distance(trial, named) < 30
    other = {"physics": "parameter_change", "site": "state:horizontal_rate", "parameters": {"damping": {}}}
    assert rival_distance(trial, other) > rival_distance(trial, named)
