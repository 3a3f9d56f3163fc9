"""How soon the passive CUSUM alarms, and how uneven its steps are: against the loop simulated."""

import numpy as np
import pytest

from afdsvc.detect.thresholds.regressor_information import excursion_steps, noise_driven
from afdsvc.errors import BadInput
from afdsvc.plugins.detectors.cusum import PassiveCusumDesign
from afdsvc.testing.machines import bearing_problem, unstable_problem, with_rate


def simulated(detector, fault, severity, runs, longest, seed=0):
    """Mean samples from the onset of a fault to the alarm, the loop in its healthy steady state and all CUSUMs at zero then."""
    noise, rng = noise_driven(detector.problem), np.random.default_rng(seed)
    p, K, test = detector.problem.plant.outputs, noise.count, detector.test
    x, g, sums = np.zeros((runs, noise.loop.order)), np.zeros((runs, len(detector.which))), np.zeros((runs, len(detector.which)))
    at = np.full(runs, longest)
    for t in range(-2000, longest):
        psi, e = (x @ noise.loop.C.T).reshape(runs, K, p), rng.normal(size=(runs, p))
        if t >= 0:
            e = e + severity * psi[:, detector.problem.fault_names.index(fault)]
            waves = test.severity[:, None] * psi[:, detector.which]
            sums += np.einsum("nkp,np->nk", waves, e) - 0.5 * np.sum(waves**2, axis=2)
            if (t + 1) % test.block == 0:
                g, sums = np.maximum(g + sums, 0.0), np.zeros_like(sums)
                at = np.where((at == longest) & (g.max(axis=1) > test.boundary), t + 1, at)
                if (at < longest).all():
                    break
        x = x @ noise.loop.A.T + e @ noise.loop.B[:, :p].T
    return at.mean()


@pytest.mark.parametrize(("severity", "tuned"), [(-0.3, -0.3), (-0.5, -0.3)])
def test_delay_stated_is_the_one_found(severity, tuned):
    problem = with_rate(bearing_problem("lqg"), per_hour=1 / 24)
    detector = PassiveCusumDesign().design(problem, {"severity": tuned})
    found = simulated(detector, "horizontal_actuator", severity, 300, 12_000)
    stated = detector.delay("horizontal_actuator", severity) / problem.plant.dt
    assert found < 1.05 * stated  # from healthy to faulty the loop still brings more information, and twins alarm as well
    assert found > 0.7 * stated


def test_faults_too_small_never_and_unknown_ones_not_at_all():
    detector = PassiveCusumDesign().design(bearing_problem("lqg"), {"severity": -0.4})
    assert detector.delay("vertical_sensor", -0.1) == np.inf
    with pytest.raises(BadInput, match="does not show fault 'bolt'"):
        detector.delay("bolt", -0.5)


def test_mean_step_of_a_single_gaussian_regressor():
    """E|s|^3 / E|s|^2 of a normal s is 1.5958 standard deviations."""
    noise = noise_driven(unstable_problem())
    rms = 0.01 * np.sqrt(noise.passive[0])
    assert excursion_steps(noise, np.array([0]), np.array([-0.01]), 1)[0] == pytest.approx(1.5958 * rms, rel=0.03)


def test_steps_are_smaller_where_a_weaker_loop_is_a_quieter_one():
    noise = noise_driven(bearing_problem("lqg"))
    rms = np.sqrt(noise.passive[0])
    small, large = (excursion_steps(noise, np.array([0]), np.array([s]), 1)[0] / abs(s) / rms for s in (-0.001, -0.3))
    assert large < 0.9 * small
