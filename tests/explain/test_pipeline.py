"""The whole way on a small spring: named, consistent, unexplained; without inputs, as Python code; the document people read."""

from __future__ import annotations

import importlib
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from afdsvc.api.model import Model, Quantity
from afdsvc.api.signals import Channel, Trace
from afdsvc.errors import BadInput
from afdsvc.explain.pipeline import explain
from afdsvc.explain.report.explanation import Explanation
from afdsvc.explain.settings import Settings
from afdsvc.explain.verdict.holdout import HeldOutVerdict
from afdsvc.files.model.improved import write_improved
from afdsvc.files.model.model_file import read_model
from afdsvc.plugins.physics import afdsvc_physics

module = importlib.import_module("afdsvc.explain.pipeline")
LEVELS = (1.0, 0.5, 0.75, 0.8)


def some(*names: str) -> list:
    return [p for p in afdsvc_physics() if p.name in names]


FEW = some("cubic_stiffness", "coulomb_friction", "quadratic_damping", "static_nonlinearity", "sensor_nonlinearity", "parameter_change")


def cubic(q: float, v: float) -> float:
    return -400.0 * q**3


@pytest.fixture(scope="module")
def four(recorded) -> list[Trace]:
    """Recordings of a spring that hardens."""
    return [recorded(seed, level, cubic) for seed, level in enumerate(LEVELS)]


@pytest.fixture(scope="module")
def answer(spring, four) -> Explanation:
    """What is said about it, the whole library offered."""
    return explain(spring, four[:3], four[3:], afdsvc_physics())


def test_a_concealed_cubic_spring_is_named_modelled_and_shown(answer):
    assert answer.verdict == "omitted_physics"
    first = answer.named[0]
    assert (first.physics, first.site) == ("cubic_stiffness", "state:v")
    found = first.parameters["stiffness"]
    assert found.value == pytest.approx(0.04, abs=4 * found.sd + 0.004)
    (fit,) = answer.fit
    assert fit.before_nrmse > 2 * fit.noise_floor_nrmse
    assert fit.after_nrmse < 1.05 * fit.noise_floor_nrmse
    assert answer.whiteness_p[0] < 1e-6 < 1e-3 < answer.whiteness_p[1]
    assert answer.gap.present


def test_the_place_and_the_picture_stand_beside_the_name(answer):
    (place,) = answer.located
    assert (place.output, place.input) == ("position", "force")
    assert 0 <= place.band_hz[0] < place.band_hz[1] < 200
    assert answer.law.against == "q"
    assert answer.law.named_y == pytest.approx(-0.04 * answer.law.x**3, abs=0.2 * 0.04 * np.abs(answer.law.x).max() ** 3)


def test_the_document_has_the_fixed_keys_and_is_plain_json(answer):
    again = json.loads(json.dumps(answer.json("improved.toml", "report.html"), allow_nan=False))
    assert {"verdict", "located", "named", "rejected", "fit", "model", "report", "gap", "candidates", "law"} <= set(again)
    assert set(again["fit"]) == {"per_output", "heldout", "whiteness_p"}
    assert set(again["fit"]["per_output"]["position"]) == {"before", "after", "noise_floor_nrmse"}
    assert again["fit"]["per_output"]["position"]["after"]["r2"] > again["fit"]["per_output"]["position"]["before"]["r2"]
    assert again["fit"]["heldout"] == ["r3"]
    assert {"physics", "site", "weight", "parameters", "sentence", "share_of_gap", "partial"} <= set(again["named"][0])
    assert set(again["named"][0]["parameters"]["stiffness"]) == {"value", "sd", "unit"}
    assert {"present", "r2", "p_value", "explainable", "sentence"} <= set(again["gap"])
    assert len(again["law"]["x"]) == len(again["law"]["low"]) == len(again["law"]["named_y"])
    assert all({"physics", "site", "heldout_nrmse", "why"} == set(r) for r in again["rejected"])


def test_a_machine_as_stated_is_consistent(spring, recorded):
    *recordings, held = [recorded(seed, level) for seed, level in enumerate(LEVELS)]
    answer = explain(spring, recordings, [held], FEW)
    assert answer.verdict == "consistent"
    assert (answer.named, answer.remainder, answer.law) == ((), None, None)


