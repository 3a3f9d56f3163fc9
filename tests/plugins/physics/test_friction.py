"""Friction: never turns a motion round, never drives, and depends on the way alone before it slides."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.plugins.physics.coulomb_friction import _joint, along, asymmetric, coulomb_force, loaded, slip
from afdsvc.plugins.physics.stribeck_friction import _stribeck, presliding

RUBBING = [
    (coulomb_force, (3.0, 1e-4), 1), (asymmetric, (3.0, 0.7, 1e-4), 1), (_stribeck, (2.0, 4.0, 0.3, 1e-4), 1),
    (loaded, (1.0, 0.5, 1e-4, 2.0), 2), (along, (1.0, 0.5, -0.8, 1e-4, 0.1, 1.0), 2),
]


def push(law, p, z, dt, memory: int = 0, writes: int = 1) -> np.ndarray:
    out = np.zeros(writes)
    law(np.array(p, float), np.atleast_1d(np.array(z, float)), np.zeros(memory), dt, out)
    return out


@pytest.mark.parametrize(("law", "p", "reads"), RUBBING, ids=lambda x: getattr(x, "__name__", ""))
@pytest.mark.parametrize("dt", [1e-4, 1e-2, 1.0])
def test_friction_brakes_and_never_turns_a_motion_round(law, p, reads, dt):
    rng = np.random.default_rng(1)
    for z in rng.standard_normal((300, reads)) * 10.0 ** rng.uniform(-8, 1, (300, 1)):
        force = float(push(law, p, z, dt)[0])
        assert force * z[0] <= 0
        assert abs(force) * dt <= abs(z[0])


@pytest.mark.parametrize(("law", "p"), [(coulomb_force, (3.0, 1e-4)), (asymmetric, (3.0, 2.9, 1e-4)), (_stribeck, (2.9, 0.5, 0.3, 1e-4))])
def test_what_is_pushed_less_than_friction_holds_creeps_no_faster_than_a_step_of_it(law, p):
    v, dt, drive = 0.2, 1e-3, 2.0
    for _ in range(2000):
        v += dt * (drive + float(push(law, p, v + 0.5 * dt * drive, dt)[0]))
    assert 0 <= v < 3.0 * dt
    assert v < 5e-3 * 2000 * dt * drive  # without friction it would have reached this a hundredfold


def test_a_joint_that_rubs_never_turns_its_relative_motion_round_and_takes_power():
    rng = np.random.default_rng(2)
    for rates in rng.standard_normal((300, 3)) * 10.0 ** rng.uniform(-6, 1, (300, 1)):
        p = (5.0, 1e-4, -0.7, 1.3, 1.0, 1.0)
        forces = push(_joint, p, rates, 1e-2, writes=3)
        shares = np.array([1.0, -0.7, 1.3])
        before, after = shares @ rates, shares @ (rates + 1e-2 * forces)
        assert before * after >= 0
        assert abs(after) <= abs(before)
        assert forces @ rates <= 0


def test_two_masses_that_rub_keep_their_momentum():
    forces = push(_joint, (5.0, 0.1, -1.0, 0.25), (0.3, -0.2), 1e-3, writes=2)  # the second mass is four times the first
    assert forces[0] < 0 < forces[1]
    assert forces[0] + 4 * forces[1] == pytest.approx(0)


def moved(law, p, memory, q, dt: float) -> np.ndarray:
    """The force along a given way."""
    m, forces = np.zeros(memory), []
    for v in np.diff(q) / dt:
        out = np.zeros(1)
        law(np.array(p, float), np.array([v]), m, dt, out)
        forces.append(out[0])
    return np.array(forces)


def test_bristles_that_slide_at_one_force_depend_on_the_way_alone():
    q = np.concatenate([np.linspace(0, 1, 400), np.linspace(1, -1, 800), np.linspace(-1, 0.3, 520)])
    p = (4.0, 0.0, 1.0, 0.05, 0.0)  # no damping of the bristles
    slow, fast = moved(presliding, p, 1, q, 1e-2), moved(presliding, p, 1, q, 1e-4)
    assert fast == pytest.approx(slow, abs=0.2)  # steps of 10 ms hold the bristles softer: 0.0516 of way instead of 0.0500
    assert slow[399] == pytest.approx(-4.0, abs=1e-3)
    exact = -4.0 * (1 - np.exp(-np.diff(q)[0] * np.arange(1, 400) / (0.05 + 16e-8)))  # Dahl's curve of the first way
    assert fast[:399] == pytest.approx(exact, rel=1e-6)


def test_bristles_end_in_stribecks_curve():
    for v in (0.05, 0.3, 2.0):
        force = moved(presliding, (4.0, 3.0, 0.5, 0.02, 0.5), 1, np.arange(4000) * v * 1e-3, 1e-3)[-1]
        assert force == pytest.approx(-(4 + 3 * np.exp(-((v / 0.5) ** 2))), rel=1e-3)


def test_a_spring_that_slips_is_stiff_to_its_width_and_constant_beyond():
    """What the model has as a spring of 50 becomes one that holds 50 times 0.2 at most: Jenkins' element."""
    q = np.concatenate([np.linspace(0, 1, 101), np.linspace(1, -1, 201)])
    m, total = np.zeros(1), []
    for now in q:
        out = np.zeros(1)
        slip(np.array([50.0, 0.2]), np.array([now]), m, 1e-3, out)
        total.append(-50 * now + out[0])
    total = np.array(total)
    assert total[:21] == pytest.approx(-50 * q[:21])
    assert total[21:101] == pytest.approx(np.full(80, -10.0))
    assert total[101:142] == pytest.approx(-10 + 50 * (1 - q[101:142]))
    assert total[142:] == pytest.approx(np.full(160, 10.0))
