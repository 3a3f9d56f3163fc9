"""Loop and clock: is the nominal model stable, is the controller known, do sample time and length fit the model's time constants?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from afdsvc.dataset.experiment import Run
from afdsvc.dataset.sample_checks import CheckFinding
from afdsvc.explain.check.comparison import compared
from afdsvc.explain.search.build import build
from afdsvc.explain.search.problem import Problem
from afdsvc.explain.simulate.nominal import Nominal, nominal

MARGIN = 1e-9


def loop(nominal: Nominal, runs: Sequence[Run]) -> Iterator[CheckFinding]:
    """Yield what there is to say on stability and feedback."""
    known = nominal.model.controller is not None and any(r.W is not None for r in runs)
    if not _stable(nominal):
        yield CheckFinding(
            "warning", "stability",
            "the nominal model is not stable by itself (a pole at zero or beyond): where a simulation from the inputs drifts away, it is "
            f"corrected by the measured outputs{', or the controller is closed around it' if known else ''}",
        )
    driven = any(r.commanded or np.ptp(r.REF, axis=0).max(initial=0.0) > 0 for r in runs)
    if known:
        yield CheckFinding("ok", "controller", "the controller is known: the loop can be simulated closed")
    elif nominal.model.controller is not None:
        yield CheckFinding("warning", "controller", "the controller is given, but gaps or its sample time keep the loop from being reconstructed")
    elif driven:
        yield CheckFinding(
            "warning", "controller",
            "the inputs come from a controller that is not stated: the loop cannot be simulated, and what disturbs the outputs is in "
            "the inputs, too; state the controller in the model where it is known",
        )


def _stable(nominal: Nominal) -> bool:
    plant = nominal.plant
    poles = plant.poles()
    if plant.discrete:
        return bool((np.abs(poles) < 1 - MARGIN).all())
    return bool((poles.real < -MARGIN).all())


FOLLOWED = 0.5  # least R2 of every output with the times in another unit, and largest ratio of the unexplained variance there to that as recorded
FAST, SLOW = 2.0, 0.5  # samples per radian of the fastest pole, and recordings per slowest time constant, beyond which it is said
CURE = "if the times are in another unit, say so (column t_ms, or time.unit in a mapping file); otherwise "


def clock(problem: Problem) -> Iterator[CheckFinding]:
    """Yield what the sample time and the length of the recordings say beside the poles of a model in continuous time; a stop where the
    model follows the outputs with the times in another unit."""
    plant, runs = problem.nominal.plant, problem.runs
    rates = np.abs(plant.poles()) if not plant.discrete else np.zeros(0)
    rates = rates[rates > 1e-9 * rates.max(initial=0.0)]
    if not len(rates):
        return
    dt, seconds = runs[0].dt, max(len(r) * r.dt for r in runs)
    if float(rates.max()) * dt > FAST:
        yield from _in_other_unit(problem, 1e-3, "as milliseconds", "expected a column named t_ms, or time.unit = 'ms' in a mapping file")
        yield CheckFinding(
            "warning", "clock",
            f"the recordings are sampled every {dt:.4g} s and the model's fastest time constant is {1 / rates.max():.3g} s: "
            f"{CURE}dynamics faster than the sampling cannot be seen; record at {10 * rates.max() / (2 * np.pi):.3g} Hz or more",
        )
    if float(rates.min()) * seconds < SLOW:
        yield from _in_other_unit(problem, 1e3, "1000 times as long", "expected times in seconds: is a column in seconds named t_ms?")
        yield CheckFinding(
            "warning", "clock",
            f"the longest recording lasts {seconds:.4g} s and the model's slowest time constant is {1 / rates.min():.3g} s: "
            f"{CURE}record for {3 / rates.min():.3g} s or more",
        )


def _in_other_unit(problem: Problem, factor: float, unit: str, cure: str) -> Iterator[CheckFinding]:
    """Yield a stop where the model follows every output with all times multiplied by a factor, and much less as they are."""
    runs = [replace(r, dt=r.dt * factor, t0=r.t0 * factor) for r in problem.runs]
    scaled = build(nominal(problem.nominal.model, runs[0].dt), runs, problem.settings)
    after, before = (min(c.r2 for c in compared(p)) for p in (scaled, problem))
    if after > FOLLOWED and 1 - after < FOLLOWED * (1 - before):
        said = f"with the times taken {unit} the model follows the outputs (R2 {after:.3g}, as they are {before:.3g})"
        yield CheckFinding("stop", "units", f"{said}; {cure}; explain --trust-units (trust_units=True) goes on where they are right")
