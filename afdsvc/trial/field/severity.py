"""How severe hidden laws are: the share of the held-out simulation error that is theirs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from afdsvc.errors import Refused
from afdsvc.lti.statespace import Array
from afdsvc.trial.effects.effect import Effect, Truth
from afdsvc.trial.field.rig import Rig
from afdsvc.trial.field.simulation import OPEN, Run, modelled, play

TOLERANCE = 0.01  # of the share
GRID = np.arange(-4.5, 7.0, 1.25)  # log severities tried from small to large
LARGEST, LEAST_MOTION = 1.1, 0.25  # error over variation; variation over that with nothing hidden
LEAST_SHARE = 0.1  # of each of several laws alone
ADDED, CANCELLED = 0.3, 1.5  # share of the effects' power in the error; power of one of several over that of all
LEAST, LEAST_LOOP, USABLE = 0.06, 0.02, 0.45  # error over variation: least with all hidden (in closed loop), largest with nothing


@dataclass(frozen=True, slots=True, eq=False)
class Measure:
    """What shares are measured by on one recording of a machine with the constants ``bare.theta``.

    ``calm`` are the outputs with nothing hidden, without noise. ``weights`` are one over the variance of each of them times their
    number; ``rest`` is the weighted mean square that the nominal model misses with nothing hidden: noise, drift, disturbances,
    errors of the constants.
    """

    rig: Rig
    bare: Truth
    run: Run
    calm: Array
    weights: Array
    rest: float

    def power(self, effects: Sequence[Effect]) -> float:
        """Return the weighted mean square of what the effects add to the outputs, without noise, under the same commands (in
        closed loop where that is how models are simulated)."""
        quiet = self.run.quiet()
        played = play(self.rig, Truth(self.bare.theta, tuple(effects)), quiet)
        same = self.rig.loop or self.run.mode == OPEN  # the model answers the same whatever is hidden
        without = self.calm if same else modelled(self.rig, Truth(self.bare.theta), quiet, played)
        added = (played.y - without)[self.run.skip :]
        return float((np.square(added).mean(axis=0) * self.weights).sum())

    def share(self, effects: Sequence[Effect]) -> float:
        """Return the share of the effects in the sum of their power and of what is missed without them."""
        power = self.power(effects) if effects else 0.0
        return power / (power + self.rest)


def measure(rig: Rig, bare: Truth, run: Run) -> Measure:
    """Return what shares are measured by on a recording with nothing hidden."""
    calm = play(rig, Truth(bare.theta), run.quiet()).y
    weights = np.asarray(1.0 / (calm[run.skip :].var(axis=0) * calm.shape[1]))
    return Measure(rig, bare, run, calm, weights, missed(rig, bare, run, weights))


def missed(rig: Rig, truth: Truth, run: Run, weights: Array) -> float:
    """Return the weighted mean square of what the nominal model misses in a recording of ``truth``, summed over the outputs."""
    played = play(rig, truth, run)
    error = (played.y - modelled(rig, Truth(rig.nominal), run, played))[run.skip :]
    return float((np.square(error).mean(axis=0) * weights).sum())


def scaled(by: Measure, effects: Sequence[Effect], wanted: float) -> tuple[Effect, ...]:
    """Return the effects at one common factor of severity that gives this share; raises `Refused` when none does."""

    def at(log: float) -> tuple[Effect, ...]:
        return tuple(e.scaled(e.severity * float(np.exp(log))) for e in effects)

    def gap(log: float) -> float:
        try:
            return by.share(at(log)) - wanted
        except Refused:
            return float("nan")

    found = _crossing(gap)
    if found is None:
        raise Refused(f"{by.rig.family}: no severity of {_sites(effects)} gives a share of {wanted:.2f}")
    return at(found)


def _crossing(gap: Callable[[float], float]) -> float | None:
    """Return the smallest log severity at which a function becomes positive, within the tolerance; None when nowhere.

    Where it is not a number the machine ran away: at small severities (a lag too short to be integrated) that is passed over.
    """
    low = -np.inf
    for log in map(float, GRID):
        value = gap(log)
        if low == -np.inf and (value > 0 or np.isnan(value)):
            continue
        if not value <= 0:
            return _bisected(gap, low, log)
        low = log
    return None


def _bisected(gap: Callable[[float], float], low: float, high: float) -> float | None:
    for _ in range(30):
        middle = 0.5 * (low + high)
        value = gap(middle)
        if abs(value) < TOLERANCE:
            return middle
        low, high = (middle, high) if value < 0 else (low, middle)
    return None


def check(by: Measure, effects: Sequence[Effect]) -> None:
    """Raise `Refused` when the machine hardly moves any more, the model's error is larger than what it describes, errors of the
    constants make up for the effects, or one of several effects is not to be seen or made up for by the others."""
    truth = by.bare.with_effects(*effects)
    y = play(by.rig, truth, by.run).y[by.run.skip :]
    motion, error = float((y.var(axis=0) * by.weights).sum()), missed(by.rig, truth, by.run, by.weights)
    power, alone = by.power(effects), [by.power([e]) for e in effects]
    if motion < LEAST_MOTION**2 or error > LARGEST**2 * max(motion, 1.0):
        raise Refused(f"{by.rig.family}: {_sites(effects)} leaves nothing of the motion")
    if error < by.rest + ADDED * power:
        raise Refused(f"{by.rig.family}: errors of the constants make up for {_sites(effects)}")
    if len(effects) > 1 and not (min(alone) > LEAST_SHARE * (min(alone) + by.rest) and max(alone) < CANCELLED * power):
        raise Refused(f"{by.rig.family}: one of {_sites(effects)} hides behind the others")


def _sites(effects: Sequence[Effect]) -> str:
    return ", ".join(e.site for e in effects)


def usable(rig: Rig, constants: Array, run: Run, wanted: float) -> Measure:
    """Return the measure for these constants, their errors halved until the nominal model describes the machine with nothing hidden.

    Raises `Refused` when noise alone makes it useless, or when it describes the machine better than models of real ones do.
    """
    least = (1.0 - wanted) * (LEAST_LOOP if rig.loop else LEAST) ** 2
    for _ in range(8):
        try:
            found = measure(rig, Truth(constants), run)
            if found.rest < least:
                break
            if found.rest < USABLE ** 2:
                return found
        except Refused:
            pass
        constants = rig.nominal + 0.5 * (constants - rig.nominal)
    raise Refused(f"{rig.family}: the nominal model is useless, or perfect")
