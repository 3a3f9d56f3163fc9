"""Slopes of S through the closed loop against central differences of the closed loop itself."""

import numpy as np
import pytest

from afdsvc.errors import BadInput
from afdsvc.identify.methods.black_box_pem import local_structure
from afdsvc.identify.parameters.closed_loop_gradients import closed_slopes, differences, filtered_slopes
from afdsvc.lti.factorise import factorise
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.yjbk import deviation_system, interconnection


@pytest.mark.parametrize("kind", ["observer", "proportional"])
def test_slopes_are_those_of_the_closed_loop(kind, bearing, observer_loop):
    nominal = StateSpace(0.8 * bearing.A, bearing.B, bearing.C, bearing.D, bearing.dt)
    gain = StateSpace.gain(np.array([[0.2, 0.05], [-0.03, 0.1]]), bearing.dt)
    fact = observer_loop(nominal) if kind == "observer" else factorise(nominal, gain)
    structure, z = local_structure(bearing), np.linspace(-0.01, 0.01, 24)
    steps = np.full(24, 1e-3)
    found = closed_slopes(interconnection(fact), structure.build(z), differences(structure.build, z, steps))
    wanted = differences(lambda v: deviation_system(fact, structure.build(v)), z, steps)
    for name in ("A", "B", "C", "D"):
        np.testing.assert_allclose(getattr(found, name), getattr(wanted, name), atol=1e-9)


def test_a_feedthrough_is_refused(bearing, observer_loop):
    direct = StateSpace(bearing.A, bearing.B, bearing.C, np.eye(2), bearing.dt)
    moved = differences(local_structure(direct).build, np.zeros(28), np.full(28, 1e-3))
    with pytest.raises(BadInput, match="the plant has a feedthrough"):
        closed_slopes(interconnection(observer_loop(bearing)), direct, moved)


def test_slopes_behind_a_filter(bearing, observer_loop):
    rng = np.random.default_rng(2)
    fact, structure, z, steps = observer_loop(bearing), local_structure(bearing), np.zeros(24), np.full(24, 1e-3)
    after = StateSpace(0.3 * rng.standard_normal((3, 3)), *(rng.standard_normal(s) for s in ((3, 2), (2, 3), (2, 2))), bearing.dt)
    own = closed_slopes(interconnection(fact), structure.build(z), differences(structure.build, z, steps))
    wanted = differences(lambda v: after @ deviation_system(fact, structure.build(v)), z, steps)
    for name in ("A", "B", "C", "D"):
        np.testing.assert_allclose(getattr(filtered_slopes(after, own), name), getattr(wanted, name), atol=1e-9)
