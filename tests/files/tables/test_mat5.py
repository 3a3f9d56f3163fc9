"""MAT-files of level 5 against SciPy's reader where that survives, and damaged ones that take SciPy's reader down."""

from __future__ import annotations

import contextlib
import io

import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st

from afdsvc.files.tables.mat5 import read_mat5

KINDS = ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"]


def saved(variables: dict, **options) -> bytes:
    stream = io.BytesIO()
    scipy.io.savemat(stream, variables, **options)
    return stream.getvalue()


@settings(max_examples=30, deadline=None)
@given(
    kinds=st.lists(st.sampled_from(KINDS), min_size=1, max_size=4),
    shape=st.sampled_from([(1, 1), (7, 1), (1, 5), (3, 4), (1, 0), (2, 3, 2)]),
    compress=st.booleans(),
    packed=st.booleans(),
    seed=st.integers(0, 99),
)
def test_the_same_as_scipy_reads(kinds, shape, compress, packed, seed):
    rng = np.random.default_rng(seed)
    variables = {f"v{i}": (100 * rng.normal(size=shape)).astype(kind) for i, kind in enumerate(kinds)}
    raw = saved({"run": variables} if packed else variables, do_compression=compress)
    found, wanted = read_mat5(raw), scipy.io.loadmat(io.BytesIO(raw), simplify_cells=True)
    if packed:
        found, wanted = found["run"], wanted["run"]
    for name in variables:
        assert found[name].dtype == variables[name].dtype
        assert np.array_equal(np.squeeze(found[name]), wanted[name])


@pytest.mark.parametrize("name", ["text", "cell", "complex"])
def test_what_is_no_vector_of_real_numbers_has_no_number_type(name):
    values = {"text": "abc", "cell": np.array([1, "a"], dtype=object), "complex": np.array([1j])}
    assert read_mat5(saved({"v": values[name]}))["v"].dtype.kind not in "fiub"


def test_every_truncation_is_said_or_gives_fewer_variables():
    raw = saved({"t": np.arange(4.0), "u_x": np.arange(4.0)})
    for n in range(len(raw)):
        try:
            found = read_mat5(raw[:n])
        except ValueError:
            continue
        assert set(found) < {"t", "u_x"}


@settings(max_examples=120, deadline=None)
@given(at=st.integers(128, 400), value=st.integers(0, 255))
def test_any_byte_may_be_wrong(at, value):
    raw = bytearray(saved({"t": np.arange(30) * 0.01, "u_force": np.sin(np.arange(30.0))}))
    raw[at] = value
    with contextlib.suppress(ValueError):
        assert isinstance(read_mat5(bytes(raw)), dict)
