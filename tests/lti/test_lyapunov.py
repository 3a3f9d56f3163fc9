"""The discrete Lyapunov equation beside its Kronecker form, poles near -1 included."""

import numpy as np
import pytest

from afdsvc.errors import BadInput
from afdsvc.lti.lyapunov import discrete_lyapunov


@pytest.mark.parametrize("nearest", [-0.5, -0.999, -0.999999, 0.99999])
def test_it_agrees_with_the_kronecker_form(nearest):
    rng = np.random.default_rng(12)
    n = 12
    T = rng.normal(size=(n, n))
    A = T @ np.diag([nearest, *rng.uniform(-0.95, 0.95, n - 1)]) @ np.linalg.inv(T)
    B = rng.normal(size=(n, 2))
    expected = np.linalg.solve(np.eye(n * n) - np.kron(A, A), (B @ B.T).ravel()).reshape(n, n)
    assert discrete_lyapunov(A, B @ B.T) == pytest.approx(expected, rel=1e-6, abs=1e-8 * np.abs(expected).max())


def test_an_unstable_system_has_none():
    with pytest.raises(BadInput, match=r"pole of modulus 1\.01"):
        discrete_lyapunov(np.diag([0.5, -1.01]), np.eye(2))
    with pytest.raises(BadInput, match="pole of modulus 1;"):
        discrete_lyapunov(np.eye(1), np.eye(1))
