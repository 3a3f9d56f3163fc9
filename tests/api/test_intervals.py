"""Intervals against sets of integers."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from afdsvc.api.intervals import Intervals

PAIRS = st.lists(st.tuples(st.integers(0, 60), st.integers(0, 60)), max_size=12)


@given(PAIRS, st.tuples(st.integers(0, 60), st.integers(0, 60)))
def test_as_a_set_of_integers(pairs, asked):
    found, expected = Intervals(), set()
    for start, end in pairs:
        found.add(start, end)
        expected |= set(range(start, end))
    assert {i for start, end in found.pairs() for i in range(start, end)} == expected
    assert found.covers(*asked) == (set(range(*asked)) <= expected)
    edges = [edge for pair in found.pairs() for edge in pair]
    assert edges == sorted(set(edges))  # in order, apart, none empty
