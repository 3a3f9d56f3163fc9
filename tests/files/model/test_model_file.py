"""MODEL.toml: read, written, read again; and one clear sentence for everything that is wrong with one."""

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from afdsvc.api.model import Model, Quantity, Variable
from afdsvc.errors import BadInput
from afdsvc.files.model.model_file import model_text, parse_model, read_model, write_model
from afdsvc.lti.statespace import StateSpace

AXIS = """
name = "positioning axis"
time = "continuous"
inputs  = [{name = "force", unit = "N"}]
outputs = [{name = "position", unit = "m"}]
states  = [{name = "q", unit = "m"}, {name = "v", unit = "m/s", rate_of = "q"}]
A = [[0, 1], [0, -2.1]]
B = [[0], [0.0105]]
C = [[1, 0]]
D = [[0]]
[parameters]
mass = {value = 95.1, unit = "kg", relative_sd = 0.02}
[uncertainty]
relative = 0.02
B = [[0], [0.1]]
[noise]
output_sd = [2e-6]
process_cov = [[1e-9, 0], [0, 2e-9]]
[controller]
time = "discrete"
sample_time = 0.001
A = []
B = []
C = []
D = [[-1.0]]
"""
CODE = """
class Axis:
    def f(self, t, x, u, p):
        return [x[1], (u[0] - p["friction"] * x[1]) / p["mass"]]
    def h(self, t, x, u, p):
        return [x[0]]
axis = Axis()
empty = object()
"""
PYTHON = """
name = "axis"
time = "continuous"
inputs = [{name = "force"}]
outputs = [{name = "position"}]
states = [{name = "q"}, {name = "v", rate_of = "q"}]
dynamics = "axis.py:axis"
[parameters]
mass = {value = 95.1}
friction = {value = 200}
"""


def test_every_key_arrives():
    m = parse_model(AXIS, "axis.toml")
    assert (m.name, m.origin, m.raw) == ("positioning axis", "axis.toml", AXIS)
    assert m.inputs == (Variable("force", "N"),)
    assert m.states == (Variable("q", "m"), Variable("v", "m/s", "q"))
    assert np.array_equal(m.plant.A, [[0, 1], [0, -2.1]])
    assert (m.plant.dt, m.sample_time) == (0.0, 0.0)
    assert m.parameters == {"mass": Quantity(95.1, "kg", 0.02)}
    # 0 and 1 are structure; B is given absolutely and wins over the relative figure.
    assert np.array_equal(m.entry_sd["A"], [[0, 0], [0, 0.02 * 2.1]])
    assert np.array_equal(m.entry_sd["B"], [[0], [0.1]])
    assert np.array_equal(m.entry_sd["C"], [[0, 0]])
    assert np.array_equal(m.output_sd, [2e-6])
    assert np.array_equal(m.process_cov, np.diag([1e-9, 2e-9]))
    assert (m.controller.order, m.controller.dt, m.controller.D.tolist()) == (0, 0.001, [[-1.0]])


def test_what_nobody_stated_has_its_default():
    text = AXIS[: AXIS.index("[parameters]")].replace(
        'states  = [{name = "q", unit = "m"}, {name = "v", unit = "m/s", rate_of = "q"}]', ""
    )
    m = parse_model(text, "axis.toml")
    assert np.array_equal(m.entry_sd["A"], [[0, 0], [0, 0.05 * 2.1]])
    assert (m.output_sd, m.process_cov, m.controller, dict(m.parameters)) == (None, None, None, {})
    assert m.states == (Variable("position", "m"), Variable("position_rate", "m/s", "position"))


