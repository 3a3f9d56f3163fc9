"""The next experiment asks for what tells look-alikes apart, and its promise is kept by data made afterwards."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from afdsvc.api.bursts import Limits
from afdsvc.api.model import Model, Variable
from afdsvc.api.physics import Hypothesis
from afdsvc.api.signals import Channel, Trace
from afdsvc.dataset.experiment import prepare
from afdsvc.explain.baseline import Baseline, baseline
from afdsvc.explain.fit import apply_shift, fit, screen
from afdsvc.explain.next_experiment import Contender, next_experiment
from afdsvc.explain.next_experiment_separation import unlike
from afdsvc.explain.nominal import nominal
from afdsvc.explain.objective import tangent
from afdsvc.explain.settle import full_cost, settle
from afdsvc.explain.simulator import Effect
from afdsvc.explain.sizes import machine
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics import afdsvc_physics

DT, W, ZETA = 1e-3, 2 * np.pi * 15, 0.15
A = np.array([[0.0, 1.0], [-(W**2), -2 * ZETA * W]])
B = np.array([[0.0], [W**2]])


def oscillator() -> Model:
    plant = StateSpace(A, B, np.array([[1.0, 0.0]]), np.zeros((1, 1)))
    states = (Variable("q", "mm"), Variable("v", "mm/s", "q"))
    sd = {"A": 0.02 * np.abs(A) * (np.abs(A) > 1), "B": 0.02 * B, "C": np.zeros((1, 2)), "D": np.zeros((1, 1))}
    return Model("oscillator", (Variable("force", "N"),), (Variable("position", "mm"),), states, plant, entry_sd=sd)


def recorded(force, noise: float, top: float, level: float, seed: int) -> Trace:
    """Return five periods of a multisine through ``q'' = -w2 q - d v + w2 u(t) + force(q)``, by Runge-Kutta."""
    rng = np.random.default_rng(seed)
    n = 500
    k = np.arange(1, int(top * n * DT) + 1, 2)
    u = np.cos(2 * np.pi * np.outer(np.arange(n), k) / n + rng.uniform(0, 2 * np.pi, len(k))).sum(1)
    u = np.tile(level * u / u.std(), 6)
    x, y, sub = np.zeros(2), np.zeros(len(u)), 8
    delayed = np.concatenate([[0.0], u[:-1]]) if force == "delay" else u
    for i in range(len(u)):
        y[i] = x[0]
        for _ in range(sub):
            h, slopes = DT / sub, [np.zeros(2)]
            for share in (0.0, 0.5, 0.5, 1.0):
                z = x + h * share * slopes[-1]
                extra = force(z[0]) if callable(force) else 0.0
                slopes.append(A @ z + B[:, 0] * delayed[i] + np.array([0.0, extra]))
            x = x + h / 6 * (slopes[1] + 2 * slopes[2] + 2 * slopes[3] + slopes[4])
    y += noise * rng.standard_normal(len(y))
    return Trace("r", DT, (Channel("u_force", "N"), Channel("y_position", "mm")), np.column_stack([u, y])[500:])


def contender(base: Baseline, physics: str, site: str) -> Contender:
    here = tangent(base.objective, base.point)
    offered = next(p for p in afdsvc_physics() if p.name == physics)
    found: Hypothesis = next(h for h in offered.hypotheses(machine(base)) if h.site == site)
    trial = fit(here, found, screen(here, found).values)
    point = settle(base.objective, apply_shift(here, Effect(found, trial.values)), 10)
    return Contender(found.key, point)


def based(trace: Trace) -> Baseline:
    model = oscillator()
    return baseline(nominal(model, DT), prepare(model, [trace]))


@pytest.fixture(scope="module")
def timing() -> tuple[Baseline, list[Contender]]:
    base = based(recorded("delay", 0.1, 40.0, 1.0, 1))
    return base, [contender(base, "transport_delay", "input:force"), contender(base, "actuator_lag", "input:force")]


def test_delay_and_lag_ask_for_higher_lines(timing):
    base, rivals = timing
    found = next_experiment(base, rivals)
    assert found.band_hz[1] > 1.5 * 40.0
    assert found.separation > 1.5 * found.repeated
    assert max(line.omega for line in found.burst.lines) > 2 * np.pi * 1.5 * 40
    assert "transport_delay@input:force" in found.sentence
    assert "Hz" in found.sentence


def test_clearance_and_cubic_ask_for_more_amplitude():
    base = based(recorded(lambda q: -0.02 * W**2 * q**3, 0.3, 40.0, 1.0, 2))
    rivals = [contender(base, "cubic_stiffness", "state:v"), contender(base, "clearance", "state:v")]
    found = next_experiment(base, rivals)
    assert found.level > 1
    assert found.separation > 1.5 * found.repeated


def test_the_promised_separation_is_the_likelihood_ratio_the_data_give():
    """The present experiment repeated would separate the rivals as much as the recording did: 2 log L ~ d^2 +- 2 d."""
    base = based(recorded("delay", 0.04, 40.0, 1.0, 4))
    delay, lag = (contender(base, p, "input:force") for p in ("transport_delay", "actuator_lag"))
    assert base.limited == "noise"
    ratio = full_cost(base.objective, lag.point) - full_cost(base.objective, delay.point)
    d = next_experiment(base, [delay, lag]).repeated
    assert d > 4
    assert abs(ratio - d**2) < 3 * 2 * d + 0.3 * d**2


def test_only_what_a_rival_cannot_imitate_separates():
    """Against a numerical minimum over the rival's numbers, weighed by what is known of them already."""
    rng = np.random.default_rng(3)
    d, J, root, repeats = rng.standard_normal(40), rng.standard_normal((40, 5)), rng.standard_normal((5, 5)), 4.0
    stacked = np.vstack([np.sqrt(repeats) * J, root])
    best = least_squares(lambda x: stacked @ x - np.concatenate([np.sqrt(repeats) * d, np.zeros(5)]), np.zeros(5))
    assert unlike(d, J, root.T @ root, repeats) == pytest.approx(2 * best.cost, rel=1e-6)


def test_limits_are_kept(timing):
    base, rivals = timing
    free = next_experiment(base, rivals)
    assert free.level > 1
    most = 1.01 * float(np.abs(free.burst.play(DT)).max()) / free.level
    found = next_experiment(base, rivals, Limits(np.array([1e3]), np.array([1e3]), np.array([most])))
    assert found.level == 1
    assert np.abs(found.burst.play(DT)).max() <= most


def test_outputs_stay_within_limits(timing):
    """Outputs may not grow at all: the burst chosen moves them no further than the limit, by simulation."""
    base, rivals = timing
    found = next_experiment(base, rivals, Limits(np.array([1.0]), np.array([1e3]), np.array([1e3])))
    y, _ = simulate(sample_zoh(base.nominal.plant, DT), found.burst.play(DT))
    assert np.abs(y).max() < 1.1


def test_the_burst_can_be_played_and_read_back(timing):
    found = next_experiment(*timing)
    table = found.json()["burst"]
    assert len(table["lines_input_hz_amplitude_rad"]) == len(found.burst.lines)
    assert found.burst.play(DT).shape == (found.burst.samples, 1)
    assert found.burst.purpose == "explain"


def test_one_contender_asks_for_nothing(timing):
    base, rivals = timing
    assert next_experiment(base, rivals[:1]) is None
