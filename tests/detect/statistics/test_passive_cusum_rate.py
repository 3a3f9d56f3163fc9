"""The CUSUM between bursts alarms as often as promised: against the loop simulated, directly and by importance sampling."""

import numpy as np
import pytest

from afdsvc.detect.thresholds import joint_false_alarm_rate as module
from afdsvc.detect.thresholds.joint_false_alarm_rate import joint_rate
from afdsvc.detect.thresholds.regressor_information import noise_driven
from afdsvc.plugins.detectors.cusum import PassiveCusumDesign
from afdsvc.testing.machines import bearing_problem, random_problem, unstable_problem, with_rate
from benchmarks.detection.truth import machines
from benchmarks.detection.truth_problem import problem_of

MACHINES = {"unstable": unstable_problem, "random": random_problem, "lqg 0": lambda: bearing_problem("lqg", 0)}
STRETCH = {"unstable": 600, "random": 600, "lqg 0": 2500}  # samples in which so many alarms are promised


def designed(machine, rate):
    problem = MACHINES[machine]()
    per_hour = rate / (STRETCH[machine] * problem.plant.dt) * 3600
    return PassiveCusumDesign().design(with_rate(problem, per_hour=per_hour), {})


def stepped(detector, rng, runs, samples, pushed=None, onset=None):
    """Yield after every block the largest CUSUM, less what its boundary is raised by, and Shiryaev's mixture over onsets (at blocks) and
    faults, and all CUSUMs.

    The whole healthy loop, many runs side by side; theta psi of fault ``pushed`` is added to the residual from ``onset`` on.
    """
    noise, which, theta = noise_driven(detector.problem), detector.which, detector.test.severity
    p, block, K = detector.problem.plant.outputs, detector.test.block, len(which)
    A, B = noise.loop.A.T.copy(), noise.loop.B[:, :p].T.copy()
    C = (np.repeat(theta, p)[:, None] * noise.loop.C[np.concatenate([np.arange(p) + p * i for i in which])]).T.copy()
    x, g, R, information, blocks = np.zeros((runs, len(A))), *(np.zeros((runs, K)) for _ in range(4))
    clock = detector.test.clock
    for _ in range(detector.filters.settling()):
        x = x @ A + rng.normal(size=(runs, p)) @ B
    for t in range(samples // block):
        gained, own = np.zeros((runs, K)), np.zeros((runs, 1, 1)) if pushed is None else (t >= onset)[:, None, None]
        blocks += 1
        for _ in range(block):
            waves, e = (x @ C).reshape(runs, K, p), rng.normal(size=(runs, p))
            if pushed is not None:
                e += (own * waves[np.arange(runs), pushed][:, None])[:, 0]
            gained += np.einsum("nkp,np->nk", waves, e) - 0.5 * np.sum(waves**2, axis=2)
            information += np.sum(waves**2, axis=2)
            x = x @ A + e @ B
        g, R = np.maximum(g + gained, 0.0), np.minimum((1 + R) * np.exp(np.minimum(gained, 300.0)), 1e100)
        blocks[g == 0], information[g == 0] = 0, 0
        deflection = np.log(np.maximum(information, 1e-300) / np.maximum(blocks, 1)) / 2
        risen = np.interp(np.maximum(deflection, clock.expected), clock.log_deflection, clock.boundary)
        yield (g - risen + np.interp(clock.expected, clock.log_deflection, clock.boundary)).max(axis=1), R.sum(axis=1) / K, g


def direct_rate(machine, rate, runs, stretches, seed):
    """Alarms per stretch and their standard error: the CUSUMs are put to rest after every alarm."""
    detector, rng, alarms = designed(machine, rate), np.random.default_rng(seed), 0
    for highest, _, g in stepped(detector, rng, runs, stretches * STRETCH[machine]):
        over = highest > detector.boundary
        alarms += over.sum()
        g[over] = 0.0
    return alarms / (runs * stretches), np.sqrt(alarms) / (runs * stretches)


def rare_rate(machine, rate, runs, lead, span, seed):
    """The same by onsets anywhere in a window from rest; ``span`` samples, after ``lead`` ones, in which the hazard is steady."""
    detector, rng = designed(machine, rate), np.random.default_rng(seed)
    block, n = detector.test.block, (lead + span) // detector.test.block
    onset, pushed = rng.integers(n, size=runs), rng.integers(len(detector.which), size=runs)
    weight, done = np.zeros(runs), np.zeros(runs, dtype=bool)
    for t, (highest, R, _) in enumerate(stepped(detector, rng, runs, lead + span, pushed, onset)):
        new = ~done & (highest > detector.boundary)
        done |= new
        if t >= lead // block:
            weight[new] = n / (R[new] + n - 1 - t)
    scale = STRETCH[machine] / span
    return weight.mean() * scale, weight.std() / np.sqrt(runs) * scale


@pytest.mark.parametrize(("machine", "runs", "stretches"), [("unstable", 1500, 5), ("random", 900, 10)])
def test_one_alarm_in_ten_stretches(machine, runs, stretches):
    found, error = direct_rate(machine, 0.1, runs, stretches, 3)
    assert error < 0.005
    assert found == pytest.approx(0.1, abs=2.58 * error)


@pytest.mark.parametrize(("machine", "runs", "lead", "span"), [("unstable", 4000, 250, 450), ("lqg 0", 400, 1500, 1000)])
def test_one_alarm_in_a_thousand_stretches(machine, runs, lead, span):
    found, error = rare_rate(machine, 1e-3, runs, lead, span, 4)
    assert error < 0.12e-3
    assert found == pytest.approx(1e-3, abs=2.58 * error)


def test_reduced_loop_is_the_loop():
    detector = designed("random", 0.1)
    noise, which, theta = noise_driven(detector.problem), detector.which, detector.test.severity
    joint = joint_rate(noise, which, theta, 1)
    p, order = 2, which[joint.which]
    assert len(joint.A) < noise.loop.order
    x, full = joint.B[:, 0], noise.loop.B[:, 0]
    rows = np.concatenate([np.arange(p) + p * i for i in order])
    for _ in range(40):
        np.testing.assert_allclose(joint.C @ x, np.repeat(theta[joint.which], p) * (noise.loop.C[rows] @ full), atol=1e-5)
        x, full = joint.A @ x, noise.loop.A @ full


def test_rates_are_the_same_again_and_none_where_paths_would_take_too_long(monkeypatch):
    detector = designed("unstable", 0.1)
    joint = joint_rate(noise_driven(detector.problem), detector.which, detector.test.severity, 1)
    boundaries = np.array([5.0, 6.0])
    first = joint.per_look(boundaries)
    np.testing.assert_array_equal(joint.per_look(boundaries), first)
    assert first[1] < 0.5 * first[0]
    monkeypatch.setattr(module, "WORK", 1e4)
    assert joint.per_look(boundaries) is None


def test_alarms_promised_before_the_cusums_forget_are_counted():
    """A loop whose noise says so little that a CUSUM remembers longer than the time in which an alarm is promised."""
    machine = next(m for m in machines() if m.name == "order 2, output noise")
    problem, every = problem_of(machine), 20_000
    detector = PassiveCusumDesign().design(with_rate(problem, per_hour=3600 / (every * machine.dt)), {})
    assert module.MEMORY / (0.3**2 * noise_driven(problem).passive[0]) > every
    assert 1.2 < detector.boundary < 1.9
    joint = joint_rate(noise_driven(problem), detector.which, detector.test.severity, detector.test.block, detector.test.clock)
    (rate,) = joint.per_look(np.array([detector.boundary]), detector.test.block / every)
    assert rate == pytest.approx(detector.test.block / every, rel=0.15)


def test_boundaries_that_rise_with_the_information_are_crossed_more_rarely():
    """The excursions that alarm gain more information than the loop at rest does, so the same paths alarm less often with the detector's table."""
    detector = designed("unstable", 0.1)
    noise, which, theta = noise_driven(detector.problem), detector.which, detector.test.severity
    moving, fixed = (joint_rate(noise, which, theta, 1, clock).per_look(np.array([detector.boundary])) for clock in (detector.test.clock, None))
    assert 0.5 < moving[0] / fixed[0] < 0.9
