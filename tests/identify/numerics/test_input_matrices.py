"""B, D and initial states equal a plain least-squares problem written out."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.identify.numerics.input_matrices import regress_input_matrices
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace


def _written_out(A, C, K, recordings, feedthrough):
    """Column by column: simulate the predictor for every unit entry of B - K D, D and every initial state."""
    n, p, m = len(A), len(C), recordings[0].u.shape[1]
    At, zero = A - K @ C, np.zeros((p, m))
    columns, target = (
        [],
        np.concatenate(
            [(r.y - simulate(StateSpace(At, K, C, np.zeros((p, p)), 1.0), r.y)[0]).ravel() for r in recordings]
        ),
    )
    for j in range(m):
        for i in range(n):
            B = np.zeros((n, m))
            B[i, j] = 1
            columns.append(
                np.concatenate([simulate(StateSpace(At, B, C, zero, 1.0), r.u)[0].ravel() for r in recordings])
            )
    for i, j in np.ndindex(p, m) if feedthrough else ():
        D = np.zeros((p, m))
        D[i, j] = 1
        columns.append(np.concatenate([(r.u @ D.T).ravel() for r in recordings]))
    for place, _ in enumerate(recordings):
        for i in range(n):
            free = [
                simulate(StateSpace(At, np.zeros((n, m)), C, zero, 1.0), r.u, np.eye(n)[i] * (k == place))[0].ravel()
                for k, r in enumerate(recordings)
            ]
            columns.append(np.concatenate(free))
    solution = np.linalg.lstsq(np.stack(columns, axis=1), target, rcond=None)[0]
    D = solution[n * m : n * m + p * m].reshape(p, m) if feedthrough else zero
    return solution[: n * m].reshape(m, n).T + K @ D, D


@given(st.integers(0, 10**6), st.booleans(), st.booleans())
@settings(max_examples=15, deadline=None)
def test_equals_the_least_squares_problem_written_out(oscillators, seed, predictor, feedthrough):
    system, rng = oscillators(seed, 4), np.random.default_rng(seed)
    recordings = [InputOutputData.of(rng.standard_normal((n, 2)), rng.standard_normal((n, 2)), 1.0) for n in (150, 90)]
    K = 0.05 * rng.standard_normal((4, 2)) if predictor else np.zeros((4, 2))
    B, D = regress_input_matrices(system.A, system.C, recordings, K if predictor else None, feedthrough)
    wanted_B, wanted_D = _written_out(system.A, system.C, K, recordings, feedthrough)
    assert pytest.approx(wanted_B, rel=1e-7, abs=1e-9) == B
    assert pytest.approx(wanted_D, rel=1e-7, abs=1e-9) == D


def test_blocks_leave_no_seam(oscillators):
    """More samples than a block: the true matrices come back from noise-free data."""
    system, rng = oscillators(5), np.random.default_rng(5)
    u = rng.standard_normal((10_000, 2))
    y, _ = simulate(system, u, rng.standard_normal(6))
    B, D = regress_input_matrices(system.A, system.C, [InputOutputData.of(u, y, 1.0)])
    assert np.abs(B - system.B).max() < 1e-10
    assert np.abs(D).max() < 1e-10
