"""Scores of hand-made explanations."""

from __future__ import annotations

from dataclasses import asdict

import pytest

from afdsvc.trial import Hidden, Options, Oracle, TrialAnswer, score
from afdsvc.trial.matching import SAME

BEARING, AXIS = Options(), Options(machine="positioning_axis")


def effect(physics: str, site: str, parameter: str = "", in_prior: float | None = None) -> Hidden:
    return Hidden(physics, site, 0.3, 0.3, 0.3, {}, parameter, in_prior)


def answer(*hidden: Hidden, options: Options = BEARING, minor: tuple[Hidden, ...] = (), outside: bool = False) -> TrialAnswer:
    seen = {"position": 1.0} if options is AXIS else {"horizontal": 0.4, "vertical": 0.02}
    return TrialAnswer(options.machine, hidden, minor, seen, outside, "0", asdict(options))


def entry(physics: str, site: str, weight: float = 0.97, **parameters) -> dict:
    return {"physics": physics, "site": site, "weight": weight, "parameters": parameters, "sentence": ""}


def said(*entries: dict, verdict: str = "omitted_physics", **more) -> dict:
    return {"verdict": verdict, "named": list(entries), "located": [{"output": "horizontal"}], **more}


FRICTION = effect("coulomb_friction", "state:horizontal_rate")
RIGHT = entry("coulomb_friction", "state:horizontal_rate")
WRONG = entry("dead_zone", "input:horizontal")


def test_right_name_first() -> None:
    s = score(said(RIGHT), answer(FRICTION))
    assert (s.first, s.in_set, s.place, s.verdict_ok, s.false_name, s.located) == (True, True, True, True, False, True)
    assert (s.question, s.truth, s.said, s.both) == ("physics", "coulomb_friction", "coulomb_friction", None)


def test_right_name_among_the_look_alikes() -> None:
    s = score(said({**WRONG, "weight": 0.6}, {**RIGHT, "weight": 0.4}), answer(FRICTION))
    assert (s.first, s.in_set, s.place) == (False, True, False)
    assert s.false_name
    assert not s.confident_false


def test_confident_false_name_needs_weight_and_no_truth_beside_it() -> None:
    assert score(said(WRONG), answer(FRICTION)).confident_false
    assert not score(said(WRONG, RIGHT), answer(FRICTION)).confident_false
    assert not score(said({**WRONG, "weight": 0.89}), answer(FRICTION)).confident_false


def test_a_further_effect_that_is_not_there_is_distinguished_from_a_look_alike() -> None:
    further = {**WRONG, "effect": 2}
    noise = entry("coloured_noise", "output:vertical", 1.0)
    assert score(said(RIGHT, further), answer(FRICTION)).extra_false
    assert score(said(RIGHT, noise), answer(FRICTION)).extra_false
    assert not score(said(RIGHT, WRONG), answer(FRICTION)).extra_false
    assert not score(said(RIGHT, further), answer(FRICTION, effect("dead_zone", "input:horizontal"))).extra_false
    assert not score(said(RIGHT, noise), answer(FRICTION, options=Options(noise="coloured"))).extra_false
    assert not score(said(WRONG), answer()).extra_false


def test_right_name_at_the_wrong_site_is_wrong() -> None:
    s = score(said(entry("coulomb_friction", "state:vertical_rate")), answer(FRICTION))
    assert (s.first, s.in_set, s.place, s.confident_false) == (False, False, False, True)


def test_wrong_name_at_the_right_site_is_noted() -> None:
    s = score(said(entry("stribeck_friction", "state:horizontal_rate")), answer(FRICTION))
    assert (s.first, s.place) == (False, True)


@pytest.mark.parametrize("verdict", ["consistent", "unexplained", "insufficient_excitation", "error"])
def test_names_without_a_naming_verdict_do_not_count(verdict: str) -> None:
    s = score(said(RIGHT, verdict=verdict), answer(FRICTION))
    assert (s.first, s.in_set, s.verdict_ok, s.false_name, s.said) == (False, False, False, False, verdict)


