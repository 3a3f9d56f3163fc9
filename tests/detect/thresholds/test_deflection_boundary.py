"""The boundary of a CUSUM whose information comes faster: that of the run length at the deflection found."""

import numpy as np
import pytest

from afdsvc.detect.statistics.cusum import cusum
from afdsvc.detect.thresholds.average_run_length import run_length
from afdsvc.detect.thresholds.deflection_boundary import DeflectionBoundary, boundary_at

LOOKS, REST = 20_000.0, 0.37


@pytest.fixture(scope="module")
def clock():
    return DeflectionBoundary.of(np.array([0.1, REST]), LOOKS)


def moved(clock, deflection, blocks=7.0):
    at_rest = float(np.interp(np.log(REST), clock.log_deflection, clock.boundary))
    return boundary_at(at_rest, clock.log_deflection, clock.boundary, np.log(REST), deflection**2 * blocks, blocks)


@pytest.mark.parametrize("deflection", [0.5, 1.0, 2.0, 4.0, 6.0, 7.0])
def test_alarms_come_as_often_at_every_deflection(clock, deflection):
    assert run_length(deflection, moved(clock, deflection)) == pytest.approx(LOOKS, rel=0.25)


def test_it_rises_then_falls_and_stays_where_information_is_scarce(clock):
    rest = moved(clock, REST)
    assert moved(clock, 2.0) > rest + 1
    assert moved(clock, 6.0) < rest - 1
    assert moved(clock, 0.1) == rest
    assert boundary_at(rest - 1, clock.log_deflection, clock.boundary, np.log(REST), 81.0, 1.0) == 0.0  # never below zero


def test_information_beyond_which_it_is_below_the_one_at_rest(clock):
    rest, turn = moved(clock, REST), float(np.sqrt(clock.falls[1]))
    assert moved(clock, 0.99 * turn) > rest > moved(clock, 1.15 * turn)
    assert clock.falls[0] > clock.falls[1]  # a lower boundary at rest is reached later


def test_without_a_table_nothing_moves():
    flat = DeflectionBoundary.flat(2)
    assert boundary_at(3.0, flat.log_deflection, flat.boundary, flat.expected[0], 1e6, 1.0) == 3.0
    assert np.isinf(flat.falls).all()


def test_large_steps_alarm_below_the_boundary_at_rest(clock):
    """Of a step of deflection 6 the likelihood ratio is ``6 r - 18``: an alarm at 5.4, where the boundary at rest is higher, and none at 0.3."""
    rest = moved(clock, REST)
    test = cusum(np.ones((1, 1, 1)), [1.0], [0], 1, rest, DeflectionBoundary(clock.log_deflection, clock.boundary, np.log([REST]), clock.falls[1:]))
    for residual, alarms in ((6.0 * 0.5 + 0.9, True), (6.0 * 0.5 + 0.05, False)):
        g = 6.0 * residual - 18.0
        assert g < rest
        _, at, who = test.step(test.start(), np.array([[residual, 6.0]]))
        assert ((at, who) == (0, 0)) == alarms