def test_a_machine_that_differs_in_what_is_held_out_only_is_not_consistent(spring, recorded):
    answer = explain(spring, [recorded(0, 0.05, cubic), recorded(1, 0.05, cubic)], [recorded(2, 1.0, cubic)], some("cubic_stiffness"))
    assert (answer.verdict, answer.named) == ("unexplained", ())
    assert any(s.startswith("on the recordings held out a flexible model predicts") for s in answer.sentences)


@pytest.mark.parametrize(("periods", "noise", "verdict"), [(1, 2.0, "unexplained"), (1, 0.5, "consistent"), (4, 2.0, "consistent")])
def test_a_model_that_misses_most_of_the_variance_is_consistent_only_with_known_noise(spring, recorded, periods, noise, verdict):
    recordings = [recorded(seed, noise=noise, periods=periods) for seed in range(3)]
    answer = explain(spring, recordings[:2], recordings[2:], some("cubic_stiffness"))
    assert (answer.verdict, answer.named) == (verdict, ())
    assert any("% of the variance of the recordings held out" in s for s in answer.sentences) is (verdict == "unexplained")


def test_without_a_hypothesis_a_gap_is_unexplained(spring, four):
    answer = explain(spring, four[:3], four[3:], [])
    assert (answer.verdict, answer.named, answer.candidates) == ("unexplained", (), ())


def test_a_few_samples_held_out_do_not_stop_the_answer(spring, recorded):
    answer = explain(spring, [recorded(0), recorded(1, 0.5)], [recorded(2).span(0, 80)], some("cubic_stiffness"))
    assert answer.verdict == "consistent"
    assert "the recordings held out have 80 samples; a test of what is missed there needs at least 100" in answer.sentences


def test_physics_that_no_hypothesis_has_is_unexplained_with_the_nearest_beside_it(spring, recorded, tmp_path):
    *recordings, held = [recorded(seed, level, lambda q, v: -3e3 * np.sin(6 * q)) for seed, level in enumerate(LEVELS)]
    answer = explain(spring, recordings, [held], some("coulomb_friction"))
    assert answer.verdict == "unexplained"
    assert (answer.named, answer.remainder) == ((), None)
    assert all(c.physics == "coulomb_friction" for c in answer.candidates)
    assert not [e for e in answer.point.effects if e.hypothesis.physics == "coulomb_friction"]
    assert write_improved(answer, tmp_path / "MODEL.toml", {}) == [tmp_path / "MODEL.toml"]


def silent(trace: Trace) -> Trace:
    return replace(trace, channels=(Channel("u_force"), *trace.channels), values=np.column_stack([np.zeros(len(trace)), trace.values]))


@pytest.mark.parametrize("inputs", ["none", "force"])
def test_a_free_decay_needs_no_input(spring, recorded, inputs):
    free = spring if inputs == "force" else replace(spring, inputs=(), plant=replace(spring.plant, B=np.zeros((2, 0)), D=np.zeros((1, 0))))
    *recordings, held = [recorded(seed, level, lambda q, v: -1500.0 * np.tanh(v / 0.5), decay=True, periods=1) for seed, level in enumerate(LEVELS)]
    if inputs == "force":
        *recordings, held = map(silent, [*recordings, held])
    answer = explain(free, recordings, [held], some("coulomb_friction", "quadratic_damping", "cubic_stiffness"))
    assert answer.named[0].physics == "coulomb_friction"
    assert answer.fit[0].after_nrmse < 0.3 * answer.fit[0].before_nrmse
    assert any(f"inputs {inputs}" in sentence and "outputs position" in sentence for sentence in answer.check)
    assert not any("no effect can be named" in sentence for sentence in answer.check)


class Code:
    """The spring as a person would write it."""

    def f(self, t, x, u, p):
        return np.array([x[1], p["stiffness"] * (u[0] - x[0]) - p["damping"] * x[1]])

    def h(self, t, x, u, p):
        return x[:1]


