"""A constant that is off by more than its owner states: named for what it is, and never shared out among the others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.dataset.experiment import prepare
from afdsvc.explain.baseline import Baseline, agitation, baseline
from afdsvc.explain.explain import explain
from afdsvc.explain.forward import seen
from afdsvc.explain.nominal import nominal
from afdsvc.explain.objective import tangent
from afdsvc.explain.settle import full_cost
from afdsvc.explain.simulator import Effect
from afdsvc.explain.strain import distance, irregular, strained
from afdsvc.explain.transfer import transfers
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics import afdsvc_physics

DT, PERIOD, PERIODS, NOISE, KNOWN = 1e-3, 1000, 4, 0.3, 0.02


def plant(stiffness: float = 1.0, damping: float = 1.0, mass: float = 1.0) -> StateSpace:
    A = np.array([[0, 1.0], [-4e4 * stiffness / mass, -30.0 * damping / mass]])
    return StateSpace(A, np.array([[0.0], [4e4 / mass]]), np.array([[1.0, 0]]), np.zeros((1, 1)))


def model() -> Model:
    states = (Variable("q", "mm"), Variable("v", "mm/s", rate_of="q"))
    G = plant()
    sd = {name: KNOWN * np.abs(matrix) * (np.abs(matrix) != 1) for name, matrix in (("A", G.A), ("B", G.B), ("C", G.C))}
    return Model("spring", (Variable("force", "N"),), (Variable("position", "mm"),), states, G, entry_sd=sd, output_sd=np.array([NOISE]))


def recordings(truth: StateSpace, count: int = 4, shaken: float = 0.0) -> list[Trace]:
    """Return recordings of a machine that a random force of this rms shakes."""
    found = []
    for seed in range(count):
        rng = np.random.default_rng(seed)
        lines = np.array([k for i, k in enumerate(range(1, 100, 2)) if i % 4 != 3])
        t = np.arange(PERIOD) * DT
        u = np.cos(2 * np.pi * np.outer(t, lines) / (PERIOD * DT) + rng.uniform(0, 2 * np.pi, len(lines))).sum(1)
        u = np.tile((1.0, 0.5, 0.75, 0.8)[seed] * u / u.std(), PERIODS)
        force = u + shaken * np.random.default_rng(seed + 100).standard_normal(len(u))
        y = simulate(sample_zoh(truth, DT), force[:, None])[0][:, 0]
        values = np.column_stack([u, y + NOISE * rng.standard_normal(len(u))])
        found.append(Trace(f"r{seed}", DT, (Channel("u_force"), Channel("y_position")), values))
    return found


def start(truth: StateSpace) -> Baseline:
    runs = prepare(model(), recordings(truth, 2))
    return baseline(nominal(model(), runs[0].dt), runs)


@pytest.mark.parametrize(("changed", "name"), [({"stiffness": 1.15}, "stiffness"), ({"mass": 1.2}, "mass"), ({"damping": 1.3}, "damping")])
def test_a_constant_off_by_many_deviations_is_named(changed, name):
    *given, held = recordings(plant(**changed))
    answer = explain(model(), given, [held], afdsvc_physics(), rehearse=False)
    assert answer.verdict == "parameter_change"
    told = {key for n in answer.named for key in n.parameters}
    assert name in told
    place = answer.located[0]
    assert (place.output, place.kind) == ("position", "linear")
    assert "as stated" in place.evidence


def test_nothing_is_located_where_the_model_is_as_stated():
    *given, held = recordings(plant(stiffness=1.03))
    answer = explain(model(), given, [held], afdsvc_physics(), rehearse=False)
    assert (answer.verdict, answer.located) == ("consistent", ())


def test_a_transfer_costs_what_it_promises():
    """Predicted from matrices and information alone, and then simulated."""
    base = start(plant(stiffness=1.15))
    t = tangent(base.objective, base.point)
    cost, hypothesis, point = transfers(t, [h for p in afdsvc_physics() for h in p.hypotheses(seen(base))], 8.0)[0]
    assert hypothesis.key.endswith("stiffness")
    assert t.cost - cost > 30
    assert full_cost(base.objective, point) == pytest.approx(cost, abs=0.1 * (t.cost - cost))


def test_the_distance_of_a_model_as_good_as_stated_is_chi_square():
    """Sixty machines drawn from the owner's statement: the strain's p-values are uniform (Kolmogorov-Smirnov, fixed seed)."""
    rng, p = np.random.default_rng(5), []
    for _ in range(60):
        a0, a1, b = 1 + KNOWN * rng.standard_normal(3)
        G = plant()
        truth = StateSpace(G.A * np.array([[1, 1], [a0, a1]]), G.B * np.array([[1], [b]]), G.C, G.D)
        strain, count = distance(start(truth))
        assert 1 <= count <= 3
        p.append(stats.chi2.sf(strain, count))
    assert stats.kstest(p, "uniform").pvalue > 0.01


def test_an_estimate_that_its_prior_held_back_counts_for_what_it_would_have_been():
    """Oracle: one number known about as well before; what the recordings know of it follows from the fall of the cost alone."""
    loose = model()
    assert loose.plant is not None
    sd = {"A": 0.001 * np.abs(loose.plant.A) * np.array([[0, 0], [1, 0]]), "B": np.zeros((2, 1)), "C": np.zeros((1, 2))}
    owner = replace(loose, entry_sd=sd)
    runs = prepare(owner, recordings(plant(stiffness=1.004), 2))
    base = baseline(nominal(owner, runs[0].dt), runs)
    (theta,) = base.point.theta
    fall = full_cost(base.objective, replace(base.point, theta=np.zeros(1))) - full_cost(base.objective, base.point)
    information = fall / theta**2 - 1  # of the recordings, where that of the prior is 1
    strain, count = distance(base)
    assert count == 1
    assert 1 < information < 9
    assert strain == pytest.approx(theta**2 * (1 + information) / information, rel=0.03)


def test_numbers_the_recordings_say_nothing_about_do_not_count():
    """A second machine that nobody moves adds three numbers to the model, and nothing to the strain."""
    G = plant()
    pair = StateSpace(*(np.kron(np.eye(2), M) for M in (G.A, G.B, G.C, G.D)))
    sd = {"A": KNOWN * np.abs(pair.A) * (pair.A != 1), "B": KNOWN * np.abs(pair.B)}
    states = tuple(v for i in "ab" for v in (Variable(f"q{i}", "mm"), Variable(f"v{i}", "mm/s", rate_of=f"q{i}")))
    both = Model(
        "pair", (Variable("fa", "N"), Variable("fb", "N")), (Variable("a", "mm"), Variable("b", "mm")), states, pair,
        entry_sd=sd, output_sd=np.full(2, NOISE),
    )
    traces = []
    for k, trace in enumerate(recordings(plant(stiffness=1.05), 2)):
        still = np.column_stack([np.zeros(len(trace.values)), NOISE * np.random.default_rng(50 + k).standard_normal(len(trace.values))])
        traces.append(side_by_side(trace, replace(trace, values=still)))
    runs = prepare(both, traces)
    base = baseline(nominal(both, runs[0].dt), runs)
    strain, count = distance(base)
    alone, known = distance(start(plant(stiffness=1.05)))
    assert len(base.point.theta) == 6
    assert count == known <= 3
    assert strain == pytest.approx(alone, rel=0.2)


def test_a_model_within_its_statement_is_not_strained():
    assert strained(start(plant(stiffness=1.03, damping=0.98))) == ""


def test_a_model_beyond_its_statement_is_strained():
    said = strained(start(plant(stiffness=1.2)))
    assert "standard deviations" in said
    assert "A[v, q]" in said


def test_a_named_law_may_strain_the_model_a_little_for_what_it_explains():
    """A hundredth of the sum of squares that a law takes away: laws are right in form to a tenth of their answer."""
    base = start(plant(stiffness=1.2))
    strain = float(base.point.theta @ base.point.theta)
    assert strained(base, 100 * strain) == ""
    assert strained(base, 10 * strain) != ""


def test_a_model_that_states_nothing_is_not_strained():
    base = start(plant(stiffness=1.2))
    assert strained(replace(base, limited="model")) == ""


@pytest.fixture(scope="module")
def gripping() -> Baseline:
    """Two springs side by side, the first with a hysteretic force named."""
    return hysteretic(recordings(plant(), 4))


def hysteretic(traces: list[Trace]) -> Baseline:
    G = plant()
    pair = StateSpace(*(np.kron(np.eye(2), M) for M in (G.A, G.B, G.C, G.D)))
    states = tuple(v for i in "ab" for v in (Variable(f"q{i}", "mm"), Variable(f"v{i}", "mm/s", rate_of=f"q{i}")))
    both = Model("pair", (Variable("fa", "N"), Variable("fb", "N")), (Variable("a", "mm"), Variable("b", "mm")), states, pair, output_sd=np.full(2, NOISE))
    runs = prepare(both, [side_by_side(*traces[2 * k : 2 * k + 2]) for k in range(2)])
    base = baseline(nominal(both, runs[0].dt), runs)
    law = next(h for p in afdsvc_physics() for h in p.hypotheses(seen(base)) if h.key == "hysteresis@state:va")
    return replace(base, point=base.point.with_effect(Effect(law, np.array([0.1 * law.parameters[0].scale, *law.starts[0][1:]]))))


def test_a_model_of_two_outputs_that_is_stated_exactly_is_located_all_the_same():
    """Two springs, one of them a tenth stiffer than its model says, with no number the owner would let move."""
    G = plant()
    pair = StateSpace(*(np.kron(np.eye(2), M) for M in (G.A, G.B, G.C, G.D)))
    states = tuple(v for i in "ab" for v in (Variable(f"q{i}", "mm"), Variable(f"v{i}", "mm/s", rate_of=f"q{i}")))
    both = Model("pair", (Variable("fa", "N"), Variable("fb", "N")), (Variable("a", "mm"), Variable("b", "mm")), states, pair, entry_sd={name: np.zeros_like(getattr(pair, name)) for name in "ABC"})
    off, right = recordings(plant(stiffness=1.1), 3), recordings(plant(), 4)[1:]
    *given, held = [side_by_side(x, y) for x, y in zip(off, right, strict=True)]
    answer = explain(both, given, [held], afdsvc_physics(), rehearse=False)
    assert answer.located[0].output == "a"
    assert (answer.verdict, answer.named[0].site) == ("parameter_change", "state:va")
    assert answer.fit[0].after_nrmse < 0.5 * answer.fit[0].before_nrmse


def side_by_side(a: Trace, b: Trace) -> Trace:
    names = ("u_fa", "u_fb", "y_a", "y_b")
    return Trace(a.name + b.name, DT, tuple(Channel(n) for n in names), np.column_stack([a.values[:, 0], b.values[:, 0], a.values[:, 1], b.values[:, 1]]))


@pytest.mark.parametrize(
    ("louder", "ratio", "coloured", "said"),
    [
        ((1.1, 1.0), 0.0, (), True), ((1.0, 1.0), 0.0, ("a",), True), ((1.1, 1.0), 0.01, (), True), ((1.0, 1.0), 0.01, ("a",), True),
        ((1.0, 1.0), 0.0, (), False),  # as stated
        ((1.1, 1.1), 0.0, (), False),  # louder everywhere: the statement is wrong, not the law
        ((1.0, 1.1), 0.0, (), False),  # somewhere else
        ((1.0, 1.0), 0.0, ("a", "b"), False),  # coloured everywhere
    ],
)
def test_noise_where_something_grips_alone_belongs_to_it(gripping, louder, ratio, coloured, said):
    floor = replace(gripping.floor, sd=NOISE * np.array(louder), known=True)
    assert bool(irregular(replace(gripping, floor=floor, ratio=ratio, limited="noise"), coloured)) == said


@pytest.mark.parametrize(("a", "b", "where", "said"), [
    (0.3, 0.0, {0}, True), (0.0, 0.3, {1}, False), (0.3, 0.3, {0, 1}, False), (0.3, 0.22, {0, 1}, False), (0.0, 0.0, set(), False),
])
def test_a_random_force_at_one_input_alone_belongs_to_what_grips_there(a, b, where, said):
    """The likelihood tells at which input noise enters; at both it is the machine's, at the other it has to do with another thing."""
    first, second = recordings(plant(), 4, shaken=a), recordings(plant(), 4, shaken=b)
    base = hysteretic([trace for k in (0, 2) for trace in (first[k], second[k + 1])])
    assert (base.ratio > 0) == bool(where)
    if where:
        assert set(np.flatnonzero(agitation(base) > 10)) == where
    calm = replace(base, floor=replace(base.floor, sd=np.full(2, NOISE)))  # the predictor takes it up: what is left is as stated
    assert bool(irregular(calm)) == said


