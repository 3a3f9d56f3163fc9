"""An undamped mode that the nominal model does not have is told; one that it has is not."""

import numpy as np
import pytest

from afdsvc.api.model import Model
from afdsvc.api.signals import Channel, Trace
from afdsvc.identify import IdentifyOptions, identify
from afdsvc.identify.validation import undamped_modes
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.statespace import StateSpace
from afdsvc.plants.gas_bearing import gas_bearing


def _oscillator(hz, damping):
    w = 2 * np.pi * hz
    return sample_zoh(StateSpace.of([[0, 1], [-w * w, -2 * damping * w]], [[0], [1]], [[1, 0]], [[0]], 0.0), 1e-3)


def test_only_new_undamped_modes_are_told():
    found = _oscillator(50.0, 0.002)
    assert undamped_modes(found, _oscillator(20.0, 0.3)) == [pytest.approx(50.0, rel=1e-3)]
    assert undamped_modes(found, _oscillator(52.0, 0.005)) == []
    assert undamped_modes(_oscillator(50.0, 0.05), _oscillator(20.0, 0.3)) == []


def test_the_orbit_of_a_rotor_is_not_taken_for_the_plant_silently(bearing, observer_loop, run_loop, binary):
    """Unbalance of twice the excited motion at 30 Hz: the estimate warns of the mode it invents; without, it does not."""
    plant, rng = gas_bearing(0), np.random.default_rng(5)
    nominal = StateSpace(0.97 * bearing.A, bearing.B, bearing.C, bearing.D, bearing.dt)
    fact = observer_loop(nominal)
    model = Model(
        "bearing", plant.inputs, plant.outputs, plant.states, nominal, sample_time=nominal.dt, controller=fact.controller
    )
    roles = (("u", plant.inputs), ("y", plant.outputs), ("alpha", plant.inputs))
    channels = tuple(Channel(f"{role}_{v.name}", v.unit) for role, side in roles for v in side)
    angle = 2 * np.pi * 30 * np.arange(4000) * bearing.dt
    told = []
    for size in (0.0, 4.0):
        d = 0.1 * rng.standard_normal((4000, 2)) + size * np.column_stack([np.cos(angle), np.sin(angle)])
        record, alpha, _ = run_loop(fact, bearing, 0.5 * binary(rng, 4000), d)
        trace = Trace("run", bearing.dt, channels, np.hstack([record.u, record.y, alpha]))
        told.append([w for w in identify(model, [trace], options=IdentifyOptions(groups=0)).warnings if "undamped" in w])
    assert told[0] == []
    assert len(told[1]) == 1
    assert "periodic disturbance" in told[1][0]
