"""Physical parameters pulled out of a build function, against plants built anew at the changed values."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from afdsvc.errors import BadInput, IllConditioned
from afdsvc.lti.lft import AugmentedPlant
from afdsvc.lti.parametric import parametric_plant
from afdsvc.lti.sampled_lft import sample_augmented
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.statespace import StateSpace

VALUES = {
    "m1": 2.0,
    "m2": 0.5,
    "k1": 900.0,
    "k2": 400.0,
    "c1": 0.6,
    "c2": 0.2,
    "motor": 3.0,
    "lag": 0.02,
    "speed": 40.0,
}
NAMES = tuple(VALUES)


def two_masses(p: Mapping[str, float]) -> StateSpace:
    """Two masses on springs, driven through a lag, with gyroscopic coupling: products and quotients of parameters."""
    k1, k2, c1, c2, g = p["k1"], p["k2"], p["c1"], p["c2"], 0.01 * p["speed"]
    A = np.array(
        [
            [0, 0, 1, 0, 0],
            [0, 0, 0, 1, 0],
            [-(k1 + k2) / p["m1"], k2 / p["m1"], -(c1 + c2) / p["m1"], (c2 + g) / p["m1"], p["motor"] / p["m1"]],
            [k2 / p["m2"], -k2 / p["m2"], (c2 - g) / p["m2"], -c2 / p["m2"], 0],
            [0, 0, 0, 0, -1 / p["lag"]],
        ]
    )
    B = np.array([[0.0], [0.0], [0.0], [0.0], [1 / p["lag"]]])
    C = np.vstack([[1.0, 0.0, 0.0, 0.0, 0.0], A[2]])  # a position and an accelerometer
    return StateSpace.of(A, B, C, [[0.0], [0.0]])


def changed(theta: Mapping[str, float]) -> StateSpace:
    return two_masses({name: value * (1 + theta.get(name, 0.0)) for name, value in VALUES.items()})


def agree(found: StateSpace, wanted: StateSpace, tolerance: float) -> None:
    for name in "ABCD":
        a, b = getattr(found, name), getattr(wanted, name)
        assert np.abs(a - b).max() <= tolerance * max(np.abs(b).max(), 1e-300), name


@settings(max_examples=60, deadline=None, derandomize=True)
@given(theta=st.dictionaries(st.sampled_from(NAMES), st.floats(-0.8, 0.8), min_size=1))
def test_any_combination_at_any_severity_agrees_with_building_anew(theta: dict[str, float]) -> None:
    augmented = parametric_plant(two_masses, VALUES, sorted(theta))
    agree(augmented.close(theta), changed(theta), 1e-12)
    agree(augmented.plant, two_masses(VALUES), 0.0)


def test_channels_are_as_few_as_the_physics_has() -> None:
    """A spring, a damper, a motor constant enter through one force each; a mass carries one acceleration."""
    augmented = parametric_plant(two_masses, VALUES, NAMES)
    widths = dict(zip(augmented.fault_names, augmented.widths, strict=True))
    assert widths["k1"] == widths["k2"] == widths["c1"] == widths["m1"] == widths["m2"] == widths["lag"] == 1
    assert widths["speed"] == 2


@settings(max_examples=15, deadline=None, derandomize=True)
@given(theta=st.dictionaries(st.sampled_from(NAMES), st.floats(-0.8, 0.5), min_size=1, max_size=4))
def test_sampled_faults_agree_with_sampling_the_changed_plant(theta: dict[str, float]) -> None:
    sampled = sample_augmented(parametric_plant(two_masses, VALUES, sorted(theta)), 0.005)
    agree(sampled.plant, sample_zoh(two_masses(VALUES), 0.005), 1e-14)
    agree(sampled.close(theta), sample_zoh(changed(theta), 0.005), 1e-11)


def test_sampled_gain_faults_keep_one_channel_and_are_exact() -> None:
    sites = {"drive": ("input", 0), "encoder": ("output", 1)}
    augmented = parametric_plant(two_masses, VALUES, ["k1"]).with_gain_faults(sites, ["drive", "k1", "encoder"])
    sampled = sample_augmented(augmented, 0.005)
    assert sampled.widths[0] == sampled.widths[2] == 1
    wanted = sample_zoh(changed({"k1": -0.4}), 0.005)
    sensors = np.diag([1.0, 0.25])
    found = sampled.close({"drive": -0.5, "k1": -0.4, "encoder": -0.75})
    agree(found, StateSpace(wanted.A, 0.5 * wanted.B, sensors @ wanted.C, 0.5 * sensors @ wanted.D, 0.005), 1e-12)


def test_a_power_and_a_square_of_a_quotient() -> None:
    def build(p: Mapping[str, float]) -> StateSpace:
        return StateSpace.of([[-(p["a"] ** 3)]], [[p["b"] * p["a"]]], [[1 / p["b"] ** 2]])

    augmented = parametric_plant(build, {"a": 1.5, "b": 2.0}, ["a", "b"])
    agree(augmented.close([0.3, -0.4]), build({"a": 1.95, "b": 1.2}), 1e-12)


def test_refusals_say_what_is_wrong() -> None:
    with pytest.raises(BadInput, match="no parameter 'm3'; it has m1"):
        parametric_plant(two_masses, VALUES, ["m3"])
    with pytest.raises(BadInput, match="parameter 'k1' is 0"):
        parametric_plant(two_masses, {**VALUES, "k1": 0.0}, ["k1"])

    def rough(p: Mapping[str, float]) -> StateSpace:
        return StateSpace.of([[-abs(p["a"] - 1.0)]], [[1.0]], [[1.0]])

    with pytest.raises(BadInput, match="parameter 'a' does not enter the plant as a sum of powers"):
        parametric_plant(rough, {"a": 1.1}, ["a"])


def test_faults_too_fast_for_the_sample_time_are_refused() -> None:
    fast = parametric_plant(two_masses, {**VALUES, "lag": 1e-5}, ["lag"])
    with pytest.raises(IllConditioned, match="too fast for the sample time"):
        sample_augmented(fast, 0.005)


def test_no_parameters_is_the_plant_itself() -> None:
    empty = parametric_plant(two_masses, VALUES, [])
    assert isinstance(empty, AugmentedPlant)
    assert empty.channels == 0
