"""The modified Hansen scheme on an unstable plant: the residual is weighted with its noise, or slow motion is lost in it."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.identify.options import IdentifyOptions
from afdsvc.identify.pipeline import identify
from afdsvc.lti.coprime import observer_factorisation
from afdsvc.lti.riccati import kalman_predictor_gain, lqr
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.yjbk import closed_loop

DT, NOISE, SLOW = 2e-4, 0.5, 30.0


def axis(rate: float) -> StateSpace:
    """One axis of a magnetic bearing: growth rate [rad/s], A in, um out."""
    return sample_zoh(StateSpace.of([[0, rate], [rate, 0]], [[0], [1.5e7 / rate]], [[1, 0]], [[0.0]]), DT)


@pytest.mark.parametrize("known", [True, False])
def test_a_slow_growth_rate_is_found_where_the_noise_is_stated(known: bool) -> None:
    """The model says 90 rad/s, the machine 30; 2 s with 0.5 um of noise. Unweighted the rate is missed altogether."""
    nominal, true = axis(90.0), axis(SLOW)
    F = lqr(nominal, np.diag([1.0, 0.0]), 1e3 * np.eye(1))
    fact = observer_factorisation(nominal, F, kalman_predictor_gain(nominal, nominal.B @ nominal.B.T, 0.25 * np.eye(1)))
    missed = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        alpha = 0.1 * np.repeat(rng.choice([-1.0, 1.0], size=(2000, 1)), 5, axis=0)
        noise = NOISE * rng.standard_normal((10000, 1))
        out, _ = simulate(closed_loop(fact, true).system, np.hstack([noise, np.zeros((10000, 2)), alpha]))
        values = np.hstack([out[:, 2:3], out[:, 1:2], alpha])  # out: y, measured y, u, beta
        trace = Trace("run", DT, (Channel("u_i", "A"), Channel("y_s", "um"), Channel("alpha_i", "A")), values)
        states = (Variable("s"), Variable("v"))
        model = Model("axis", (Variable("i", "A"),), (Variable("s", "um"),), states, nominal, sample_time=DT,
                      output_sd=np.array([NOISE]) if known else None, controller=fact.K)  # fmt: skip
        found = identify(model, [trace], [], IdentifyOptions(method="hansen", cross_check=False, groups=0)).fit.system
        missed.append(np.log(np.abs(found.poles()).max()) / DT / SLOW - 1)
    if known:
        assert np.abs(missed).max() < 0.25
    else:
        assert np.abs(missed).max() > 0.5
