"""PID per axis: its frequency response in closed form, its loops, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.errors import BadInput, NotStabilising
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace, block_diagonal
from afdsvc.lti.yjbk import interconnection
from afdsvc.plugins.controllers.pid import Pid, pid

DT = 1e-3
SETTINGS = {"proportional": 9.0, "integral_seconds": 0.5, "derivative_seconds": 0.3, "filter_seconds": 0.02}


def cart() -> StateSpace:
    """A unit mass pushed on by u, sampled: unstable without control (two poles on the unit circle)."""
    return StateSpace.of([[1, DT], [0, 1]], [[DT**2 / 2], [DT]], [[1, 0]], None, DT)


def test_slow_signals_see_the_continuous_pid() -> None:
    """``-k (1 + 1/(Ti s) + Td s/(Tf s + 1))`` up to the half-sample delay of holding y."""
    K, w = pid(9.0, 0.5, 0.3, 0.02, DT), np.array([0.1, 1.0, 5.0])
    s = 1j * w
    wanted = -9.0 * (1 + 1 / (0.5 * s) + 0.3 * s / (0.02 * s + 1))
    assert frequency_response(K, w)[:, 0, 0] == pytest.approx(wanted, rel=1e-2)


def test_discrete_response_is_the_formula_exactly() -> None:
    w = np.array([3.0, 70.0, 900.0])
    z, lag = np.exp(1j * w * DT), np.exp(-DT / 0.02)
    wanted = -9.0 * (1 + DT / 0.5 / (z - 1) + 0.3 * (1 - lag) / DT * (z - 1) / (z - lag))
    assert frequency_response(pid(9.0, 0.5, 0.3, 0.02, DT), w)[:, 0, 0] == pytest.approx(wanted, rel=1e-10)


def test_axes_are_independent_and_ordered() -> None:
    plant = block_diagonal(cart(), cart())
    design = Pid().design(plant, {**SETTINGS, "proportional": [9.0, 16.0], "integral_seconds": [0.5, 0.0]})
    K = design.factorisation.K
    assert K.order == 3
    found = frequency_response(K, [2.0])[0]
    assert found[0, 1] == found[1, 0] == 0
    for i, (k, ti) in enumerate(((9.0, 0.5), (16.0, 0.0))):
        alone = frequency_response(pid(k, ti, 0.3, 0.02, DT), [2.0])[0, 0, 0]
        assert found[i, i] == pytest.approx(alone, rel=1e-12)
    assert design.interconnection.order == 4 + 3
    loop = frequency_response(interconnection(design.factorisation), [2.0])[0]
    assert np.abs(loop[:2, :2] - found).max() < 1e-9 * np.abs(found).max()


def test_proportional_alone_is_a_gain() -> None:
    K = pid(2.5, 0, 0, 0, DT)
    assert (K.order, K.D.item()) == (0, -2.5)


@pytest.mark.parametrize("filter_seconds", [0.0, 0.02])
def test_a_ramp_gives_its_slope(filter_seconds: float) -> None:
    K = pid(1.0, 0.0, 0.3, filter_seconds, DT)
    ramp = 7.0 * DT * np.arange(2000)[:, None]
    u, _ = simulate(K, ramp)
    assert u[-1, 0] + ramp[-1, 0] == pytest.approx(-0.3 * 7.0, rel=1e-9)


def test_refusals_name_the_setting() -> None:
    with pytest.raises(BadInput, match="'proportional' is missing"):
        Pid().design(cart(), {})
    with pytest.raises(BadInput, match="unknown setting 'gain'"):
        Pid().design(cart(), {**SETTINGS, "gain": 1})
    with pytest.raises(BadInput, match=r"'proportional' has shape \(2,\); expected a number or 1 numbers"):
        Pid().design(cart(), {**SETTINGS, "proportional": [1, 2]})
    with pytest.raises(BadInput, match="negative"):
        Pid().design(cart(), {**SETTINGS, "integral_seconds": -1.0})
    with pytest.raises(BadInput, match="1 inputs and 2 outputs"):
        Pid().design(StateSpace.of([[0.5]], [[1]], [[1], [1]], None, DT), SETTINGS)
    with pytest.raises(NotStabilising):
        Pid().design(cart(), {**SETTINGS, "proportional": -9.0})