def test_python_code_is_explained_as_it_is_and_stays_the_code_it_is(spring, four, tmp_path):
    (tmp_path / "spring.py").write_text(
        "import numpy as np\n\n\nclass Code:\n    def f(self, t, x, u, p):\n        return np.array([x[1], p['stiffness'] * (u[0] - x[0]) - p['damping'] * x[1]])\n\n"
        "    def h(self, t, x, u, p):\n        return x[:1]\n\n\nmodel = Code()\n"
    )
    parameters = {"stiffness": Quantity(1e4, "1/s^2", 0.05), "damping": Quantity(20.0, "1/s", 0.1)}
    model: Model = replace(
        spring, plant=None, dynamics=Code(), parameters=parameters, origin=str(tmp_path / "model.toml"), extra={"dynamics": "spring.py:model"}
    )
    answer = explain(model, four[:3], four[3:], some("cubic_stiffness", "coulomb_friction"), experiment=False)
    assert (answer.named[0].physics, answer.named[0].site) == ("cubic_stiffness", "state:v")
    (tmp_path / "out").mkdir()
    written = write_improved(answer, tmp_path / "out" / "MODEL.toml", {})
    assert [f.name for f in written] == ["MODEL.toml", "MODEL.py"]
    improved = read_model(written[0], allow_code=True)
    again = explain(improved, four[:3], four[3:], some("cubic_stiffness"), experiment=False)
    left = [n.parameters["stiffness"].value for n in again.named if n.physics == "cubic_stiffness"]
    assert sum(left) < 0.03 * answer.named[0].parameters["stiffness"].value  # the fit holds a force over each step, the written code does not
    assert again.fit[0].before_nrmse < 0.1 * answer.fit[0].before_nrmse


def test_a_column_of_the_model_that_is_missing_is_named(spring, recorded):
    trace = recorded(1)
    cut = Trace("cut", trace.dt, trace.channels[:1], trace.values[:, :1])
    with pytest.raises(BadInput, match="y_position"):
        explain(spring, [cut], [], FEW)


def test_a_gain_that_is_off_is_a_constant_and_not_physics(spring):
    """A staircase drives the stated model with 4 % more gain and slow noise: curves, lags and hysteresis fit, too, and are not named."""
    rng = np.random.default_rng(5)
    accelerated = replace(spring, plant=replace(spring.plant, B=np.array([[0.0], [1.0]])))  # the input is an acceleration: its gain is not a free number
    A, B, *_ = cont2discrete((spring.plant.A, np.array([[0.0], [1.04]]), spring.plant.C, spring.plant.D), 2e-3)
    recordings = []
    for name in "abcd":
        u = np.repeat(rng.uniform(-1e4, 1e4, 40), 50)
        x, y = np.zeros(2), np.empty(len(u))
        for k, now in enumerate(u):
            y[k] = x[0]
            x = A @ x + B[:, 0] * now
        noise = lfilter([0.02 * np.sqrt(1 - 0.9**2)], [1, -0.9], rng.standard_normal(len(u)))
        recordings.append(Trace(name, 2e-3, (Channel("u_force"), Channel("y_position")), np.column_stack([u, y + noise])))
    answer = explain(accelerated, recordings[:3], recordings[3:], afdsvc_physics())
    assert answer.verdict == "parameter_change"
    assert {n.physics for n in answer.named if n.weight > 0.2} == {"parameter_change"}


def test_what_the_recordings_held_out_refute_gives_way_to_another_name(spring, four, monkeypatch):
    """The cubic spring is refuted by decree: the next search goes without it, and what it names is not certain."""
    checked = module.checked_on_holdout

    def decreed(found, verdict, runs, attempt):
        answer = checked(found, verdict, runs, attempt)
        cubic = any(c.candidate.hypothesis.physics == "cubic_stiffness" for c in answer.verdict.claims)
        return replace(answer, unconfirmed=True) if cubic else answer

    monkeypatch.setattr(module, "checked_on_holdout", decreed)
    again = explain(spring, four[:3], four[3:], some("cubic_stiffness", "clearance", "stiffness_follows_aux", "cogging"), experiment=False)
    assert again.named
    assert "cubic_stiffness" not in {n.physics for n in again.named}
    assert max(n.weight for n in again.named) <= 0.8
    assert any("cubic stiffness" in s and "held out" in s for s in again.sentences)