def same(a: Model, b: Model) -> None:
    for name in ("name", "inputs", "outputs", "states", "sample_time", "parameters"):
        assert getattr(a, name) == getattr(b, name)
    for x, y in ((a.plant, b.plant), (a.controller, b.controller)):
        assert (x is None) == (y is None)
        for matrix in "ABCD" if x else "":
            assert getattr(x, matrix).tobytes() == getattr(y, matrix).tobytes()
            assert getattr(x, matrix).shape == getattr(y, matrix).shape
        assert x is None or x.dt == y.dt
    assert {k: v.tolist() for k, v in a.entry_sd.items()} == {k: v.tolist() for k, v in b.entry_sd.items()}
    assert np.array_equal(a.output_sd, b.output_sd) if a.output_sd is not None else b.output_sd is None
    assert np.array_equal(a.process_cov, b.process_cov) if a.process_cov is not None else b.process_cov is None


def test_written_and_read_it_is_the_same(tmp_path):
    m = parse_model(AXIS, "axis.toml")
    write_model(m, tmp_path / "new.toml")
    same(read_model(tmp_path / "new.toml"), m)
    assert "relative = 0.02" in (tmp_path / "new.toml").read_text()
    assert os.listdir(tmp_path) == ["new.toml"]


finite = st.floats(allow_nan=False, allow_infinity=False)
names = st.from_regex(r"[\w.+\" -]*\w", fullmatch=True).filter(lambda name: name == name.strip())
words = st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=8)


