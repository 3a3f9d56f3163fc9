"""A curve in words: its power, its sign, its sizes in either direction."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.api.physics import Size
from afdsvc.explain.locate.places import described

SPEED = Size(0, "v", "mm/s", 0.0, 1.0, 3.0)
X = np.array([-3, -1.5, -0.6, -0.1, 0, 0.1, 0.6, 1.5, 3.0])


@pytest.mark.parametrize(
    ("law", "words"),
    [
        (lambda v: -2 * v * np.abs(v), ["square of the speed", "changes sign"]), (lambda v: -np.sign(v), ["same size at every value of the speed", "changes sign"]),
        (lambda v: 0.3 * v**2, ["square of the speed", "keeps its sign"]), (lambda v: -0.5 * v, ["in proportion to the speed", "changes sign"]),
        (lambda v: -0.1 * v**3, ["third power", "changes sign"]), (lambda v: np.where(v > 0, -2 * v, -v), ["2 times as large forwards"]),
        (lambda v: np.sin(4 * v), ["N that no power of the speed describes"]),
    ],
)
def test_a_force_against_speed(law, words):
    said = described(X, law(X), 0.01 * np.ones(len(X)), False, SPEED, "N")
    assert all(w in said for w in words), said


def test_nothing_is_said_of_a_direction_in_which_nothing_moved():
    x = np.linspace(-0.05, 3.0, 9)
    said = described(x, -np.abs(x) * x, 0.01 * np.ones(len(x)), False, SPEED)
    assert "square of the speed" in said
    assert "sign" not in said
    assert "forwards" not in said


def test_the_error_of_the_words_is_stated():
    rng = np.random.default_rng(0)
    y = -2 * X * np.abs(X) * (1 + 0.3 * rng.standard_normal(len(X)))
    error = float(described(X, y, 0.01 * np.ones(len(X)), False, SPEED).rsplit("+-", 1)[1].split()[0])
    assert 3 < error < 35


def test_an_input_is_described_by_its_gains():
    x = np.linspace(-2, 2, 9)
    said = described(x, np.sign(x) * np.maximum(np.abs(x) - 0.5, 0), np.ones(9), True, Size(0, "force", "N", 0.0, 1.0, 2.0))
    assert said.startswith("passes small changes 0 times, 1 times at the lower and 1 times at the upper end")
