"""The next experiment separates look-alikes by what neither can imitate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from afdsvc.api.signals import Trace
from afdsvc.dataset.experiment import prepare
from afdsvc.explain.experiment.next_experiment import experiment_after, first_experiment
from afdsvc.explain.experiment.plans import plans
from afdsvc.explain.experiment.separation import unlike
from afdsvc.explain.search.base import settled
from afdsvc.explain.search.build import build
from afdsvc.explain.search.forward import search
from afdsvc.explain.settings import Settings
from afdsvc.explain.simulate.nominal import nominal
from afdsvc.explain.verdict.verdict import Claim
from afdsvc.plugins.physics.actuator_lag import ActuatorLag
from afdsvc.plugins.physics.transport_delay import TransportDelay


def late(trace: Trace, samples: int) -> Trace:
    u, y = trace.values.T
    return replace(trace, values=np.column_stack([u[samples:], y[: len(y) - samples]]))


@pytest.fixture(scope="module")
def answer(spring, recorded):
    """A delay of two samples, and what the search makes of it."""
    runs = prepare(spring, [late(recorded(k, level, periods=5), 2) for k, level in enumerate((1.0, 0.6))])
    return search(settled(build(nominal(spring, runs[0].dt), runs, replace(Settings(), effects=1))), [TransportDelay(), ActuatorLag()])


def claims(answer, *weights: float) -> list[Claim]:
    by_name = {c.hypothesis.physics: c for c in reversed(answer.steps[0].candidates)}
    pair = [by_name["transport_delay"], by_name["actuator_lag"]]
    return [Claim(c, w, 1, c.evidence.share) for c, w in zip(pair, weights, strict=False)]


def test_delay_and_lag_are_separated_by_a_multisine_that_can_be_played(answer):
    found = experiment_after(answer, claims(answer, 0.6, 0.4))
    assert found.repeated > 0
    assert found.separation >= 6
    assert found.sentence.startswith("to separate transport delay (input force) from actuator lag (input force)")
    table = found.json()["burst"]
    assert len(table["lines_input_hz_amplitude_rad"]) == len(found.burst.lines)
    assert found.burst.play(2e-3).shape == (found.burst.samples, 1)


def test_one_name_without_doubt_asks_for_nothing(answer):
    assert experiment_after(answer, claims(answer, 1.0)) is None
    assert experiment_after(answer, claims(answer, 0.999, 0.001)) is None


def test_only_what_a_rival_cannot_imitate_separates():
    """Against a numerical minimum over the rival's numbers, weighed by what is known of them already."""
    rng = np.random.default_rng(3)
    d, J, root, repeats = rng.standard_normal(40), rng.standard_normal((40, 5)), rng.standard_normal((5, 5)), 4.0
    stacked = np.vstack([np.sqrt(repeats) * J, root])
    best = least_squares(lambda x: stacked @ x - np.concatenate([np.sqrt(repeats) * d, np.zeros(5)]), np.zeros(5))
    assert unlike(d, J, root.T @ root, repeats) == pytest.approx(2 * best.cost, rel=1e-6)


def test_a_machine_without_inputs_has_no_first_experiment(spring, recorded):
    free = replace(spring, inputs=(), plant=replace(spring.plant, B=np.zeros((2, 0)), D=np.zeros((1, 0))))
    runs = prepare(free, [recorded(1, decay=True)])
    assert first_experiment(nominal(free, runs[0].dt), runs) is None


@pytest.mark.parametrize("dt", [1e-5, 2e-3, 0.031, 0.04, 0.1, 0.11, 3.0, 3600.0])
def test_a_machine_of_any_sample_time_has_a_first_experiment(spring, recorded, dt):
    """Its lines lie in its band, below the Nyquist frequency."""
    runs = [replace(r, dt=dt) for r in prepare(spring, [recorded(1)])]
    found = first_experiment(nominal(spring, dt), runs)
    lines = np.array([x.omega for x in found.burst.lines]) / (2 * np.pi)
    assert found.band_hz[0] <= lines.min() < lines.max() <= found.band_hz[1] < 0.5 / dt
    assert len(lines) >= 4


@pytest.mark.parametrize(("mean", "gain", "most"), [(0.0, 1.0, np.inf), (5.0, 1.0, 1.0), (-5.0, 1.0, 1.0), (5.0, 2.0, 2.0)])
def test_an_input_that_never_changes_its_sign_stays_in_its_range(spring, recorded, mean, gain, most):
    """A heater or a pump may be unable to: half of its range is the most on either side."""
    trace = recorded(1)
    shaped = np.sign(trace.values[:, 0])
    runs = prepare(spring, [replace(trace, values=np.column_stack([mean + gain * shaped, trace.values[:, 1]]))])
    made = plans(runs)
    assert {p.level for p in made} >= ({1.0, 2.0, 0.5} if most == np.inf else {0.5})
    assert all(p.peak <= most * (1 + 1e-9) for p in made)
    assert max(p.peak for p in made) == pytest.approx(min(most, 2 * 1.8 * gain * shaped.std()))
    for p in made:
        assert np.abs(p.burst.play(2e-3)).max() <= p.peak * (1 + 1e-6)


def test_constant_inputs_have_no_level_to_begin_from(spring, recorded):
    runs = prepare(spring, [replace(recorded(1), values=recorded(1).values * [0.0, 1.0] + [3.0, 0.0])])
    assert plans(runs) == []
    assert plans(prepare(spring, [recorded(1)])) != []