@settings(deadline=None, max_examples=60)
@given(st.data(), st.integers(0, 3), st.integers(1, 2), st.integers(1, 2), st.sampled_from([0.0, 2e-4, 0.1]))
def test_any_model_comes_back_bit_for_bit(data, n, m, p, dt):
    def matrix(*shape):
        return data.draw(arrays(np.float64, shape, elements=finite))

    plant = StateSpace(matrix(n, n), matrix(n, m), matrix(p, n), matrix(p, m), dt)
    model = Model(
        data.draw(words),
        tuple(Variable(f"u{i}", data.draw(words)) for i in range(m)),
        tuple(Variable(f"y{i}") for i in range(p)),
        tuple(Variable(f"x{i}") for i in range(n)),
        plant,
        sample_time=dt,
        parameters={data.draw(names): Quantity(data.draw(finite), "kg", 0.1)},
        entry_sd={name: np.abs(matrix(*getattr(plant, name).shape)) for name in "ABCD"},
        output_sd=np.full(p, 1e-300),
        controller=StateSpace.gain(matrix(m, p), 1e-3),
    )
    same(parse_model(model_text(model), "memory"), model)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("A = [[0, 1], [0, -2.1]]", "A = [[0, 1], [0]]", ["'A'", "[1, 2]", "equal length"]),
        ("A = [[0, 1], [0, -2.1]]", "A = [[0, 1]]", ["'A'", "(1, 2)", "expected (1, 1)"]),
        ("A = [[0, 1], [0, -2.1]]", "", ["matrix A is missing"]),
        ("A = [[0, 1], [0, -2.1]]", 'A = [[0, "1"], [0, -2.1]]', ["'A[0][1]'", "'1'", "number"]),
        ("A = [[0, 1], [0, -2.1]]", "A = [[0, nan], [0, -2.1]]", ["'A[0][1]'", "nan", "finite"]),
        ("A = [[0, 1], [0, -2.1]]", "A = [[0, true], [0, -2.1]]", ["'A[0][1]'", "True", "number"]),
        ("B = [[0], [0.0105]]", "B = [[0, 0], [0, 0.0105]]", ["'B'", "(2, 2)", "expected (2, 1)", "2 states"]),
        ("C = [[1, 0]]", "C = [[1], [0]]", ["'C'", "(2, 1)", "expected (1, 2)"]),
        ("D = [[0]]", "D = [[0, 1]]", ["'D'", "(1, 2)", "expected (1, 1)"]),
        ("D = [[-1.0]]", "D = [[-1.0, 0.0]]", ["'controller.D'", "(1, 2)", "expected (1, 1)"]),
        ("D = [[-1.0]]", "", ["'controller'", "matrix D is missing"]),
        ("B = [[0], [0.0105]]", "B = [0, 0.0105]", ["'B'", "[[0, 0.0105]] is one row", "[[0], [0.0105]] one column"]),
        ("D = [[0]]", "num = [1]", ["num and A are both given"]),
        ("D = [[0]]", "D = 0,5", ["not a TOML file", "the decimal sign is a point"]),
        ("A = [[0, 1], [0, -2.1]]\nB = [[0], [0.0105]]\nC = [[1, 0]]\nD = [[0]]", "num = [2]\nden = [0,3, 1,0]", ["'den' begins with 0", "a point as decimal sign"]),
        ("B = [[0], [0.0105]]", "", ["matrix B is missing", "num and den"]),
        ("[parameters]\nmass = {value = 95.1, unit = \"kg\", relative_sd = 0.02}", '[parameters]\nmass = "heavy"', ["'parameters.mass'", "'heavy'"]),
        ("sample_time = 0.001", "", ["'controller'", "sample_time is missing"]),
        ("sample_time = 0.001", "sample_time = -0.001", ["'controller.sample_time'", "-0.001", "a number above 0"]),
        ('time = "continuous"', 'time = "continuous"\nsample_time = 0.1', ["continuous", "0.1"]),
        ('time = "continuous"', 'time = "discrete"', ["sample_time is missing"]),
        ('time = "continuous"', 'time = "sampled"', ["'time'", "'sampled'", "'continuous' or 'discrete'"]),
        ('name = "positioning axis"', "", ["'name' is missing"]),
        ('name = "positioning axis"', "name = 3", ["'name'", "3", "expected text"]),
        ('unit = "N"', 'units = "N"', ["'inputs[0].units' is not known", "name, unit"]),
        ("[noise]", "[nosie]", ["'nosie' is not known", "noise"]),
        ("output_sd = [2e-6]", "output_sd = [2e-6, 1e-6]", ["'noise.output_sd'", "2 values", "expected 1"]),
        ("output_sd = [2e-6]", "output_sd = [0]", ["'noise.output_sd[0]'", "0", "a number above 0"]),
        (
            "process_cov = [[1e-9, 0], [0, 2e-9]]",
            "process_cov = [[1e-9, 1], [0, 2e-9]]",
            ["'noise.process_cov'", "symmetric"],
        ),
        (
            "process_cov = [[1e-9, 0], [0, 2e-9]]",
            "process_cov = [[1, 0], [0, -1]]",
            ["'noise.process_cov'", "eigenvalue -1"],
        ),
        ("B = [[0], [0.1]]", "B = [[0], [-0.1]]", ["'uncertainty.B'", "-0.1", "0 or more"]),
        ("B = [[0], [0.1]]", "B = [[0.1]]", ["'uncertainty.B'", "(1, 1)", "expected (2, 1)"]),
        ('rate_of = "q"', 'rate_of = "x"', ["rate_of of 'v' is 'x'", "(q)", "leave rate_of out"]),
        ('rate_of = "q"', 'rate_of = "v"', ["rate_of of 'v' is 'v'"]),
        ('name = "v"', 'name = "q"', ["'q' twice"]),
        (', {name = "v", unit = "m/s", rate_of = "q"}', "", ["'states' names 1", "expected 2"]),
        ('inputs  = [{name = "force", unit = "N"}]', "inputs = []", ["B", "(2, 0)", "0 inputs"]),
        ("[parameters]", "[parameters", ["not a TOML file", "line"]),
        ("[parameters]", 'dynamics = "axis.py:axis"\n[parameters]', ["both matrices and dynamics"]),
        ("[parameters]", 'dynamics = "axis.py"\n[parameters]', ["'dynamics'", "'axis.py'"]),
        ("value = 95.1, ", "", ["'parameters.mass.value' is missing"]),
    ],
)
def test_what_is_wrong_is_named(tmp_path, old, new, words):
    path = tmp_path / "bad.toml"
    assert old in AXIS
    path.write_text(AXIS.replace(old, new, 1))
    with pytest.raises(BadInput) as error:
        read_model(path)
    assert all(word in str(error.value) for word in [str(path), *words]), str(error.value)


