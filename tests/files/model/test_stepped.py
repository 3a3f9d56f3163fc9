"""MODEL.toml files whose simulator only steps: an FMI unit or a function, its linear part in the states it names, and refusals."""

import numpy as np
import pytest

from afdsvc.api.signals import Channel, Trace
from afdsvc.errors import BadInput
from afdsvc.files.model import stepped
from afdsvc.files.model.model_file import model_text, parse_model, read_model
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.statespace import StateSpace
from afdsvc.plants.stepped.fmi_unit import UnitDescription
from afdsvc.plants.stepped.linearise import linearisation_notes
from afdsvc.testing.fmi_units import build_slide

CODE = """
import numpy as np

def axis(x, u, dt, stiffness=4000.0, friction=0.0):
    q, v = (0.0, 0.0) if x is None else x
    h = dt / 40
    for _ in range(40):
        v += h * (-stiffness * q - 20 * v + 500 * (u[0] - friction * np.sign(v)))
        q += h * v
    return np.array([q, v]), [q + OFFSET]

OFFSET = 0.0
number = 3
"""
MODEL = """
name = "axis"
time = "discrete"
sample_time = 0.002
inputs = [{name = "force", unit = "N"}]
outputs = [{name = "position", unit = "mm"}]
states = [{name = "position", unit = "mm"}, {name = "velocity", unit = "mm/s", rate_of = "position"}]
dynamics = "axis.py:axis"
[parameters]
stiffness = {value = 4080.0}
"""
TRUE = StateSpace.of([[0, 1], [-4080, -20]], [[0], [500]], [[1, 0]])


def write(tmp_path, model: str = MODEL, code: str = CODE):
    (tmp_path / "axis.py").write_text(code)
    path = tmp_path / "axis.toml"
    path.write_text(model)
    return path


def test_a_functions_linear_part_has_its_physical_matrices(tmp_path):
    model = read_model(write(tmp_path), allow_code=True)
    assert np.linalg.det(model.plant.A) == pytest.approx(4080, rel=2e-3)
    assert np.trace(model.plant.A) == pytest.approx(-20, rel=2e-2)
    np.testing.assert_allclose(model.plant.B, TRUE.B, atol=1)
    assert [s.rate_of for s in model.states] == [None, "position"]
    assert (model.plant.dt, model.sample_time, model.dynamics) == (0.0, 0.002, None)
    reported = model.extra["linearised"]
    assert "axis.py:axis only steps" in reported[0]
    assert "force by 1 N" in reported[0]
    assert "its states position, velocity looked at for 400 steps" in reported[0]


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_units_linear_part_agrees_with_the_functions(fmi, tmp_path):
    pytest.importorskip("fmpy", reason="the extra 'fmi' is not installed")
    pytest.importorskip({2: "pythonfmu", 3: "pythonfmu3"}[fmi], reason="the builder of test units is not installed")
    build_slide(tmp_path, fmi)
    model = read_model(write(tmp_path, MODEL.replace("axis.py:axis", f"Slide{fmi}.fmu")), allow_code=True)
    omega = np.geomspace(1, 500, 30)
    truth = frequency_response(TRUE, omega)
    assert np.abs(frequency_response(model.plant, omega) - truth).max() < 0.02 * np.abs(truth).max()


def test_a_unit_alone_stands_for_a_model_in_its_modes(tmp_path):
    pytest.importorskip("fmpy", reason="the extra 'fmi' is not installed")
    pytest.importorskip("pythonfmu", reason="the builder of test units is not installed")
    model = read_model(build_slide(tmp_path), allow_code=True)
    assert (model.name, [v.name for v in model.inputs], [v.name for v in model.outputs]) == ("Slide2", ["force"], ["position"])
    A = model.plant.A
    assert A[0, 0] == pytest.approx(A[1, 1])
    assert A[0, 1] == pytest.approx(-A[1, 0])
    assert np.sqrt(np.linalg.det(A)) == pytest.approx(np.sqrt(4000), rel=0.02)
    with pytest.raises(BadInput, match=r"compiled code \(SHA-256 [0-9a-f]{64}\) that would run on this computer; expected permission to run code: --allow-code"):
        read_model(tmp_path / "Slide2.fmu")


