"""The one entry: what it finds, what it says, and everything it refuses."""

import json

import numpy as np
import pytest

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.errors import BadInput
from afdsvc.identify import IdentifyOptions, identify
from afdsvc.identify.excitation import needed_order
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.statespace import StateSpace
from afdsvc.plants.gas_bearing import gas_bearing

PLANT = gas_bearing(0)
OMEGA = np.geomspace(100, 8000, 40)
QUICK = IdentifyOptions(groups=0)


def _channels(roles):
    sides = {"u": PLANT.inputs, "y": PLANT.outputs, "alpha": PLANT.inputs, "beta": PLANT.outputs, "ref": PLANT.outputs}
    return tuple(Channel(f"{role}_{v.name}", v.unit) for role in roles for v in sides[role])


@pytest.fixture(scope="module")
def nominal(bearing):
    return StateSpace(0.7 * bearing.A, bearing.B, bearing.C, bearing.D, bearing.dt)


@pytest.fixture(scope="module")
def fact(nominal, observer_loop):
    return observer_loop(nominal)


@pytest.fixture(scope="module")
def model(nominal, fact):
    return Model(
        "bearing",
        PLANT.inputs,
        PLANT.outputs,
        PLANT.states,
        nominal,
        sample_time=nominal.dt,
        controller=fact.controller,
        output_sd=np.sqrt([0.12, 0.15]),
    )


@pytest.fixture(scope="module")
def run(fact, bearing, run_loop, binary):
    def make(seed, samples=6000, roles=("u", "y", "alpha", "beta"), amplitude=2.0, name="run.mcap"):
        rng = np.random.default_rng(seed)
        d = np.sqrt([0.12, 0.15]) * rng.standard_normal((samples, 2))
        record, alpha, beta = run_loop(fact, bearing, binary(rng, samples, 2, amplitude), d)
        parts = {"u": record.u, "y": record.y, "alpha": alpha, "beta": beta}
        return Trace(name, bearing.dt, _channels(roles), np.hstack([parts[role] for role in roles]))

    return make


def _error(system, bearing):
    truth = frequency_response(bearing, OMEGA)
    return np.abs(frequency_response(system, OMEGA) - truth).max() / np.abs(truth).max()


@pytest.fixture(scope="module")
def result(model, run):
    return identify(model, [run(1), run(2, 4000)], [run(3, 4000, name="other.mcap")])


def test_hansen_finds_the_bearing_from_a_model_that_predicts_nothing(result, bearing):
    assert result.fit.method == "hansen"
    assert result.fit.order == 6
    assert result.loop_stable is True
    for name in ("horizontal", "vertical"):
        assert result.before[name].r2 < 0.1
        assert result.after[name].r2 > 0.6
    assert _error(result.model.plant, bearing) < 0.05
    band = result.fit.band
    assert band.covers(frequency_response(bearing, band.omega), 0.999).mean() > 0.95
    own_axis = (band.sd / np.abs(band.value))[band.omega < 2000][:, [0, 1], [0, 1]]
    assert np.median(own_axis) < 0.05  # and the band is not wide for it
    assert result.cross_check.deviations < 2


def test_truth_would_hardly_predict_better(result, run, bearing):
    from afdsvc.dataset.arrays import InputOutputData
    from afdsvc.identify.validation import heldout_measures

    trace = run(3, 4000)
    best = heldout_measures(bearing, [InputOutputData.of(trace.role("u"), trace.role("y"), trace.dt)])
    for found, limit in zip(result.after.values(), best, strict=True):
        assert limit.r2 - 0.01 < found.r2 < limit.r2 + 0.005


def test_document_has_the_agreed_shape(result):
    document = json.loads(json.dumps(result.json("new.toml")))
    assert {"method", "order", "parameters", "fit", "loop_stable", "model"} <= set(document)
    assert document["model"] == "new.toml"
    assert document["fit"]["heldout"] == ["other.mcap"]
    per_output = document["fit"]["per_output"]
    assert set(per_output) == {"horizontal", "vertical"}
    for entry in per_output.values():
        assert set(entry) == {"before", "after"}
        assert entry["after"]["r2_classical"] == pytest.approx(1 - entry["after"]["nrmse"] ** 2)
    assert document["trained_on"] == ["run.mcap", "run.mcap"]
    assert {r["method"] for r in document["reductions"]} == {
        "refined",
        "balanced",
        "frequency_weighted",
        "closed_loop",
        "coprime",
    }


def test_without_recordings_to_hold_out_the_last_quarter_is_kept_away(model, run):
    found = identify(model, [run(4, 8000)], options=QUICK)
    assert found.heldout == ("run.mcap (last 25 %)",)
    assert found.after["vertical"].r2 > 0.6


