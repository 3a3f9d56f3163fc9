"""Parameters far from nominal: renewed coprime factors make the standard errors right, and small."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
import pytest
from scipy import stats

from afdsvc.api.model import Model, Quantity
from afdsvc.api.signals import Channel, Trace
from afdsvc.dataset.arrays import InputOutputData
from afdsvc.identify.methods.hansen import youla_signals
from afdsvc.identify.methods.indirect import fit_indirect
from afdsvc.identify.methods.repeated_indirect import NoiseCovariances, fit_recentred
from afdsvc.identify.options import IdentifyOptions
from afdsvc.identify.parameters.structure import physical_structure
from afdsvc.identify.pipeline import identify
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import Array
from afdsvc.lti.whitening import innovations, whitening_filter
from afdsvc.lti.yjbk import closed_loop
from afdsvc.plants.amb_turboexpander import NOISE_SD, amb_turboexpander
from afdsvc.plugins.controllers.lqg import Lqg

CHANGE = {"stiffness_a_x": -0.3, "stiffness_b_y": -0.5}


@lru_cache(maxsize=4)
def machine(states: int = 8, dt: float = 1e-4):
    """Return the plant and the factors of its LQG controller."""
    plant = amb_turboexpander(states=states, sample_time=dt)
    return plant, Lqg().design(plant.discrete(), plant.recommended["lqg"]).factorisation


def recording(samples, seed=3, states=8, dt=1e-4, noise_sd=NOISE_SD, hold=10, size=0.05):
    """Return u and y of the loop from rest, alpha, the true values, the plant and its factors."""
    plant, fact = machine(states, dt)
    values = {name: plant.parameters[name].value * (1 + theta) for name, theta in CHANGE.items()}
    rng = np.random.default_rng(seed)
    alpha = size * np.repeat(rng.choice([-1.0, 1.0], size=(samples // hold, 4)), hold, axis=0)
    noise = noise_sd * rng.standard_normal((samples, 4))
    out, _ = simulate(closed_loop(fact, plant.discrete(**values)).system, np.hstack([noise, np.zeros((samples, 8)), alpha]))
    return InputOutputData.of(out[:, 8:12], out[:, 4:8], dt), alpha, values, plant, fact


def test_two_stiffnesses_within_their_standard_errors_which_shrink() -> None:
    """0.7 s of data; one round alone takes the noise for white where it is not and knows five times less."""
    data, _, values, plant, fact = recording(7000)
    structure, noise = physical_structure(plant, list(CHANGE)), NoiseCovariances(plant.output_cov)
    once, found = (fit_recentred(structure, fact, [data], noise, rounds=rounds) for rounds in (1, 6))
    for name, before, after in zip(CHANGE, once.parameters, found.parameters, strict=True):
        assert abs(after.value - values[name]) < 3.5 * after.sd, name
        assert after.sd < 0.4 * before.sd
        assert after.sd < 0.004 * abs(plant.parameters[name].value)
        assert after.prior == plant.parameters[name].value


@pytest.mark.parametrize(("states", "samples", "runs"), [(8, 2500, 12), (16, 5000, 2)])
def test_the_errors_have_the_size_that_is_stated(states: int, samples: int, runs: int) -> None:
    """The whitening filter forgets its start within 0.16 s; left in, that is 40 standard deviations of noise."""
    plant, fact = machine(states)
    structure, noise, errors = physical_structure(plant, list(CHANGE)), NoiseCovariances(plant.output_cov), []
    for seed in range(runs):
        data, _, values, _, _ = recording(samples, 100 + seed, states)
        errors += [(p.value - values[p.name]) / p.sd for p in fit_recentred(structure, fact, [data], noise).parameters]
    low, high = stats.chi2.ppf([0.001, 0.999], len(errors)) / len(errors)
    assert low < np.mean(np.square(errors)) < high


def test_the_standard_errors_are_those_of_the_innovations() -> None:
    """Oracle without S: what neighbouring plants leave in the innovations of the plant found, start of the filter unknown."""
    data, alpha, values, plant, fact = recording(5000)
    structure = physical_structure(plant, list(CHANGE))
    fit = fit_recentred(structure, fact, [data], NoiseCovariances(plant.output_cov))
    found = np.array([p.value for p in fit.parameters])
    centre = innovations(plant.discrete(**dict(zip(CHANGE, found, strict=True))), plant.output_cov)
    whiten = np.linalg.inv(np.linalg.cholesky(centre.covariance)).T

    def left(theta: Array) -> Array:
        true = plant.discrete(**dict(zip(CHANGE, theta, strict=True)))
        out, _ = simulate(closed_loop(fact, true).system, np.hstack([np.zeros((5000, 12)), alpha]))
        return (simulate(centre.filter, np.hstack([out[:, 4:8], out[:, 8:12]]))[0] @ whiten)[150:].ravel()

    steps = np.diag(1e-3 * np.abs(found))
    slopes = np.array([(left(found + h) - left(found - h)) / (2 * h.sum()) for h in steps]).T
    A, C, free = centre.filter.A, centre.filter.C, []
    for _ in range(4850):
        free.append(whiten.T @ C)
        C = C @ A
    start = np.vstack(free)
    slopes -= start @ np.linalg.lstsq(start, slopes, rcond=None)[0]
    covariance = np.linalg.inv(slopes.T @ slopes)
    assert np.sqrt(np.diag(fit.covariance)) == pytest.approx(np.sqrt(np.diag(covariance)), rel=0.04)


class Rotor:
    """The linear rotor as an owner's Python simulator, its stiffnesses named."""

    def __init__(self, plant) -> None:
        self.plant, self.known = plant, {}

    def system(self, p: Mapping[str, float]):
        key = tuple(sorted(p.items()))
        if key not in self.known:
            self.known[key] = self.plant.continuous(**p)
        return self.known[key]

    def f(self, t: float, x: Array, u: Array, p: Mapping[str, float]) -> Array:
        return self.system(p).A @ x + self.system(p).B @ u

    def h(self, t: float, x: Array, u: Array, p: Mapping[str, float]) -> Array:
        return self.system(p).C @ x


