"""Where laws are offered, and that their ranges follow the sizes in the data."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from afdsvc.api.physics import Machine
from afdsvc.explain.search.ranking import mechanism
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics import BUILT_IN
from afdsvc.plugins.physics.attach import quantity, radians, summed
from afdsvc.plugins.physics.back_emf import BackEmf
from afdsvc.plugins.physics.cogging import Cogging
from afdsvc.testing.conformance.physics import machines

ROTOR, BLACK_BOX, MOTOR, ARM, MAGNET, TANKS, STRUCTURE, DAMPER, SHAFT, TWISTED, COIL, GIMBAL, CART, REACTOR = range(14)


def offered(machine: Machine) -> dict:
    return {h.key: h for physics in BUILT_IN for h in physics().hypotheses(machine)}


@pytest.mark.parametrize(("machine", "keys"), [
    (MOTOR, "actuator_lag@input:voltage asymmetric_damping@state:w back_emf@input:voltage back_emf@input:voltage#the model's damping"),
    (MOTOR, "coulomb_friction@state:w coulomb_friction@state:w#asymmetric coulomb_friction@state:w#presliding"),
    (MOTOR, "coulomb_friction@state:w#grows with the input stribeck_friction@state:w stribeck_friction@state:w#presliding"),
    (MOTOR, "quadratic_damping@state:w cubic_damping@state:w constant_load@state:w constant_load@state:w#drifting"),
    (MOTOR, "flexible_mode@state:w#attached mass flexible_mode@state:w#divided in 2 flexible_mode@state:w#divided in 3"),
    (MOTOR, "saturation@state:w saturation@input:voltage#asymmetric saturation@input:voltage#above saturation@input:voltage#below dead_zone@input:voltage#asymmetric supply_droop@input:voltage"),
    (MOTOR, "quantisation@input:voltage parameter_change@state:w#mass parameter_change@state:w#damping sensor_drift@output:w"),
    (MOTOR, "sensor_saturation@output:w sensor_saturation@output:w#above sensor_saturation@output:w#asymmetric"),
    (ARM, "gravity@state:w gravity@state:w#sine in place of a line cogging@state:w gain_follows_position@input:torque#w"),
    (ARM, "coulomb_friction@state:w#along the way coulomb_friction@state:w#grows with the transmitted force"),
    (MAGNET, "magnetic_force@state:v magnetic_force@state:v#pair"),
    (TANKS, "saturation@state:h1#gradual saturation@state:h2#gradual"),
    (TANKS, "saturation@state:h1 saturation@state:h2 slow_mode@state:h1 static_nonlinearity@state:h1#outflow"),
    (TANKS, "static_nonlinearity@state:h2#outflow about a level constant_load@input:pump static_nonlinearity@input:pump#thrust"),
    (TANKS, "gain_follows_level@state:h1#pump gain_follows_level@state:h1#pump, flow from a supply"),
    (COIL, "slow_mode@state:i saturation@state:i#gradual both ways gain_follows_level@state:i#voltage clearance@state:v#stop above clearance@state:v#stop below"),
    (TANKS, "static_nonlinearity@input:pump#power static_nonlinearity@input:pump#power from a threshold"),
    (STRUCTURE, "clearance@machine#between v1,v2 clearance@machine#between v1,v2,v3 coulomb_friction@machine#between v1,v3"),
    (STRUCTURE, "coulomb_friction@machine#slip between v2,v3 cubic_stiffness@machine#between v1,v2 quadratic_stiffness@machine#between v1,v2,v3"),
    (ARM, "clearance@state:w#play in the spring cubic_stiffness@state:w#about another centre"),
    (MOTOR, "clock_offset@input:voltage cogging@state:w encoder_error@output:w"),
    (SHAFT, "encoder_error@output:motor encoder_error@output:load"),
    (COIL, "encoder_error@output:q cogging@state:v gain_follows_position@state:v#i magnetic_force@state:v magnetic_force@state:v#pair"),
    (ROTOR, "clock_offset@machine clock_offset@input:horizontal clock_offset@input:vertical"),
    (SHAFT, "clearance@machine#play in the spring between w1,w2 clearance@machine#between w1,w2 cubic_stiffness@machine#between w1,w2"),
    (MOTOR, "static_nonlinearity@input:voltage#two slopes actuator_lag@input:voltage#rising and falling actuator_lag@state:w#rising and falling"),
    (MOTOR, "saturation@input:voltage#falls with w slew_limit@input:voltage slew_limit@state:w"),
    (COIL, "coulomb_friction@state:v#grows with i"),
    (ROTOR, "supply_droop@machine#horizontal,vertical supply_droop@input:horizontal supply_droop@input:vertical"),
    (TANKS, "exchange@machine#between h1,h2 exchange@machine#turbulent, between h1,h2"),
    (ARM, "parameter_drift@state:w#mass parameter_drift@state:w#damping parameter_drift@input:torque#actuator gain parameter_drift@output:q#sensor gain"),
    (TANKS, "parameter_drift@state:h1#loss parameter_drift@state:h2#capacity"),
    (ARM, "parameter_step@state:w#mass parameter_step@state:w#damping parameter_step@input:torque#actuator gain parameter_step@output:q#sensor gain"),
    (ARM, "offset_step@state:w offset_step@output:q"),
    (TANKS, "offset_step@input:pump offset_step@output:h2"),
    (REACTOR, "parameter_step@parameter:volume#volume parameter_step@parameter:rate#rate parameter_step@input:jacket#actuator gain"),
    (REACTOR, "parameter_drift@parameter:volume#volume parameter_drift@parameter:rate#rate parameter_drift@input:jacket#actuator gain"),
    (MOTOR, "sensor_ac_coupling@output:w transport_delay@output:w#mean over a window transport_delay@input:voltage#mean over a window"),
    (CART, "linear_stiffness@state:v viscous_damping@state:v repulsion@state:v#from above repulsion@state:v#from below"),
    (COIL, "voltage_drop@state:i#voltage self_heating@state:i#voltage parameter_follows_state@state:i#inductance"),
    (REACTOR, "parameter_follows_state@parameter:rate#temperature parameter_follows_state@parameter:volume#concentration"),
    (SHAFT, "asymmetric_damping@machine#between w1,w2 quadratic_damping@machine#between w1,w2 coulomb_friction@machine#a spring that slips between w1,w2"),
    (TWISTED, "asymmetric_damping@machine#between w1,w2 clearance@machine#play in the spring between w1,w2 coulomb_friction@machine#slip between w1,w2 cubic_stiffness@machine#between w1,w2"),
    (ROTOR, "actuator_crosstalk@state:vx#vertical actuator_crosstalk@state:vy#horizontal"),
    (GIMBAL, "inertia_follows_position@machine#turn_rate by tilt_rate actuator_crosstalk@state:turn_rate#tilt_current"),
    (DAMPER, "hysteresis@input:speed hysteresis@output:force#speed coulomb_friction@output:force#speed saturation@state:force"),
])
def test_a_machine_is_offered_what_it_may_have(machine, keys):
    known = offered(machines()[machine])
    names = [" ".join(w) for w in _split(keys)]
    assert [k for k in names if k not in known] == []


def _split(text: str) -> list[list[str]]:
    """Cut at words that hold an @: variants may hold blanks."""
    words: list[list[str]] = []
    for word in text.split():
        if "@" in word:
            words.append([])
        words[-1].append(word)
    return words


def test_a_step_is_short_and_away_from_the_ends_and_a_number_keeps_its_sign():
    h = offered(replace(machines()[ARM], span=(100.0, 200.0)))["parameter_step@input:torque#actuator gain"]
    change, moment, takes, *_ = h.parameters
    assert (change.low, change.high, moment.low, moment.high, takes.high, takes.decisive) == (-0.99, 1.0, 110.0, 190.0, 25.0, True)


@pytest.mark.parametrize("physics", ["parameter_drift", "parameter_step"])
def test_numbers_of_code_change_by_name_and_not_as_forces_of_its_linearisation(physics):
    drifts = {k for k in offered(machines()[REACTOR]) if k.startswith(physics)}
    assert {k.partition("@")[2].partition(":")[0] for k in drifts} == {"input", "output", "parameter"}
    arm = {k for k in offered(replace(machines()[ARM], code=True)) if k.startswith(physics)}
    assert {k.partition("@")[2].partition(":")[0] for k in arm} == {"input", "output"}


def test_every_resonance_ends_where_its_damping_does():
    for k in (MOTOR, ARM, STRUCTURE):
        modes = [h for h in offered(machines()[k]).values() if h.physics == "flexible_mode"]
        assert modes
        assert all([c.name for c in h.parameters if c.decisive] == [c.name for c in h.parameters if c.name.startswith("damping ratio")] != [] for h in modes)


def test_what_repeats_with_every_turn_needs_a_turn_or_a_speed_that_the_samples_resolve():
    arm, motor = machines()[ARM], machines()[MOTOR]
    assert "encoder_error@output:q" not in offered(arm)  # swings by less than a turn
    turning = replace(arm.outputs[0], rms=2.0, peak=4.0)
    assert "encoder_error@output:q" in offered(replace(arm, outputs=(turning,)))
    plant = StateSpace(arm.plant.A, arm.plant.B, np.eye(2), np.zeros((2, 1)))
    both = replace(
        arm, outputs=(turning, arm.states[1]), states=(turning, arm.states[1]), axes=(replace(arm.axes[0], position=turning),), plant=plant,
        residual=np.array([0.04, 0.3]),
    )
    assert "encoder_error@machine#q and w" in offered(both)
    starts = offered(motor)["encoder_error@output:w"].starts
    assert [s[0] for s in starts] == list(range(1, 1 + int(np.pi / (20.0 * motor.dt))))
    fast = replace(motor, outputs=(replace(motor.outputs[0], rms=400.0),))
    assert "encoder_error@output:w" not in offered(fast)


def test_a_speed_is_not_read_with_play():
    motor, arm = offered(machines()[MOTOR]), offered(machines()[ARM])
    assert [k for k in motor if k.startswith("backlash")] == ["backlash@input:voltage"]
    assert "backlash@output:q" in arm


def test_laws_of_two_directions_need_both():
    motor = machines()[MOTOR]
    speed = replace(motor.outputs[0], reverses=False)
    one_way = replace(motor, outputs=(speed,), states=(speed,), axes=(replace(motor.axes[0], rate=speed),))
    assert set(offered(motor)) - set(offered(one_way)) >= {"sensor_rectification@output:w", "asymmetric_damping@state:w"}


def test_a_joint_of_two_masses_is_sized_by_their_difference():
    machine = machines()[SHAFT]
    gap = offered(machine)["clearance@machine#play in the spring between w1,w2"].parameters[1]
    assert gap.high == pytest.approx(3 * machine.deflections[0, 2].peak)
    assert gap.high < 0.1 * machine.states[0].rms


def test_waves_that_the_residual_shows_are_starts():
    coil = machines()[COIL]
    numbers = {k: [s[0] for s in h.starts] for k, h in offered(coil).items() if k in ("encoder_error@output:q", "cogging@state:v")}
    assert numbers["encoder_error@output:q"] == [3.1]  # of the other the way of 11.6 mm does not hold two periods
    port = coil.outputs[0]
    far = replace(port, peak=1.5 * port.peak)
    further = offered(replace(coil, outputs=(far,)))["encoder_error@output:q"]
    assert [s[0] for s in further.starts] == [3.1, 0.8]
    assert further.parameters[0].low * 2 * (far.peak - abs(far.mean)) == pytest.approx(4 * np.pi)
    assert 3.1 in numbers["cogging@state:v"]
    assert "encoder_error@output:q" not in offered(replace(coil, waves={}))
    assert not any(3.1 in [s[0] for s in h.starts] for h in offered(replace(coil, waves={})).values() if h.physics == "cogging")


def test_a_coil_is_the_state_that_pushes_an_axis_without_an_input_most():
    coil = machines()[COIL]
    assert coil.plant is not None
    gain = offered(coil)["gain_follows_position@state:v#i"]
    assert [(s.kind, s.index) for s in (*gain.reads, *gain.writes)] == [("x", 0), ("x", 1), ("x", 2), ("x", 2), ("x", 0)]
    assert [c.low for c in gain.parameters[-2:]] == [4e5, -1.4]
    pull = offered(coil)["magnetic_force@state:v"]
    assert [(s.kind, s.index) for s in pull.reads] == [("x", 0), ("x", 1)]
    assert [c.low for c in pull.parameters if c.name == "gain"] == [4e5]
    without = StateSpace(coil.plant.A * [[1, 1, 0], [1, 1, 1], [1, 1, 1]], coil.plant.B, coil.plant.C, coil.plant.D)
    assert len(offered(replace(coil, plant=without))["gain_follows_position@state:v#i"].writes) == 1  # nothing is induced
    moved = StateSpace(coil.plant.A * [[1, 1, 1], [1, 1, 1], [0, 1, 1]], coil.plant.B, coil.plant.C, coil.plant.D)
    assert not {"gain_follows_position", "magnetic_force"} & {h.physics for h in offered(replace(coil, plant=moved)).values()}
    newtons = replace(coil, states=(replace(coil.states[0], unit="N"), *coil.states[1:]))
    assert "magnetic_force" not in {h.physics for h in offered(newtons).values()}
    pushed = replace(coil, inputs=(replace(coil.inputs[0], unit="N"),), axes=(replace(coil.axes[0], input=0),))
    assert "magnetic_force" not in {h.physics for h in offered(pushed).values()}  # an input acts at once


def test_a_joint_begins_at_the_ratio_of_masses_that_the_model_has():
    """Its force on one mass is that on the other, or both drift; its damper acts where its spring does."""
    machine = machines()[SHAFT]
    assert machine.plant is not None
    A = machine.plant.A
    for key in ("clearance@machine#play in the spring between w1,w2", "cubic_stiffness@machine#between w1,w2"):
        h = offered(machine)[key]
        at = [c.name for c in h.parameters].index("mass ratio")
        assert {s[at] for s in h.starts} == {A[3, 0] / A[1, 2]}
    play = offered(machine)["clearance@machine#play in the spring between w1,w2"]
    assert play.parameters[2].low == A[1, 3] / A[1, 2]
    assert [(s.kind, s.index) for s in play.reads] == [("x", 0), ("x", 2), ("x", 1), ("x", 3)]


def test_a_shaft_is_the_same_joint_by_its_angles_and_by_its_twist():
    """Laws between its ends, called with the same motion: what they add to both velocities is the same."""
    by_angle, by_twist = (offered(machines()[k]) for k in (SHAFT, TWISTED))
    between = {k for k in by_angle if "between" in k and k.startswith(("asymmetric", "clearance", "coulomb", "cubic", "quadratic"))}
    assert len(between) == 9
    assert between <= set(by_twist)
    speeds = (2.0, 1.7)
    for key, angles in product(between, [(1.03, 0.97), (1.005, 0.995)]):  # beyond the gap and inside
        values = {"x": {0: angles[0], 2: angles[1], 1: speeds[0], 3: speeds[1]}}, {"x": {2: angles[0] - angles[1], 0: speeds[0], 1: speeds[1]}}
        added = []
        for h, x in zip((by_angle[key], by_twist[key]), values, strict=True):
            p = [{"stiffness": 700.0, "gap": 0.02, "damping over stiffness": 0.02, "stiffness lost": 500.0, "width": 0.01, "force": 3.0, "rounding": 0.1, "damping forwards": 5.0, "damping backwards": 2.0, "drag": 4.0}.get(c.name, s) for c, s in zip(h.parameters, h.starts[0], strict=True)]
            out = np.zeros(2)
            h.law(p, [x[s.kind][s.index] for s in h.reads], np.zeros(max(h.memory, 1)), 1e-3, out)
            added.append(out)
        assert added[0] == pytest.approx(added[1]), key
        assert added[0][0] * added[0][1] < 0 or angles[0] < 1.01, key
        assert added[0][1] == pytest.approx(-added[0][0] / 3), key  # the second mass is three times the first


@pytest.mark.parametrize("entry", [(2, 1, -0.9), (2, 2, -5.0), (0, 2, 900.0), (1, 2, -300.0)])
def test_a_state_whose_rate_is_no_difference_of_speeds_or_that_pulls_nothing_together_is_no_twist(entry):
    machine = machines()[TWISTED]
    assert machine.plant is not None
    i, j, value = entry
    A = machine.plant.A.copy()
    A[i, j] = value
    changed = replace(machine, plant=StateSpace(A, machine.plant.B, machine.plant.C, machine.plant.D))
    assert [k for k in offered(machine) if "between w1,w2" in k]
    assert not [k for k in offered(changed) if "between w1,w2" in k]


def test_dampers_between_masses_need_a_spring_of_the_model():
    assert not any("between" in k for k in offered(machines()[STRUCTURE]) if "damping" in k)


def test_play_needs_a_spring_of_the_model():
    machine = machines()[ARM]
    assert machine.plant is not None
    free = StateSpace(machine.plant.A * [[1, 1], [0, 1]], machine.plant.B, machine.plant.C, machine.plant.D)
    assert not [k for k in offered(replace(machine, plant=free)) if "play in the spring" in k]


def test_a_speed_alone_has_no_law_of_the_position():
    positions = {"clearance", "cubic_stiffness", "quadratic_stiffness", "gravity", "magnetic_force", "gain_follows_position", "cross_coupled_stiffness"}
    assert not positions & {h.physics for h in offered(machines()[MOTOR]).values()}


def test_a_motor_whose_angle_is_recorded_may_cog():
    motor = machines()[MOTOR]
    angle = replace(machines()[ROTOR].aux["angle"], index=0)
    cogging = offered(replace(motor, aux={"angle": angle}))["cogging@state:w"]
    assert cogging.reads[0].kind == "aux"


def test_curves_without_a_mechanism_are_marked():
    marked = {h.physics for m in machines() for h in offered(m).values() if h.description}
    assert marked == {"static_nonlinearity", "sensor_nonlinearity", "cubic_damping", "parameter_follows_state"}
    arm = offered(machines()[ARM])
    assert [arm[f"static_nonlinearity@input:torque#{v}"].description for v in ("cube", "power", "thrust", "thrust of a rotor")] == [True, True, False, False]


def test_gains_share_a_gauge():
    motor = offered(machines()[MOTOR])
    gauges = {k: h.notes.get("gauge") for k, h in motor.items() if h.physics == "parameter_change"}
    assert gauges["parameter_change@input:voltage#actuator gain"] == gauges["parameter_change@output:w#sensor gain"] is not None
    assert gauges["parameter_change@state:w#damping"] is None


@pytest.mark.parametrize("number", [ROTOR, BLACK_BOX, MOTOR, MAGNET, TANKS, STRUCTURE, DAMPER])
def test_ranges_follow_the_sizes_in_the_data(number):
    """In other units of input, states and output every parameter is the same multiple of its scale; ripples count turns, whose unit is fixed."""
    machine = machines()[number]
    plain, scaled = ({k: h for k, h in offered(m).items() if h.family != "ripple"} for m in (machine, in_other_units(machine, 7.0, 1e-3, 300.0)))
    assert plain.keys() == scaled.keys()
    for key, h in plain.items():
        for j, (a, b) in enumerate(zip(h.parameters, scaled[key].parameters, strict=True)):
            before = np.array([a.low, a.high, *(s[j] for s in h.starts)]) / a.scale
            after = np.array([b.low, b.high, *(s[j] for s in scaled[key].starts)]) / b.scale
            assert after == pytest.approx(before, rel=1e-9, abs=1e-12), f"{key}: {a.name}"


def in_other_units(machine: Machine, u: float, x: float, y: float) -> Machine:
    def times(size, by):
        return replace(size, mean=size.mean * by, rms=size.rms * by, peak=size.peak * by, step=size.step * by)

    states = tuple(times(s, x) for s in machine.states)
    axes = tuple(
        replace(a, position=a.position and states[a.position.index], rate=states[a.rate.index], push=a.push * x, gain=a.gain * x / u)
        for a in machine.axes
    )
    plant = StateSpace(machine.plant.A, machine.plant.B * x / u, machine.plant.C * y / x, machine.plant.D * y / u)
    return replace(
        machine, inputs=tuple(times(s, u) for s in machine.inputs), outputs=tuple(times(s, y) for s in machine.outputs), states=states,
        axes=axes, plant=plant, residual=machine.residual * y,
    )


@pytest.mark.parametrize(("unit", "kind"), [
    ("m", "length"), ("um", "length"), ("deg", "angle"), ("rad", "angle"), ("cm/s", "velocity"), ("rpm", "velocity"), ("deg/s", "velocity"),
    ("N m", "force"), ("kN", "force"), ("mA", "current"), ("V", "voltage"), ("Hz", ""), ("1/s", ""), ("", ""), ("parrots", ""), ("K", ""),
])
def test_units_say_what_is_measured(unit, kind):
    assert quantity(unit) == kind


def test_units_of_what_a_velocity_sums_up_to():
    assert (summed("rad/s"), summed("rpm"), summed("")) == ("rad", "(rpm) s", "s")
    assert radians("deg") == pytest.approx(np.pi / 180)


def test_cogging_is_offered_where_two_periods_were_travelled():
    """In less nothing repeats: a force that falls along the way would be a wave."""
    offers = [(m, h) for m in machines() for h in Cogging().hypotheses(m) if h.reads[0].kind == "x"]
    assert offers
    for machine, h in offers:
        where = machine.states[h.reads[0].index]
        travel = 2 * (where.peak - abs(where.mean))
        assert min(h.parameters[0].low, *(start[0] for start in h.starts)) * travel >= 4 * np.pi * (1 - 1e-12)


def test_a_spring_or_a_damper_is_offered_where_the_model_has_none():
    arm = machines()[ARM]
    assert {"linear_stiffness@state:w", "viscous_damping@state:w"}.isdisjoint(offered(arm))
    for key, entry in (("linear_stiffness@state:w", (1, 0)), ("viscous_damping@state:w", (1, 1))):
        A = arm.plant.A.copy()
        A[entry] = 0.0
        h = offered(replace(arm, plant=replace(arm.plant, A=A)))[key]
        built = h.linear(replace(arm.plant, A=A), [7.0])
        assert built.A[entry] == -7.0
        assert np.count_nonzero(built.A != A) == 1


@pytest.mark.parametrize(("change", "offers"), [
    ({}, True), ({"inputs": "N"}, True), ({"states": ""}, True), ({"inputs": "N", "states": ""}, False), ({"reverses": False}, False),
])  # fmt: skip
def test_a_voltage_drops_where_a_current_takes_both_signs(change, offers):
    """The unit of the current or that of the voltage says that it is one."""
    coil = machines()[COIL]
    current = replace(coil.states[0], unit=change.get("states", "A"), reverses=change.get("reverses", True))
    machine = replace(coil, states=(current, *coil.states[1:]), inputs=(replace(coil.inputs[0], unit=change.get("inputs", "V")),))
    assert ("voltage_drop@state:i#voltage" in offered(machine)) == offers


def test_stores_that_the_model_joins_are_not_joined_again_and_the_flow_is_that_of_the_matrices():
    tanks = machines()[TANKS]
    h = offered(tanks)["exchange@machine#between h1,h2"]
    built, out = h.linear(tanks.plant, [0.3, 0.5]), np.zeros(2)
    h.law(np.array([0.3, 0.5]), np.array([2.0, 1.2]), np.zeros(1), 1.0, out)
    assert (built.A - tanks.plant.A) @ [2.0, 1.2] == pytest.approx(out)
    both = tanks.plant.A.copy()
    both[0, 1] = 0.01
    assert not any(k.startswith("exchange") for k in offered(replace(tanks, plant=replace(tanks.plant, A=both))))
    other = replace(tanks, states=(tanks.states[0], replace(tanks.states[1], unit="K")))
    assert not any(k.startswith("exchange") for k in offered(other))


def test_forces_are_stated_by_the_size_of_the_gain_and_shares_of_inputs_with_its_sign():
    friction, share = (offered(machines()[k])[key].parameters[0] for k, key in ((ARM, "coulomb_friction@state:w"), (GIMBAL, "actuator_crosstalk@state:turn_rate#tilt_current")))
    assert (friction.through, friction.unsigned) == ((1, 0), True)
    assert (share.through, share.unsigned) == ((2, 1), False)


def test_no_gain_follows_a_level_that_no_input_drives_at_once():
    assert not any(k.startswith("gain_follows_level@state:h2") for k in offered(machines()[TANKS]))


def test_shapes_of_a_stop_are_one_mechanism_and_inputs_at_one_level_are_two():
    coil = offered(machines()[COIL])
    assert len({mechanism(coil[f"clearance@state:v{shape}"]) for shape in ("", "#stop above", "#stop below")}) == 1
    tanks = machines()[TANKS]
    second = replace(tanks.inputs[0], index=1, name="valve")
    plant = replace(tanks.plant, B=np.hstack([tanks.plant.B, tanks.plant.B]), D=np.zeros((1, 2)))
    gains = [h for k, h in offered(replace(tanks, inputs=(*tanks.inputs, second), plant=plant)).items() if k.startswith("gain_follows_level")]
    assert (len(gains), len({mechanism(h) for h in gains})) == (4, 2)


def test_an_axis_that_stands_still_is_offered_no_cogging():
    arm = machines()[ARM]
    (axis,) = arm.axes
    still = replace(axis, position=replace(axis.position, mean=0.0, rms=0.0, peak=0.0))
    assert not list(Cogging().hypotheses(replace(arm, axes=(still,))))


def test_a_delay_may_be_as_long_as_a_twentieth_of_the_recordings():
    """The slowest excitation does not bound it: what is late in a tube may be later than the time constant of what it feeds."""
    machine = replace(machines()[TANKS], duration=600.0, dt=1.0, bandwidth=3.0)
    delay = offered(machine)["transport_delay@input:pump"]
    assert delay.parameters[0].high == pytest.approx(30.0)
    assert max(delay.starts)[0] >= 12.0


def test_the_coil_of_an_input_that_drives_two_axes_is_one_mechanism_with_a_shape_for_each():
    motor = machines()[MOTOR]
    (axis,) = motor.axes
    coils = list(BackEmf().hypotheses(replace(motor, axes=(axis, replace(axis, rate=replace(axis.rate, name="w2"))))))
    assert len({h.key for h in coils}) == len(coils) == 4
    assert len({mechanism(h) for h in coils}) == 1


def test_starts_are_dense_where_a_fit_has_many_minima():
    """A step off by an eighth is another staircase three steps up; with play a deflection is up to three times the model's."""
    grid = offered(machines()[MOTOR])["quantisation@input:voltage"]
    assert grid.parameters[0].high == machines()[MOTOR].inputs[0].rms  # beyond it there are two or three levels
    steps = np.array(grid.starts)[:, 0]
    assert (steps[1:] / steps[:-1]).max() < 1.15
    play = offered(machines()[ARM])["clearance@state:w#play in the spring"]
    gaps = np.array(play.starts)[:, 1]
    assert gaps.max() > 0.9 * play.parameters[1].high
    assert (gaps[1:] / gaps[:-1]).max() < 4
