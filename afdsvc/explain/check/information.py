"""Which uncertain numbers of the model these data determine: Fisher information of the recordings against the stated uncertainty;
and which hypotheses no fit to these recordings can separate."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from afdsvc.api.model import Model
from afdsvc.dataset.excitation import input_source
from afdsvc.dataset.experiment import Run
from afdsvc.dataset.periods import aperiodic_part, speeds
from afdsvc.dataset.sample_checks import CheckFinding
from afdsvc.dataset.split import still
from afdsvc.dataset.units import is_velocity
from afdsvc.explain.check.lines import Caused, weakest_horizon
from afdsvc.explain.search.fit import Coordinates, jacobian
from afdsvc.explain.search.machine import bandwidth
from afdsvc.explain.search.problem import Problem
from afdsvc.explain.simulate.nominal import Entry, Nominal, entry_name
from afdsvc.lti.statespace import Array

DETERMINED = 0.5  # posterior over prior standard deviation below which the data determine a number
STEP = 1e-3
VISIBLE = 0.3  # rms of what the excitation causes in the outputs, over the noise, below which nothing can be named


def information(problem: Problem, response: Caused) -> Iterator[CheckFinding]:
    """Yield which entries the data determine, and a stop when the excitation determines nothing; nothing for a machine without inputs or at rest."""
    nominal = problem.nominal
    if not any(r.U.any() for r in problem.runs):  # it moves by itself, or not at all
        return
    sd = noise_sd(nominal, problem.runs)
    if np.isinf(sd).all():  # dead sensors, which are findings of their own
        return
    visible, posterior = visibility(response, sd), posterior_sd(problem, sd)
    known = [e for e, s in zip(nominal.entries, posterior, strict=True) if s < DETERMINED]
    blind = [e for e, s in zip(nominal.entries, posterior, strict=True) if s > 0.9]
    if visible < VISIBLE or (nominal.entries and not known and visible < 1.0):
        yield CheckFinding(
            "stop", "excitation",
            f"the excitation moves the outputs by {visible:.2g} of their noise and determines none of the model's numbers better than "
            "stated, so no effect can be named; an odd multisine on every input over the machine's band that moves the outputs by ten times "
            "their noise, at two levels and four periods or more, would do",
        )
        return
    if nominal.entries:
        listed = "" if known else "; an excitation that is larger, longer or broader would fix more"
        listed += f"; there is almost no information about {_names(nominal, blind)}" if blind else ""
        yield CheckFinding(
            "ok" if known else "warning", "information",
            f"the recordings fix {len(known)} of {len(nominal.entries)} uncertain numbers of the model: their uncertainty falls below half of what the model states{listed}",
        )


def noise_sd(nominal: Nominal, runs: Sequence[Run]) -> Array:
    """Return the noise per output ``(p,)``: what does not repeat, else as stated, else the sample-to-sample roughness.

    It is infinite for a reading that never moves: it holds no information.
    """
    pieces = aperiodic_part(runs, [r.Y for r in runs])
    if pieces:
        sd = np.vstack(pieces).std(0)
    elif nominal.model.output_sd is not None:
        sd = np.array(nominal.model.output_sd, dtype=np.float64)
    else:
        sd = np.sqrt(np.mean([np.nanmean(np.diff(r.Y, 4, axis=0) ** 2, axis=0) / 70 for r in runs], axis=0))
    return np.where(still(np.concatenate([r.Y for r in runs])), np.inf, np.maximum(sd, 1e-300))


def visibility(response: Caused, sd: Array) -> float:
    """Return the rms of what the inputs cause in the outputs, over the noise, in the best output."""
    return float((np.std(np.vstack([c.sum(2) for c in response.parts]), axis=0) / sd).max())


def posterior_sd(problem: Problem, sd: Array) -> Array:
    """Return the standard deviation of every uncertain number after the data, in units of that before; ``sd (p,)`` is that of the noise.

    By the Jacobian of the search, offsets of the sensors being free.
    """
    point, horizon, k = problem.start(), weakest_horizon(problem), len(problem.nominal.entries)
    c = Coordinates(problem, point)
    residuals = problem.residuals(point, horizon)
    J = jacobian(problem, c, c.pack(point), horizon, residuals)[:, :k]
    slopes = J.reshape(len(J) // len(sd), len(sd), k)
    rows = ((slopes - slopes.mean(0)) * (problem.scale / sd)[:, None]).reshape(len(J), k)
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(rows.T @ rows + np.eye(k)))))


def _names(nominal: Nominal, entries: Sequence[Entry]) -> str:
    listed = ", ".join(entry_name(nominal, e) for e in entries[:6])
    return listed + (f" and {len(entries) - 6} more" if len(entries) > 6 else "")


SHORT = 0.12  # phase [rad] by which one sample of delay differs from one of lag, third order; see `_timing`
ROTATING = ("speed", "angle")


def ambiguities(model: Model, runs: Sequence[Run]) -> Iterator[CheckFinding]:
    """Yield what cannot be separated."""
    yield from _motion(model)
    yield from _levels(model, runs)
    yield from _timing(runs)
    yield from _rotation(runs)
    yield from _still(runs)


def _motion(model: Model) -> Iterator[CheckFinding]:
    unstated = ", ".join(v.name for v in model.outputs if not v.unit)
    if unstated and not any(v.rate_of or is_velocity(v.unit) for v in model.states):
        yield CheckFinding(
            "warning", "motion",
            f"no unit is stated of {unstated}, and no state is known as a velocity: friction and other forces of motion are not tried; "
            "if this is a speed, state its unit (rpm, m/s); if it is a position, state which state is its rate (rate_of)",
        )


def _levels(model: Model, runs: Sequence[Run]) -> Iterator[CheckFinding]:
    drives = [p for i in range(len(model.inputs)) if any((p := input_source(runs, i)).rms)]
    if drives and max(p.levels for p in drives) < 2 and all(p.periods > 1 for p in drives):
        yield CheckFinding(
            "warning", "ambiguity",
            "all recordings excite the machine at one level: clearance and cubic stiffness, friction and a dead zone may fit alike; "
            "a second level, half or twice as high, would separate them",
        )


def _timing(runs: Sequence[Run]) -> Iterator[CheckFinding]:
    """A lag of one sample and a delay of one differ in phase by (omega dt)^3 / 3 and in gain by (omega dt)^2 / 2."""
    turn = bandwidth(runs) * runs[0].dt
    if turn**2 / 2 < SHORT:
        yield CheckFinding(
            "warning", "ambiguity",
            f"the excitation ends at {bandwidth(runs) / (2 * np.pi):.4g} Hz: a delay and a lag of a sample ({1e3 * runs[0].dt:.3g} ms) fit "
            f"alike below {np.sqrt(2 * SHORT) / (2 * np.pi * runs[0].dt):.4g} Hz; higher lines would separate them",
        )


def _rotation(runs: Sequence[Run]) -> Iterator[CheckFinding]:
    names = runs[0].aux
    if "speed" in names and "angle" not in names:
        yield CheckFinding("warning", "ambiguity", "the rotor's speed is recorded but not its angle: unbalance and runout can only be seen as tones")
    turning = speeds(runs)
    if turning and max(turning) < 1.05 * min(turning):
        yield CheckFinding(
            "warning", "ambiguity",
            "all recordings are at one rotor speed: unbalance, which grows with the speed squared, and runout, which does not, may fit "
            "alike; a second speed would separate them",
        )


def _still(runs: Sequence[Run]) -> Iterator[CheckFinding]:
    for k, name in enumerate(runs[0].aux):
        values = np.concatenate([r.AUX[:, k] for r in runs])
        if name not in ROTATING and np.ptp(values) <= 1e-6 * max(float(np.abs(values).max()), 1e-300):
            yield CheckFinding("warning", "ambiguity", f"aux_{name} does not change: no effect that depends on it can be found")
