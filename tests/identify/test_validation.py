"""An undamped mode that the nominal model does not have is reported; one that it has is not."""

import numpy as np
import pytest

import afdsvc
from afdsvc.api.model import Model
from afdsvc.api.signals import Channel, Trace
from afdsvc.identify import IdentifyOptions, identify
from afdsvc.identify.fit import ResponseBand
from afdsvc.identify.validation import agreement, undamped_modes
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.statespace import StateSpace
from afdsvc.plants.gas_bearing import gas_bearing


def _oscillator(hz, damping):
    w = 2 * np.pi * hz
    return sample_zoh(StateSpace.of([[0, 1], [-w * w, -2 * damping * w]], [[0], [1]], [[1, 0]], [[0]], 0.0), 1e-3)


def test_only_new_undamped_modes_are_reported():
    found = _oscillator(50.0, 0.002)
    assert undamped_modes(found, _oscillator(20.0, 0.3)) == [pytest.approx(50.0, rel=1e-3)]
    assert undamped_modes(found, _oscillator(52.0, 0.005)) == []
    assert undamped_modes(_oscillator(50.0, 0.05), _oscillator(20.0, 0.3)) == []
    assert undamped_modes(_oscillator(50.0, -0.05), _oscillator(20.0, 0.3)) == [pytest.approx(50.0, rel=1e-3)]


def test_in_a_short_recording_a_mode_that_rings_from_end_to_end_is_undamped():
    found, nominal = _oscillator(50.0, 0.02), _oscillator(20.0, 0.3)
    assert undamped_modes(found, nominal, 0.4) == [pytest.approx(50.0, rel=1e-3)]  # a twelfth of it is left at the end
    assert undamped_modes(found, nominal, 1.0) == []
    assert undamped_modes(_oscillator(5.0, 0.2), nominal, 0.4) == []  # slow, but damped


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
    reported = []
    for size in (0.0, 4.0):
        d = 0.1 * rng.standard_normal((4000, 2)) + size * np.column_stack([np.cos(angle), np.sin(angle)])
        record, alpha, _ = run_loop(fact, bearing, 0.5 * binary(rng, 4000), d)
        trace = Trace("run", bearing.dt, channels, np.hstack([record.u, record.y, alpha]))
        reported.append([w for w in identify(model, [trace], options=IdentifyOptions(groups=0)).warnings if "undamped" in w])
    assert reported[0] == []
    assert len(reported[1]) == 1
    assert "periodic disturbance" in reported[1][0]


def _bands(difference, sd):
    omega = np.geomspace(0.1, 3, 60)
    value = np.ones((60, 1, 1), dtype=complex)
    covariance = np.broadcast_to(0.5 * sd**2 * np.eye(2), (60, 1, 1, 2, 2))
    return ResponseBand(omega, value, covariance), ResponseBand(omega, value * (1 + difference), covariance)


@pytest.mark.parametrize(
    ("difference", "sd", "verdict"),
    [(0.01, 0.01, "agree"), (0.48, 0.27, "undecided"), (0.1, 0.01, "differ")],
    ids=["narrow bands", "48 % and 1.3 standard deviations", "ten per cent"],
)
def test_wide_bands_are_no_agreement(difference, sd, verdict):
    found = agreement(*_bands(difference, sd))
    assert found.relative == pytest.approx(difference)
    assert found.deviations == pytest.approx(difference / (sd * np.sqrt(2)))
    assert found.verdict == verdict
    assert ("agree within" in found.sentence) is (verdict == "agree")


def test_a_tenth_of_the_frequencies_far_off_is_no_agreement():
    first, second = _bands(0.0, 0.01)
    off = second.value.copy()
    off[:8] += 0.1
    assert agreement(first, ResponseBand(second.omega, off, second.covariance)).verdict == "differ"


@pytest.mark.parametrize("method", ["pbsid", "pem"])
def test_an_unstable_plant_is_validated_by_prediction_without_its_controller(method):
    """x+ = 1.05 x + u under u = -0.4 y + probe: the controller is not named, and the plant cannot be simulated."""
    rng, x = np.random.default_rng(1), 0.0
    u, y = np.zeros((4000, 1)), np.zeros((4000, 1))
    for k in range(4000):
        y[k] = x + 0.1 * rng.standard_normal()
        u[k] = -0.4 * (y[k - 1] if k else 0.0) + rng.standard_normal()
        x = 1.05 * x + u[k, 0]
    found = afdsvc.identify(u, y, dt=1.0, method=method, order=2, groups=0)
    assert np.abs(found.system.poles()).max() == pytest.approx(1.05, abs=0.01)
    assert any("one-step predictions" in note for note in found.result.fit.notes)
    # noise of 0.1 on the output: what a predictor leaves is little more than that
    assert found.result.after["y1"].nrmse == pytest.approx(0.1 / y[3000:].std(), rel=0.35)
