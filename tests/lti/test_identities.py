"""The algebra checked by its identities on random systems: stable or not, continuous or discrete, with or without D.

A factorisation that rounding would spoil is refused by the library; then the example does not count, and the share
of refusals is bounded by a test of its own.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from afdsvc.errors import IllConditioned
from afdsvc.lti.coprime import (
    Factorisation,
    observer_factorisation,
    proportional_factorisation,
    stable_controller_factorisation,
)
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.lft import star
from afdsvc.lti.python_control import factorise
from afdsvc.lti.riccati import kalman_predictor_gain, lqr
from afdsvc.lti.simulate import simulate
from afdsvc.lti.stability import is_stable
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.yjbk import (
    closed_loop,
    controller_from,
    deviation_system,
    excited_controller,
    interconnection,
    plant_from,
    plant_interconnection,
    reference_compensation,
    residual_generator,
)

EXAMPLES = 220
many = settings(max_examples=EXAMPLES, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))


@st.composite
def plants(draw: st.DrawFn, discrete: bool | None = None) -> StateSpace:
    n, m, p = draw(st.integers(2, 12)), draw(st.integers(1, 3)), draw(st.integers(1, 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    dt = 0.01 if (draw(st.booleans()) if discrete is None else discrete) else 0.0
    A = rng.standard_normal((n, n)) / np.sqrt(n)
    size = draw(st.floats(0.5, 1.25))  # of the largest modulus (discrete): up to 1.25 outside the unit circle
    A *= size / np.abs(np.linalg.eigvals(A)).max()
    if not dt:
        A = 10 * (A - draw(st.sampled_from([0.0, 0.3, 1.3])) * np.eye(n))
    D = rng.standard_normal((p, m)) if draw(st.booleans()) else np.zeros((p, m))
    return StateSpace.of(A, rng.standard_normal((n, m)), rng.standard_normal((p, n)), D, dt)


def observer(plant: StateSpace) -> Factorisation:
    n, m, p = plant.order, plant.inputs, plant.outputs
    F = lqr(plant, 0.1 * np.eye(n), np.eye(m))
    L = kalman_predictor_gain(plant, 0.1 * np.eye(n), np.eye(p))
    return observer_factorisation(plant, F, L)


def random_stable(rng: np.random.Generator, outputs: int, inputs: int, order: int, dt: float) -> StateSpace:
    A = rng.standard_normal((order, order))
    A *= 0.7 / np.abs(np.linalg.eigvals(A)).max()
    A = A if dt else 5 * (A - np.eye(order))
    shapes = (rng.standard_normal((order, inputs)), rng.standard_normal((outputs, order)))
    return StateSpace.of(A, *(0.3 * s for s in shapes), 0.1 * rng.standard_normal((outputs, inputs)), dt)


def made(plant: StateSpace, kind: str) -> Factorisation | None:
    """Return a factorisation by one of the ways the library offers; None when the plant does not suit that way."""
    rng = np.random.default_rng(plant.order)
    base = observer(plant)
    if kind == "observer":
        return base
    if kind == "order n controller":
        return factorise(plant, base.K)
    if kind == "youla":  # a controller of another order, stable or not
        return factorise(plant, controller_from(base, random_stable(rng, plant.inputs, plant.outputs, 2, plant.dt)))
    if kind == "static":
        P = 0.05 * np.random.default_rng(1).standard_normal((plant.inputs, plant.outputs))
        A = plant.A + plant.B @ np.linalg.solve(np.eye(plant.inputs) - P @ plant.D, P @ plant.C)
        return proportional_factorisation(plant, P) if is_stable(A, plant.dt) else None
    K = controller_from(base, StateSpace.gain(0.05 * rng.standard_normal((plant.inputs, plant.outputs)), plant.dt))
    return stable_controller_factorisation(plant, K) if is_stable(K.A, plant.dt) else None


def factorisation(plant: StateSpace, kind: str) -> Factorisation:
    """Return what `made` returns; rejects examples it refuses or that do not suit."""
    try:
        found = made(plant, kind)
    except IllConditioned:
        found = None
    assume(found is not None)
    assert found is not None
    return found


KINDS = ("observer", "order n controller", "youla", "static", "stable controller")


def frequencies(system: StateSpace) -> np.ndarray:
    return np.geomspace(1e-2, 0.97 * np.pi / system.dt, 25) if system.discrete else np.geomspace(1e-2, 1e3, 25)


def response(system: StateSpace) -> np.ndarray:
    return frequency_response(system, frequencies(system))


def distance(found: np.ndarray, wanted: np.ndarray) -> float:
    """Return the largest difference relative to the largest entry over all frequencies (or to one if that is less)."""
    return float(np.abs(found - wanted).max() / max(1.0, np.abs(wanted).max()))


class Factors:
    """Frequency responses of the eight factors and of G and K."""

    def __init__(self, f: Factorisation) -> None:
        for name in ("M", "N", "U", "V", "Mt", "Nt", "Ut", "Vt"):
            setattr(self, name, response(getattr(f, name)))
        self.G, self.K = response(f.plant), response(f.K)


@given(kind=st.sampled_from(KINDS), plant=plants())
@many
def test_bezout_and_factors(kind: str, plant: StateSpace) -> None:
    f = factorisation(plant, kind)
    F = Factors(f)
    m, p = np.eye(plant.inputs), np.eye(plant.outputs)
    # [Vt -Ut; -Nt Mt] [M U; N V] = I, then the other way round; blocks that vanish relative to what cancels in them
    assert distance(F.Vt @ F.M - F.Ut @ F.N, m) < 1e-9
    assert distance(F.Vt @ F.U, F.Ut @ F.V) < 1e-9
    assert distance(F.Nt @ F.M, F.Mt @ F.N) < 1e-9
    assert distance(F.Mt @ F.V - F.Nt @ F.U, p) < 1e-9
    assert distance(F.M @ F.Vt - F.U @ F.Nt, m) < 1e-9
    assert distance(F.M @ F.Ut, F.U @ F.Mt) < 1e-9
    assert distance(F.N @ F.Vt, F.V @ F.Nt) < 1e-9
    assert distance(F.V @ F.Mt - F.N @ F.Ut, p) < 1e-9
    assert all(is_stable(getattr(f, name).A, plant.dt) for name in ("M", "N", "U", "V", "Mt", "Nt", "Ut", "Vt"))
    for whole, left, right in ((F.N, F.G, F.M), (F.Nt, F.Mt, F.G), (F.U, F.K, F.V), (F.Ut, F.Vt, F.K)):
        # next to a pole of G (or K) the product is small against its factors
        assert np.abs(whole - left @ right).max() < 1e-9 * max(1.0, (np.abs(left) @ np.abs(right)).max())


@given(kind=st.sampled_from(KINDS), plant=plants())
@many
def test_interconnections(kind: str, plant: StateSpace) -> None:
    f = factorisation(plant, kind)
    F, m, p = Factors(f), plant.inputs, plant.outputs
    J, JG = interconnection(f), plant_interconnection(f)
    assert J.order == f.R.order
    if kind in ("observer", "static"):
        assert J.order == plant.order
    # J_G * J_K: eta = alpha, beta = eps; the other two blocks vanish relative to what cancels in them
    loop, jg = response(star(JG, J, p, m)), response(JG)
    assert distance(loop[:, :m, p:], np.eye(m)) < 1e-9
    assert distance(loop[:, m:, :p], np.eye(p)) < 1e-9
    assert np.abs(loop[:, :m, :p]).max() < 1e-9 * max(1.0, np.abs(jg[:, :m, :p]).max())
    assert np.abs(loop[:, m:, p:]).max() < 1e-9 * max(1.0, np.abs(response(J)[:, m:, p:]).max())
    # thesis 2.11, each block against the factors
    j = response(J)
    assert distance(j[:, :m, :p], F.K) < 1e-9
    assert distance(F.V @ j[:, m:, :p], np.eye(p)) < 1e-9
    assert distance(F.Vt @ j[:, :m, p:], np.eye(m)) < 1e-9
    assert distance(F.V @ j[:, m:, p:], -F.N) < 1e-9


@given(plant=plants())
@many
def test_parametrisations(plant: StateSpace) -> None:
    f = factorisation(plant, "observer")
    F, m, p = Factors(f), plant.inputs, plant.outputs
    rng = np.random.default_rng(plant.order)
    Q = random_stable(rng, m, p, 3, plant.dt)
    S = random_stable(rng, p, m, 3, plant.dt)
    q, s = response(Q), response(S)
    k = response(controller_from(f, Q))
    assert distance((F.Vt + q @ F.Nt) @ k, F.Ut + q @ F.Mt) < 1e-9
    assert distance(k @ (F.V + F.N @ q), F.U + F.M @ q) < 1e-9
    true = plant_from(f, S)
    g = response(true)
    assert distance(g @ (F.M + F.U @ s), F.N + F.V @ s) < 1e-9
    assert distance((F.Mt + s @ F.Ut) @ g, F.Nt + s @ F.Vt) < 1e-9
    sizes = [np.linalg.norm(x, 2, axis=(1, 2)) for x in (F.Mt + s @ F.Ut, g, np.linalg.inv(F.Ut @ g - F.Vt))]
    rounding = 1e-12 * float(np.prod(sizes, axis=0).max())  # of G, amplified: (Mt + S Ut) dG + dS (Ut G - Vt) = 0
    assert distance(response(deviation_system(f, true)), s) < max(1e-9, rounding)


@given(kind=st.sampled_from(KINDS), plant=plants(), seed=st.integers(0, 1000))
@many
def test_deviation_and_every_closed_loop_path(kind: str, plant: StateSpace, seed: int) -> None:
    f = factorisation(plant, kind)
    rng = np.random.default_rng(seed)
    change = 1 + 0.02 * rng.standard_normal(plant.B.shape)
    true = StateSpace(plant.A, plant.B * change, plant.C, plant.D, plant.dt)
    F, S = Factors(f), response(deviation_system(f, true))
    assert distance(response(deviation_system(f, plant)), 0 * S) < 1e-9  # S(0) = 0
    Gt, eye = response(true), np.eye(plant.outputs)
    # S = V^-1 (I - Gt K)^-1 (Gt - G) M, multiplied out; and its mirror image from the left
    assert distance((eye - Gt @ F.K) @ F.V @ S, (Gt - F.G) @ F.M) < 1e-9 * max(1.0, np.abs(Gt).max() / np.abs(F.G).max())
    loop = closed_loop(f, true)
    path = {(o, i): response(loop.path(o, i)) for o in ("y", "y_m", "u", "beta") for i in ("d", "r1", "r2", "alpha")}
    y, u, beta = F.N + F.V @ S, F.M + F.U @ S, F.Mt + S @ F.Ut
    assert distance(path["beta", "alpha"], S) < 1e-9
    assert distance(path["beta", "d"], beta) < 1e-9
    assert distance(path["beta", "r1"], beta) < 1e-9
    assert distance(path["beta", "r2"], F.Nt + S @ F.Vt) < 1e-9
    for signal, factor in (("y", y), ("u", u)):
        assert distance(path[signal, "alpha"], factor) < 1e-9
        assert distance(path[signal, "d"], factor @ F.Ut) < 1e-9
        assert distance(path[signal, "r1"], factor @ F.Ut) < 1e-9
        assert distance(path[signal, "r2"], factor @ F.Vt) < 1e-9
    assert distance(path["y_m", "d"], F.V @ beta) < 1e-9
    # a reference instead of alpha, compensated: the same residual through S
    compensation = response(reference_compensation(f))
    p = plant.outputs
    assert distance(path["beta", "r1"] - compensation[:, :, :p], S @ F.Ut) < 1e-9
    assert distance(path["beta", "r2"] - compensation[:, :, p:], S @ F.Vt) < 1e-9
    # and without any access to the controller: eps = Mt y_m - Nt u
    generator, m = response(residual_generator(f)), plant.inputs
    for excitation, through in (("r1", F.Ut), ("r2", F.Vt), ("alpha", np.eye(m))):
        eps = generator[:, :, :m] @ path["u", excitation] + generator[:, :, m:] @ path["y_m", excitation]
        assert distance(eps, S @ through) < 1e-9
    # the controller excited through its references: the true loop's answers, and a residual that excitation alone does not move
    for word, excitation, sign, factor in (("input", "r2", 1, F.Vt), ("setpoint", "r1", -1, F.Ut), ("alpha", "alpha", 1, np.eye(m))):
        seen = response(star(_with_input(true), excited_controller(f, word), p, m))
        for rows, wanted in ((slice(0, p), path["y", excitation]), (slice(p, p + m), path["u", excitation]), (slice(p + m, None), S @ factor)):
            assert distance(seen[:, rows], sign * wanted) < 1e-9


def _with_input(g: StateSpace) -> StateSpace:
    """Return the plant with its output, its input and its output again: the last is what a controller sees."""
    C, D = np.vstack([g.C, np.zeros((g.inputs, g.order)), g.C]), np.vstack([g.D, np.eye(g.inputs), g.D])
    return StateSpace(g.A, g.B, C, D, g.dt)


@given(kind=st.sampled_from(KINDS), plant=plants(discrete=True), seed=st.integers(0, 1000))
@many
def test_beta_in_time_is_s_alpha_plus_noise_path(kind: str, plant: StateSpace, seed: int) -> None:
    """``beta = S alpha + (Mt + S Ut) d``: the loop run sample by sample against the two filters run on their own."""
    f = factorisation(plant, kind)
    rng = np.random.default_rng(seed)
    true = StateSpace(plant.A, plant.B * (1 + 0.02 * rng.standard_normal(plant.B.shape)), plant.C, plant.D, plant.dt)
    S = deviation_system(f, true)
    assume(is_stable(S.A, S.dt))
    alpha, d = rng.standard_normal((300, plant.inputs)), rng.standard_normal((300, plant.outputs))
    loop, p, m = closed_loop(f, true).system, plant.outputs, plant.inputs
    run, _ = simulate(loop, np.hstack([d, np.zeros((300, p + m)), alpha]))
    beta = run[:, 2 * p + m :]
    wanted = simulate(S, alpha)[0] + simulate(f.Mt, d)[0] + simulate(S, simulate(f.Ut, d)[0])[0]
    assert distance(beta, wanted) < 1e-9


@pytest.mark.parametrize("dt", [0.0, 0.01])
@pytest.mark.parametrize("kind", KINDS)
def test_tame_plants_are_never_refused(kind: str, dt: float) -> None:
    """Refusing must not hide a wrong formula: well-damped plants with feedthrough pass by every way."""
    suited = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        n = 2 + seed // 2
        A = rng.standard_normal((n, n))
        A *= 0.8 / np.abs(np.linalg.eigvals(A)).max()
        A = A if dt else 10 * (A - np.eye(n))
        B, C, D = rng.standard_normal((n, 2)), rng.standard_normal((2, n)), 0.2 * rng.standard_normal((2, 2))
        suited += made(StateSpace.of(A, B, C, D, dt), kind) is not None
    assert suited > 8


def test_refusals_are_rare() -> None:
    """LQG loops of 120 random plants: no stable plant is refused, of the unstable ones at most one in eight."""
    refused, counted = {True: 0, False: 0}, {True: 0, False: 0}
    for seed in range(120):
        rng = np.random.default_rng(seed)
        n, dt = int(rng.integers(2, 13)), float(rng.choice([0.0, 0.01]))
        A = rng.standard_normal((n, n))
        A *= rng.uniform(0.5, 1.25) / np.abs(np.linalg.eigvals(A)).max()
        A = A if dt else 10 * (A - rng.choice([0.0, 0.3, 1.3]) * np.eye(n))
        m, p = (int(k) for k in rng.integers(1, 4, 2))
        plant = StateSpace.of(A, rng.standard_normal((n, m)), rng.standard_normal((p, n)), None, dt)
        F, L = lqr(plant, 0.1 * np.eye(n), np.eye(m)), kalman_predictor_gain(plant, 0.1 * np.eye(n), np.eye(p))
        K = StateSpace(plant.A + plant.B @ F + L @ plant.C, -L, F, np.zeros((m, p)), dt)
        counted[plant.is_stable()] += 1
        try:
            factorise(plant, K)
        except IllConditioned:
            refused[plant.is_stable()] += 1
    assert refused[True] == 0
    assert 0 < refused[False] < counted[False] / 8
    assert min(counted.values()) > 40
