"""The turboexpander's closed loop with everything on it: excitation, sensor noise, unbalance, changed parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from afdsvc.lti.coprime import Factorisation
from afdsvc.lti.lft import star
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.lti.yjbk import interconnection
from afdsvc.plants.amb_turboexpander import BALANCE_GRADE, turboexpander_rotor


@dataclass(frozen=True, eq=False)
class Record:
    """What was recorded: ``u, alpha (n, 4)`` [A], ``y, beta (n, 4)`` [um] and the rotor angle ``(n,)`` [rad]."""

    u: Array
    y: Array
    alpha: Array
    beta: Array
    angle: Array


def full_plant(values: dict[str, float], rpm: float, dt: float) -> StateSpace:
    """Return the sampled finite-element model: all 320 states."""
    return sample_zoh(turboexpander_rotor(rpm).full_system(values), dt)


def record(
    plant: StateSpace, fact: Factorisation, alpha: Array, generator: np.random.Generator, noise_sd: float = 0.0,
    rpm: float = 0.0, grade: float = BALANCE_GRADE,
) -> Record:
    """Run the loop from rest; with ``rpm`` the unbalance of that balance grade turns with the rotor."""
    n, m = alpha.shape
    angle = 2 * np.pi * rpm / 60 * plant.dt * np.arange(n)
    currents = turboexpander_rotor(rpm).unbalance(grade) if rpm else np.zeros(m)
    force = np.real(np.exp(1j * angle)[:, None] * currents)
    noise = noise_sd * generator.standard_normal((n, plant.outputs))
    out, _ = simulate(closed(plant, interconnection(fact)), np.hstack([noise, force, alpha]))
    u, y, beta = np.split(out, [m, m + plant.outputs], axis=1)
    return Record(u, y + noise, alpha, beta, np.mod(angle, 2 * np.pi))


def closed(plant: StateSpace, J_K: StateSpace) -> StateSpace:
    """Return the loop from (noise, current disturbance, alpha) to (u, y without noise, beta); D of the plant is 0."""
    n, m, p = plant.order, plant.inputs, plant.outputs
    B = np.hstack([np.zeros((n, p)), plant.B, plant.B])
    C = np.vstack([np.zeros((m, n)), plant.C, plant.C])
    D = np.zeros((m + 2 * p, p + 2 * m))
    D[:m, p + m :] = np.eye(m)
    D[m + p :, :p] = np.eye(p)
    return star(StateSpace(plant.A, B, C, D, plant.dt), J_K, p, m)


def without_rotation(signal: Array, angle: Array) -> Array:
    """Return a signal ``(n, p)`` less its part that turns with the rotor, found by least squares."""
    basis = np.column_stack([np.cos(angle), np.sin(angle)])
    return np.asarray(signal - basis @ np.linalg.lstsq(basis, signal, rcond=None)[0])