MOTOR = """
name = "motor"
time = "continuous"
inputs = [{name = "voltage", unit = "V"}]
outputs = [{name = "speed", unit = "rpm"}]
"""
SPEED = (Variable("speed", "rpm"),)


@pytest.mark.parametrize(
    ("lines", "A", "B", "C", "D", "states"),
    [
        ("num = [12.0]\nden = [0.5, 1]", [[-2]], [[24]], [[1]], [[0]], SPEED),
        ("poles = [-2]\ngain = 24", [[-2]], [[24]], [[1]], [[0]], SPEED),
        ("num = [1]\nden = [1, 0]", [[0]], [[1]], [[1]], [[0]], SPEED),
        ("A = [[-2]]\nB = [[24]]\nC = [[1]]", [[-2]], [[24]], [[1]], [[0]], SPEED),
        ("num = [1, 6]\nden = [1, 2]", [[-2]], [[4]], [[1]], [[1]], (Variable("x1"),)),
        ("zeros = [-3]\npoles = [[-1, 2], [-1, -2]]\ngain = 10", [[-2, 1], [-5, 0]], [[10], [30]], [[1, 0]], [[0]], (*SPEED, Variable("x2"))),
        ("num = [10]\nden = [1, 2, 5]", [[0, 1], [-5, -2]], [[0], [10]], [[1, 0]], [[0]], (*SPEED, Variable("speed_rate", "rpm/s", "speed"))),
        ("D = [[3]]", np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[3]], ()),
    ],
)
def test_models_as_people_have_them(lines, A, B, C, D, states):
    """A motor whose speed is measured needs neither a position nor names of states."""
    m = parse_model(MOTOR + lines, "motor.toml")
    for name, wanted in zip("ABCD", (A, B, C, D), strict=True):
        np.testing.assert_array_equal(getattr(m.plant, name), wanted)
    assert m.states == states
    assert m.transfer == ("num" in lines or "poles" in lines)
    same(parse_model(model_text(m), "again.toml"), m)


def test_parameters_on_one_line():
    text = MOTOR + 'D = [[3]]\n[parameters]\nmass = "95.1 kg +- 2 %"\nstiffness = 4e3\ndamping = "20 N/(m/s)"'
    assert parse_model(text, "m.toml").parameters == {
        "mass": Quantity(95.1, "kg", 0.02), "stiffness": Quantity(4e3), "damping": Quantity(20.0, "N/(m/s)"),
    }


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ("num = [1, 2, 3]\nden = [1, 2]", ["degree 2", "degree 1"]),
        ("num = [1]\nden = [0]", ["denominator is zero"]),
        ("num = [1]", ["key den is missing"]),
        ("num = [[[1], [2]]]\nden = [1, 2]", ["'num'", "1 outputs of 1 inputs"]),
        ("poles = [[-1, 2]]\ngain = 1", ["poles", "conjugate"]),
    ],
)
def test_transfer_functions_that_are_none_are_named(lines, words):
    with pytest.raises(BadInput) as error:
        parse_model(MOTOR + lines, "motor.toml")
    assert all(word in str(error.value) for word in ["motor.toml", *words]), str(error.value)


def test_several_offences_are_all_reported():
    text = AXIS.replace('unit = "N"', "unit = 1").replace("relative = 0.02", 'relative = "much"')
    with pytest.raises(BadInput, match=r"inputs\[0\].unit.*uncertainty.relative"):
        parse_model(text, "bad.toml")


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    (tmp_path / "latin.toml").write_bytes(b'name = "\xe6"')
    for name, words in (("none.toml", "No such file"), (".", "directory"), ("latin.toml", "not UTF-8")):
        with pytest.raises(BadInput, match=words) as error:
            read_model(tmp_path / name)
        assert str(tmp_path) in str(error.value)


def test_a_file_that_cannot_be_written_is_named(tmp_path):
    with pytest.raises(BadInput, match="cannot be written"):
        write_model(parse_model(AXIS, "axis.toml"), tmp_path / "no" / "folder.toml")