def test_alpha_need_not_be_recorded_and_beta_neither(model, run, bearing):
    found = identify(model, [run(5, 8000, ("u", "y"))], options=QUICK)
    assert found.fit.method == "hansen"
    assert _error(found.model.plant, bearing) < 0.05


def test_excitation_through_the_reference_serves_as_well(model, fact, bearing, run_loop, binary):
    """Original Hansen scheme: r1 = -ref excites, nothing is injected into the controller."""
    rng = np.random.default_rng(6)
    traces = []
    for samples in (8000, 4000):
        ref, d = 3 * binary(rng, samples), np.sqrt([0.12, 0.15]) * rng.standard_normal((samples, 2))
        record, _, _ = run_loop(fact, bearing, np.zeros((samples, 2)), d, -ref)
        traces.append(Trace("ref.mcap", bearing.dt, _channels(("u", "y", "ref")), np.hstack([record.u, record.y, ref])))
    found = identify(model, traces[:1], traces[1:], QUICK)
    assert _error(found.model.plant, bearing) < 0.15
    assert found.after["horizontal"].r2 > found.before["horizontal"].r2 + 0.05


def test_every_order_can_be_asked_for(model, run, bearing):
    four = identify(model, [run(7)], options=IdentifyOptions(groups=0, reduce_to=4))
    full = identify(model, [run(7)], options=IdentifyOptions(groups=0, reduce_to=40, order=12))
    assert (four.fit.order, full.fit.order, full.fit.deviation.order) == (4, 18, 12)
    assert four.model.states[-1].name == "x4"
    for method in ("closed_loop", "coprime"):
        reduced = identify(model, [run(7)], options=IdentifyOptions(groups=0, reduction=method))
        assert f"reduced to 6 by {method} truncation" in reduced.fit.notes[0]


def test_pbsid_and_greybox_need_no_controller(bearing, run):
    bare = Model("bearing", PLANT.inputs, PLANT.outputs, PLANT.states, bearing, sample_time=bearing.dt)
    for method in ("pbsid", "pem"):
        found = identify(bare, [run(8, 8000, ("u", "y"))], options=IdentifyOptions(method=method, groups=0))
        assert found.fit.method == method
        assert found.loop_stable is None
        assert _error(found.model.plant, bearing) < 0.1
    continuous = PLANT.continuous(gain_hh=4.0e6)
    deviations = {"B": np.zeros((6, 2)), "A": np.zeros((6, 6))}
    deviations["A"][2, 4] = 0.5e6  # the input gain of the horizontal axis
    uncertain = Model("bearing", PLANT.inputs, PLANT.outputs, PLANT.states, continuous, entry_sd=deviations)
    found = identify(
        uncertain, [run(8, 6000, ("u", "y"))], options=IdentifyOptions(method="greybox", cross_check=False)
    )
    estimate = found.fit.parameters[0]
    assert estimate.name == "A[3,5]"
    assert abs(estimate.value - 4.318e6) < 4 * estimate.sd
    assert found.model.plant.A[2, 4] == estimate.value
    assert found.model.plant.dt == 0  # the grey box keeps the model's form
    assert found.json()["parameters"]["A[3,5]"]["sd"] == estimate.sd


def test_no_controller_and_no_sign_of_one_takes_the_open_loop_method(oscillators):
    from afdsvc.lti.simulate import simulate

    rng, system = np.random.default_rng(9), oscillators(9)
    u = rng.standard_normal((6000, 2))
    y = simulate(system, u)[0]
    trace = Trace(
        "open.csv", 1.0, _channels(("u", "y")), np.hstack([u, y + 0.2 * y.std(axis=0) * rng.standard_normal(y.shape)])
    )
    found = identify(
        Model("box", PLANT.inputs, PLANT.outputs, PLANT.states, system, sample_time=1.0), [trace], options=QUICK
    )
    assert found.fit.method in ("subspace", "output_error")  # whatever the samples left out speak for, but nothing made for a loop
    assert found.fit.order == 6


# --- refusals: each names what was found and what was wanted -------------------------------------------------------------


def test_unknown_controller(model, nominal, run):
    bare = Model("bearing", PLANT.inputs, PLANT.outputs, PLANT.states, nominal, sample_time=nominal.dt)
    with pytest.raises(
        BadInput, match=r"names no controller, but the recording was made in closed loop \(alpha_horizontal"
    ):
        identify(bare, [run(10)])
    with pytest.raises(BadInput, match="method 'hansen' needs the one that ran"):
        identify(bare, [run(10, roles=("u", "y"))], options=IdentifyOptions(method="hansen"))
    with pytest.raises(BadInput, match="method 'subspace' is biased in closed loop"):
        identify(model, [run(10)], options=IdentifyOptions(method="subspace"))


