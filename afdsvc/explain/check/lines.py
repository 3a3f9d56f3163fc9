"""What every input causes in every output by the model, beside what was measured, at the frequencies where the excitation is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from afdsvc.dataset.excitation import only_noise
from afdsvc.dataset.experiment import Run
from afdsvc.dataset.periods import fold
from afdsvc.explain.search.problem import Problem
from afdsvc.explain.simulate.nominal import Nominal
from afdsvc.lti.statespace import Array

STRONG = 0.02  # size of what an input causes, over the largest at any frequency
MOST = 800
MOVING = 0.1  # share of the variance of what the inputs cause that has to come after what a recording begins with is forgotten
STEP = 1e-3  # relative change of an input
ComplexArray = np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Caused:
    """What the inputs cause by the model, run by run: ``parts (n, p, m)``, and ``measured (n, p)`` less the response to the initial state.

    Where the model follows the recordings, ``measured`` is the sum of the parts.
    """

    parts: tuple[Array, ...]
    measured: tuple[Array, ...]


@dataclass(frozen=True, slots=True, eq=False)
class ExcitedLines:
    """Amplitudes at the excited frequencies of all runs: ``parts (L, p, m)`` and ``Y (L, p)`` complex, angle per sample ``angle (L,)`` rad."""

    parts: ComplexArray
    Y: ComplexArray
    angle: Array


def caused(problem: Problem) -> Caused:
    """Return what a gain of each input changes in the outputs, simulated or, where the plant cannot be, predicted from corrected states.

    Inputs through which a controller feeds nothing but noise cause nothing.
    """
    inputs, base = range(problem.nominal.plant.inputs), _outputs(problem, np.ones(problem.nominal.plant.inputs))
    parts = [[0 * c if only_noise(r, i) else c for r, c in zip(problem.runs, _by_gain(problem, i, base), strict=True)] for i in inputs]
    together = tuple(np.stack(p, axis=2) for p in zip(*parts, strict=True)) if parts else tuple(y[:, :, None][:, :, :0] for y in base)
    rest = [np.nan_to_num(r.Y - y) for r, y in zip(problem.runs, base, strict=True)]
    return Caused(together, tuple(e + c.sum(2) for e, c in zip(rest, together, strict=True)))


def _by_gain(problem: Problem, i: int, base: list[Array]) -> list[Array]:
    gain = np.ones(problem.nominal.plant.inputs)
    gain[i] += STEP
    return [(b - a) / STEP for a, b in zip(base, _outputs(problem, gain), strict=True)]


def _outputs(problem: Problem, gain: Array) -> list[Array]:
    """Return the outputs of every run with inputs, in a loop their external parts, times ``gain (m,)``; 0 where the simulation left."""
    amplified = replace(problem, runs=tuple(r.amplified(gain) for r in problem.runs))
    return [np.nan_to_num(s.y) for s in amplified.simulated(problem.start(), weakest_horizon(problem))]


def weakest_horizon(problem: Problem) -> float:
    """Return the horizon of a simulation, or of the weakest predictor of a plant that cannot be simulated."""
    return 0.0 if problem.regular else min(h for h in problem.settings.horizons if h > 0)


def lines(problem: Problem, response: Caused) -> ExcitedLines:
    """Return the amplitudes of all runs, of the mean of whole periods where the excitation repeats.

    Recordings that last much longer than the plant remembers count from where it has forgotten what they begin with, unless they rest by then.
    """
    forgets = _forgotten(problem)
    pieces = [_of_run(r, c, y, forgets if _moves(c, forgets) else 0) for r, c, y in zip(problem.runs, response.parts, response.measured, strict=True)]
    parts, Y, angle = (np.concatenate(part) for part in zip(*pieces, strict=True))
    return ExcitedLines(parts, Y, angle)


def _moves(parts: Array, first: float) -> bool:
    """Whether what the inputs cause moves on after a sample in the first half of a recording."""
    return 2 * first < len(parts) and bool(parts[int(first) :].var(0).sum() > MOVING * parts.var(0).sum())


def _forgotten(problem: Problem) -> float:
    """Return the samples in which the slowest pole decays to a hundredth; infinite for a plant that cannot be simulated."""
    plant, dt = problem.nominal.plant, problem.runs[0].dt
    slowest = float((np.log(np.abs(plant.poles()) + 1e-300) if plant.discrete else plant.poles().real * dt).max(initial=-np.inf))
    return 1 + np.log(100) / -slowest if problem.regular and slowest < 0 else np.inf


def _of_run(run: Run, parts: Array, measured: Array, first: float) -> tuple[ComplexArray, ComplexArray, Array]:
    flat = parts.reshape(len(run), -1)
    folded = fold(run, flat), fold(run, measured)
    c, y = (x[int(first) :] if f is None else f.mean(0) for x, f in zip((flat, measured), folded, strict=True))
    C, S = (np.fft.rfft(x - x.mean(0), axis=0) * 2 / len(x) for x in (c, y))
    size = (np.abs(C[1 : len(c) // 2]) / np.maximum(np.abs(C[1:]).max(0, initial=0.0), 1e-300)).max(1, initial=0.0)
    rows = np.flatnonzero(size > STRONG) + 1
    if len(rows) > MOST:
        rows = rows[np.linspace(0, len(rows) - 1, MOST).astype(int)]
    return C[rows].reshape(len(rows), *parts.shape[1:]), S[rows], 2 * np.pi * rows / len(c)


def line_response(nominal: Nominal, theta: Array, angle: Array) -> ComplexArray:
    """Return the sampled nominal frequency response ``(L, p, m)``; a line on a pole gets a large finite value."""
    s = nominal.steps(theta)
    plant = nominal.at(theta)
    a, b = np.linalg.matrix_power(s.phi, s.nsub), s.gam
    for _ in range(s.nsub - 1):
        b = s.phi @ b + s.gam
    z = np.exp(1j * angle)
    if not plant.order:
        return np.repeat(plant.D[None].astype(complex), len(z), axis=0)
    return np.asarray(plant.C @ np.linalg.solve(z[:, None, None] * np.eye(len(a)) - a, np.repeat(b[None], len(z), 0)) + plant.D)
