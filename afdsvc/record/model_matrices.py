"""Matrices of a MODEL.toml: their shapes checked against the names, and how well their entries are known."""

from __future__ import annotations

import numpy as np

from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.record.model_schema import LinearTable, Matrix, UncertaintyTable

DEFAULT_RELATIVE_SD = 0.05


def linear_system(table: LinearTable, inputs: int, outputs: int, source: str, prefix: str = "") -> StateSpace:
    """Return the system of four matrices; raises `BadInput` naming file, key, shape found and shape wanted."""
    order = len(table.A or [])
    shapes = {"A": (order, order), "B": (order, inputs), "C": (outputs, order), "D": (outputs, inputs)}
    matrices = {}
    for name, shape in shapes.items():
        why = f"{order} states, {inputs} inputs and {outputs} outputs"
        matrices[name] = checked_matrix(getattr(table, name), shape, f"{source}: key '{prefix}{name}'", why)
    return StateSpace(**matrices, dt=table.dt)


def checked_matrix(rows: Matrix, shape: tuple[int, int], where: str, why: str) -> Array:
    """Return rows as an array; raises `BadInput` for ragged rows or another shape (``[]`` is any empty matrix)."""
    widths = sorted({len(row) for row in rows})
    if len(widths) > 1:
        raise BadInput(f"{where} has rows of {widths} entries; rows of equal length are wanted")
    found = (len(rows), widths[0] if widths else 0)
    if 0 in shape and 0 in found:
        return np.zeros(shape)
    if found != shape:
        raise BadInput(f"{where} has shape {found}; {shape} is wanted for {why}")
    return np.array(rows, dtype=np.float64)


def entry_deviations(plant: StateSpace, table: UncertaintyTable | None, source: str) -> dict[str, Array]:
    """Return absolute standard deviations of the entries of A, B, C and D, shapes as theirs."""
    relative = DEFAULT_RELATIVE_SD if table is None else table.relative
    deviations = {name: relative_deviation(getattr(plant, name), relative) for name in "ABCD"}
    for name in "ABCD":
        rows = None if table is None else getattr(table, name)
        if rows is not None:
            where = f"{source}: key 'uncertainty.{name}'"
            given = checked_matrix(rows, deviations[name].shape, where, f"the entries of {name}")
            if (given < 0).any():
                raise BadInput(f"{where} holds {given.min()}; standard deviations of 0 or more are wanted")
            deviations[name] = given
    return deviations


def relative_deviation(matrix: Array, relative: float) -> Array:
    """Return the deviation of every entry that is not 0 or +-1 (those are structure, not measured) as a share of it."""
    return np.where(np.isin(matrix, (0.0, 1.0, -1.0)), 0.0, relative * np.abs(matrix))


def covariance(rows: Matrix | None, order: int, source: str) -> Array | None:
    """Return the covariance of the state noise; raises `BadInput` unless it is symmetric and not negative."""
    if rows is None:
        return None
    where = f"{source}: key 'noise.process_cov'"
    cov = checked_matrix(rows, (order, order), where, f"{order} states")
    if not np.array_equal(cov, cov.T):
        raise BadInput(f"{where} is not symmetric; a covariance is wanted")
    if order and np.linalg.eigvalsh(cov)[0] < -1e-12 * max(np.abs(cov).max(), 1e-300):
        raise BadInput(f"{where} has the eigenvalue {np.linalg.eigvalsh(cov)[0]:.3g}; none below 0 is wanted")
    return cov