def test_another_controller_than_the_model_says(model, run):
    from dataclasses import replace

    K = model.controller
    other = replace(model, controller=StateSpace(K.A, K.B, 1.2 * K.C, K.D, K.dt))
    with pytest.raises(BadInput, match="not what the model's controller makes of the recorded output and excitation"):
        identify(other, [run(11)])


def test_saturated_actuator(model, run):
    trace = run(12)
    table = trace.values.copy()
    limit = 0.8 * np.abs(table[:, 0]).max()
    table[:, 0] = np.clip(table[:, 0], -limit, limit)
    with pytest.raises(BadInput, match=r"'u_horizontal' sits at its .* the actuator saturates"):
        identify(model, [Trace("run.mcap", trace.dt, trace.channels, table)])


@pytest.fixture
def diagnosis_burst(model, fact, bearing, run_loop):
    """One second of silence, a burst of one sine per input with ramps, silence: what a diagnosis plays."""
    lines = (Line(0, 2 * np.pi * 121, 2.0), Line(1, 2 * np.pi * 197, 2.0))
    played = Burst("diagnose", 2, 12_500, 300, lines).play(bearing.dt)
    alpha = np.vstack([np.zeros((5000, 2)), played, np.zeros((5000, 2))])
    d = np.sqrt([0.12, 0.15]) * np.random.default_rng(13).standard_normal((len(alpha), 2))
    record, alpha, _ = run_loop(fact, bearing, alpha, d)
    table = np.hstack([record.u, record.y, alpha])
    return Trace("burst.mcap", bearing.dt, _channels(("u", "y", "alpha")), table)


def test_not_exciting(model, diagnosis_burst):
    """One sentence: the order of persistent excitation found, the one wanted, and the burst to play instead."""
    with pytest.raises(BadInput) as reported:
        identify(model, [diagnosis_burst])
    text = str(reported.value)
    assert "input 'horizontal' holds 1 spectral line: persistent excitation of order 2, expected" in text
    assert ", expected 10 for a model of order 6" in text
    assert "afdsvc burst --purpose identify" in text
    assert "\n" not in text


def test_noise_that_comes_back_through_the_controller_is_no_excitation(model, diagnosis_burst):
    from dataclasses import replace

    bare = replace(model, controller=None)
    for method in ("pbsid", "pem"):
        with pytest.raises(BadInput, match=r"persistent excitation of order [24], expected 10"):
            identify(bare, [diagnosis_burst], options=IdentifyOptions(method=method))


def test_the_order_of_S_stays_within_what_the_burst_supports(model, fact, bearing, run_loop):
    """Six lines on every input: a plant of order 6 can be carried (10 of 12), S of order 12 (needs 19) cannot."""
    lines = [Line(j, 2 * np.pi * f, 1.0, f) for j in (0, 1) for f in (40.0 + 17 * j + 60.0 * np.arange(6))]
    alpha = Burst("six", 2, 10_000, 300, tuple(lines)).play(bearing.dt)
    d = np.sqrt([0.12, 0.15]) * np.random.default_rng(14).standard_normal((10_000, 2))
    record, alpha, _ = run_loop(fact, bearing, alpha, d)
    trace = Trace("six.mcap", bearing.dt, _channels(("u", "y", "alpha")), np.hstack([record.u, record.y, alpha]))
    found = identify(model, [trace], options=QUICK)
    assert needed_order(found.fit.deviation.order, 2) <= 12


def test_no_excitation_at_all(model, run):
    with pytest.raises(BadInput, match="input 'horizontal' never moves"):
        identify(model, [run(14, amplitude=0.0)])


def test_too_short_gaps_and_drift(model, run):
    with pytest.raises(BadInput, match="are too short; expected at least"):
        identify(model, [run(15, 300)])
    trace = run(15)
    table = trace.values.copy()
    table[100, 2] = np.nan
    with pytest.raises(BadInput, match="1 samples of 'y_horizontal' are missing"):
        identify(model, [Trace("run.mcap", trace.dt, trace.channels, table)])
    table = trace.values.copy()
    table[:, 3] += np.linspace(0, 5 * table[:, 3].std(), len(table))
    with pytest.raises(BadInput, match="'y_vertical' drifts"):
        identify(model, [Trace("run.mcap", trace.dt, trace.channels, table)])


