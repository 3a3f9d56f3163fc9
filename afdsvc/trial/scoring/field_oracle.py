"""The oracle of a field trial: who knows the hidden laws and refits them leaves so much error on the holdout and no less."""

from __future__ import annotations

import numpy as np

from afdsvc.errors import Refused
from afdsvc.lti.statespace import Array
from afdsvc.trial.effects.effect import Effect, Truth
from afdsvc.trial.field.generate import STATED, FieldTrial
from afdsvc.trial.field.run import Run, Signals, modelled
from afdsvc.trial.scoring.oracle import STEP, Oracle

LONGEST = 2  # recordings the laws are refitted to: with more the oracle gains next to nothing
Data = list[tuple[Run, Signals]]


def field_oracle(trial: FieldTrial) -> Oracle:
    """Return the errors on the holdout, relative to each output's variance and averaged over the outputs.

    ``before`` with the nominal model, ``after`` with the true laws and one Gauss-Newton step of their parameters and the
    machine's constants from the truth (or the truth itself, where the step is worse), ``floor`` with the truth.
    """
    truth = Truth(trial.truth.theta, trial.truth.effects)
    before, floor = _missed(trial, Truth(trial.rig.nominal)), _missed(trial, truth)
    try:
        after = min(floor, _missed(trial, _refitted(trial, truth)))
    except Refused:
        after = floor
    return Oracle(before, after, floor, "loop" if trial.rig.loop else "commands")


def _missed(trial: FieldTrial, truth: Truth) -> float:
    run, played = trial.runs[-1], trial.played[-1]
    y = played.y[run.skip :]
    error = y - modelled(trial.rig, truth, run, played)[run.skip :]
    return float((np.square(error).mean(axis=0) / y.var(axis=0)).mean())


def _refitted(trial: FieldTrial, truth: Truth) -> Truth:
    """Return the truth one Gauss-Newton step nearer to the recordings, constants held by what the owner states."""
    data = list(zip(trial.runs[:-1], trial.played[:-1], strict=True))[:LONGEST]
    residual = _residual(trial, truth, data)
    count, sd = _free(trial, truth), float(np.sqrt(np.square(residual).mean()))
    columns = [(residual - _residual(trial, _moved(trial, truth, STEP * row), data)) / STEP for row in np.eye(count)]
    held = np.flatnonzero(trial.rig.loose > 0)
    known = np.maximum(trial.rig.loose[held] * (trial.conditions.stated or STATED), 1e-3)
    now, nominal = truth.theta[held], trial.rig.nominal[held]
    prior, pull = np.zeros((held.size, count)), (nominal - now) / (np.abs(nominal) * known)
    prior[:, : held.size] = np.diag(now / (nominal * known) * np.sign(nominal))
    left = np.vstack([np.column_stack(columns) / sd, prior])
    shift, *_ = np.linalg.lstsq(left, np.concatenate([residual / sd, pull]), rcond=1e-10)
    return _moved(trial, truth, shift)


def _residual(trial: FieldTrial, truth: Truth, data: Data) -> Array:
    """Return the simulation errors over the rms of each output, as one column."""
    parts = []
    for run, played in data:
        y = played.y[run.skip :]
        parts.append(np.ravel((y - modelled(trial.rig, truth, run, played)[run.skip :]) / y.std(axis=0)))
    return np.concatenate(parts)


def _free(trial: FieldTrial, truth: Truth) -> int:
    return int((trial.rig.loose > 0).sum()) + sum(len(e.free) for e in truth.effects)


def _moved(trial: FieldTrial, truth: Truth, shift: Array) -> Truth:
    """Return the truth with every free value changed by these relative shifts: constants, then the laws' parameters."""
    held = np.flatnonzero(trial.rig.loose > 0)
    theta, rest = truth.theta.copy(), list(shift[held.size :])
    theta[held] *= 1.0 + shift[: held.size]
    return Truth(theta, tuple(_shifted(e, [rest.pop(0) for _ in e.free]) for e in truth.effects))


def _shifted(effect: Effect, shifts: list[float]) -> Effect:
    values = effect.values.copy()
    for i, shift in zip(effect.free, shifts, strict=True):
        values[i] *= 1.0 + shift
    return effect.with_values(values)
