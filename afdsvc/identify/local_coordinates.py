"""A black box with just as many parameters as matter: local coordinates around a realisation.

Of the entries of (A, B, C) only the directions that change the transfer function count; those along a change of state
coordinates, ``(T A - A T, T B, -C T)``, are projected out (data-driven local coordinates; McKelvey, Helmersson and
Ribarits, Automatica 40, 2004). What remains, n (m + p) numbers (and D where it is not zero), is well conditioned around
a balanced realisation.
"""

from __future__ import annotations

import numpy as np
from scipy import linalg

from afdsvc.identify.structure import Parameter, Structure
from afdsvc.lti.statespace import Array, StateSpace

#: Size of one unit of a coordinate, relative to the entries.
_UNIT = 1e-3


def local_structure(system: StateSpace) -> Structure:
    """Return the structure of all discrete systems near this one, of the same order; the nominal values are zero.

    Columns of D that are zero stay zero.
    """
    n, m, p = system.order, system.inputs, system.outputs
    direct = np.flatnonzero(np.broadcast_to(system.D.any(axis=0), (p, m)).ravel())
    directions = linalg.block_diag(_across(system), np.eye(p * m)[:, direct])
    origin = np.concatenate([system.A.ravel(), system.B.ravel(), system.C.ravel(), system.D.ravel()])
    unit = _UNIT * float(np.linalg.norm(origin))

    def build(z: Array) -> StateSpace:
        v = origin + directions @ z
        A, B, C, D = np.split(v, np.cumsum([n * n, n * m, p * n]))
        return StateSpace(A.reshape(n, n), B.reshape(n, m), C.reshape(p, n), D.reshape(p, m), system.dt)

    names = (Parameter(f"z{i + 1}", 0.0, "", unit) for i in range(directions.shape[1]))
    return Structure(tuple(names), build)


def _across(system: StateSpace) -> Array:
    """Return an orthonormal basis of the directions across changes of state coordinates, shape ``(entries, n (m +
    p))``."""
    n, A, B, C = system.order, system.A, system.B, system.C
    along = []
    for T in np.eye(n * n).reshape(n * n, n, n):
        along.append(np.concatenate([(T @ A - A @ T).ravel(), (T @ B).ravel(), -(C @ T).ravel()]))
    return np.asarray(linalg.null_space(np.stack(along)))
