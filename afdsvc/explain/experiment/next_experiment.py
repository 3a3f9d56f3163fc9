"""The next experiment: the excitation that separates look-alikes, or the first one for a machine that was hardly excited."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from afdsvc.api.bursts import Burst
from afdsvc.dataset.experiment import Run, sampled
from afdsvc.dataset.units import with_unit
from afdsvc.explain.check.information import noise_sd
from afdsvc.explain.check.lines import line_response
from afdsvc.explain.experiment.plans import PERIODS, Plan, multisine_plan, plans
from afdsvc.explain.experiment.separation import separation_of
from afdsvc.explain.search.forward import Found
from afdsvc.explain.simulate.nominal import Nominal
from afdsvc.explain.verdict.verdict import Claim
from afdsvc.lti.statespace import Array

DOUBT = 0.02  # weight from which a look-alike has to be separated from the first
ENOUGH = 6.0  # standard deviations between look-alikes that settle the matter
CLEAR = 10.0  # rms of the outputs over the noise that a first experiment should reach
LOW, REACH = 2.0, 3.0  # lower edge [Hz], upper edge over the model's fastest pole


@dataclass(frozen=True, slots=True, eq=False)
class NextExperiment:
    """What to play next, as a sentence and as a burst to be added to alpha (or the input where no controller is known).

    ``separation`` is the distance of the look-alikes in standard deviations, ``repeated`` what the present excitation would give;
    ``level`` multiplies the present amplitude.
    """

    sentence: str
    burst: Burst
    separation: float
    repeated: float
    level: float
    band_hz: tuple[float, float]

    def json(self) -> dict[str, Any]:
        """Return it as plain values; the lines of the burst as input, frequency, amplitude and phase."""
        b = self.burst
        return {
            "sentence": self.sentence, "separation_sd": self.separation, "repeated_sd": self.repeated, "level": self.level,
            "band_hz": list(self.band_hz),
            "burst": {
                "name": b.name, "inputs": b.inputs, "samples": b.samples, "ramp": b.ramp, "settle": b.settle, "purpose": b.purpose,
                "notes": dict(b.notes),
                "lines_input_hz_amplitude_rad": [[x.input, x.omega / (2 * np.pi), x.amplitude, x.phase] for x in b.lines],
            },
        }


def experiment_after(found: Found, claims: Sequence[Claim]) -> NextExperiment | None:
    """Return the mildest multisine that separates the most doubtful pair of look-alikes, else the best one.

    None where no name is in doubt, nothing can be played, or nothing separates the two.
    """
    firsts = {c.effect: c for c in reversed(claims)}
    pairs = [(c, firsts[c.effect]) for c in claims if c is not firsts[c.effect] and c.weight >= DOUBT]
    if not pairs or not found.machine.inputs:
        return None
    rival, first = max(pairs, key=lambda pair: pair[0].weight)
    measure = separation_of(found, first.candidate.fit, rival.candidate.fit)
    tried = plans(found.problem.runs) if measure else []
    if measure is None or not tried:
        return None
    apart = [(measure(p), p) for p in tried]
    best, plan = min((x for x in apart if x[0] >= ENOUGH), key=lambda x: x[1].effort, default=max(apart, key=lambda x: x[0]))
    names = (first.candidate.hypothesis.title, rival.candidate.hypothesis.title)
    return NextExperiment(_sentence(found, names, plan, best, apart[0][0]), plan.burst, best, apart[0][0], plan.level, plan.band) if best else None


def _sentence(found: Found, names: tuple[str, str], plan: Plan, apart: float, repeated: float) -> str:
    ports = found.machine.inputs
    level = "the present level" if plan.level == 1 else f"{plan.level:.2g} times the present level"
    doubt = "" if apart >= ENOUGH else "; even that may not separate them"
    return (
        f"to separate {names[0]} from {names[1]}: an odd multisine on input {' and '.join(x.name for x in ports)} from {plan.band[0]:.4g} to "
        f"{plan.band[1]:.4g} Hz at {level}, peak {with_unit(f'{plan.peak:.4g}', ports[0].unit)}; the two would differ by {apart:.2g} standard deviations, "
        f"against {repeated:.2g} in the present band at the present level{doubt}"
    )


def first_experiment(nominal: Nominal, runs: Sequence[Run]) -> NextExperiment | None:
    """Return a multisine on all inputs that moves the outputs by ten times their noise; None for a machine without inputs."""
    m, dt = nominal.plant.inputs, nominal.dt
    if not m:
        return None
    fastest = float(_pole_sizes(nominal).max(initial=0.2 / dt)) / (2 * np.pi)
    band = (LOW, float(np.clip(REACH * fastest, 40 * LOW, 0.4 / dt)))
    if band[1] < 2 * band[0]:  # a slow machine: two decades below what the sample time allows
        band = (0.004 / dt, 0.4 / dt)
    shape = multisine_plan(band, np.ones(m), dt)
    angles = np.array([line.omega * dt for line in shape.lines])
    gains = np.abs(_from_alpha(nominal, angles)[np.arange(len(angles)), :, [line.input for line in shape.lines]])
    rms = np.sqrt(((gains * np.array([line.amplitude for line in shape.lines])[:, None]) ** 2).sum(0) / 2)
    level = CLEAR / max(float((rms / noise_sd(nominal, runs)).max()), 1e-300)
    burst = replace(shape, name="first_experiment", lines=tuple(replace(x, amplitude=x.amplitude * level) for x in shape.lines))
    names, unit = " and ".join(v.name for v in nominal.model.inputs), nominal.model.inputs[0].unit
    said = (
        f"to excite the machine: an odd multisine with detection lines on input {names} from {band[0]:.4g} to {band[1]:.4g} Hz, peak {with_unit(f'{level:.4g}', unit)}, "
        f"{PERIODS} periods of {burst.samples / PERIODS * dt:g} s, and the same at half the level"
    )
    return NextExperiment(said, burst, 0.0, 0.0, 1.0, band)


def _pole_sizes(nominal: Nominal) -> Array:
    poles = nominal.plant.poles()
    if nominal.plant.discrete:
        poles = np.log(np.where(np.abs(poles) > 1e-6, poles, 1e-6).astype(complex)) / nominal.dt
    return np.asarray(np.abs(poles), dtype=np.float64)


def _from_alpha(nominal: Nominal, angle: Array) -> np.ndarray:
    """Return the response of the outputs to alpha ``(L, p, m)``: G (1 - K G)^-1 with the controller where it is known."""
    G = line_response(nominal, np.zeros(len(nominal.entries)), angle)
    K = None if nominal.model.controller is None else sampled(nominal.model.controller, nominal.dt)
    if K is None:
        return G
    z = np.exp(1j * angle)
    inner = K.D + K.C @ np.linalg.solve(z[:, None, None] * np.eye(K.order) - K.A, np.repeat(K.B[None], len(z), 0)) if K.order else K.D
    return np.asarray(G @ np.linalg.inv(np.eye(G.shape[2]) - inner @ G))
