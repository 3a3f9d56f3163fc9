"""The oracle: whoever knows what was hidden, and refits it, leaves so much error on the holdout and no less.

The true structure (its own functional forms) is refitted with the plant's constants by one Gauss-Newton step from the truth,
which is where a least-squares search would end up; the constants are held by the uncertainty the owner states.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from afdsvc.lti.statespace import Array
from afdsvc.trial.effect import Effect, Truth
from afdsvc.trial.generate import BlindTrial
from afdsvc.trial.laws import scalar as c
from afdsvc.trial.simulation import RunPlan, RunSignals, play_run, replay

Data = list[tuple[RunPlan, RunSignals]]
STEP = 1e-3  # relative step of the finite differences


@dataclass(frozen=True, slots=True)
class Oracle:
    """Mean squares of the simulation error on the holdout over the noise variance, summed over the outputs.

    ``before`` with the nominal model, ``after`` with the true structure refitted; the noise alone gives ``floor``.
    ``objective``: ``commands`` (simulated from the measured inputs) or ``loop`` (simulated in closed loop).
    """

    before: float
    after: float
    floor: float
    objective: str

    @property
    def gain(self) -> float:
        """Share of the nominal model's error that goes away."""
        return 1.0 - self.after / self.before


def oracle(trial: BlindTrial) -> Oracle:
    """Return the oracle's figures for a trial."""
    held = trial.runs[-1], trial.played[-1]
    fitted = refit(trial, trial.truth)
    before = _squares(trial, Truth(trial.machine.nominal), *held)
    floor = float(np.square(held[0].noise[held[0].skip :] / trial.machine.sigma).mean(axis=0).sum())
    return Oracle(before, _squares(trial, fitted, *held), floor, _objective(trial))


def refit(trial: BlindTrial, start: Truth) -> Truth:
    """Return the structure of ``start`` without dirt (and without steps in the reading, which no simulation predicts), its
    parameters and the plant's constants fitted to the recordings by one Gauss-Newton step."""
    start = Truth(start.theta, tuple(e for e in start.effects if e.code // 10 != c.READING))
    return gauss_newton(trial, start, list(zip(trial.runs[:-1], trial.played[:-1], strict=True)))


def gauss_newton(trial: BlindTrial, start: Truth, data: Data, damping: float = 1.0) -> Truth:
    """Return the structure one (damped) Gauss-Newton step nearer to the data, constants held by their uncertainty."""
    residual = residuals(trial, start, data)
    columns = []
    for i in range(_parameters(trial, start).size):
        columns.append((residual - residuals(trial, _moved(trial, start, i), data)) / STEP)
    return _at(trial, start, damping * _solve(trial, start, np.column_stack(columns), residual))


def residuals(trial: BlindTrial, truth: Truth, data: Data) -> Array:
    """Return the simulation errors of the recorded parts in units of the noise, as one column."""
    return np.concatenate([_residual(trial, truth, *pair) for pair in data])


def prior(trial: BlindTrial, truth: Truth) -> float:
    """Return the square of the constants' distance from nominal in stated standard deviations."""
    sd, nominal = trial.machine.theta_sd, trial.machine.nominal
    return float(np.sum(((truth.theta - nominal)[sd > 0] / (nominal * sd)[sd > 0]) ** 2))


def _objective(trial: BlindTrial) -> str:
    return "commands" if trial.machine.stable else "loop"


def simulated(trial: BlindTrial, truth: Truth, run: RunPlan, signals: RunSignals) -> Array:
    """Return the noise-free simulated outputs of a whole run, from its measured commands or in closed loop."""
    if _objective(trial) == "commands":
        return replay(trial.machine, truth, run.quiet(), signals.u).y
    return play_run(replace(trial.machine, reach=np.inf), truth, run.quiet()).y


def _residual(trial: BlindTrial, truth: Truth, run: RunPlan, signals: RunSignals) -> Array:
    """Return the recorded part of the simulation error in units of the noise, as one column."""
    error = (signals.y - simulated(trial, truth, run, signals))[run.skip :]
    return np.ravel(error / trial.machine.sigma)


def _squares(trial: BlindTrial, truth: Truth, run: RunPlan, signals: RunSignals) -> float:
    return float(np.square(_residual(trial, truth, run, signals)).sum() / (run.alpha.shape[0] - run.skip))


def _parameters(trial: BlindTrial, truth: Truth) -> Array:
    """Return the values that are refitted: uncertain constants, then the free parameters of every effect."""
    free = [effect.values[i] for effect in truth.effects for i in effect.free]
    changed = [effect.values[0] for effect in truth.effects if effect.code == c.CONSTANT]
    return np.array([*truth.theta[trial.machine.theta_sd > 0], *free, *changed])


def _moved(trial: BlindTrial, truth: Truth, i: int) -> Truth:
    """Return the structure with parameter i moved by the relative step."""
    shift = np.zeros(_parameters(trial, truth).size)
    shift[i] = STEP
    return _at(trial, truth, shift)


def _at(trial: BlindTrial, truth: Truth, shift: Array) -> Truth:
    """Return the structure with every refitted value changed by these relative shifts."""
    uncertain = np.flatnonzero(trial.machine.theta_sd > 0)
    theta = truth.theta.copy()
    theta[uncertain] *= 1.0 + shift[: uncertain.size]
    rest = list(shift[uncertain.size :])
    effects = [_shifted(e, e.free, [rest.pop(0) for _ in e.free]) for e in truth.effects]
    effects = [_shifted(e, (0,), [rest.pop(0)]) if e.code == c.CONSTANT else e for e in effects]
    return Truth(theta, tuple(effects))


def _shifted(effect: Effect, which: tuple[int, ...], shifts: list[float]) -> Effect:
    values = effect.values.copy()
    for i, shift in zip(which, shifts, strict=True):
        values[i] *= 1.0 + shift
    return effect.with_values(values)


def _solve(trial: BlindTrial, start: Truth, jacobian: Array, residual: Array) -> Array:
    """Return the relative shifts: least squares with the owner's uncertainty of the constants as a ridge."""
    uncertain = trial.machine.theta_sd > 0
    sd, nominal, now = trial.machine.theta_sd[uncertain], trial.machine.nominal[uncertain], start.theta[uncertain]
    scale = now / (nominal * sd)  # a relative shift of 1 in units of the stated standard deviation
    prior = np.zeros((scale.size, jacobian.shape[1]))
    prior[:, : scale.size] = np.diag(scale)
    left = np.vstack([jacobian, prior])
    right = np.concatenate([residual, (nominal - now) / (nominal * sd)])
    shifts, *_ = np.linalg.lstsq(left, right, rcond=1e-10)
    return np.asarray(shifts)
