"""Where forces towards an end, resistances that warm and numbers that follow a state have a place, and with which numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.physics import Machine, Signal
from afdsvc.explain.search.ranking import mechanism
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics.eccentricity import out_of_round
from afdsvc.plugins.physics.supply_droop import SupplyDroop
from tests.plugins.physics.test_sites import ARM, CART, COIL, DAMPER, MOTOR, REACTOR, ROTOR, TANKS, machines, offered


def test_a_force_towards_an_end_belongs_to_lines_and_decays_within_a_third_of_the_reach():
    assert not any(k.startswith("repulsion") for k in offered(machines()[ARM]))
    q = machines()[CART].axes[0].position
    below = offered(machines()[CART])["repulsion@state:v#from below"]
    force, length, place, side = below.parameters
    assert force.linear
    assert length.high == pytest.approx(q.reach / 3)
    assert (place.low, side.low) == pytest.approx((q.mean - q.rms, -1.0))


def measured_current(voltage: str = "V", current: str = "A", through: float = 0.8):
    """A motor whose current is read, ``i = 0.8 u - 0.3 w + 0.1 v`` with a second voltage v."""
    motor = machines()[MOTOR]
    plant = StateSpace(motor.plant.A, np.array([[40.0, 5.0]]), np.array([[1.0], [-0.3]]), np.array([[0.0, 0.0], [through, 0.1]]))
    inputs = (replace(motor.inputs[0], unit=voltage), replace(motor.inputs[0], index=1, name="bias", unit="N"))
    outputs = (motor.outputs[0], replace(motor.outputs[0], index=1, name="i", unit=current, mean=3.0, rms=4.0))
    return replace(motor, plant=plant, inputs=inputs, outputs=outputs, residual=np.full(2, 0.1))


@pytest.mark.parametrize(("changes", "offers"), [({}, True), ({"voltage": "N"}, False), ({"current": "V"}, False), ({"through": 0.0}, False)])
def test_a_winding_warms_where_a_voltage_moves_a_current_that_is_read(changes, offers):
    key = "self_heating@input:voltage#i"
    found = offered(measured_current(**changes))
    assert (key in found) is offers
    if offers:
        h = found[key]
        resistance, _, size, *weights = h.parameters
        assert [(s.kind, s.index) for s in h.reads] == [("u", 0), ("x", 0), ("u", 1)]
        assert [w.low for w in weights] == [0.8, -0.3, 0.1]
        assert (resistance.high, size.low) == pytest.approx((5 / 0.8, 5.0))


@pytest.mark.parametrize(("unit", "offers"), [("A", True), ("N", False)])
def test_a_coil_warms_whose_state_is_a_current(unit, offers):
    coil = machines()[COIL]
    machine = replace(coil, states=(replace(coil.states[0], unit=unit), *coil.states[1:]))
    found = offered(machine)
    assert ("self_heating@state:i#voltage" in found) is offers
    if offers:
        assert (found["self_heating@state:i#voltage"].parameters[0].through, found["self_heating@state:i#voltage"].parameters[0].unsigned) == ((0, 0), True)


def test_numbers_of_code_follow_states_and_of_matrices_what_states_store_follows_their_own_size():
    code, tanks, coil = (
        {k: h for k, h in offered(machines()[m]).items() if h.physics == "parameter_follows_state"} for m in (REACTOR, TANKS, COIL)
    )
    assert {h.site for h in code.values()} == {"parameter:volume", "parameter:rate"}
    assert {h.reads[1] for h in code.values()} == {Signal("x", 0), Signal("x", 1)}
    assert len({mechanism(h) for h in code.values()}) == len(code) == 4
    assert set(tanks) == {"parameter_follows_state@state:h1#storage", "parameter_follows_state@state:h2#storage"}
    (h,) = coil.values()
    assert h.reads[0] == Signal("x", 0)
    assert [c.low for c in h.parameters[2:]] == [0.0, -1500, -1.4, 250]
    assert all(h.description for h in [*code.values(), *coil.values()])


def test_an_inductance_follows_its_own_current_wherever_that_stands_and_is_left_to_the_numbers_of_code():
    coil, order = machines()[COIL], [1, 2, 0]
    states = tuple(replace(coil.states[k], index=i) for i, k in enumerate(order))
    plant = StateSpace(coil.plant.A[np.ix_(order, order)], coil.plant.B[order], coil.plant.C[:, order], coil.plant.D)
    moved = replace(coil, states=states, plant=plant, axes=(replace(coil.axes[0], position=states[0], rate=states[1]),))
    h = offered(moved)["parameter_follows_state@state:i#inductance"]
    assert h.reads == (Signal("x", 2), Signal("x", 1), Signal("u", 0))
    assert [c.low for c in h.parameters[2:]] == [0.0, -1500, -1.4, 250]
    assert not any(k.startswith("parameter_follows") for k in offered(replace(moved, code=True)))


def test_a_store_is_brought_back_from_below_its_limit_only():
    h = offered(machines()[TANKS])["saturation@state:h1#below"]
    for level, back in ((0.5, 0.2 / 0.1), (0.8, 0.0)):
        out = np.zeros(1)
        h.law(np.array([0.7]), np.array([level]), np.zeros(0), 0.1, out)
        assert out[0] == pytest.approx(back)


def test_inputs_of_one_unit_share_a_supply_that_sags_with_the_sum_of_both():
    """Oracle: the formula, at once."""
    rotor = machines()[ROTOR]
    h = offered(rotor)["supply_droop@machine#horizontal,vertical"]
    assert h.parameters[2].low == pytest.approx(sum(u.rms for u in rotor.inputs))
    out, u = np.zeros(2), np.array([3.0, -1.0])
    h.law(np.array([0.2, 1e-9, 8.0]), u, np.zeros(1), 0.01, out)
    assert u + out == pytest.approx(u * (1 - 0.2 * 4 / 8))
    other, many = (rotor.inputs[0], replace(rotor.inputs[1], unit="N")), tuple(replace(rotor.inputs[0], name=f"valve {k}") for k in range(15))
    for inputs in (other, many):  # of another unit; more than one law can read
        found = {x.key for x in SupplyDroop().hypotheses(replace(rotor, inputs=inputs))}
        assert not any(k.startswith("supply_droop@machine") for k in found)


def test_two_slopes_are_offered_to_inputs_that_take_both_signs():
    motor = machines()[MOTOR]
    one_way = replace(motor, inputs=(replace(motor.inputs[0], reverses=False),))
    assert "static_nonlinearity@input:voltage#two slopes" in offered(motor)
    assert "static_nonlinearity@input:voltage#two slopes" not in offered(one_way)


def test_a_dead_zone_has_a_centre_where_the_input_has_one_sign_and_is_wide_enough_for_a_sample_to_lie_in_it():
    motor = machines()[MOTOR]
    volts = replace(motor.inputs[0], reverses=False, mean=5.0, origin=3.2, peak=6.8)
    zone, two, about = (offered(replace(motor, inputs=(volts,))).get(f"dead_zone@input:voltage{s}") for s in ("", "#asymmetric", "#about another centre"))
    assert "dead_zone@input:voltage#about another centre" not in offered(motor)
    assert [c.low for c in (*zone.parameters, *two.parameters)] == [3.2] * 3
    assert all(start[0] >= 3.2 for start in (*zone.starts, *two.starts))
    width, centre, shift = about.parameters
    assert width.low < 1e-3 * volts.rms
    assert {start[2] for start in about.starts} == {0.0, 5.0}
    assert shift.nuisance
    assert centre.low < volts.mean < centre.high
    constant = offered(replace(motor, inputs=(replace(volts, origin=6.8),)))["dead_zone@input:voltage"]
    assert constant.parameters[0].low < constant.parameters[0].high


@pytest.mark.parametrize(("word", "place"), [("above", 2.0), ("below", -2.0)])
def test_a_stop_answers_an_imposed_way_on_one_side_with_the_sign_of_the_spring(word, place):
    """Oracle: the formula, of a spring whose force grows with the way."""
    damper = machines()[DAMPER]
    way = replace(damper.inputs[0], name="way", unit="mm", rms=3.0, mean=0.5)
    plant = StateSpace(damper.plant.A, damper.plant.B, damper.plant.C, np.array([[4.0]]))
    h = offered(replace(damper, inputs=(way,), plant=plant))[f"clearance@output:force#way, stop {word}"]
    assert (h.parameters[0].low, h.parameters[0].high > 0) == (0.0, True)
    beyond, within, p = 1.5 * place, 0.5 * place, np.array([7.0, place, np.sign(place)])
    for u, pushed in ((beyond, 7.0 * (beyond - place)), (within, 0.0), (-beyond, 0.0)):
        out = np.zeros(1)
        h.law(p, np.array([9.0, u]), np.zeros(0), 0.1, out)
        assert out[0] == pytest.approx(pushed)
    assert not any("stop" in k for k in offered(damper))


@pytest.mark.parametrize("gain", [40.0, -40.0])
def test_a_supply_has_less_to_give_the_faster_an_axis_turns(gain):
    motor = machines()[MOTOR]
    turned = replace(motor, axes=(replace(motor.axes[0], gain=gain),))
    h = offered(turned)["saturation@input:voltage#falls with w"]
    limit, fall, own = h.parameters
    assert [abs(s[0] / s[1]) for s in h.starts] == pytest.approx([1.1 * motor.axes[0].rate.peak] * 3)  # nothing is left to give there
    assert limit.low > 0
    assert own.low == gain
    assert (fall.high if gain > 0 else -fall.low) == pytest.approx(20 * motor.inputs[0].peak / motor.axes[0].rate.peak)
    assert (fall.low if gain > 0 else fall.high) == 0.0


def test_a_state_that_follows_more_than_one_input_has_no_lag_of_its_own():
    """The current of a coil is driven by the voltage and by the motion, the second tank by the first."""
    coil, tanks, two = ({k.split("@")[1] for k in offered(m) if k.endswith("#rising and falling")} for m in (machines()[COIL], machines()[TANKS], measured_current()))
    assert coil == {"input:voltage#rising and falling"}
    assert tanks == {"input:pump#rising and falling", "state:h1#rising and falling"}
    assert two == {"input:voltage#rising and falling", "input:bias#rising and falling"}
    rates = {k.split("@")[1] for m in (machines()[COIL], machines()[TANKS], measured_current()) for k in offered(m) if k.startswith("slew_limit@state")}
    assert rates == {"state:h1"}


@pytest.mark.parametrize(("weight", "offers"), [(-0.95, True), (-1.05, True), (-1.2, False), (-0.8, False), (1.0, False)])
def test_the_error_of_a_servo_is_limited_where_a_position_follows_its_input(weight, offers):
    arm = machines()[ARM]
    gain = arm.axes[0].gain
    A = arm.plant.A.copy()
    A[arm.axes[0].rate.index, arm.axes[0].position.index] = weight * gain
    found = offered(replace(arm, plant=StateSpace(A, arm.plant.B, arm.plant.C, arm.plant.D)))
    key = "saturation@input:torque#of the error"
    assert (key in found) is offers
    if offers:
        h = found[key]
        assert [(s.kind, s.index) for s in h.reads] == [("u", 0), ("x", arm.axes[0].position.index)]
        assert [c.low for c in h.parameters[2:]] == pytest.approx([gain, weight])
        assert all(0 < c.low < s < c.high for start in h.starts for c, s in zip(h.parameters[:2], start[:2], strict=True))


def test_friction_under_a_load_reads_the_current_with_the_force_it_has():
    coil = machines()[COIL]
    h = offered(coil)["coulomb_friction@state:v#grows with i"]
    assert h.reads[1] == Signal("x", coil.states[0].index)
    assert h.parameters[3].low == coil.plant.A[coil.axes[0].rate.index, coil.states[0].index] != 0


@pytest.mark.parametrize("other", [False, True])
def test_a_roll_out_of_round_repeats_along_its_way(other):
    """Oracle: the phase is the integral of the speed, by its formula."""
    dt, k, share = 1e-3, 7.0, 0.02
    t = dt * np.arange(3000)
    speed, phase = 1.5 + np.sin(2 * t), 1.5 * (t + dt / 2) + (1 - np.cos(2 * (t + dt / 2))) / 2
    memory, found = np.array([np.cos(0.4), np.sin(0.4)]), []
    for v in speed:
        out = np.zeros(1)
        out_of_round(np.array([k, share]), np.array([9.0, v] if other else [v]), memory, dt, out)
        found.append(out[0])
    assert found == pytest.approx(share * speed * np.cos(k * phase + 0.4), abs=5e-4)


def test_a_wave_along_the_way_of_a_speed_is_offered_in_every_speed():
    damper = machines()[DAMPER]
    two = replace(damper.inputs[0], index=1, name="draw", unit="mm/s", rms=3.0), replace(damper.inputs[0], index=2, name="push", unit="N")
    B, D = np.array([[7e4, 10.0, 1.0]]), np.zeros((1, 3))
    machine = replace(damper, inputs=(damper.inputs[0], *two), plant=replace(damper.plant, B=B, D=D))
    found = {k: h for k, h in offered(machine).items() if h.physics == "eccentricity"}
    assert set(found) == {"eccentricity@input:speed", "eccentricity@input:draw#speed"}
    assert [[(s.kind, s.index) for s in h.reads] for h in found.values()] == [[("u", 0)], [("u", 1), ("u", 0)]]
    assert found["eccentricity@input:draw#speed"].parameters[1].unit == "(mm/s)/(m/s)"
    assert not any(k.startswith("eccentricity") for k in offered(replace(machine, waves={})))


def test_a_part_of_a_spring_relaxes_as_the_matrices_say():
    """A standard solid: the law's force in sinusoidal motion against the extended plant's."""
    h = offered(machines()[ARM])["relaxation@state:w#q"]
    built, omega, tau, c = h.linear(machines()[ARM].plant, [30.0, 0.4]), 3.0, 0.4, 30.0
    t = 1e-3 * np.arange(20000)
    memory, pushes = np.zeros(2), []
    for q in np.cos(omega * t):
        out = np.zeros(1)
        h.law(np.array([c, tau]), np.array([q]), memory, 1e-3, out)
        pushes.append(out[0])
    expected = -c * 1j * omega * tau / (1 + 1j * omega * tau)
    settled = slice(10000, None)
    assert np.array(pushes)[settled] == pytest.approx((expected * np.exp(1j * omega * t)).real[settled], abs=0.05)
    s = 1j * omega
    whole = (built.C @ np.linalg.solve(s * np.eye(3) - built.A, built.B))[0, 0]
    assert whole == pytest.approx(50 / (s**2 + 1.5 * s + 60 - expected))
    assert {k for k in offered(machines()[ARM]) if k.startswith("relaxation")} == {"relaxation@state:w#q"}


def test_a_reading_of_what_a_state_sums_up_may_have_a_memory_of_the_way():
    tanks = machines()[TANKS]
    A, C = tanks.plant.A.copy(), np.array([[0.3, 1.0]])
    assert not any(k.startswith("hysteresis@output") for k in offered(tanks))
    A[0] = 0.0
    found = {k: h for k, h in offered(replace(tanks, plant=StateSpace(A, tanks.plant.B, C, tanks.plant.D))).items() if k.startswith("hysteresis@output")}
    (h,) = found.values()
    assert (h.site, h.reads[1], h.notes["variant"]) == ("output:h2", Signal("x", 0), "h1")
    assert not any(k.startswith("hysteresis@output") for k in offered(replace(tanks, plant=StateSpace(A, tanks.plant.B, np.array([[0.0, 1.0]]), tanks.plant.D))))
    cart = machines()[CART]  # its velocity sums up forces, but is motion
    cart = replace(cart, plant=replace(cart.plant, C=np.array([[0.0, 1.0]])))
    assert not any(k.startswith("hysteresis@output") for k in offered(cart))


def test_nothing_drifts_in_a_free_decay_and_no_number_where_nothing_goes_on_changing():
    cart = machines()[CART]
    n, p = len(cart.plant.A), len(cart.plant.C)
    plant = StateSpace(cart.plant.A, np.zeros((n, 0)), cart.plant.C, np.zeros((p, 0)))
    free = replace(cart, inputs=(), driven=False, plant=plant, axes=tuple(replace(a, input=None) for a in cart.axes))
    for machine, signals, numbers in ((cart, True, True), (replace(cart, driven=False), True, False), (free, False, False)):
        kinds = {(h.physics, h.notes.get("variant", "")) for h in offered(machine).values()}
        assert {("sensor_drift", "") in kinds, ("constant_load", "drifting") in kinds} == {signals}
        assert {name in {k for k, _ in kinds} for name in ("parameter_drift", "parameter_step")} == {numbers}
        assert ("constant_load", "") in kinds


@pytest.mark.parametrize(("mean", "rms", "peak"), [(0.0, 1.0, 3.0), (50.0, 2.0, 57.0), (0.0, 1.0, 0.5)])
def test_no_term_of_a_curve_of_a_sensor_exceeds_the_reading_at_its_peak(mean, rms, peak):
    cart = machines()[CART]
    h = offered(replace(cart, outputs=(replace(cart.outputs[0], mean=mean, rms=rms, peak=peak),)))[f"sensor_nonlinearity@output:{cart.outputs[0].name}"]
    square, cube, size = h.parameters
    for most in ((square.high, 0.0), (square.low, 0.0), (0.0, cube.high), (0.0, cube.low)):
        out = np.zeros(1)
        h.law(np.array([*most, size.low]), np.array([max(peak, rms)]), np.zeros(0), 0.1, out)
        assert abs(out[0]) == pytest.approx(max(peak, rms))


def one_sided(machine: Machine, kind: str) -> Machine:
    """Return the machine with its "inputs", "outputs" or "states" of one sign about 10."""
    def moved(size):
        return replace(size, mean=10.0, peak=10.0 + 3 * size.rms, reverses=False)

    axes = machine.axes
    if kind == "states":
        axes = tuple(replace(a, rate=moved(a.rate), position=a.position and moved(a.position)) for a in axes)
    return replace(machine, axes=axes, **{kind: tuple(map(moved, getattr(machine, kind)))})


@pytest.mark.parametrize(("number", "kind", "keys"), [
    (MOTOR, "inputs", {"static_nonlinearity@input:voltage#about the operating point"}),
    (MOTOR, "states", {"quadratic_damping@state:w#in place of a line"}),
    (MOTOR, "outputs", {"sensor_nonlinearity@output:w#about the operating point"}),
    (ARM, "states", {"quadratic_damping@state:w#in place of a line", "quadratic_stiffness@state:w#about the operating point"}),
    (TANKS, "states", {"static_nonlinearity@state:h1#about the operating point", "static_nonlinearity@state:h2#about the operating point"}),
])  # fmt: skip
def test_laws_about_an_operating_point_are_offered_where_a_signal_has_one_sign(number, kind, keys):
    found = offered(one_sided(machines()[number], kind))
    for offers, expected in ((offered(machines()[number]), set()), (found, keys)):
        assert {k for k in offers if "operating point" in k or ("damping" in k and "in place of a line" in k)} == expected
    assert all(any(c.name == "operating point" and c.low == 10.0 and not c.free for c in found[k].parameters) for k in keys)


def test_a_cubic_spring_is_held_where_its_position_has_one_sign():
    arm = machines()[ARM]
    for machine, held in ((arm, 0.0), (one_sided(arm, "states"), 10.0)):
        h = offered(machine)["cubic_stiffness@state:w#about another centre"]
        assert (h.parameters[2].low, (h.parameters[1].low + h.parameters[1].high) / 2) == pytest.approx((held, held))


def test_a_sensor_curve_about_an_operating_point_adds_nothing_there_and_curves_beside_it():
    """Oracle: the formula, at once."""
    h = offered(one_sided(machines()[MOTOR], "outputs"))["sensor_nonlinearity@output:w#about the operating point"]
    for reading, added in ((10.0, 0.0), (12.0, (0.3 * 1 + 0.1 * 1) * 2), (6.0, (0.3 * 4 - 0.1 * 8) * 2)):
        out = np.zeros(1)
        h.law(np.array([0.3, 0.1, 2.0, 10.0, 0.0]), np.array([reading]), np.zeros(0), 0.1, out)
        assert out[0] == pytest.approx(added)
