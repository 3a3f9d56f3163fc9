"""Machines simulated by what only steps: the same loop as the linear simulator, limits, faults, and ends that are reported."""

import numpy as np
import pytest

from afdsvc.api.bursts import Burst, Line
from afdsvc.app import commissioning, ports
from afdsvc.errors import BadInput
from afdsvc.files.site import read_site
from afdsvc.plugins.manager import load
from afdsvc.service.clock import FastClock
from afdsvc.testing.fmi_units import build_slide

MODEL = """
name = "axis"
time = "discrete"
sample_time = 0.002
inputs = [{name = "force", unit = "N"}]
outputs = [{name = "position", unit = "mm"}]
A = [[0.9, 0.1], [-0.1, 0.8]]
B = [[0.0], [0.5]]
C = [[1.0, 0.3]]
D = [[0.0]]
"""
CODE = """
import numpy as np
A, B, C = np.array([[0.9, 0.1], [-0.1, 0.8]]), np.array([[0.0], [0.5]]), np.array([[1.0, 0.3]])

def axis(x, u, dt, gain=1.0, nan_after=1e9, start=0.0):
    if x is None:
        return (np.zeros(2), 0), [start]
    x, k = x
    x = A @ x + B @ u
    return (x, k + 1), gain * (C @ x) if k < nan_after else [float("nan")]

three = 3
"""
SITE = """
site = "hall"
[[machines]]
id = "axis"
model = "axis.toml"
output_sd = [0.01]
limits = {output = [6.0], input = [3.0], seconds = 4.0}
controller = {kind = "state_space", settings = {A = [], B = [], C = [], D = [[-0.4]]}}
[machines.driver]
kind = "function"
unit = "axis.py:axis"
real_time = false
"""


@pytest.fixture
def folder(tmp_path):
    """A folder with model, function and site."""
    (tmp_path / "axis.toml").write_text(MODEL)
    (tmp_path / "axis.py").write_text(CODE)
    (tmp_path / "site.toml").write_text(SITE)
    return tmp_path


def machine(folder, *changes):
    text = SITE
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "site.toml").write_text(text)
    return commissioning.commission(read_site(folder / "site.toml").machine("axis"), load(), allow_code=True)


def port(folder, *changes):
    return ports.open_port(machine(folder, *changes), "s", FastClock(), load())


def samples(opened, blocks: int = 4) -> np.ndarray:
    return np.vstack([opened.read().values for _ in range(blocks)])


def test_a_linear_function_moves_as_the_linear_simulator_with_its_noise(folder):
    """u, y and beta obey plant, controller and noise of the seed, sample by sample."""
    opened = port(folder)
    u, y, _, beta = samples(opened).T
    opened.close()
    noise = 0.01 * np.random.default_rng(0).standard_normal(len(u))
    x = np.zeros(2)
    for k in range(len(u)):
        assert y[k] == pytest.approx(x[0] + 0.3 * x[1] + noise[k], abs=1e-12)
        assert u[k] == pytest.approx(-0.4 * y[k], abs=1e-12)
        x = np.array([[0.9, 0.1], [-0.1, 0.8]]) @ x + np.array([0.0, 0.5]) * u[k]
    assert np.isfinite(beta).all()


def test_the_linear_model_itself_can_be_the_machine(folder):
    """The simulator of kind "simulator" takes its noise from other draws, so the spectra agree, not the samples."""
    own, linear = port(folder), port(folder, ('kind = "function"\nunit = "axis.py:axis"', 'kind = "simulator"'))
    one, other = samples(own, 40), samples(linear, 40)
    assert one[:, 1].std() == pytest.approx(other[:, 1].std(), rel=0.05)
    assert one[:, 0].std() == pytest.approx(other[:, 0].std(), rel=0.05)


def test_a_burst_shows_in_beta_only_when_the_machine_is_not_as_modelled(folder):
    burst = Burst("b", 1, samples=1000, ramp=100, lines=(Line(0, 300.0, 0.5),))
    power = []
    for options in ("{gain = 1.0}", "{gain = 0.7}"):
        opened = port(folder, ("real_time = false", f"real_time = false\noptions = {options}"))
        with opened.arm(machine(folder).limits) as drive:
            drive.play(burst)
            blocks = []
            while drive.playing:
                blocks.append(opened.read())
        beta = np.concatenate([b.column("beta_position") for b in blocks])
        alpha = np.concatenate([b.column("alpha_force") for b in blocks])
        power.append(abs(np.mean(beta * np.exp(-1j * 300.0 * 0.002 * np.arange(len(beta))))))
        assert np.abs(alpha).max() > 0.4
    assert power[1] > 20 * power[0]


def test_gains_fail_at_their_sample_on_either_side(folder):
    opened = port(folder, ("real_time = false", """real_time = false
faults = [{name = "position_sensor", severity = -1.0, at_seconds = 1.0}, {name = "force_actuator", severity = -1.0, at_seconds = 0.5}]"""))
    y = samples(opened, 4)[:, 1]
    noise = 0.01 * np.random.default_rng(0).standard_normal(1000)
    assert not np.allclose(y[:250], noise[:250])
    np.testing.assert_allclose(y[420:500], noise[420:500], atol=1e-9)  # what moved before the actuator went has died away
    np.testing.assert_allclose(y[500:], noise[500:], atol=1e-12)  # the sensor says nothing


