"""White residuals against spectra, an independent Riccati iteration, and simulated noise."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.errors import BadInput, IllConditioned
from afdsvc.lti.coprime import (
    Factorisation,
    controller_factorisation,
    observer_factorisation,
    proportional_factorisation,
    stable_controller_factorisation,
)
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.lft import star
from afdsvc.lti.riccati import kalman_predictor_gain, lqr
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.whitening import innovations, whitening_filter
from afdsvc.lti.yjbk import closed_loop, interconnection

R = np.array([[0.12, 0.02], [0.02, 0.15]])
OMEGA = np.linspace(0.05, 3.1, 40)


def plant(stable: bool, dt: float = 1.0) -> StateSpace:
    rng = np.random.default_rng(3)
    A = rng.standard_normal((4, 4))
    A *= (0.95 if stable else 1.3) / np.abs(np.linalg.eigvals(A)).max()
    return StateSpace.of(A, rng.standard_normal((4, 2)), rng.standard_normal((2, 4)), rng.standard_normal((2, 2)), dt)


def observer(G: StateSpace) -> Factorisation:
    return observer_factorisation(G, lqr(G, np.eye(4), np.eye(2)), kalman_predictor_gain(G, np.eye(4), np.eye(2)))


def factorisations(G: StateSpace) -> dict[str, Factorisation]:
    K = observer(G).K
    found = {"observer": observer(G), "general": controller_factorisation(G, K)}
    if K.is_stable():
        found["stable controller"] = stable_controller_factorisation(G, K)
    if G.is_stable():
        found["proportional"] = proportional_factorisation(G, 0.01 * np.eye(2))
    return found


def process(stable: bool) -> np.ndarray:
    root = np.random.default_rng(5).standard_normal((4, 4))
    return 0.1 * root @ root.T


CASES = [(stable, noisy, kind) for stable in (True, False) for noisy in (False, True) for kind in ("observer", "general")]
CASES += [(True, False, "proportional"), (True, True, "proportional"), (True, False, "stable controller")]


@pytest.mark.parametrize(("stable", "noisy", "kind"), CASES)
def test_spectrum_of_r_is_flat_and_equals_its_covariance(stable: bool, noisy: bool, kind: str) -> None:
    """``W^-1 Phi_beta W^-* = Xi`` at every frequency, Phi_beta made from the noise model and the loop."""
    G = plant(stable)
    f, Q = factorisations(G)[kind], process(stable) if noisy else np.zeros((4, 4))
    W, Xi = whitening_filter(f, R, Q if noisy else None)
    assert W.is_stable()
    assert W.order <= f.R.order
    # disturbances (w, v) enter as x+ = .. + w, y = .. + v; the loop turns them into beta
    noisy_plant = StateSpace(G.A, np.hstack([np.eye(4), G.B]), G.C, np.hstack([np.zeros((2, 4)), G.D]), G.dt)
    eye, zero = np.eye(2), np.zeros((4, 2))
    with_v = StateSpace(G.A, np.hstack([np.eye(4), zero, G.B]), G.C, np.hstack([np.zeros((2, 4)), eye, G.D]), noisy_plant.dt)
    beta = star(with_v, interconnection(f), 2, 2).select(slice(None), slice(0, 6))
    path = frequency_response(beta, OMEGA)
    cov = np.block([[Q, zero], [zero.T, R]])
    w = frequency_response(W, OMEGA) @ path
    spectrum = w @ cov @ np.conj(np.swapaxes(w, 1, 2))
    assert np.abs(spectrum - Xi).max() < 1e-9 * np.abs(Xi).max()


@pytest.mark.parametrize("kind", ["observer", "general", "proportional", "stable controller"])
def test_r_from_beta_is_r_from_measurements(kind: str) -> None:
    """The residual does not depend on the factorisation: filtered beta equals the innovations of (y, u)."""
    G = plant(stable=True)
    f, Q = factorisations(G)[kind], process(True)
    rng = np.random.default_rng(0)
    loop = closed_loop(f, G)
    noise = rng.multivariate_normal(np.zeros(2), R, 400)
    inputs = np.hstack([noise, np.zeros((400, 4)), rng.standard_normal((400, 2))])
    out, _ = simulate(loop.system, inputs)
    y_m, u, beta = out[:, 2:4], out[:, 4:6], out[:, 6:8]
    W, _ = whitening_filter(f, R, Q)
    direct, _ = simulate(innovations(G, R, Q).filter, np.hstack([y_m, u]))
    assert np.abs(simulate(W, beta)[0] - direct).max() < 1e-9


def test_stable_plant_with_output_noise_only_needs_no_riccati() -> None:
    """Then r = y - G u exactly and Xi = R (thesis 5.14)."""
    G = plant(stable=True)
    found = innovations(G, R)
    assert np.array_equal(found.covariance, R)
    wanted = np.concatenate([np.broadcast_to(np.eye(2), (40, 2, 2)), -frequency_response(G, OMEGA)], 2)
    assert np.abs(frequency_response(found.filter, OMEGA) - wanted).max() < 1e-12


def test_unstable_plant_mirrors_its_poles() -> None:
    """det Xi / det R is the product of the squared unstable moduli (Jensen's formula), poles go to 1/conj(p)."""
    G = plant(stable=False)
    found = innovations(G, R)
    unstable = G.poles()[np.abs(G.poles()) > 1]
    assert np.linalg.det(found.covariance) / np.linalg.det(R) == pytest.approx(np.prod(np.abs(unstable) ** 2), rel=1e-10)
    mirrored = np.sort(np.abs(found.filter.poles()))
    wanted = np.sort(np.where(np.abs(G.poles()) > 1, 1 / np.abs(G.poles()), np.abs(G.poles())))
    assert np.abs(mirrored - wanted).max() < 1e-9


@pytest.mark.parametrize("cross", [False, True])
def test_innovations_against_riccati_recursion(cross: bool) -> None:
    """The stationary solution equals the time-varying Kalman recursion run until it stands still."""
    G, Q = plant(stable=False), process(False)
    S = 0.5 * np.linalg.cholesky(Q) @ np.random.default_rng(2).uniform(-0.3, 0.3, (4, 2)) @ np.linalg.cholesky(R).T
    S = S if cross else np.zeros((4, 2))
    found = innovations(G, R, Q, S)
    P = np.eye(4)
    for _ in range(400):
        Xi = G.C @ P @ G.C.T + R
        K = (G.A @ P @ G.C.T + S) @ np.linalg.inv(Xi)
        loss, noise = G.A - K @ G.C, np.hstack([np.eye(4), -K])
        P = loss @ P @ loss.T + noise @ np.block([[Q, S], [S.T, R]]) @ noise.T  # Joseph form keeps P symmetric
    assert np.abs(found.covariance - Xi).max() < 1e-9 * np.abs(Xi).max()
    assert np.abs(found.gain - K).max() < 1e-9 * np.abs(K).max()


def test_simulated_residual_is_white_with_that_covariance() -> None:
    """Monte Carlo, 40000 samples: covariance within five standard errors, autocorrelations within five over root n."""
    G, Q, n = plant(stable=False), process(False), 40000
    f, rng = observer(G), np.random.default_rng(11)
    W, Xi = whitening_filter(f, R, Q)
    with_noise = StateSpace(
        G.A, np.hstack([np.eye(4), np.zeros((4, 2)), G.B]), G.C, np.hstack([np.zeros((2, 4)), np.eye(2), G.D]), G.dt
    )
    loop = star(with_noise, interconnection(f), 2, 2)
    w = rng.multivariate_normal(np.zeros(4), Q, n)
    v = rng.multivariate_normal(np.zeros(2), R, n)
    beta, _ = simulate(loop, np.hstack([w, v, np.zeros((n, 2))]))
    r = simulate(W, beta)[0][200:]
    sample = r.T @ r / len(r)
    error = np.sqrt((np.outer(np.diag(Xi), np.diag(Xi)) + Xi**2) / len(r))
    assert (np.abs(sample - Xi) < 5 * error).all()
    scaled = r / np.sqrt(np.diag(Xi))
    for lag in (1, 2, 3, 10):
        assert np.abs(scaled[lag:].T @ scaled[:-lag] / len(r)).max() < 5 / np.sqrt(len(r))


def test_pole_on_the_unit_circle_is_refused_with_the_cure_and_can_be_regularised() -> None:
    G = StateSpace.of([[1.0, 0.1], [0.0, 0.8]], [[0.0], [1.0]], [[1.0, 0.0]], None, 0.1)
    with pytest.raises(IllConditioned, match=r"pole 1.*process_cov.*regularise"):
        innovations(G, [[0.2]])
    found = innovations(G, [[0.2]], regularise=1e-6)
    assert found.regularised == 1e-6
    assert found.filter.is_stable()
    assert 0.2 < found.covariance[0, 0] < 0.21
    assert np.linalg.eigvalsh(found.state_covariance).min() > 0
    with_noise = innovations(G, [[0.2]], np.diag([0.0, 1e-3]))
    assert with_noise.regularised == 0
    assert with_noise.filter.is_stable()


def test_process_noise_that_misses_the_mode_on_the_circle_is_refused() -> None:
    G = StateSpace.of(np.diag([1.0, 0.5]), [[1.0], [1.0]], [[1.0, 1.0]], None, 0.1)
    with pytest.raises(IllConditioned, match="pole 1 "):
        innovations(G, [[0.2]], np.diag([0.0, 1e-3]))


def test_undetectable_plant_is_refused() -> None:
    G = StateSpace.of(np.diag([1.2, 0.5]), [[1.0], [1.0]], [[0.0, 1.0]], None, 0.1)
    with pytest.raises(IllConditioned, match=r"1\.2"):
        innovations(G, [[0.2]])


def test_a_pole_next_to_the_circle_is_exact() -> None:
    G = StateSpace.of([[1.000001]], [[1.0]], [[1.0]], None, 0.1)
    assert innovations(G, [[0.2]]).covariance[0, 0] == pytest.approx(0.2 * 1.000001**2, rel=1e-12)


def test_poles_in_mirrored_pairs() -> None:
    """Two undamped magnetic bearings, poles at +-180 and +-200 rad/s: what is mirrored falls on poles already there."""
    A = np.kron(np.eye(2), [[0.0, 1.0], [0.0, 0.0]]) + np.diag([180.0**2, 0.0, 200.0**2], -1)
    B, C = np.kron(np.eye(2), [[0.0], [1.0]]), np.kron(np.eye(2), [[1.0, 0.0]])
    for G in (sample_zoh(StateSpace.of(A, B, C), 1e-3), StateSpace.of(A, B, C)):
        found = innovations(G, 0.25 * np.eye(2))
        assert found.filter.is_stable()
        if G.discrete:
            growth = np.exp(2 * (180 + 200) * G.dt)
            assert np.linalg.det(found.covariance) == pytest.approx(0.25**2 * growth, rel=1e-9)


def test_kalman_observer_has_white_innovation() -> None:
    """Own observer = Kalman predictor: beta itself is white and the filter is the identity."""
    G, Q = plant(stable=False), process(False)
    F = lqr(G, np.eye(4), np.eye(2))
    f = observer_factorisation(G, F, kalman_predictor_gain(G, Q, R))
    W, _ = whitening_filter(f, R, Q)
    assert np.abs(frequency_response(W, OMEGA) - np.eye(2)).max() < 1e-9


def test_continuous_time_is_kalman_bucy() -> None:
    """r has the noise intensity R whatever the plant; the discrete innovations of a fast sampling agree."""
    rng = np.random.default_rng(7)
    A = rng.standard_normal((3, 3))
    A -= (np.linalg.eigvals(A).real.max() - 0.5) * np.eye(3)
    G = StateSpace.of(A, rng.standard_normal((3, 1)), rng.standard_normal((1, 3)))
    Q, Rc = 0.3 * np.eye(3), np.array([[0.04]])
    found, dt = innovations(G, Rc, Q), 1e-4
    assert np.array_equal(found.covariance, Rc)
    assert found.filter.is_stable()
    discrete = innovations(sample_zoh(G, dt), Rc / dt, Q * dt)
    assert np.abs(discrete.gain / dt - found.gain).max() < 1e-3 * np.abs(found.gain).max()


def test_bad_covariances_are_named() -> None:
    G = plant(stable=True)
    with pytest.raises(BadInput, match=r"output_cov has shape \(3, 3\)"):
        innovations(G, np.eye(3))
    with pytest.raises(BadInput, match="output_cov is singular"):
        innovations(G, np.zeros((2, 2)))
    with pytest.raises(BadInput, match="process_cov has the eigenvalue -1"):
        innovations(G, R, -np.eye(4))
    with pytest.raises(BadInput, match="not symmetric"):
        innovations(G, [[1.0, 0.5], [0.0, 1.0]])
    with pytest.raises(BadInput, match="cross_cov"):
        innovations(G, R, 1e-6 * np.eye(4), np.ones((4, 2)))
