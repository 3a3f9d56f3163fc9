"""What reduction costs, and how fast all 320 states run in closed loop.

    python benchmarks/rotor/models.py
"""

from __future__ import annotations

import time

import numpy as np

from afdsvc.hal import control_sample
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.statespace import StateSpace
from afdsvc.plants.amb_turboexpander import amb_turboexpander, turboexpander_rotor
from afdsvc.plugins.controllers.lqg import Lqg

OMEGA = np.geomspace(30.0, 20000.0, 120)


def difference(small: StateSpace, full: StateSpace) -> np.ndarray:
    """Return the largest difference of singular values at every frequency [dB]."""
    a, b = (np.linalg.svd(frequency_response(g, OMEGA), compute_uv=False) for g in (small, full))
    return np.abs(20 * np.log10(a / b)).max(axis=1)


def mapping_error(states: int) -> float:
    """Return the largest relative error of the mapped stiffness change over theta in [-0.5, 0.5] and all four axes."""
    plant, rotor, worst = amb_turboexpander(states=states), turboexpander_rotor(31500.0), 0.0
    for name in [n for n in plant.parameters if n.startswith("stiffness")]:
        for theta in (-0.5, -0.25, 0.25, 0.5):
            values = plant.values({name: plant.parameters[name].value * (1 + theta)})
            a = frequency_response(plant.continuous(**{name: values[name]}), OMEGA)
            b = frequency_response(rotor.reduced(values, states), OMEGA)
            worst = max(worst, float((np.linalg.norm(a - b, 2, (1, 2)) / np.linalg.norm(b, 2, (1, 2))).max()))
    return worst


def real_time_factor(sample_time: float, seconds: float = 0.5) -> float:
    """Return simulated seconds per second of processor time of the full model in its loop, one core."""
    plant = amb_turboexpander(sample_time=sample_time)
    J_K = control_sample.contiguous_system(Lqg().design(plant.discrete(), plant.recommended["lqg"]).interconnection)
    G = control_sample.contiguous_system(sample_zoh(turboexpander_rotor(31500.0).full_system(plant.values()), plant.sample_time))
    control_sample.compile_loops()
    n, rng = round(seconds / plant.sample_time), np.random.default_rng(1)
    bounds, x, xk, hold = np.full(4, 1e9), np.zeros(G.order), np.zeros(J_K.order), np.zeros(4)
    u, y, beta, alpha = (np.zeros((n, 4)) for _ in range(4))
    start = time.process_time()
    control_sample.run_closed_loop(
        G.A, G.B, G.C, x, J_K.A, J_K.B, J_K.C, J_K.D, xk, *control_sample.no_q(4, 4), alpha, np.zeros((n, 4)),
        0.5 * rng.standard_normal((n, 4)), False, bounds, bounds, hold, u, y, beta,
    )
    spent = time.process_time() - start
    print("displacement noise in the loop [um]:", np.round(y.std(axis=0), 2))
    return seconds / spent


if __name__ == "__main__":
    full = turboexpander_rotor(31500.0).full_system(amb_turboexpander().values())
    for states in (8, 12, 16, 24):
        db = difference(amb_turboexpander(states=states).continuous(), full)
        limit = OMEGA[np.argmax(db > 1)] if (db > 1).any() else OMEGA[-1]
        print(f"{states} states: within 1 dB to {limit:.0f} rad/s, {db.max():.2f} dB at worst below 20000;", end=" ", flush=True)
        print(f"mapped stiffness change {mapping_error(states):.2g}", flush=True)
    for hertz in (10_000, 20_000):
        print(f"320 states at {hertz} Hz, simulated seconds per second:", round(real_time_factor(1 / hertz), 2))
