"""The door for python-control systems: drawn by somebody else, checked with python-control's own evaluation."""

from __future__ import annotations

import subprocess
import sys

import control
import numpy as np
import pytest
from scipy import signal

import afdsvc.lti as lti
from afdsvc.api.model import Model
from afdsvc.errors import BadInput, NotStabilising
from afdsvc.lti.python_control import as_state_space, is_transfer_function
from afdsvc.lti.statespace import StateSpace

FACTORS = ("M", "N", "U", "V", "Mt", "Nt", "Ut", "Vt")


def lqg(plant: control.StateSpace) -> control.StateSpace:
    """An LQG controller for positive feedback made with python-control alone."""
    n, p, m = plant.nstates, plant.noutputs, plant.ninputs
    if plant.dt:
        F = -control.dlqr(plant.A, plant.B, np.eye(n), np.eye(m))[0]
        L = -control.dlqr(plant.A.T, plant.C.T, np.eye(n), np.eye(p))[0].T
    else:
        F = -control.lqr(plant.A, plant.B, np.eye(n), np.eye(m))[0]
        L = -control.lqr(plant.A.T, plant.C.T, np.eye(n), np.eye(p))[0].T
    return control.ss(plant.A + plant.B @ F + L @ (plant.C + plant.D @ F), -L, F, np.zeros((m, p)), plant.dt)


def systems() -> dict[str, tuple[control.StateSpace, control.StateSpace]]:
    np.random.seed(4)  # noqa: NPY002  python-control's rss and drss take numpy's global state
    double_integrator = control.ss([[0, 1], [0, 0]], [[0], [1]], [[1, 0]], 0)
    pid = control.ss(control.tf([-2.0, -8.0, -1.0], [0.05, 1.0, 0.0]))
    unstable = control.ss([[1, -0.3], [-0.5, 0.2]], [[2], [3]], [[-1, 4]], 0, 0.001)
    discrete, continuous = control.drss(5, 2, 3), control.rss(6, 3, 2, strictly_proper=True)
    return {
        "double integrator, unstable PID": (double_integrator, pid),
        "discrete unstable, LQG": (unstable, lqg(unstable)),
        "drss with dt=True, LQG": (discrete, lqg(discrete)),
        "rss, LQG": (continuous, lqg(continuous)),
        "rss, small gain": (continuous, control.ss([], [], [], 1e-3 * np.ones((2, 3)))),
    }


CASES = list(systems())


def points(plant: control.StateSpace) -> np.ndarray:
    omega = np.geomspace(1e-2, 3.0, 15)
    return np.exp(1j * omega) if plant.dt else 1j * omega * 5


def at(system: control.StateSpace, x: complex) -> np.ndarray:
    return np.atleast_2d(system(x))


@pytest.mark.parametrize("case", CASES)
def test_factors_satisfy_bezout_with_both_systems(case: str) -> None:
    plant, K = systems()[case]
    f = lti.coprime(plant, K)
    for x in points(plant):
        g = {name: at(getattr(f, name), x) for name in FACTORS}
        right = np.block([[g["M"], g["U"]], [g["N"], g["V"]]])
        left = np.block([[g["Vt"], -g["Ut"]], [-g["Nt"], g["Mt"]]])
        assert np.abs(left @ right - np.eye(len(left))).max() < 1e-9
        assert np.abs(right @ left - np.eye(len(left))).max() < 1e-9
        assert np.abs(g["N"] - at(plant, x) @ g["M"]).max() < 1e-9
        assert np.abs(g["Ut"] - g["Vt"] @ at(K, x)).max() < 1e-9
    for name in FACTORS:
        poles = getattr(f, name).poles()
        assert not len(poles) or (np.abs(poles).max() < 1 if plant.dt else poles.real.max() < 0)
        assert getattr(f, name).dt == plant.dt


