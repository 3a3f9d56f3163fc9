"""What is claimed and what is withdrawn."""

from __future__ import annotations

import pytest

from afdsvc.gap.verdict import _too_little
from afdsvc.gap.verify import Explained


@pytest.mark.parametrize(("fraction", "sd", "p_left", "withdrawn"), [
    (0.70, 0.05, 1e-6, True), (0.74, 0.05, 1e-6, True),
    (0.76, 0.05, 1e-6, False),  # within a standard error of enough
    (0.70, 0.05, 1e-3, False),  # what is left may be noise
    (0.90, 0.01, 1e-9, False),  # a law is never exact
])
def test_names_are_withdrawn_where_surely_too_little_goes_with_them(fraction, sd, p_left, withdrawn):
    assert _too_little(Explained(fraction, sd, None, None, p_left)) == withdrawn
