"""The gas bearing's forms, its parameters and its faults."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.errors import BadInput
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.statespace import StateSpace
from afdsvc.plants.gas_bearing import FAULTS, TABLE_0_1, gas_bearing

FORMS = ("first_order_actuators", "delay", "second_order_actuators")


def test_first_order_form_is_thesis_3_7_entry_by_entry() -> None:
    G = gas_bearing().continuous()
    O, I = np.zeros((2, 2)), np.eye(2)
    P = np.diag(TABLE_0_1["P"])
    wanted = np.block([[O, I, O], [np.array(TABLE_0_1["K"]), np.array(TABLE_0_1["D"]), np.array(TABLE_0_1["B"])], [O, O, -P]])
    assert np.array_equal(G.A, wanted)
    assert np.array_equal(G.B, np.vstack([O, O, P]))
    assert np.array_equal(G.C, np.hstack([I, O, O]))
    assert not G.D.any()


def test_delay_form_is_an_all_pass_before_the_body() -> None:
    """P3 (22)-(25): the Tustin image (1 - sT/2)/(1 + sT/2) of a delay T per axis, in series with the mass on its spring."""
    p = gas_bearing(form="delay")
    G, omega = p.continuous(), np.array([10.0, 500.0, 1340.0, 5000.0])
    T = [p.parameters["delay_h"].value, p.parameters["delay_v"].value]
    K, D, B = (np.array(TABLE_0_1[k]) for k in "KDB")
    for w, found in zip(omega, frequency_response(G, omega), strict=True):
        s = 1j * w
        delay = np.diag([(1 - s * t / 2) / (1 + s * t / 2) for t in T])
        wanted = np.linalg.inv(s * s * np.eye(2) - s * D - K) @ B @ delay
        assert np.abs(found - wanted).max() < 1e-12 * np.abs(wanted).max()


def test_ten_state_form_has_the_actuator_first() -> None:
    """Thesis (3.6) with the order of the factors mended: body times delay times actuators."""
    p = gas_bearing(form="second_order_actuators")
    assert p.continuous().order == 10
    value = {name: q.value for name, q in p.parameters.items()}
    K, D, B = (np.array(TABLE_0_1[k]) for k in "KDB")
    for w in (10.0, 1340.0, 5000.0):
        s = 1j * w
        actuator, delay = np.zeros((2, 2), complex), np.zeros((2, 2), complex)
        for i, axis in enumerate("hv"):
            lags = (1 + s / value[f"pole_{axis}"]) * (1 + s / value[f"second_pole_{axis}"])
            actuator[i, i] = value[f"actuator_gain_{axis}"] / lags
            delay[i, i] = (1 - s * value[f"delay_{axis}"] / 2) / (1 + s * value[f"delay_{axis}"] / 2)
        wanted = np.linalg.inv(s * s * np.eye(2) - s * D - K) @ B @ delay @ actuator
        assert np.abs(frequency_response(p.continuous(), w)[0] - wanted).max() < 1e-12 * np.abs(wanted).max()


def test_forms_agree_at_low_frequency() -> None:
    """Same static gain; the two 6-state forms also lag alike."""
    first, delay, second = (frequency_response(gas_bearing(form=f).continuous(), [0.0, 20.0]) for f in FORMS)
    assert np.abs(first[0] - delay[0]).max() < 1e-9
    assert np.abs(first[0] - second[0]).max() < 1e-9
    assert np.degrees(np.angle(delay[1] / first[1]).diagonal()) == pytest.approx([0, 0], abs=0.01)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("parameters", ["table_0_1", "table_0_2", "equations_3_9"])
def test_names_units_and_stability(form: str, parameters: str) -> None:
    p = gas_bearing(parameters=parameters, form=form)
    G = p.discrete()
    assert len(p.states) == G.order
    assert [v.unit for v in p.outputs] == ["um", "um"]
    assert [v.unit for v in p.inputs] == ["V", "V"]
    assert [v.rate_of for v in p.states[2:4]] == ["horizontal", "vertical"]
    assert G.is_stable()
    assert G.dt == 2e-4
    assert len(p.recommended["lqg"]["state_weight"]) == G.order


@pytest.mark.parametrize("form", FORMS)
def test_gain_faults_against_plants_changed_by_hand(form: str) -> None:
    p = gas_bearing(form=form)
    G, faults = p.discrete(), p.faults()
    assert (
        faults.fault_names
        == tuple(FAULTS)
        == ("horizontal_actuator", "vertical_actuator", "horizontal_sensor", "vertical_sensor")
    )
    found = faults.close([-0.5, -0.25, -1.0, -0.125])
    assert np.array_equal(found.A, G.A)
    assert np.abs(found.B - G.B * [0.5, 0.75]).max() < 1e-14 * np.abs(G.B).max()
    assert np.abs(found.C - np.diag([0.0, 0.875]) @ G.C).max() < 1e-15
    one = p.gain_faults(["vertical_sensor"])
    assert [d.name for d in one] == ["vertical_sensor"]


@pytest.mark.parametrize("form", FORMS)
def test_any_parameter_as_a_fault_agrees_with_the_plant_built_anew(form: str) -> None:
    """Every named parameter, one at a time, at -0.4: continuous and sampled."""
    p = gas_bearing(form=form)
    for name in p.parameters:
        change = {name: 0.6 * p.parameters[name].value}
        agree(p.continuous_faults([name]).close([-0.4]), p.continuous(**change), 1e-13)
        agree(p.faults([name]).close([-0.4]), p.discrete(**change), 1e-10)


def test_parameters_and_gains_together() -> None:
    p = gas_bearing()
    names = ["stiffness_hh", "horizontal_actuator", "mass", "pole_h", "vertical_sensor", "damping_vv"]
    theta = [-0.3, -0.5, 0.2, -0.4, -0.8, 0.5]
    changed = {n: p.parameters[n].value * (1 + t) for n, t in zip(names, theta, strict=True) if n in p.parameters}
    wanted = sample_zoh(p.continuous(**changed), p.sample_time)
    faulty = StateSpace(wanted.A, wanted.B * [0.5, 1.0], np.diag([1.0, 0.2]) @ wanted.C, wanted.D, wanted.dt)
    agree(p.faults(names).close(theta), faulty, 1e-11)
    agree(p.faults(names).plant, p.discrete(), 0.0)


def agree(found: StateSpace, wanted: StateSpace, tolerance: float) -> None:
    for name in "ABC":
        a, b = getattr(found, name), getattr(wanted, name)
        assert np.abs(a - b).max() <= tolerance * np.abs(b).max(), name


def test_other_values_give_another_plant() -> None:
    p = gas_bearing().at(pole_h=500.0)
    assert p.parameters["pole_h"].value == 500.0
    assert p.continuous().A[4, 4] == -500.0
    assert gas_bearing().continuous(pole_h=500.0).A[4, 4] == -500.0


def test_refusals() -> None:
    with pytest.raises(BadInput, match="identified at 0 and 1100 rpm, not at 2500"):
        gas_bearing(rpm=2500)
    with pytest.raises(BadInput, match="no parameter set 'table_9'; it has table_0_1"):
        gas_bearing(parameters="table_9")
    with pytest.raises(BadInput, match="no form 'magnetic'; it has first_order_actuators"):
        gas_bearing(form="magnetic")
    with pytest.raises(BadInput, match="no parameter 'stiffnes_hh'"):
        gas_bearing().continuous(stiffnes_hh=1.0)
    with pytest.raises(BadInput, match="no fault or parameter 'leak'; it has horizontal_actuator"):
        gas_bearing().faults(["leak"])
    with pytest.raises(BadInput, match="no gain fault 'leak'"):
        gas_bearing().gain_faults(["leak"])


def test_between_its_two_speeds_the_bearing_is_interpolated() -> None:
    ends = [gas_bearing(rpm) for rpm in (0, 1100)]
    half = gas_bearing(550)
    for name, q in half.parameters.items():
        assert q.value == pytest.approx(sum(e.parameters[name].value for e in ends) / 2, rel=1e-12)
    assert ends[0].at_speed is not None
    assert ends[0].at_speed(2 * np.pi * 1100 / 60).values() == ends[1].values()