def coupled(damping: float) -> StateSpace:
    """Two springs, ``a`` and ``b``, whose dampers pull at each other too; what damps ``a`` is ``damping`` times as strong."""
    A = np.kron(np.eye(2), plant().A)
    A[1, [1, 3]], A[3, 1] = np.array([-30.0, -18.0]) * damping, -18.0
    G = plant()
    return StateSpace(A, np.kron(np.eye(2), G.B), np.kron(np.eye(2), G.C), np.zeros((2, 2)))


def test_what_damps_an_axis_may_change_with_its_couplings_and_is_one_name():
    G, truth = coupled(1.0), coupled(0.5)
    states = tuple(v for i in "ab" for v in (Variable(f"q{i}", "mm"), Variable(f"v{i}", "mm/s", rate_of=f"q{i}")))
    sd = {name: KNOWN * np.abs(matrix) * (np.abs(matrix) != 1) for name, matrix in (("A", G.A), ("B", G.B), ("C", G.C))}
    both = Model("pair", (Variable("fa", "N"), Variable("fb", "N")), (Variable("a", "mm"), Variable("b", "mm")), states, G, entry_sd=sd, output_sd=np.full(2, NOISE))
    played = [side_by_side(x, y) for x, y in zip(recordings(plant(), 3), recordings(plant(), 4)[1:], strict=True)]
    *given, held = [answered(truth, trace, seed) for seed, trace in enumerate(played)]
    answer = explain(both, given, [held], afdsvc_physics(), rehearse=False)
    assert [(n.physics, n.site) for n in answer.named] == [("parameter_change", "state:va")]
    change = answer.named[0]
    assert change.weight > 0.99
    assert abs(change.parameters["damping"].value + 0.5) < 4 * change.parameters["damping"].sd < 0.1


