"""The check before any fit: every defect put into sound recordings is named, and sound recordings raise no objection."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from afdsvc.api.model import Model, Quantity, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.dataset.experiment import prepare, repetition
from afdsvc.dataset.sample_checks import CheckFinding
from afdsvc.errors import BadInput
from afdsvc.explain.check.check import check, insufficient_excitation, objection, one_frequency
from afdsvc.explain.check.information import ambiguities, posterior_sd
from afdsvc.explain.experiment.next_experiment import first_experiment
from afdsvc.explain.pipeline import explain
from afdsvc.explain.search.build import build
from afdsvc.explain.settings import Settings
from afdsvc.explain.simulate.nominal import nominal
from afdsvc.files.model.model_file import parse_model, read_model
from afdsvc.files.tables.tables import read_table
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics import afdsvc_physics
from afdsvc.trial import Options, generate_trial
from afdsvc.trial.folder import nominal_model_text


@cache
def sound(excitation: str = "multisine", machine: str = "gas_bearing") -> tuple[Model, tuple[Trace, ...]]:
    trial = generate_trial("nothing", None, 0.0, np.random.default_rng(3), Options(machine=machine, excitation=excitation))
    return parse_model(nominal_model_text(trial.machine), "model.toml"), trial.recordings[:2]


def spoiled(column: str, change, traces: tuple[Trace, ...] | None = None) -> list[Trace]:
    out = []
    for t in traces or sound()[1]:
        values = t.values.copy()
        k = [c.name for c in t.channels].index(column)
        values[:, k] = change(values[:, k])
        out.append(Trace(t.name, t.dt, t.channels, values, t.t0))
    return out


def reported(findings: tuple[CheckFinding, ...], topic: str) -> str:
    return " ".join(f.sentence for f in findings if f.topic == topic and f.kind != "ok")


@pytest.mark.parametrize("machine", ["gas_bearing", "positioning_axis"])
def test_sound_recordings_raise_no_objection(machine):
    findings = check(*sound(machine=machine))
    assert objection(findings) == ""
    assert insufficient_excitation(findings) == ""
    for topic in ("units", "synchronisation", "saturation", "quantisation", "gaps", "drift", "inputs"):
        assert reported(findings, topic) == ""


@pytest.mark.parametrize(
    ("column", "factor", "word"),
    [
        ("y_horizontal", 1000.0, "about 1000"), ("y_horizontal", 1e-3, "about 1/1000"), ("y_vertical", 1e6, "about 1e6"),
        ("y_horizontal", np.pi / 180, "pi/180"), ("y_vertical", -1.0, "opposite sign"),
    ],
)
def test_a_wrong_unit_is_named_with_its_factor(column, factor, word):
    refused = objection(check(sound()[0], spoiled(column, lambda x: factor * x)))
    assert column in refused
    assert word in refused


def test_a_factor_is_called_by_the_nearest_unit():
    said = reported(check(sound()[0], spoiled("y_horizontal", lambda x: np.pi / 30 * x)), "units")
    assert "about pi/30 (rad/s for rpm)" in said


def test_an_output_that_hardly_moves_and_does_not_follow_the_model_is_another_signal():
    rng = np.random.default_rng(4)
    noise = spoiled("y_horizontal", lambda x: 1e-4 * x.std() * rng.standard_normal(len(x)))
    refused = objection(check(sound()[0], noise))
    assert "y_horizontal moves" in refused
    assert "are columns exchanged?" in refused
    assert "y_vertical" not in refused
    dead = objection(check(sound()[0], spoiled("y_horizontal", lambda x: np.full_like(x, 0.1))))
    assert "dead" in dead
    assert "exchanged" not in dead
    louder = spoiled("y_horizontal", lambda x: 0.1 * x.std() * rng.standard_normal(len(x)))
    assert "exchanged" not in objection(check(sound()[0], louder))


@pytest.mark.parametrize("share", [0.3, -0.3])
def test_crosstalk_between_sensors_is_no_wrong_unit(share):
    """The small path of the model may be several times off, with the other sign, when a sensor hears the other axis."""
    crossed = []
    for t in sound()[1]:
        values, names = t.values.copy(), [c.name for c in t.channels]
        values[:, names.index("y_horizontal")] += share * values[:, names.index("y_vertical")]
        crossed.append(Trace(t.name, t.dt, t.channels, values, t.t0))
    assert objection(check(sound()[0], crossed)) == ""


def test_units_are_said_in_words():
    model, traces = sound()
    strange = replace(model, outputs=(replace(model.outputs[0], unit="revs/m"), *model.outputs[1:]))
    assert f"inputs {model.inputs[0].name} [volt]" in check(model, traces)[0].sentence
    assert f"outputs {model.outputs[0].name} [revs/m, a unit that is not known]" in check(strange, traces)[0].sentence


def test_a_wrong_unit_of_an_input_is_seen():
    refused = objection(check(sound()[0], spoiled("u_vertical", lambda x: 1e-3 * x)))
    assert "u_vertical" in refused
    assert "1000" in refused


def test_a_change_of_thirty_per_cent_is_no_wrong_unit():
    assert objection(check(sound()[0], spoiled("y_horizontal", lambda x: 1.3 * x))) == ""


def motor_log(seconds: float = 1.0, gain: float = 60.0, held: int = 50) -> Trace:
    """Return 30 s of a motor of 0.1 s at 100 Hz under random levels, times counted in ``seconds``."""
    rng = np.random.default_rng(8)
    u = np.repeat(rng.uniform(-5, 5, 3000 // held), held)
    y = np.zeros(3000)
    for k in range(2999):
        y[k + 1] = np.exp(-0.1) * y[k] + gain * (1 - np.exp(-0.1)) * u[k]
    return Trace("log.csv", 0.01 * seconds, (Channel("u_voltage", "V"), Channel("y_speed", "rpm")), np.column_stack([u, y + rng.normal(size=3000)]))


@pytest.mark.parametrize(("seconds", "words"), [(1e3, "times taken as milliseconds"), (1e-3, "times taken 1000 times as long")])
def test_times_in_another_unit_stop(seconds, words):
    model = Model.from_system(([60.0], [0.1, 1]), {"voltage": "V"}, {"speed": "rpm"})
    refused = objection(check(model, [motor_log(seconds)]))
    assert words in refused
    assert "--trust-units (trust_units=True)" in refused
    assert objection(check(model, [motor_log()])) == ""
    slow = Model.from_system(([60.0], [0.002, 1]), {"voltage": "V"}, {"speed": "rpm"})  # faster than the sampling, and right but for that
    assert objection(check(slow, [motor_log()])) == ""
    either = Model.from_system(([60.0], [3e-4, 1]), {"voltage": "V"}, {"speed": "rpm"})  # follows slow levels in both units
    assert objection(check(either, [motor_log(held=500)])) == ""


@pytest.mark.parametrize(("num", "den"), [([60.0, 4.0], [0.1, 1]), ([60.0], [1, 0.1])])
def test_a_model_that_no_output_follows_is_said(num, den):
    """A comma as decimal sign, and the order of coefficients turned around."""
    said = reported(check(Model.from_system((num, den), {"voltage": "V"}, {"speed": "rpm"}), [motor_log()]), "units")
    assert "follows less than half of what the inputs cause" in said


@pytest.mark.parametrize(("shift", "words"), [(4, "4 samples late"), (-3, "3 samples early")])
def test_clocks_out_of_step_are_counted_in_samples(shift, words):
    sentence = reported(check(sound()[0], spoiled("y_horizontal", lambda x: np.roll(x, shift))), "synchronisation")
    assert words in sentence
    assert "y_horizontal" in sentence
    assert "y_vertical" not in sentence


def test_clipping_is_seen_with_its_level():
    sentence = reported(check(sound()[0], spoiled("y_vertical", lambda x: np.clip(x, -np.inf, 1.5))), "saturation")
    assert "largest value 1.5 um" in sentence
    assert "smallest" not in sentence


def test_quantisation_is_seen_with_its_step_and_is_no_clipping():
    findings = check(sound()[0], spoiled("y_vertical", lambda x: np.round(x / 2.5) * 2.5))
    assert "steps of 2.5 um" in reported(findings, "quantisation")
    assert reported(findings, "saturation") == ""


def test_gaps_are_counted():
    def gap(x):
        x = x.copy()
        x[100:140] = np.nan
        return x

    assert "lacks 40 of 12500 samples" in reported(check(sound()[0], spoiled("y_horizontal", gap)), "gaps")


def test_drift_is_measured():
    findings = check(sound()[0], spoiled("y_horizontal", lambda x: x + np.linspace(0, 2, len(x))))
    sentence = reported(findings, "drift")
    assert "y_horizontal drifts by" in sentence
    assert float(sentence.split("drifts by ")[1].split()[0]) == pytest.approx(2.0, rel=0.25)


def test_a_missing_column_stops_by_name():
    model, traces = sound()
    names = [c for c in traces[0].channels if c.name != "y_vertical"]
    rest = [traces[0].channels.index(c) for c in names]
    (finding,) = check(model, [Trace("cut", traces[0].dt, tuple(names), traces[0].values[:, rest])])
    assert finding.kind == "stop"
    assert "'y_vertical'" in finding.sentence


@pytest.mark.parametrize(
    ("unit", "states", "said"),
    [("", (Variable("w"),), True), ("rpm", (Variable("w", "rpm"),), False), ("", (Variable("q"), Variable("v", rate_of="q")), False), ("degC", (Variable("T", "degC"),), False)],
)
def test_an_output_without_a_unit_that_may_be_a_speed_is_named(unit, states, said):
    plant = StateSpace(-np.eye(len(states)), np.ones((len(states), 1)), np.eye(1, len(states)), np.zeros((1, 1)))
    model = Model("motor", (Variable("voltage", "V"),), (Variable("n", unit),), states, plant)
    rng = np.random.default_rng(1)
    trace = Trace("log", 0.01, (Channel("u_voltage"), Channel("y_n")), rng.standard_normal((500, 2)))
    found = [f.sentence for f in ambiguities(model, prepare(model, [trace])) if f.topic == "motion"]
    assert bool(found) is said
    assert all("no unit is stated of n" in f for f in found)


def test_one_sine_is_said_to_leave_things_open():
    findings = check(*sound("sine"))
    assert "two sines (88 and " in one_frequency(findings)
    assert "multisine" in one_frequency(findings)
    assert one_frequency(check(*sound())) == ""


def test_ordinary_operation_of_a_machine_at_rest_is_insufficient():
    findings = check(*sound("operation"))
    assert "odd multisine on every input" in insufficient_excitation(findings)
    assert objection(findings) == ""


def test_the_information_is_that_of_the_fit():
    """One gain known to 50 %, a first-order plant: the posterior spread is the textbook one of a regression on its output."""
    n, sd = 4000, 0.3
    rng = np.random.default_rng(0)
    u = np.tile(rng.standard_normal(400), n // 400)
    text = 'name="m"\ntime="discrete"\nsample_time=0.01\ninputs=[{name="u"}]\noutputs=[{name="y"}]\nstates=[{name="x"}]\n'
    text += f"A=[[0.5]]\nB=[[2.0]]\nC=[[1]]\nD=[[0]]\n[uncertainty]\nA=[[0]]\nB=[[1.0]]\n[noise]\noutput_sd=[{sd}]\n"
    model = parse_model(text, "model.toml")
    x, y = 0.0, np.zeros(n)
    for k in range(n):
        y[k] = x
        x = 0.5 * x + 2.0 * u[k]
    trace = Trace("r", 0.01, (Channel("u_u"), Channel("y_y")), np.column_stack([u, y + sd * rng.standard_normal(n)]))
    (found,) = posterior_sd(build(nominal(model, 0.01), prepare(model, [trace]), Settings()), np.array([sd]))
    sensitivity = y / 2.0  # d y / d B, whose prior sd is 1
    expected = 1 / np.sqrt(1 + (sensitivity - sensitivity.mean()) @ (sensitivity - sensitivity.mean()) / sd**2)
    assert found == pytest.approx(expected, rel=0.06)


@pytest.mark.parametrize("cycles", [(51, 0), (255, 0), (51, 73), (255, 111)])
def test_a_sine_that_nearly_repeats_is_not_taken_for_periodic_early(cycles):
    """Sines of whole cycles in 2500 samples repeat after that, or a divisor, and after nothing else."""
    t = np.arange(12500)
    x = np.column_stack([np.sin(2 * np.pi * c * t / 2500 + 1) for c in cycles])
    period, _ = repetition(x)
    assert period > 0
    assert 2500 % period == 0


@pytest.mark.parametrize(
    ("folder", "model", "names"),
    [("emps", "model", ["estimation"]), ("silverbox", "model_physical", ["multisine"]), ("two_mass", "model", ["multisine_A", "multisine_B"])],
)
def test_measured_recordings_raise_no_objection(measured, folder, model, names):
    traces = [read_table(measured / folder / f"{n}.csv") for n in names]
    findings = check(read_model(measured / folder / f"{model}.toml"), traces)
    assert objection(findings) == ""
    assert insufficient_excitation(findings) == ""


def test_explain_refuses_a_wrong_unit_by_name():
    with pytest.raises(BadInput, match=r"y_horizontal is 10\d\d times what the model says, about 1000"):
        explain(sound()[0], spoiled("y_horizontal", lambda x: 1000 * x), (), afdsvc_physics())


def test_explain_says_insufficient_and_what_to_play():
    """A machine at rest: the burst proposed moves the nominal outputs by about ten times their noise."""
    trial = generate_trial("nothing", None, 0.0, np.random.default_rng(3), Options(excitation="operation", periods=2))
    model = parse_model(nominal_model_text(trial.machine), "model.toml")
    few = [p for p in afdsvc_physics() if p.name in ("coulomb_friction", "static_nonlinearity", "actuator_lag", "parameter_change")]
    answer = explain(model, trial.recordings, [trial.holdout], few)
    assert answer.verdict == "insufficient_excitation"
    assert "odd multisine" in answer.next_experiment["sentence"]
    runs = prepare(model, trial.recordings)
    burst = first_experiment(nominal(model, runs[0].dt), runs).burst
    played = burst.play(runs[0].dt)
    u, y = closed_loop(model, played, runs[0].dt)
    assert np.max(y[burst.settle :].std(0) / model.output_sd) == pytest.approx(10, rel=0.25)


def closed_loop(model: Model, alpha: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Return inputs and outputs of the nominal loop, sample by sample: u = K y + alpha."""
    G, K = sample_zoh(model.plant, dt), model.controller
    x, w, u, y = np.zeros(G.order), np.zeros(K.order), np.zeros_like(alpha), np.zeros((len(alpha), G.outputs))
    for k in range(len(alpha)):
        y[k] = G.C @ x
        u[k] = K.C @ w + K.D @ y[k] + alpha[k]
        w = K.A @ w + K.B @ y[k]
        x = G.A @ x + G.B @ u[k]
    return u, y