def model_and_trace(data: InputOutputData, alpha: Array, plant, fact, names, angle=None) -> tuple[Model, Trace]:
    parameters = {n: Quantity(plant.parameters[n].value, "N/m", 0.1) for n in names}
    model = Model(
        "rotor", plant.inputs, plant.outputs, plant.states, None, dynamics=Rotor(plant), parameters=parameters,
        output_sd=np.full(4, NOISE_SD), controller=fact.K,
    )  # fmt: skip
    roles = [("u", plant.inputs, data.u), ("y", plant.outputs, data.y), ("alpha", plant.inputs, alpha)]
    names = [Channel(f"{role}_{v.name}", v.unit) for role, of, _ in roles for v in of]
    columns = [s for _, _, s in roles]
    if angle is not None:
        names.append(Channel("aux_angle", "rad"))
        columns.append(angle[:, None])
    return model, Trace("run", data.dt, tuple(names), np.hstack(columns))


def test_the_public_job_finds_half_the_stiffness_as_in_the_paper() -> None:
    """P1: 0.5 for 0.5 within 0.005, from 0.5 s of a random binary signal at 1 ms without noise, of which a quarter is held out."""
    data, alpha, values, plant, fact = recording(500, dt=1e-3, noise_sd=0.0, hold=1, size=0.02)
    model, trace = model_and_trace(data, alpha, plant, fact, list(CHANGE))
    found = identify(model, [trace], [], IdentifyOptions(method="indirect", cross_check=False)).fit
    for p in found.parameters:
        assert p.value / plant.parameters[p.name].value - 1 == pytest.approx(CHANGE[p.name], abs=1e-3)
    assert "made the nominal plant" in found.notes[-1]


def test_the_public_job_takes_unbalance_out_by_the_rotor_angle() -> None:
    """0.5 um of noise and a whirl of 3 um at 525 Hz: within 3.5 standard errors of 0.1 %, and the loop reported stable."""
    data, alpha, values, plant, fact = recording(9000)
    angle = 2 * np.pi * 525.0 * 1e-4 * np.arange(9000)
    force = np.real(np.exp(1j * angle)[:, None] * np.array([1, -1j, 1, -1j]))
    true = plant.discrete(**values)
    whirl, _ = simulate(closed_loop(fact, true).system, np.hstack([np.zeros((9000, 8)), force, np.zeros((9000, 4))]))
    size = 3.0 / np.abs(whirl[3000:, 4:8]).max()
    shaken = InputOutputData.of(data.u + size * (whirl[:, 8:12] - force), data.y + size * whirl[:, 4:8], data.dt)
    model, trace = model_and_trace(shaken, alpha, plant, fact, list(CHANGE), np.mod(angle, 2 * np.pi))
    result = identify(model, [trace.span(3000, 9000)], [], IdentifyOptions(method="indirect", cross_check=False))
    for p in result.fit.parameters:
        assert abs(p.value - values[p.name]) < 3.5 * p.sd
        assert p.sd < 0.003 * abs(p.value)
    assert result.loop_stable
    assert not result.warnings


def test_without_noise_model_and_in_the_1_norm() -> None:
    """Within the stated errors too, which are wide where nothing is whitened."""
    data, _, values, plant, fact = recording(3000)
    structure = physical_structure(plant, list(CHANGE))
    for norm, noise in ((2, None), (1, NoiseCovariances(plant.output_cov))):
        fit = fit_recentred(structure, fact, [data], noise, norm)
        for p in fit.parameters:
            assert abs(p.value - values[p.name]) < 4 * p.sd


def test_one_round_is_the_plain_fit() -> None:
    data, _, _, plant, fact = recording(2000)
    structure = physical_structure(plant, list(CHANGE))
    signals = youla_signals(fact, data).centred()
    plain = fit_indirect(structure, fact, [signals], 2, whitening_filter(fact, plant.output_cov)[0])
    once = fit_recentred(structure, fact, [data], NoiseCovariances(plant.output_cov), rounds=1)
    assert [p.value for p in once.parameters] == [p.value for p in plain.parameters]
