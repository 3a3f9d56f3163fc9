"""The next experiment: which burst tells look-alikes apart, by playing each fitted rival and comparing what would be seen.

The difference counts after the other rival has been refitted within what the recordings so far allow: only what it cannot
imitate with its own parameters separates the two. Of all bursts that suffice the mildest is chosen, otherwise the best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from afdsvc.api.bursts import Burst, Limits
from afdsvc.explain.baseline import Baseline
from afdsvc.explain.next_experiment_plans import Plan, plans, present
from afdsvc.explain.next_experiment_separation import Rehearsal, rehearsal
from afdsvc.explain.objective import Point

ENOUGH = 6.0  # standard deviations between rivals that settle the matter
MOST = 3


@dataclass(frozen=True, slots=True)
class Contender:
    """A rival: its name, and the point of the search with its effect fitted (the last of the point's effects)."""

    name: str
    point: Point


@dataclass(frozen=True, slots=True, eq=False)
class NextExperiment:
    """What to play next, as a sentence and as a ``burst`` to be added to alpha (or the input where no controller is known).

    ``separation`` is the distance of the closest two rivals in standard deviations, ``repeated`` what playing the same as before
    would give; ``level`` multiplies the present amplitude, ``speed`` [rad/s] is that of the rotor (None: no rotor).
    """

    sentence: str
    burst: Burst
    separation: float
    repeated: float
    level: float
    band_hz: tuple[float, float]
    speed: float | None = None

    def json(self) -> dict[str, object]:
        """Return it as plain values; the lines of the burst as input, frequency, amplitude and phase."""
        b = self.burst
        lines = [[line.input, line.omega / (2 * np.pi), line.amplitude, line.phase] for line in b.lines]
        return {
            "sentence": self.sentence, "separation_sd": self.separation, "repeated_sd": self.repeated, "level": self.level,
            "band_hz": list(self.band_hz), "speed_rad_s": self.speed,
            "burst": {
                "name": b.name, "inputs": b.inputs, "samples": b.samples, "ramp": b.ramp, "settle": b.settle, "purpose": b.purpose,
                "notes": dict(b.notes), "lines_input_hz_amplitude_rad": lines,
            },
        }


def next_experiment(
    base: Baseline, contenders: Sequence[Contender], limits: Limits | None = None, generator: np.random.Generator | None = None
) -> NextExperiment | None:
    """Return the burst that tells the first contender from the others; None when the machine cannot be rehearsed.

    ``limits`` are the machine's (default: outputs twice as large as recorded). ``generator`` draws detection lines and phases.
    That needs a known controller or a stable plant, and at least two contenders.
    """
    if len(contenders) < 2:
        return None
    rivals = list(contenders[:MOST])
    ready = rehearsal(base, [c.point for c in rivals])
    if ready is None:
        return None
    tried = plans(base, limits, generator or np.random.default_rng(1))
    now = present(tried)
    chosen = _mildest(ready, tried, limits)
    if chosen is None:
        return None
    best, plan = chosen
    repeated = ready.separation(now)
    return NextExperiment(
        _sentence(base, rivals, plan, now, best, repeated), plan.burst, best, repeated, plan.level, plan.band, plan.speed
    )


def _mildest(ready: Rehearsal, tried: Sequence[Plan], limits: Limits | None) -> tuple[float, Plan] | None:
    """Return the mildest allowed plan that separates enough and by how much, else the best allowed one, else None.

    Plans are rehearsed from the mildest on, so that the demanding ones cost nothing where a mild one will do.
    """
    values: list[tuple[float, Plan]] = []
    for _, group in groupby(sorted(tried, key=lambda p: p.effort), key=lambda p: p.effort):
        fresh = [(ready.separation(p), p) for p in group]
        enough = sorted((v for v in fresh if v[0] >= ENOUGH), key=lambda v: -v[0])
        found = next((v for v in enough if ready.allowed(v[1], limits)), None)
        if found is not None:
            return found
        values += [v for v in fresh if v[0] < ENOUGH]
    return next((v for v in sorted(values, key=lambda v: -v[0]) if ready.allowed(v[1], limits)), None)


def _sentence(
    base: Baseline, rivals: Sequence[Contender], plan: Plan, now: Plan, separation: float, repeated: float
) -> str:
    names = base.nominal.model.inputs
    where = " and ".join(names[i].name for i in plan.inputs)
    unit = names[plan.inputs[0]].unit
    level = "the present level" if plan.level == 1 else f"{plan.level:g} times the present level"
    speed = "" if plan.speed is None else f", at {plan.speed:.4g} rad/s" + ("" if plan.speed == now.speed else f" (now {now.speed:.4g})")
    verdict = "" if separation >= ENOUGH else "; even that may not settle it"
    return (
        f"to tell {rivals[0].name} from {', '.join(c.name for c in rivals[1:])}: an odd multisine on input {where} from {plan.band[0]:.4g} to "
        f"{plan.band[1]:.4g} Hz (now to {now.band[1]:.4g} Hz) at {level}, peak {plan.peak:.4g} {unit}{speed}; they would differ by {separation:.2g} standard "
        f"deviations, against {repeated:.2g} if the present experiment were repeated{verdict}"
    )