def test_a_delay_of_many_samples_is_counted_too():
    sentence = reported(check(sound()[0], spoiled("y_horizontal", lambda x: np.roll(x, 90))), "synchronisation")
    assert "90 samples" in sentence
    assert "shift one of the columns" in sentence


def test_a_dead_sensor_is_one_finding_and_no_wrong_unit():
    model, traces = sound()
    names = [c.name for c in traces[0].channels if c.role == "y"]
    for name in names:
        traces = [Trace(t.name, t.dt, t.channels, np.where([c.name == name for c in t.channels], 0.37, t.values), t.t0) for t in traces]
    assert [f.topic for f in check(model, traces) if f.kind == "stop"] == ["dead"] * len(names)


def test_a_unit_that_is_none_is_said_to_be_the_models():
    model, traces = sound()
    misspelt = replace(model, outputs=(replace(model.outputs[0], unit="rmp"), *model.outputs[1:]))
    assert f"the model's y_{model.outputs[0].name}: unit 'rmp' is not known; expected one such as 'rpm'" in reported(check(misspelt, traces), "units")


def test_a_step_whose_response_is_over_early_is_no_wrong_unit():
    """A motor with two and a half times the time constant of the model: later than the model remembers, next to nothing moves."""
    t = 0.002 * np.arange(450)
    speed = np.round(25 * (1 - np.exp(-t / 0.16)) / 0.26) * 0.26
    motor = Model.from_system(([2.09], [0.065, 1]), {"voltage": "V"}, {"speed": "rad/s"})
    found = check(motor, [Trace("step", 0.002, (Channel("u_voltage", "V"), Channel("y_speed", "rad/s")), np.column_stack([np.full(450, 12.0), speed]))])
    assert reported(found, "units") == ""