def test_wrong_columns_and_sample_times(model, run):
    from dataclasses import replace

    with pytest.raises(BadInput, match="no column 'y_horizontal'; it has u_horizontal, u_vertical"):
        identify(model, [run(16, roles=("u",))])
    trace = run(16)
    with pytest.raises(BadInput, match=r"model 'bearing' has sample_time 0.0002 s, the recordings 0.001 s"):
        identify(model, [Trace("run.mcap", 1e-3, trace.channels, trace.values)])
    slow = replace(model, controller=StateSpace(*(getattr(model.controller, k) for k in "ABCD"), 1e-3))
    with pytest.raises(BadInput, match=r"the controller has sample_time 0.001 s, the recordings 0.0002 s"):
        identify(slow, [trace])
    with pytest.raises(BadInput, match="no recording was handed in"):
        identify(model, [])


@pytest.mark.parametrize(("order", "worse"), [(1, True), (2, False)])
def test_a_model_that_is_followed_better_than_the_identified_one_is_reported(order, worse):
    """Of an oscillator that is known, an asked first order leaves more of the samples held out than the model that was given."""
    plant = StateSpace(np.array([[1.6, -0.9], [1.0, 0.0]]), np.array([[1.0], [0.0]]), np.array([[0.3, 0.0]]), np.zeros((1, 1)), 1e-2)
    rng, x, y = np.random.default_rng(0), np.zeros(2), []
    u = rng.standard_normal(3000)
    for now in u:
        y.append(plant.C @ x)
        x = plant.A @ x + plant.B[:, 0] * now
    table = np.column_stack([u, np.vstack(y) + 0.05 * rng.standard_normal((3000, 1))])
    model = Model("known", (Variable("force", "N"),), (Variable("position", "m"),), (), plant, sample_time=1e-2)
    found = identify(model, [Trace("run.csv", 1e-2, (Channel("u_force"), Channel("y_position")), table)], options=IdentifyOptions(method="subspace", order=order))
    said = [w for w in found.warnings if w.startswith("output 'position': the model that was given follows the samples held out better than")]
    assert bool(said) == worse
    if worse:
        given, left = found.before["position"].nrmse, found.after["position"].nrmse
        assert f"(error {100 * given:.3g} % of the output's deviation, identified {100 * left:.3g} %)" in said[0]


def test_unknown_options_are_errors():
    with pytest.raises(BadInput, match="identify has no option 'ordr'; it has method, order"):
        IdentifyOptions.of({"ordr": 4})
    with pytest.raises(BadInput, match="option method = 'n4sid'"):
        IdentifyOptions.of({"method": "n4sid"})
    with pytest.raises(BadInput, match="option weighting = 'PERSIM_K'"):
        IdentifyOptions.of({"weighting": "PERSIM_K"})
    assert IdentifyOptions.of({"order": 4}).order == 4


def test_order_zero_of_S_leaves_the_nominal_model_in_place(model, fact, bearing, run_loop, binary):
    """A plant equal to the model, recorded through an observer that is the Kalman filter: beta is white, S is zero."""
    from dataclasses import replace

    from afdsvc.lti.coprime import observer_factorisation
    from afdsvc.lti.riccati import kalman_predictor_gain, lqr
    from afdsvc.lti.simulate import simulate

    rng, samples = np.random.default_rng(17), 8000
    Q, R = np.diag([0, 0, 1e4, 1e4, 0, 0]), np.diag([0.12, 0.15])
    kalman = observer_factorisation(
        bearing, lqr(bearing, 1e-4 * np.diag([0, 0, 1.0, 1, 0, 0]), np.eye(2)), kalman_predictor_gain(bearing, Q, R)
    )
    w = rng.standard_normal((samples, 6)) * np.sqrt(np.diag(Q))
    d = simulate(StateSpace(bearing.A, np.eye(6), bearing.C, np.zeros((2, 6)), bearing.dt), w)[0]
    record, alpha, _ = run_loop(
        kalman, bearing, 2 * binary(rng, samples), d + np.sqrt(np.diag(R)) * rng.standard_normal((samples, 2))
    )
    true = replace(model, plant=bearing, controller=kalman.controller)
    trace = Trace("healthy.mcap", bearing.dt, _channels(("u", "y", "alpha")), np.hstack([record.u, record.y, alpha]))
    found = identify(true, [trace], options=QUICK)
    assert found.fit.order_reason.startswith("order 0")
    assert np.array_equal(found.model.plant.A, bearing.A)
    assert found.fit.notes == ("no deviation from the nominal model shows in the recordings; the nominal model is kept",)