def test_nothing_hidden_wants_consistent() -> None:
    good = score({"verdict": "consistent", "named": []}, answer())
    assert (good.verdict_ok, good.first, good.false_name, good.located, good.truth) == (True, None, False, None, "nothing")
    bad = score(said(WRONG), answer())
    assert (bad.verdict_ok, bad.false_name, bad.confident_false) == (False, True, True)


def test_outside_wants_unexplained_and_the_right_place() -> None:
    hidden = answer(effect("memory_polynomial", "input:horizontal"), outside=True)
    good = score({"verdict": "unexplained", "named": [], "located": [{"output": "horizontal"}]}, hidden)
    assert (good.verdict_ok, good.located, good.first) == (True, True, None)
    wrong = score({"verdict": "unexplained", "located": [{"output": "vertical"}]}, hidden)
    assert wrong.located is False
    assert score(said(WRONG), hidden).confident_false


def test_two_effects_want_both_names() -> None:
    pair = answer(FRICTION, effect("sensor_offset", "output:vertical"))
    both = score(said(RIGHT, entry("sensor_offset", "output:vertical")), pair)
    assert (both.first, both.both, both.verdict_ok) == (True, True, True)
    one = score(said(RIGHT), pair)
    assert (one.first, one.in_set, one.both) == (True, True, False)
    swapped = score(said(entry("sensor_offset", "output:vertical"), RIGHT), pair)
    assert (swapped.first, swapped.both) == (True, True)


CHANGE = effect("parameter_change", "state:horizontal_rate", "stiffness", 7.0)


def test_parameter_change_wants_the_parameter() -> None:
    right = entry("parameter_change", "state:horizontal", stiffness={"value": 0.1})
    s = score(said(right, verdict="parameter_change"), answer(CHANGE))
    assert (s.first, s.verdict_ok, s.truth, s.said) == (
        True, True, "parameter_change (stiffness)", "parameter_change (stiffness)",
    )
    other = entry("parameter_change", "state:horizontal_rate", damping={"value": 0.1})
    assert score(said(other, verdict="parameter_change"), answer(CHANGE)).first is False
    axis = entry("parameter_change", "state:vertical_rate", stiffness={})
    assert score(said(axis, verdict="parameter_change"), answer(CHANGE)).first is False


def test_parameter_change_inside_the_stated_uncertainty_may_be_consistent() -> None:
    small = answer(effect("parameter_change", "state:horizontal_rate", "stiffness", 2.0))
    assert score({"verdict": "consistent"}, small).verdict_ok
    assert score({"verdict": "consistent"}, small).first is None
    assert not score({"verdict": "consistent"}, answer(CHANGE)).verdict_ok


def test_lost_gain_accepts_the_honest_pair_only_whole() -> None:
    lost = answer(effect("parameter_change", "input:horizontal", "actuator gain", 6.0))
    sensor = entry("parameter_change", "output:horizontal", 0.55, **{"sensor gain": {}})
    actuator = entry("parameter_change", "input:horizontal", 0.45, actuator_gain={})
    assert score(said(sensor, actuator, verdict="parameter_change"), lost).first
    assert score(said(sensor, verdict="parameter_change"), lost).first is False
    vertical = {**actuator, "site": "input:vertical"}
    assert score(said(sensor, vertical, verdict="parameter_change"), lost).first is False


def test_dirt_that_is_there_is_no_false_name() -> None:
    dirty = answer(FRICTION, minor=(effect("dead_zone", "input:horizontal"),))
    s = score(said(WRONG), dirty)
    assert (s.first, s.false_name, s.confident_false) == (False, False, False)


def test_noise_that_was_put_in_may_be_named() -> None:
    noisy = answer(options=Options(noise="coloured"))
    assert not score(said(entry("coloured_noise", "output:vertical")), noisy).false_name
    assert score(said(WRONG), noisy).false_name
    assert score({"verdict": "consistent"}, noisy).verdict_ok
    quiet = answer(options=Options(noise="quieter"))
    assert score(said(entry("coloured_noise", "output:vertical")), quiet).false_name


