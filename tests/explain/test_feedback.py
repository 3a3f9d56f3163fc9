"""A stable stage in feedback, pushed by coloured forces that its controller answers: nothing is missing but its numbers."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.dataset.experiment import prepare
from afdsvc.explain.pipeline import explain
from afdsvc.explain.search.build import build
from afdsvc.explain.settings import Settings
from afdsvc.explain.simulate.nominal import nominal
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics import afdsvc_physics

DT, SAMPLES, REST = 5e-4, 3200, np.exp(-0.35)  # of the controller's filter, per sample
CONTROLLER = StateSpace.of([[1, 0], [0, REST]], [[DT], [1 - REST]], [[-6.0, 0.147]], [[-0.147]], DT)  # of y - reference: integral action, filtered damping
LIBRARY = [p for p in afdsvc_physics() if p.name in ("flexible_mode", "periodic_disturbance", "relaxation", "coulomb_friction", "actuator_lag", "cubic_stiffness")]


def plant(stiffness: float, damping: float, gain: float) -> StateSpace:
    return StateSpace.of([[0, 1.0], [-stiffness, -damping]], [[0.0], [gain]], [[1.0, 0.0]])


TRUE, STATED = plant(52_600.0, 5.5, 4.1e5), plant(47_000.0, 7.0, 3.7e5)


def recording(seed: int, reference: np.ndarray, added: np.ndarray) -> Trace:
    """Return the loop under a force with a correlation time of 20 samples, sampled exactly; the reading has steps, noise and drift."""
    rng = np.random.default_rng(seed)
    both = expm(np.vstack([np.column_stack([TRUE.A, TRUE.B, [0.0, 1.0]]), np.zeros((2, 4))]) * DT)
    drift, x, z, force, rows = 0.012 * rng.standard_normal(SAMPLES).cumsum() / SAMPLES**0.5, np.zeros(2), np.zeros(2), 0.0, []
    for r, a, d in zip(reference, added, drift, strict=True):
        y = np.round((x[0] + d + 0.015 * rng.standard_normal()) / 0.02) * 0.02
        u = (CONTROLLER.C @ z + CONTROLLER.D[:, 0] * (y - r))[0] + a
        rows.append((u, y, r))
        z, x = CONTROLLER.A @ z + CONTROLLER.B[:, 0] * (y - r), both[:2] @ [*x, u, force]
        force = np.exp(-1 / 20) * force + 3000 * np.sqrt(1 - np.exp(-1 / 10)) * rng.standard_normal()
    return Trace(f"r{seed}", DT, (Channel("u_coil"), Channel("y_position"), Channel("ref_position")), np.array(rows))


def recordings(seed: int) -> list[Trace]:
    """Return steps and a sweep of the reference, steps added to the input, and the first two together."""
    rng, t = np.random.default_rng(seed), DT * np.arange(SAMPLES)
    steps = [np.repeat(rng.uniform(-a, a, SAMPLES // n), n) for n, a in ((400, 20), (80, 3), (400, 20))]
    sweep = np.sin(2 * np.pi * (0.5 * t + 9.2 * t**2))
    given = [(steps[0], 0 * t), (15 * sweep, 0 * t), (0 * t, steps[1]), (steps[2] + 4 * sweep, 0 * t)]
    return [recording(10 * seed + k, *pair) for k, pair in enumerate(given)]


def model() -> Model:
    words = (Variable("coil", "A"),), (Variable("position", "um"),), (Variable("position", "um"), Variable("velocity", "um/s", rate_of="position"))
    sd = {"A": np.array([[0, 0], [4700.0, 2.0]]), "B": np.array([[0], [5.5e4]]), "C": np.zeros((1, 2))}
    return Model("stage", *words, STATED, controller=CONTROLLER, entry_sd=sd)


@pytest.mark.parametrize("seed", [2, 3])
def test_what_disturbs_a_loop_is_not_named_where_its_controller_is_stated(seed):
    """Simulated from the recorded input, which holds the controller's answer to the forces, friction and a tone were named in 4 of 8 of these."""
    *fitted, held = recordings(seed)
    answer = explain(model(), fitted, [held], LIBRARY, experiment=False)
    assert (answer.simulated, answer.verdict, answer.named) == ("in closed loop", "consistent", ())


@pytest.mark.parametrize(("controller", "closed"), [(1.0, True), (-1.0, False), (0.0, False)])
def test_the_loop_is_simulated_where_that_follows_better_than_a_simulation_from_the_inputs(controller, closed):
    """With the sign of the controller turned the simulated loop is unstable; without gain it is the simulation from the inputs."""
    stated = replace(model(), controller=StateSpace.of(CONTROLLER.A, CONTROLLER.B, controller * CONTROLLER.C, controller * CONTROLLER.D, DT))
    fitted, held = prepare(stated, recordings(1)[::3])
    assert build(nominal(stated, DT), [fitted], Settings(), [held]).closed == closed


def test_a_loop_that_follows_no_better_than_the_mean_is_not_simulated():
    """A plant that falls over leaves its recordings when it is simulated from the inputs; of readings that have nothing to do with it the loop follows none."""
    falls = replace(model(), plant=plant(-52_600.0, 5.5, 4.1e5), controller=StateSpace.gain(np.array([[-0.3]]), DT))
    rng = np.random.default_rng(1)
    names = (Channel("u_coil"), Channel("y_position"), Channel("ref_position"))
    fitted, held = prepare(falls, [Trace("r", DT, names, rng.standard_normal((SAMPLES, 3)) * [1, 1, 0]) for _ in range(2)])
    assert not build(nominal(falls, DT), [fitted], Settings(), [held]).closed