def test_recordings_that_fix_no_number_of_the_model_are_limited():
    """A motor sampled far below its time constant: its answer moves with the input, and its numbers do not show."""
    rng = np.random.default_rng(0)
    u = np.repeat(rng.standard_normal(50), 10)
    motor = Model.from_system(([2.0], [0.3, 1]), {"voltage": "V"}, {"speed": "rad/s"})
    motor = replace(motor, entry_sd={"A": np.array([[0.01]]), "B": np.array([[0.02]]), "C": np.zeros((1, 1)), "D": np.zeros((1, 1))})
    trace = Trace("slow", 5.0, (Channel("u_voltage", "V"), Channel("y_speed", "rad/s")), np.column_stack([u, 2 * u + rng.standard_normal(500)]))
    sentence = reported(check(motor, [trace]), "information")
    assert "fix 0 of 2 uncertain numbers" in sentence
    assert "an excitation that is larger, longer or broader would fix more" in sentence


class Tank:
    """A tank with an orifice: its time constant grows with the level, and vanishes where it is empty."""

    @staticmethod
    def f(t, x, u, p):
        return [p["pump"] * u[0] - p["orifice"] * max(x[0], 0.0) ** 0.5]

    @staticmethod
    def h(t, x, u, p):
        return [x[0]]


def test_time_constants_of_code_are_those_where_the_inputs_hold_it():
    rng, x, rows = np.random.default_rng(1), 9.0, []
    for u in np.repeat(rng.uniform(2.0, 4.0, 20), 60):
        rows.append((u, x + 0.01 * rng.standard_normal()))
        x += 2.0 * (0.1 * u - 0.1 * max(x, 0.0) ** 0.5)
    made = Model(
        "tank", (Variable("pump", "V"),), (Variable("level", "cm"),), (Variable("level", "cm"),), None, Tank,
        parameters={"pump": Quantity(0.1, relative_sd=0.1), "orifice": Quantity(0.1, relative_sd=0.1)},
    )
    findings = check(made, [Trace("log.csv", 2.0, (Channel("u_pump"), Channel("y_level")), np.array(rows))])
    assert reported(findings, "clock") == ""
