"""The screen: what a hypothesis promises is what it gains, however nearly the free numbers imitate it."""

import numpy as np
import pytest
from scipy.signal import lsim

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.dataset.experiment import prepare
from afdsvc.explain.search.build import build
from afdsvc.explain.search.fit import Coordinates, fit
from afdsvc.explain.search.machine import machine
from afdsvc.explain.search.screen import Screen
from afdsvc.explain.settings import Settings
from afdsvc.explain.simulate.nominal import nominal
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics.clearance import Clearance
from afdsvc.plugins.physics.parameter_change import ParameterChange

DT, SAMPLES, HEAVIER = 0.01, 1000, 0.18


def matrices(mass):
    """Two coupled bodies, each pushed by an input."""
    A = np.array([[0, 1, 0, 0], [-55 / mass, -1.2 / mass, 15 / mass, 0], [0, 0, 0, 1], [15, 0, -105, -0.8]])
    return A, np.array([[0, 0], [1 / mass, 0], [0, 0], [0, 1]])


@pytest.fixture(scope="module")
def bodies():
    """The first body is heavier than stated, and every term of both force balances is uncertain: only the priors speak for the mass."""
    rng, t = np.random.default_rng(4), DT * np.arange(SAMPLES)
    u, C, D = np.repeat(rng.standard_normal((SAMPLES // 10, 2)), 10, axis=0), np.eye(4)[[0, 2]], np.zeros((2, 2))
    y = lsim((*matrices(1 + HEAVIER), C, D), u, t, interp=False)[1]
    y = y + 1e-3 * y.std(0) * rng.standard_normal(y.shape)
    recording = Trace("bodies", DT, (Channel("u_f"), Channel("u_g"), Channel("y_q"), Channel("y_p")), np.column_stack([u, y]))
    A, B = matrices(1.0)
    uncertain = {"A": 0.05 * abs(A) * np.array([[0], [1], [0], [1]]), "B": 0.05 * B, "C": 0 * C, "D": D}
    states = (Variable("q", "m"), Variable("v", "m/s", rate_of="q"), Variable("p", "m"), Variable("w", "m/s", rate_of="p"))
    model = Model("bodies", (Variable("f", "N"), Variable("g", "N")), (Variable("q", "m"), Variable("p", "m")), states, StateSpace(A, B, C, D), entry_sd=uncertain)
    problem = build(nominal(model, DT), prepare(model, [recording]), Settings())
    return problem, fit(problem, problem.start(), 0.0, 1.0)


def test_a_heavier_mass_promises_what_the_priors_lose_without_it(bodies):
    """With it every term is as stated, and the penalty of the priors vanishes."""
    problem, base = bodies
    screened = [Screen(problem, base, 0.0)(h) for h in ParameterChange().hypotheses(machine(problem, base, 0.0, [], [], "model")) if h.notes["of"] == "mass"]
    first, second = sorted(screened, key=lambda s: -s.fall)
    assert "state:v" in first.hypothesis.key
    assert first.fall == pytest.approx(base.penalty, rel=0.2)
    assert second.fall < 0.1


def test_a_law_in_place_of_a_part_of_the_model_also_begins_at_the_stated_numbers(bodies):
    """What it promises there is what it leaves less than the base, which the mass has bent; a law that begins at nothing is not tried there."""
    problem, base = bodies
    screen = Screen(problem, base, 0.0)
    offers = {h.key: h for h in Clearance().hypotheses(machine(problem, base, 0.0, [], [], "model"))}
    h = offers["clearance@state:v#play in the spring"]
    starts = screen(h).starts
    assert len(starts) == 2 * len(h.starts)
    assert len(screen(offers["clearance@state:v"]).starts) == len(offers["clearance@state:v"].starts)
    c, left = Coordinates(problem, base.point), []
    for s in starts:
        point = c.unpack(c.pack(base.point) + s.shift)
        if not point.theta.any():
            (residual,) = problem.residuals(point.added(s.effect), 0.0)
            (without,) = base.residuals
            left.append((s.fall, float((((without / base.sd) ** 2).sum() - ((residual / base.sd) ** 2).sum()) / base.tau)))
    assert len(left) == len(h.starts)
    assert [fall for fall, _ in left] == pytest.approx([fall for _, fall in left])
