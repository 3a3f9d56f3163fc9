"""Transfer functions realised: the response is that of the polynomials."""

import numpy as np
import pytest

from afdsvc.errors import BadInput
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.transfer_function import from_polynomials, from_roots, ratio_text, to_polynomials


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_several_inputs_and_outputs(dt):
    num = [[[1, 2], [3.0]], [[1, 0, 2], [4, 5]], [[2.0], [0, 1]]]
    den = [[[1, 2, 3], [1, 0.4]], [[2, 3, 4], [2, 3, 4]], [[1, 0.5, 0.2], [1, 0.5, 0.2]]]
    omega = np.array([0.1, 1.0, 7.0])
    found = frequency_response(from_polynomials(num, den, dt), omega)
    s = np.exp(1j * omega * dt) if dt else 1j * omega
    wanted = np.array([[[np.polyval(n, x) / np.polyval(d, x) for n, d in zip(*row, strict=True)] for row in zip(num, den, strict=True)] for x in s])
    np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-14)
    again = [[to_polynomials(from_polynomials(num, den, dt), i, j) for j in range(2)] for i in range(3)]
    np.testing.assert_allclose([[[np.polyval(n, x) / np.polyval(d, x) for n, d in row] for row in again] for x in s], wanted, rtol=1e-12)


def test_roots():
    zeros, poles = [-3.0], [-1 + 2j, -1 - 2j, -0.5]
    s = 1j * np.array([0.1, 1.0, 7.0])
    found = frequency_response(from_roots(zeros, poles, 2.0), s.imag)[:, 0, 0]
    np.testing.assert_allclose(found, 2 * (s + 3) / np.prod([s - p for p in poles], axis=0), rtol=1e-12)


def test_a_single_root_needs_no_list():
    assert from_roots(1.0, 2.0, 3.0).poles() == [2.0]


def test_a_negligible_first_coefficient_is_named():
    with pytest.raises(BadInput, match="begins with 1e-300"):
        from_polynomials([[[1.0]]], [[[1e-300, 1.0]]])


def test_a_constant_over_a_polynomial_has_derivatives_as_states():
    system = from_polynomials([[[6.0]]], [[[2.0, 3.0, 4.0]]])
    assert system.A.tolist() == [[0, 1], [-2, -1.5]]
    assert system.B.tolist() == [[0], [3]]


@pytest.mark.parametrize(
    ("num", "den", "text"),
    [
        ([6.0], [2, 3, 4.0], "1.5 / (0.5 s^2 + 0.75 s + 1)"), ([4.0, -2], [2, 0, 0], "(2 s - 1) / s^2"), ([3.0, 6], [1, 2.0, 3], "(s + 2) / (0.3333 s^2 + 0.6667 s + 1)"),
        ([5.0], [2.0], "2.5"), ([0.0], [2, 1.0], "0 / (2 s + 1)"), ([1.0], [1, -3.0], "-0.3333 / (-0.3333 s + 1)"), ([1.0, 1], [4, 2.0], "(0.5 s + 0.5) / (2 s + 1)"),
    ],
)  # fmt: skip
def test_a_realisation_is_written_as_a_ratio_again(num, den, text):
    assert ratio_text(*to_polynomials(from_polynomials([[num]], [[den]]), 0, 0), "s") == text
