import numpy as np

from afdsvc.explain.gap.dictionary import dictionary
from afdsvc.explain.gap.features import ALL, LINEAR, STATIC
from afdsvc.explain.gap.settings import GapSettings
from afdsvc.explain.gap.signals import ResidualSignals
from tests.explain.gap.machines import NAMES, motor


def found(recording, names, seed=1):
    return dictionary([recording], names, np.random.default_rng(seed), GapSettings())


def test_linear_features_of_twice_the_signals_are_twice_as_large():
    r = motor(np.random.default_rng(1), 400)
    d = found(r, NAMES)
    double = ResidualSignals(r.residual, 2 * r.inputs, 2 * r.states, r.aux, r.dt)
    for f in d.features:
        if f.tier == LINEAR:
            np.testing.assert_allclose(d.columns(double, f), 2 * d.columns(r, f), atol=1e-9)


def test_units_do_not_matter():
    r = motor(np.random.default_rng(2), 400)
    scaled = ResidualSignals(r.residual, 1e3 * r.inputs, 1e-6 * r.states, r.aux, r.dt)
    a, b = found(r, NAMES), found(scaled, NAMES)
    for f, g in zip(a.features, b.features, strict=True):
        np.testing.assert_allclose(a.columns(r, f), b.columns(scaled, g), atol=1e-6)


def test_all_tiers_and_groups_are_there():
    d = found(motor(np.random.default_rng(3), 400), NAMES)
    assert {f.tier for f in d.features} == {LINEAR, STATIC, ALL}
    assert frozenset().union(*(f.groups for f in d.features)) == {
        "inputs", "input history", "state v", "amplitude", "sign of u", "sign of v", "time"
    }


def test_a_signal_that_does_not_move_has_no_features():
    r = motor(np.random.default_rng(4), 400)
    still = ResidualSignals(r.residual, r.inputs, np.hstack([r.states, np.full((400, 1), 7.0)]), r.aux, r.dt)
    d = found(still, (["y"], ["u"], ["v", "temperature"], []))
    assert not any("temperature" in g for f in d.features for g in f.groups)


def test_an_angle_gives_its_turns():
    r = motor(np.random.default_rng(5), 400)
    angle = np.cumsum(np.full((400, 1), 0.3), 0)
    turning = ResidualSignals(r.residual, r.inputs, r.states, angle, r.dt)
    d = found(turning, (["y"], ["u"], ["v"], ["angle"]))
    expected = np.cos(angle[:, 0]) - np.cos(angle[:, 0]).mean()
    columns = np.hstack([d.columns(turning, f) for f in d.features if f.groups == {"aux angle"} and f.tier == STATIC])
    assert np.abs(columns - expected[:, None]).max(0).min() < 1e-9


def test_a_free_decay_has_features_of_its_states_only():
    r = motor(np.random.default_rng(6), 400)
    d = found(ResidualSignals(r.residual, r.inputs[:, :0], r.states, r.aux, r.dt), (["y"], [], ["v"], []))
    assert "input history" not in frozenset().union(*(f.groups for f in d.features))
    assert len(d.features) > 20