def python_model(folder: Path, text: str = PYTHON) -> Path:
    (folder / "axis.py").write_text(CODE)
    (folder / "model.toml").write_text(text)
    return folder / "model.toml"


def test_code_of_a_stranger_does_not_run_unasked(tmp_path):
    path = python_model(tmp_path)
    (tmp_path / "axis.py").write_text("raise SystemExit('ran')")
    with pytest.raises(BadInput, match=r"permission to run code.*--allow-code"):
        read_model(path)


def test_code_in_a_trusted_folder_runs(tmp_path, monkeypatch):
    path = python_model(tmp_path)
    monkeypatch.setenv("AFDSVC_TRUSTED", f"/nowhere:{tmp_path.parent}")
    assert read_model(path).dynamics is not None
    monkeypatch.setenv("AFDSVC_TRUSTED", f"{tmp_path}-other")
    with pytest.raises(BadInput, match="permission"):
        read_model(path)


def test_a_python_simulator_is_called_by_name(tmp_path):
    m = read_model(python_model(tmp_path), allow_code=True)
    p = {name: q.value for name, q in m.parameters.items()}
    assert m.plant is None
    assert m.dynamics.f(0.0, [1.0, 2.0], [590.2], p) == [2.0, (590.2 - 400) / 95.1]
    assert m.dynamics.h(0.0, [1.0, 2.0], [0.0], p) == [1.0]


def test_a_python_model_written_elsewhere_finds_its_code_again(tmp_path):
    m = read_model(python_model(tmp_path), allow_code=True)
    (tmp_path / "out").mkdir()
    write_model(m, tmp_path / "out" / "new.toml")
    again = read_model(tmp_path / "out" / "new.toml", allow_code=True)
    assert again.dynamics.h(0.0, [3.0, 0.0], [0.0], {}) == [3.0]
    same(again, m)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("axis.py:axis", "none.py:axis", "none.py, which does not exist"),
        ("axis.py:axis", "axis.py:other", "defines no 'other'"),
        ("axis.py:axis", "axis.py:empty", "'empty' has no f and no h"),
        ("[parameters]", "[uncertainty]\nrelative = 0.1\n[parameters]", "relative_sd of each parameter"),
    ],
)
def test_what_is_wrong_with_a_python_model_is_named(tmp_path, old, new, words):
    with pytest.raises(BadInput, match=words) as error:
        read_model(python_model(tmp_path, PYTHON.replace(old, new)), allow_code=True)
    assert "model.toml" in str(error.value)


def test_code_that_fails_is_named(tmp_path):
    path = python_model(tmp_path)
    (tmp_path / "axis.py").write_text("import nothing_of_this_name")
    with pytest.raises(BadInput, match="ModuleNotFoundError"):
        read_model(path, allow_code=True)


def test_a_model_without_any_dynamics_cannot_be_written():
    m = Model("m", (Variable("u"),), (Variable("y"),), (), None)
    with pytest.raises(BadInput, match="neither matrices nor a file"):
        model_text(m)


@pytest.mark.parametrize("name", ["emps/model", "silverbox/model", "silverbox/model_physical", "two_mass/model"])
def test_measured_benchmarks(measured, name, tmp_path):
    m = read_model(measured / f"{name}.toml")
    write_model(m, tmp_path / "again.toml")
    same(read_model(tmp_path / "again.toml"), m)


def test_without_inputs_B_is_left_out_too():
    decay = 'name = "decay"\ntime = "continuous"\ninputs = []\noutputs = [{name = "q"}]\nA = [[0, 1], [-30, -0.8]]\nC = [[1, 0]]\n'
    plant = parse_model(decay, "decay.toml").plant
    assert plant is not None
    assert (plant.B.shape, plant.D.shape) == ((2, 0), (1, 0))
    with pytest.raises(BadInput, match="matrix B"):
        parse_model(decay.replace("inputs = []", 'inputs = [{name = "u"}]'), "driven.toml")