@pytest.mark.parametrize("case", CASES)
def test_augmented_controller_is_the_controller_and_beta_belongs_to_the_other_functions(case: str) -> None:
    """J_K of the nominal plant on a changed one gives exactly `deviation`; zero on the nominal plant itself."""
    plant, K = systems()[case]
    p, m = plant.noutputs, plant.ninputs
    J, f = lti.augmented_controller(plant, K), lti.coprime(plant, K)
    assert (J.ninputs, J.noutputs) == (p + m, m + p)
    true = control.ss(plant.A, 1.05 * plant.B, plant.C, 1.05 * plant.D, plant.dt)
    S, zero = lti.deviation(true, plant, K), lti.deviation(plant, plant, K)
    for x in points(plant):
        j, g = at(J, x), at(true, x)
        assert np.abs(j[:m, :p] - at(K, x)).max() < 1e-9 * max(1, np.abs(j).max())
        closed = j[m:, p:] + j[m:, :p] @ g @ np.linalg.inv(np.eye(m) - j[:m, :p] @ g) @ j[:m, p:]
        assert np.abs(at(S, x) - closed).max() < 1e-9 * max(1, np.abs(closed).max())
        mt, gt = at(f.Mt, x), at(true, x) - at(plant, x)
        written = mt @ gt @ np.linalg.inv(np.eye(m) - at(K, x) @ at(true, x)) @ np.linalg.inv(at(f.Vt, x))
        assert np.abs(at(S, x) - written).max() < 1e-9 * max(1, np.abs(written).max())
        assert np.abs(at(zero, x)).max() < 1e-9


@pytest.mark.parametrize("case", [c for c in CASES if "discrete" in c or "drss" in c])
def test_whitening_flattens_the_noise_on_beta(case: str) -> None:
    """On the nominal plant beta = Mt d (output noise), so W^-1 Mt R Mt* W^-* must be Xi at every frequency."""
    plant, K = systems()[case]
    R = np.diag(np.arange(1.0, plant.noutputs + 1))
    W, Xi = lti.whitening(plant, K, R)
    f = lti.coprime(plant, K)
    for x in points(plant):
        path = at(W, x) @ at(f.Mt, x)
        assert np.abs(path @ R @ path.conj().T - Xi).max() < 1e-9 * np.abs(Xi).max()


def test_gas_bearing_in_its_own_units() -> None:
    """um, um/s, 1e6: nothing is rescaled by the caller, and everything still holds to 1e-9."""
    from afdsvc.plants.gas_bearing import gas_bearing

    G = gas_bearing().discrete()
    plant = control.ss(G.A, G.B, G.C, G.D, G.dt)
    F = -control.dlqr(G.A, G.B, 1e-4 * np.diag([0, 0, 1, 1, 0, 0]), np.eye(2))[0]
    L = -control.dlqr(G.A.T, G.C.T, 0.01 * np.eye(6), np.eye(2))[0].T
    K = control.ss(G.A + G.B @ F + L @ G.C, -L, F, np.zeros((2, 2)), G.dt)
    assert lti.augmented_controller(plant, K).nstates == 6
    for controller in (K, control.ss([], [], [], 0.2 * np.eye(2), G.dt), 0.2 * np.eye(2)):
        f = lti.coprime(plant, controller)
        for omega in (1.0, 62.0, 1340.0, 5000.0, 15000.0):
            g = {name: at(getattr(f, name), np.exp(1j * omega * G.dt)) for name in FACTORS}
            product = np.block([[g["Vt"], -g["Ut"]], [-g["Nt"], g["Mt"]]]) @ np.block([[g["M"], g["U"]], [g["N"], g["V"]]])
            assert np.abs(product - np.eye(4)).max() < 1e-9
            healthy = at(lti.deviation(plant, plant, controller), np.exp(1j * omega * G.dt))
            assert np.abs(healthy).max() < 1e-9


