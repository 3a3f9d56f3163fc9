"""The residual of a fit with the signals it may depend on, as the gap test reads it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from afdsvc.dataset.experiment import Run
from afdsvc.explain.gap.signals import ResidualSignals
from afdsvc.explain.noise.surrogates import autoregressive, whiten
from afdsvc.explain.search.fit import Coordinates, Fit, weighted
from afdsvc.explain.search.problem import Point, Problem
from afdsvc.lti.statespace import Array

Names = tuple[Sequence[str], Sequence[str], Sequence[str], Sequence[str]]


def signals(problem: Problem, point: Point, horizon: float) -> list[ResidualSignals]:
    """Return residual, inputs, simulated states and other signals of every run; references where a loop has them in all runs.

    Inputs simulated in the loop hold no noise of the outputs, so no reference is needed there.
    """
    references = [None if problem.closed else _reference(r) for r in problem.runs]
    known = all(r is not None for r in references)
    found = []
    for run, s, reference in zip(problem.runs, problem.simulated(point, horizon), references, strict=True):
        inputs = np.nan_to_num(s.u) if problem.closed else run.U
        states = np.nan_to_num(s.x, posinf=0.0, neginf=0.0)
        found.append(ResidualSignals(run.Y - s.y, inputs, states, run.AUX, run.dt, run.period, reference if known else None))
    return found


def by_innovations(problem: Problem, fit: Fit, horizon: float, order: int) -> Point:
    """Return the fit after a step of generalised least squares: residuals whitened by their own autoregressive model.

    A fit by the power of the residual leaves numbers of the model off by what slow noise moves them. In the innovations that error
    shows, though nothing is left out. The step is taken where it lowers the power of the innovations.
    """
    c = Coordinates(problem, fit.point)
    q, filters = c.pack(fit.point), [autoregressive([e[:, j] for e in fit.residuals], order) for j in range(len(fit.sd))]

    def whitened(pieces: Sequence[Array]) -> Array:
        return np.concatenate([np.stack([whiten(x[:, j], a) for j, a in enumerate(filters)], axis=1) for x in pieces])

    e = whitened(fit.residuals)
    first = np.concatenate([[0], np.cumsum([r.size for r in fit.residuals])])
    J = whitened([fit.J[a:b].reshape(-1, len(fit.sd), c.size) for a, b in pairwise(first)])
    sd = np.sqrt(np.mean(e**2, axis=0))
    Js, es = (J / sd[:, None]).reshape(-1, c.size), (e / sd).ravel()
    H = Js.T @ Js + np.diag(c.prior_weight**2)
    step = -np.linalg.lstsq(H, Js.T @ es + c.prior_weight**2 * (q - c.prior_mean), rcond=1e-12)[0]
    there = c.unpack(q + step)
    moved = whitened(weighted(problem, there, horizon))
    return there if np.log(np.mean(moved**2, axis=0)).sum() < np.log(sd**2).sum() else fit.point


def _reference(run: Run) -> Array | None:
    """Return what comes into a closed loop from outside: the burst and the references, as far as they move."""
    outside = np.hstack([run.W if run.W is not None and run.commanded else run.U[:, :0], run.REF])
    moves = np.ptp(outside, axis=0) > 0
    return outside[:, moves] if moves.any() else None


def signal_names(problem: Problem) -> Names:
    """Return the names of states, inputs, outputs and other signals."""
    model = problem.nominal.model
    states, inputs, outputs = ([v.name for v in side] for side in (model.states, model.inputs, model.outputs))
    return states, inputs, outputs, list(problem.runs[0].aux)
