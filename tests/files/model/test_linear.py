"""A Python simulator stands in as matrices: linearised around rest, its parameters' uncertainty carried to the entries."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from afdsvc.errors import BadInput
from afdsvc.files.model.linear import linear_model
from afdsvc.files.model.model_file import read_model

TOML = """
name = "pendulum"
time = "continuous"
inputs = [{name = "torque", unit = "N m"}]
outputs = [{name = "angle", unit = "rad"}]
states = [{name = "q", unit = "rad"}, {name = "v", unit = "rad/s", rate_of = "q"}]
dynamics = "pendulum.py:pendulum"
[parameters]
inertia = {value = 0.5, unit = "kg m^2", relative_sd = 0.02}
weight = {value = 8.0, unit = "N m", relative_sd = 0.01}
"""
CODE = """
import math
class Pendulum:
    def f(self, t, x, u, p):
        return [x[1], (u[0] - p["weight"] * math.sin(x[0]) - 0.3 * x[1]) / p["inertia"]]
    def h(self, t, x, u, p):
        return [x[0]]
pendulum = Pendulum()
"""


def pendulum(folder: Path, code: str = CODE) -> Path:
    (folder / "pendulum.py").write_text(code)
    (folder / "pendulum.toml").write_text(TOML)
    return folder / "pendulum.toml"


def test_a_pendulum_hangs_like_a_spring(tmp_path):
    m = linear_model(read_model(pendulum(tmp_path), allow_code=True))
    assert m.dynamics is None
    assert m.plant is not None
    assert m.plant.A == pytest.approx(np.array([[0, 1], [-16, -0.6]]), abs=1e-6)
    assert m.plant.B == pytest.approx(np.array([[0], [2.0]]), abs=1e-6)
    assert m.plant.C == pytest.approx(np.array([[1.0, 0]]))
    # by error propagation: stiffness weight / inertia has sqrt(0.01^2 + 0.02^2), damping and gain have the inertia's 0.02
    assert m.entry_sd["A"] == pytest.approx(np.array([[0, 0], [16 * np.hypot(0.01, 0.02), 0.6 * 0.02]]), rel=1e-3)
    assert m.entry_sd["B"] == pytest.approx(np.array([[0], [2 * 0.02]]), rel=1e-3)
    assert not m.entry_sd["C"].any()


def test_matrices_are_left_alone(tmp_path):
    path = pendulum(tmp_path)
    text = TOML.replace('dynamics = "pendulum.py:pendulum"', "A = [[0, 1], [-1, 0]]\nB = [[0], [1]]\nC = [[1, 0]]\nD = [[0]]")
    path.write_text(text)
    m = read_model(path)
    assert linear_model(m) is m


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [("return [x[0]]", "return [x[0], x[1]]", "C has shape"), ("return [x[1],", "return [x[7],", "fails at rest"),
     ('p["weight"]', 'p["wheight"]', "wheight")],
)
def test_a_simulator_that_fails_is_one_sentence(tmp_path, old, new, words):
    with pytest.raises(BadInput, match=words):
        linear_model(read_model(pendulum(tmp_path, CODE.replace(old, new)), allow_code=True))
