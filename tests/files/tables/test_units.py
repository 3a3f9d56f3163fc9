"""Units: conversions against the definitions of the units, spellings, and what is refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from afdsvc.errors import BadInput
from afdsvc.files.tables.units import converted, product, same_unit

KNOWN = [
    ("rpm", "rad/s", 2 * np.pi / 60), ("deg", "rad", np.pi / 180), ("inch", "mm", 25.4), ("lbf", "N", 4.4482216152605),
    ("cycle/s", "rad/s", 2 * np.pi), ("um", "m", 1e-6), ("mV", "V", 1e-3), ("bar", "Pa", 1e5), ("kHz", "Hz", 1e3), ("min", "s", 60.0),
]  # fmt: skip


@pytest.mark.parametrize(("source", "target", "factor"), KNOWN)
def test_a_unit_is_converted_by_its_definition(source, target, factor):
    values = np.array([-2.0, 0.0, 1.0, 3.5])
    np.testing.assert_allclose(converted(values, source, target, "here"), factor * values, rtol=1e-14)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1), st.sampled_from(KNOWN))
def test_there_and_back_is_where_it_began(values, units):
    source, target, _ = units
    there = converted(np.array(values), source, target, "here")
    np.testing.assert_allclose(converted(there, target, source, "here"), values, rtol=1e-13, atol=1e-300)


def test_temperatures_are_points_on_a_scale():
    np.testing.assert_allclose(converted(np.array([0.0, 100.0]), "degC", "K", "here"), [273.15, 373.15])


def test_one_unit_in_two_spellings_leaves_every_bit():
    values = np.random.default_rng(0).standard_normal(9)
    for other in ("um", "µm", "micrometer"):
        assert same_unit("um", other, "here")
        assert converted(values, "um", other, "here") is values


def test_a_product_has_the_unit_of_the_product():
    assert same_unit(product("A", "N/A", "here"), "N", "here")


@pytest.mark.parametrize(
    ("source", "target", "said"),
    [
        ("m", "N", "here: 'm' cannot become 'N': their dimensions differ"),
        ("furlongs_of_mine", "m", "here: unit 'furlongs_of_mine' is not known"),
        ("m/(", "m", "unit 'm/\\(' is not known"),
        ("Hz", "rad/s", "differ by 2 pi or not.*'cycle/s'"),
        ("rpm", "Hz", "differ by 2 pi or not"),
    ],
)
def test_what_is_wrong_or_ambiguous_is_refused(source, target, said):
    with pytest.raises(BadInput, match=said):
        converted(np.ones(2), source, target, "here")