@pytest.mark.parametrize(
    ("attempts", "chosen"),
    [
        ("c", 0), ("wc", 1), ("dc", 1), ("ddd", 0), ("wdw", 1), ("www", 0), ("ddc", 2),
    ],
)
def test_a_confirmed_name_goes_before_a_doubted_one_and_that_before_none(monkeypatch, attempts, chosen):
    """Attempts one after another: c is confirmed, d followed better without its name, w withdrawn."""
    verdicts = [SimpleNamespace(claims=() if a == "w" else (a,)) for a in attempts]
    answers = iter([HeldOutVerdict(v, k, a != "c") for k, (v, a) in enumerate(zip(verdicts, attempts, strict=True))])
    candidate = SimpleNamespace(hypothesis=SimpleNamespace(title="a law"))
    found = SimpleNamespace(end=0, start=0, steps=(SimpleNamespace(candidates=(candidate,)),), problem=None)
    said = []
    monkeypatch.setattr(module, "_searched", lambda *_: found)
    monkeypatch.setattr(module, "mechanism", lambda h: h.title)
    monkeypatch.setattr(module, "verdict", lambda *_: None)
    monkeypatch.setattr(module, "checked_on_holdout", lambda *_: next(answers))
    monkeypatch.setattr(module, "doubted", lambda verdict, why, most: said.append(why) or verdict)
    base = SimpleNamespace(problem=SimpleNamespace(settings=Settings()))
    answer = module._confirmed(base, None, [], map, lambda *_: None, None, [])[1]
    assert answer.final == chosen
    assert [why.count("a law") for why in said] == ([chosen] if chosen else [])


class Left:
    """What a fit leaves."""

    def __init__(self, name: str, residual: np.ndarray) -> None:
        self.name, self.residuals = name, (residual,)

    def __str__(self) -> str:
        return self.name


def test_what_a_fit_leaves_is_tested_once_also_where_it_is_nearly_the_same(monkeypatch):
    asked = []
    monkeypatch.setattr(module, "by_innovations", lambda problem, fit, *_: fit)
    monkeypatch.setattr(module, "signals", lambda problem, point, horizon: point)
    monkeypatch.setattr(module, "signal_names", lambda problem: ())
    monkeypatch.setattr(module, "gap_test", lambda point, rng, mapper: asked.append(point) or f"gap of {point}")
    remainder, e = module.Remainder(np.random.default_rng(0)), np.random.default_rng(1).normal(size=(500, 2))
    one, nearly, other, shorter = (Left(name, r) for name, r in (("one", e), ("nearly", 1.005 * e), ("other", e * [1.0, 1.02]), ("shorter", e[:400])))
    found = [remainder(None, {0.1: one, 0.0: fit}) for fit in (one, other, one, nearly, shorter)]
    assert found == [f"gap of {name}" for name in ("one", "other", "one", "one", "shorter")]
    assert asked == [one, other, shorter]


@pytest.mark.parametrize(("lines", "most"), [((12.0,), 1), ((5.0, 12.0, 21.0), Settings().effects)])
def test_an_input_of_one_frequency_names_one_effect_at_most(spring, recorded, monkeypatch, lines, most):
    """A sine determines one complex gain: further effects were named beside a resonant actuator that was all there was."""
    t = 2e-3 * np.arange(3000)
    u = sum(np.sin(2 * np.pi * f * t) for f in lines)
    y = lfilter([0, 0.0392], [1, -1.921, 0.9608], u)  # the spring, about
    trace = replace(recorded(1), values=np.column_stack([u, y]))
    asked = []

    def built(nominal, runs, settings, heldout):
        asked.append(settings.effects)
        raise BadInput("enough")

    monkeypatch.setattr(module, "build", built)
    with pytest.raises(BadInput, match="enough"):
        explain(spring, [trace, trace], [], [])
    assert asked == [most]


@pytest.mark.parametrize(("sure", "chosen"), [(0.4, "offset"), (0.9, "effect")])
def test_an_effect_under_slow_noise_replaces_an_offset_only_where_held_out_recordings_follow(monkeypatch, sure, chosen):
    """A body that spins down one way: its friction is a constant force there, and what is left of it under slow noise resembles gravity."""
    problem = SimpleNamespace(weighting=SimpleNamespace(even=True), settings=Settings())
    point = SimpleNamespace(point=None)
    found = {
        "offset": SimpleNamespace(steps=(SimpleNamespace(accepted=True),), effects=0, end={0.0: point}, otherwise=None),
        "effect": SimpleNamespace(steps=(SimpleNamespace(accepted=True),), effects=1, end={0.0: point}, otherwise=None),
    }
    answers = iter(found.values())
    monkeypatch.setattr(module, "search", lambda *_: next(answers))
    monkeypatch.setattr(module, "under_slow_noise", lambda base, noise: base)
    monkeypatch.setattr(module, "player", lambda *_: SimpleNamespace(better=lambda *_: sure))
    base, gap = SimpleNamespace(problem=problem), SimpleNamespace(whitened=np.zeros(1))
    assert module._searched(base, gap, [], map, lambda *_: None, module.Remainder(np.random.default_rng(0)), [], []) is found[chosen]