def test_an_output_at_its_limit_ends_the_burst_and_control_goes_on(folder):
    burst = Burst("b", 1, samples=1000, ramp=10, lines=(Line(0, 30.0, 0.5),))
    opened = port(folder, ("output = [6.0]", "output = [0.6]"), ("real_time = false", "real_time = false\noptions = {gain = 3.0}"))
    with opened.arm(machine(folder, ("output = [6.0]", "output = [0.6]")).limits) as drive:
        drive.play(burst)
        while drive.playing:
            opened.read()
        assert "an output reached its limit" in drive.aborted
    assert np.abs(opened.read().column("alpha_force")).max() == 0.0


def test_a_simulator_that_answers_nan_ends_with_its_name(folder):
    opened = port(folder, ("real_time = false", "real_time = false\noptions = {nan_after = 300}"))
    opened.read()
    with pytest.raises(BadInput, match=r"simulator .*axis\.py:axis returns nan for output 0"):
        opened.read()
    opened.close()
    assert opened.read() is None


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ([('unit = "axis.py:axis"\n', "")], "a driver of kind 'function' needs 'unit', a function as file.py:name"),
        ([("axis.py:axis", "axis.py:nothing")], "key 'driver.unit' names .*axis.py, which defines no 'nothing'"),
        ([("axis.py:axis", "axis.py:three")], "names .*axis.py:three, which is not a function"),
        ([("axis.py:axis", "no.such.module:f")], "names the module no.such.module, which cannot be imported: ModuleNotFoundError"),
        ([("axis.py:axis", "axis")], "key 'driver.unit' is 'axis'; expected file.py:name or package.module:name"),
        ([("limits = {output = [6.0], ", "limits = {")], "key 'limits.output' is missing; a driven machine with 'model' needs"),
        ([("input = [3.0]", "input = [3.0, 4.0]")], "key 'limits.input' has 2 values; expected 1"),
        ([("output_sd = [0.01]\n", "")], "has no controller or no noise"),
        ([("real_time = false", "real_time = false\noptions = {start = 1.0}")], "starts with output 0 at 1; expected deviations from an operating point at 0"),
        ([("real_time = false", 'real_time = false\nvariables = {speed = "v"}')], "maps 'speed'; the model has force, position"),
        ([("real_time = false", 'real_time = false\nfaults = [{name = "mass", severity = -0.1}]')], "fault 'mass' cannot be injected .*: force_actuator, position_sensor"),
    ],
)
def test_what_does_not_fit_is_refused_before_anything_moves(folder, changes, said):
    with pytest.raises(BadInput, match=said):
        port(folder, *changes)


def test_a_continuous_model_needs_a_sample_time(folder):
    (folder / "axis.toml").write_text(MODEL.replace('time = "discrete"\nsample_time = 0.002', 'time = "continuous"').replace("0.9, 0.1", "-9, 1").replace("-0.1, 0.8", "-1, -8"))
    with pytest.raises(BadInput, match=r"states no sample time; expected key 'options\.sample_time' \[s\]"):
        machine(folder)
    found = machine(folder, ('id = "axis"', 'id = "axis"\noptions = {sample_time = 0.004}'))
    assert found.plant.dt == 0.004


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_unit_is_a_machine_by_its_own_names_and_parameters(folder, fmi):
    pytest.importorskip("fmpy", reason="the extra 'fmi' is not installed")
    pytest.importorskip({2: "pythonfmu", 3: "pythonfmu3"}[fmi], reason="the builder of test units is not installed")
    build_slide(folder, fmi)
    as_unit = ('kind = "function"\nunit = "axis.py:axis"', f'kind = "fmu"\nunit = "Slide{fmi}.fmu"\noptions = {{stiffness = 9000.0}}')
    calm = ("D = [[-0.4]]", "D = [[0.0]]")
    opened = port(folder, as_unit, calm)
    assert samples(opened)[:, 1].std() == pytest.approx(0.01, rel=0.1)  # nothing but the noise of the sensor
    opened.close()
    for change, said in [
        (("stiffness = 9000.0", "mass = 1.0"), "has no parameter 'mass'; it has force, stiffness"),
        (("stiffness = 9000.0", 'stiffness = "high"'), "'driver.options.stiffness' is 'high'; expected a number"),
        (("options = {", 'variables = {position = "angle"}\noptions = {'), "has no output 'angle'; it has position"),
    ]:
        with pytest.raises(BadInput, match=said):
            port(folder, as_unit, calm, change)


def test_the_site_of_a_unit_may_take_it_for_the_model_as_well(folder):
    pytest.importorskip("fmpy", reason="the extra 'fmi' is not installed")
    pytest.importorskip("pythonfmu", reason="the builder of test units is not installed")
    build_slide(folder)
    found = machine(folder, ("axis.toml", "Slide2.fmu"), ('kind = "function"\nunit = "axis.py:axis"', 'kind = "fmu"\nunit = "Slide2.fmu"'), ("[[-0.4]]", "[[0.0]]"))
    assert found.plant.order == 2
    assert "dynamics" not in found.model_text()
