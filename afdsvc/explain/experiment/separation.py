"""How far apart two look-alikes would be on an excitation, after each has done its best to imitate the other."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from afdsvc.explain.experiment.plans import Plan, as_run
from afdsvc.explain.search.fit import Coordinates, Fit, fit, jacobian, weighted
from afdsvc.explain.search.forward import Found
from afdsvc.explain.search.problem import Point, Problem
from afdsvc.lti.statespace import Array

ROOM = 2.2  # largest output over what was recorded


@dataclass(frozen=True, slots=True, eq=False)
class Rival:
    """A fitted look-alike with what the recordings say of its numbers: information ``H (k, k)``, initial states given up."""

    point: Point
    H: Array


@dataclass(frozen=True, slots=True, eq=False)
class Separation:
    """The rivals, ready to be simulated on excitations; ``noise (p,)`` is the deviation of one independent weighted sample."""

    problem: Problem
    rivals: tuple[Rival, Rival]
    noise: Array

    def __call__(self, plan: Plan) -> float:
        """Return the distance in standard deviations; 0 where a simulation leaves the outputs seen so far far behind."""
        there = self._there(plan)
        seen = [self._seen(there, r.point, plan) for r in self.rivals]
        limit = ROOM * np.max([np.nanmax(np.abs(r.Y), axis=0) for r in self.problem.runs], axis=0)
        if not all(np.abs(s.y).max(initial=0.0) < np.inf and (np.abs(s.y) <= limit).all() for s in there.simulated(self._rested(self.rivals[0].point), 0.0)):
            return 0.0
        d = seen[0] - seen[1]
        repeats = plan.burst.samples / plan.period - 1.0
        return float(np.sqrt(max(min(unlike(d, self._jacobian(there, r, plan), r.H, repeats) for r in self.rivals), 0.0)))

    def _there(self, plan: Plan) -> Problem:
        run = as_run(plan.burst, self.problem.runs[0], len(self.problem.scale))
        return self.problem.of([run], [np.zeros(self.problem.nominal.plant.order)])

    def _rested(self, point: Point) -> Point:
        return point.rested([np.zeros(self.problem.nominal.plant.order)])

    def _seen(self, there: Problem, point: Point, plan: Plan) -> Array:
        return np.asarray((weighted(there, self._rested(point), 0.0)[0] / self.noise)[-plan.period :].ravel())

    def _jacobian(self, there: Problem, rival: Rival, plan: Plan) -> Array:
        point = self._rested(rival.point)
        c, residuals = Coordinates(there, point), weighted(there, point, 0.0)
        J = jacobian(there, c, c.pack(point), 0.0, residuals)[:, : c.shared]
        p = len(self.noise)
        return (J.reshape(-1, p, c.shared) / self.noise[:, None])[-plan.period :].reshape(-1, c.shared)


def separation_of(found: Found, first: Fit, second: Fit) -> Separation | None:
    """Return the two fits ready to be compared; None for a plant that is not stable and whose controller is unknown."""
    last = list(found.end)[-1]
    closed = found.problem.nominal.model.controller is not None
    if not closed and last != 0.0:
        return None
    rivals = tuple(Rival(f.point, _information(found.problem, f, last)) for f in (first, second))
    problem = replace(found.problem, closed=closed)
    return Separation(problem, (rivals[0], rivals[1]), first.sd * np.sqrt(first.own_tau))


def _information(problem: Problem, of: Fit, horizon: float) -> Array:
    here = fit(problem, of.point, horizon, of.own_tau, iterations=0)
    k = Coordinates(problem, of.point).shared
    cross = here.H[:k, k:]
    return np.asarray(here.H[:k, :k] - cross @ np.linalg.pinv(here.H[k:, k:], hermitian=True) @ cross.T)


def unlike(d: Array, J: Array, H: Array, repeats: float) -> float:
    """Return the part of the squared distance ``d'd`` that the numbers behind ``J``, known to ``H``, cannot make up for."""
    c = J.T @ d
    return repeats * float(d @ d - c @ np.linalg.lstsq(J.T @ J + H / repeats, c, rcond=1e-12)[0])