def test_transfer_functions_are_welcome_improper_ones_are_not() -> None:
    plant, K = control.tf([1], [1, 2]), control.tf([-1], [1, 1])
    assert lti.coprime(plant, K).M.dt == plant.dt
    with pytest.raises(BadInput, match="controller is not proper: a numerator is 1 degree"):
        lti.coprime(plant, control.tf([1, 2, 0], [1, 1]))


def test_a_controller_that_does_not_stabilise_is_named_with_its_pole() -> None:
    plant = control.ss([[0.5]], [[1.0]], [[1.0]], 0, 0.1)
    with pytest.raises(NotStabilising, match=r"pole 1\.5 \(modulus 1\.5.*check the sign of K"):
        lti.coprime(plant, control.ss([], [], [], [[1.0]], 0.1))


def test_hidden_unstable_modes_are_distinguished() -> None:
    hidden = control.ss(np.diag([1.2, 0.5]), [[1.0], [1.0]], [[0.0, 1.0]], 0, 0.1)
    with pytest.raises(NotStabilising, match=r"pole 1\.2 .*plant is unobservable \(rank 1 of 2\)"):
        lti.coprime(hidden, control.ss([], [], [], [[-0.1]], 0.1))
    stuck = control.ss(np.diag([1.2, 0.5]), [[0.0], [1.0]], [[1.0, 1.0]], 0, 0.1)
    with pytest.raises(NotStabilising, match=r"uncontrollable \(rank 1 of 2\)"):
        lti.augmented_controller(stuck, control.ss([], [], [], [[-0.1]], 0.1))


def test_shapes_times_and_types_are_named() -> None:
    plant = control.ss([[0.5]], [[1.0]], [[1.0]], 0, 0.1)
    with pytest.raises(BadInput, match="controller has 1 outputs and 2 inputs; a plant with 1 inputs and 1 outputs"):
        lti.coprime(plant, control.ss([], [], [], [[1.0, 2.0]], 0.1))
    with pytest.raises(BadInput, match=r"plant has dt 0\.1 and the controller dt 0\.2"):
        lti.coprime(plant, control.ss([[0.1]], [[1.0]], [[1.0]], 0, 0.2))
    with pytest.raises(BadInput, match="the plant is a str"):
        lti.coprime("plant", plant)
    with pytest.raises(BadInput, match="the true plant has 2 outputs and 1 inputs; expected 1 and 1"):
        lti.deviation(control.ss([[0.5]], [[1.0]], [[1.0], [1.0]], [[0], [0]], 0.1), plant, 0.1)
    with pytest.raises(BadInput, match="have 2, 1, 1, 2 dimensions; expected matrices"):
        as_state_space((1, [2], [3], 4))
    assert as_state_space((-1, 2, 3, 4)).B.tolist() == [[2]]
    with pytest.raises(BadInput, match="NaN or infinity"):
        lti.coprime(control.ss([[np.nan]], [[1.0]], [[1.0]], 0, 0.1), 0.1)


def test_systems_stated_as_transfer_functions_are_known() -> None:
    transfer = [control.tf([1.0], [1, 2.0]), signal.TransferFunction([1.0], [1, 2.0]), ([1.0], [1, 2.0]), ([], [-2.0], 3.0), signal.ZerosPolesGain([], [-2.0], 3.0)]
    state_space = [control.ss(-1.0, 1, 1, 0), signal.StateSpace(-1.0, 1, 1, 0), (-1.0, 1.0, [[1.0]]), (-1.0, 1.0, 1.0, 0.0), StateSpace.gain(np.eye(1))]
    assert [is_transfer_function(s) for s in transfer] == [True] * 5
    assert [is_transfer_function(s) for s in state_space] == [False] * 5
    assert [Model.from_system(s).transfer for s in (transfer[0], state_space[0])] == [True, False]


def test_importing_the_room_does_not_import_python_control() -> None:
    code = "import sys, afdsvc.lti; assert 'control' not in sys.modules and 'matplotlib' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