def answered(truth: StateSpace, played: Trace, seed: int) -> Trace:
    """Return a trace with the answer of another plant to its inputs."""
    u = played.values[:, :2]
    y = simulate(sample_zoh(truth, DT), u)[0] + NOISE * np.random.default_rng(seed + 50).standard_normal(u.shape)
    return replace(played, values=np.column_stack([u, y]))


@pytest.mark.parametrize(("key", "size", "grips"), [
    ("sensor_drift@output:a", 50.0, False), ("slew_limit@input:fa", None, False), ("creep@input:fa", 5.0, False), ("backlash@input:fa", None, True),
])
def test_what_remembers_need_not_grip_where_the_noise_is_louder(gripping, key, size, grips):
    """A law may count the time, lag behind or creep and yet hold on to nothing: rounding or a bad cable beside it is no riddle."""
    law = next(h for p in afdsvc_physics() for h in p.hypotheses(seen(gripping)) if h.key == key)
    values = np.array(law.starts[0])
    values[0] = values[0] if size is None else size * law.parameters[0].scale
    base = replace(gripping, point=replace(gripping.point, effects=(Effect(law, values),)), ratio=0.0, limited="noise")
    assert grips == bool(irregular(replace(base, floor=replace(base.floor, sd=NOISE * np.array([1.1, 1.0]), known=True))))


def relaxing(share: float, seconds: float) -> StateSpace:
    """Return the spring of 200 rad/s with a Maxwell element of ``share`` of its stiffness beside it: rubber, not a structure."""
    k = 4e4
    A = np.array([[0, 1.0, 0], [-k, -30.0, -1.0], [0, share * k, -1 / seconds]])
    return StateSpace(A, np.array([[0.0], [k], [0.0]]), np.array([[1.0, 0, 0]]), np.zeros((1, 1)))


def test_what_relaxes_is_the_damping_it_mostly_is_and_no_resonance():
    """A tenth of the stiffness that relaxes within 4 ms: nothing there rings, though a mass with a damping ratio of 0.37 would fit."""
    *given, held = recordings(relaxing(0.1, 0.004))
    answer = explain(model(), given, [held], afdsvc_physics(), rehearse=False)
    assert (answer.named[0].physics, answer.named[0].site, *answer.named[0].parameters) == ("parameter_change", "state:v", "damping")