def test_weak_excitation_may_be_said_to_be_weak() -> None:
    weak = answer(FRICTION, options=Options(excitation="sine"))
    assert score({"verdict": "insufficient_excitation"}, weak).verdict_ok
    assert score(said(WRONG), weak).confident_false
    assert not score({"verdict": "insufficient_excitation"}, answer(FRICTION)).verdict_ok


@pytest.mark.parametrize(
    ("options", "hidden", "named", "same"),
    [
        (BEARING, ("cubic_stiffness", "state:horizontal_rate"), ("cubic_stiffness", "state:horizontal"), True),
        (BEARING, ("cubic_stiffness", "state:horizontal_rate"), ("cubic_stiffness", "state:vertical"), False),
        (BEARING, ("cubic_stiffness", "state:horizontal_rate"), ("clearance", "state:horizontal_rate"), False),
        (BEARING, ("flexible_mode", "state:horizontal_rate"), ("flexible_mode", "machine"), False),
        (AXIS, ("flexible_mode", "state:v"), ("flexible_mode", "machine"), True),
        (BEARING, ("gyroscopic_coupling", "machine"), ("gyroscopic_coupling", "state:vertical_rate"), True),
        (BEARING, ("gyroscopic_coupling", "machine"), ("gyroscopic_coupling", "output:vertical"), False),
        (BEARING, ("sensor_misalignment", "machine"), ("sensor_misalignment", "output:vertical"), True),
        (BEARING, ("sensor_misalignment", "machine"), ("sensor_crosstalk", "output:vertical"), False),
        (BEARING, ("actuator_lag", "input:horizontal"), ("sensor_lag", "output:horizontal"), False),
        (AXIS, ("actuator_lag", "input:force"), ("sensor_lag", "output:position"), True),
        (AXIS, ("transport_delay", "output:position"), ("transport_delay", "input:force"), True),
        (AXIS, ("transport_delay", "output:position"), ("actuator_lag", "input:force"), False),
        (AXIS, ("constant_load", "state:v"), ("constant_load", "input:force"), True),
        (BEARING, ("constant_load", "state:horizontal_rate"), ("constant_load", "input:horizontal"), False),
        (BEARING, ("constant_load", "state:horizontal_rate"), ("sensor_offset", "output:horizontal"), False),
        (AXIS, ("dead_zone", "input:force"), ("dead_zone", "state:v"), False),
    ],
)
def test_only_the_same_effect_at_the_same_place_is_the_same(options, hidden, named, same) -> None:
    assert score(said(entry(*named)), answer(effect(*hidden), options=options)).first is same


def test_gains_of_actuator_and_sensor_are_one_factor_with_one_input_and_output() -> None:
    lost = answer(effect("parameter_change", "input:force", "actuator gain", 6.0), options=AXIS)
    assert score(said(entry("parameter_change", "output:position", gain={}), verdict="parameter_change"), lost).first


def test_every_equivalence_states_its_reason() -> None:
    assert all(len(rule.reason) > 20 for rule in SAME)
    assert len(SAME) == 6


def fit(before: float, after: float) -> dict:
    table = {"before": {"nrmse": before}, "after": {"nrmse": after}, "noise_floor_nrmse": 0.1}
    return {"fit": {"per_output": {"horizontal": table}}}


def test_held_share_of_the_oracle_is_one_for_the_oracle_itself() -> None:
    best = Oracle(before=4.0, after=1.0, floor=1.0, objective="commands")
    assert score(said(RIGHT, **fit(0.2, 0.1)), answer(FRICTION), best).held_share == pytest.approx(1.0)
    half = 0.1 * (2.5) ** 0.5
    assert score(said(RIGHT, **fit(0.2, half)), answer(FRICTION), best).held_share == pytest.approx(0.5)


def test_held_share_is_left_out_where_it_means_nothing() -> None:
    nothing_to_gain = Oracle(1.005, 1.0, 1.0, "commands")
    assert score(said(RIGHT, **fit(0.2, 0.1)), answer(FRICTION), nothing_to_gain).held_share is None
    best = Oracle(4.0, 1.0, 1.0, "commands")
    assert score(said(RIGHT), answer(FRICTION), best).held_share is None
    assert score(said(WRONG, **fit(0.2, 0.1)), answer(FRICTION), best).held_share is None