def test_a_unit_alone_must_say_enough(tmp_path, monkeypatch):
    reported = {"step": None, "inputs": {"force": "N"}}
    monkeypatch.setattr(stepped, "describe", lambda path: UnitDescription("slide", reported["inputs"], {"position": "mm"}, reported["step"]))
    with pytest.raises(BadInput, match=r"states no step size in its default experiment; expected a MODEL\.toml with dynamics = \"Slide3\.fmu\""):
        read_model(tmp_path / "Slide3.fmu", allow_code=True)
    reported.update(step=0.002, inputs={})
    with pytest.raises(BadInput, match=r"Slide3\.fmu: has no real inputs; expected at least one"):
        read_model(tmp_path / "Slide3.fmu", allow_code=True)


def test_what_is_written_is_the_linear_part_which_needs_no_simulator(tmp_path):
    model = read_model(write(tmp_path), allow_code=True)
    again = parse_model(model_text(model), "elsewhere.toml")
    np.testing.assert_array_equal(again.plant.A, model.plant.A)
    assert model.raw == ""  # a recording gets the matrices


def test_friction_is_said_to_be_left_out(tmp_path):
    text = MODEL + "friction = {value = 0.4}\n[perturbation]\namplitude = [2.0]\nsamples = 200\n"
    reported = read_model(write(tmp_path, text), allow_code=True).extra["linearised"]
    assert "the simulator is not linear, and what it does beyond is not in the nominal model" in reported[1]


def test_the_simulator_itself_is_compared_with_recordings(tmp_path):
    text = MODEL + "friction = {value = 0.4}\n[perturbation]\namplitude = [5.0]\n"
    model = read_model(write(tmp_path, text), allow_code=True)
    t = np.arange(1500) * 0.002
    u = 1.5 * np.sin(40 * t) + 1.0 * np.sin(91 * t)
    unit = model.opened()
    y = np.array([unit.begin(), *(unit.advance(np.array([f]), 0.002) for f in u[:-1])])[:, 0]
    (said,) = linearisation_notes(model, [Trace("run.csv", 0.002, (Channel("u_force"), Channel("y_position")), np.column_stack([u, y]))])
    shares = [float(word) for word in said.replace("%", "").split() if word.replace(".", "").replace("e-", "").isdigit()]
    assert said.startswith("run.csv, simulated from its inputs and from rest, error over variation: position 0 % by the simulator itself")
    assert shares[1] > 3.0  # the linear part has no friction
    assert linearisation_notes(parse_model(model_text(model), "x.toml"), []) == []


def test_a_simulator_that_fails_on_a_recording_is_reported(tmp_path):
    code = CODE.replace("q, v = ", "assert abs(u[0]) < 50, 'too hard'\n    q, v = ")
    model = read_model(write(tmp_path, code=code), allow_code=True)
    trace = Trace("run.csv", 0.002, (Channel("u_force"), Channel("y_position")), np.full((60, 2), 99.0))
    assert linearisation_notes(model, [trace]) == [
        "run.csv: the simulator itself could not follow the recorded inputs: simulator axis.py:axis fails: AssertionError: too hard"
    ]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (('time = "discrete"\nsample_time = 0.002', 'time = "continuous"'), "key 'time' is \"continuous\"; a stepped simulator needs"),
        (("axis.py:axis", "axis.py:number"), "'number' has no f and no h"),
        (("axis.py:axis", "axis.py:other"), "which defines no 'other'"),
        (("axis.py:axis", "axis.fmi"), "key 'dynamics' is 'axis.fmi'"),
        (("[parameters]", "[perturbation]\namplitude = [1.0, 2.0]\n[parameters]"), "'perturbation.amplitude' holds 2 values; expected 1"),
        (("[parameters]", "[perturbation]\nsamples = 3\n[parameters]"), "key 'perturbation.samples' is 3"),
        (("stiffness =", "mass ="), "unexpected keyword argument 'mass'"),
        ((", {name = \"velocity\", unit = \"mm/s\", rate_of = \"position\"}", ""), "key 'states' names 1 states; expected 2"),
    ],
)
def test_what_does_not_fit_is_refused_by_key(change, said, tmp_path):
    with pytest.raises(BadInput, match=said):
        read_model(write(tmp_path, MODEL.replace(*change)), allow_code=True)


def test_a_model_of_matrices_has_no_perturbation(tmp_path):
    text = MODEL.replace('dynamics = "axis.py:axis"', "A=[[0,1],[0,0]]\nB=[[0],[1]]\nC=[[1,0]]\nD=[[0]]") + "[perturbation]\nsamples = 99\n"
    with pytest.raises(BadInput, match="key 'perturbation' applies to stepped simulators only"):
        read_model(write(tmp_path, text))
