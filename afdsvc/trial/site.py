"""What a kind of physics may know when it is made up at a site: the machine, sizes of its signals, and chance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from afdsvc.lti.statespace import Array
from afdsvc.trial.effect import Effect, Truth
from afdsvc.trial.machine import MachineAxis, TrialMachine
from afdsvc.trial.simulation import RunPlan, play_run


@dataclass(frozen=True, slots=True, eq=False)
class SignalSizes:
    """Root mean squares with nothing hidden: commands u, positions q, velocities v and accelerations ``push`` per axis (the
    largest of the terms that cause them), outputs y; means and standard deviations of the auxiliary signals."""

    u: Array
    q: Array
    v: Array
    push: Array
    y: Array
    aux_mean: Array
    aux_sd: Array


def signal_sizes(machine: TrialMachine, truth: Truth, runs: tuple[RunPlan, ...]) -> SignalSizes:
    """Return the sizes over the recorded parts of some runs of the plant with nothing hidden."""
    bare = Truth(truth.theta)
    parts = [play_run(machine, bare, run).kept(run) for run in runs]
    u, y, x = (np.vstack([getattr(part, name) for part in parts]) for name in "uyx")
    aux = np.vstack([run.aux[run.skip :] for run in runs])
    position, velocity = [a.position for a in machine.axes], [a.velocity for a in machine.axes]
    A, B, _ = machine.matrices(bare.constants())
    terms = np.hstack([np.abs(A[velocity]) * column_rms(x), np.abs(B[velocity]) * column_rms(u)])
    return SignalSizes(column_rms(u), column_rms(x[:, position]), column_rms(x[:, velocity]), terms.max(axis=1), column_rms(y), aux.mean(0), aux.std(0))


def column_rms(x: Array) -> Array:
    """Return the root mean square of every column."""
    return np.asarray(np.sqrt(np.mean(np.square(x), axis=0)))


@dataclass(frozen=True, slots=True, eq=False)
class EffectSite:
    """One place of one machine: number ``i`` of the input, axis or output, its name, and a generator for shapes."""

    machine: TrialMachine
    sizes: SignalSizes
    name: str
    i: int
    generator: np.random.Generator

    @property
    def axis(self) -> MachineAxis:
        """The axis of number i."""
        return self.machine.axes[self.i]

    @property
    def along(self) -> tuple[int, int]:
        """Position and velocity of the axis."""
        return self.axis.position, self.axis.velocity

    @property
    def unit(self) -> str:
        """Unit of the input or output of number i, whichever the site names."""
        variables = self.machine.inputs if self.name.startswith("input:") else self.machine.outputs
        return variables[self.i].unit

    @property
    def length(self) -> str:
        """Unit of the axis' position."""
        return self.machine.states[self.axis.position].unit

    @property
    def rate(self) -> str:
        """Unit of the axis' velocity."""
        return self.machine.states[self.axis.velocity].unit

    @property
    def force(self) -> str:
        """Unit of the axis' acceleration (forces are per unit of mass)."""
        return self.length + "/s^2"

    @property
    def travel(self) -> float:
        """Root mean square of the axis' position."""
        return float(self.sizes.q[self.i])

    @property
    def speed(self) -> float:
        """Root mean square of the axis' velocity."""
        return float(self.sizes.v[self.i])

    @property
    def push(self) -> float:
        """Root mean square of the largest term of the axis' acceleration."""
        return float(self.sizes.push[self.i])

    @property
    def means(self) -> tuple[float, float, float]:
        """Travel, speed and push in the mean over all axes."""
        return float(self.sizes.q.mean()), float(self.sizes.v.mean()), float(self.sizes.push.mean())

    @property
    def turning(self) -> float:
        """Mean speed of the rotor [rad/s]."""
        return float(self.sizes.aux_mean[self.aux("speed")])

    @property
    def both(self) -> tuple[int, int, int, int]:
        """Position and velocity of the first axis and of the second (-1 where there is none)."""
        first = self.machine.axes[0]
        second = self.machine.axes[1] if len(self.machine.axes) > 1 else MachineAxis(-1, -1, -1, -1)
        return first.position, first.velocity, second.position, second.velocity

    def aux(self, name: str) -> int:
        """Return the number of an auxiliary signal."""
        return self.machine.aux.index(name)

    def draw(self, low: float, high: float) -> float:
        """Return a number between two."""
        return float(self.generator.uniform(low, high))

    def phase(self) -> float:
        """Return an angle."""
        return self.draw(0.0, 2 * np.pi)

    def sign(self) -> float:
        """Return 1 or -1."""
        return float(self.generator.choice([-1.0, 1.0]))

    def effect(self, physics: str, code: int, at: tuple[int, ...], *values: Any, **more: Any) -> Effect:
        """Return an effect here; every value is ``(name, unit, value, power of the severity)``."""
        names, units, base, powers = zip(*values, strict=True)
        return Effect(physics, self.name, code, at, base, powers, names, units, **more)

    def on_input(self, physics: str, code: int, *values: Any, extra: tuple[int, ...] = (), **more: Any) -> Effect:
        """Return an effect on the command of input i."""
        return self.effect(physics, code, (self.i, *extra), *values, **more)

    def on_axis(self, physics: str, code: int, *values: Any, **more: Any) -> Effect:
        """Return a force on axis i."""
        return self.effect(physics, code, self.along, *values, **more)

    def on_output(self, physics: str, code: int, *values: Any, extra: tuple[int, ...] = (), **more: Any) -> Effect:
        """Return an effect on the sensor of output i."""
        return self.effect(physics, code, (self.i, *extra), *values, **more)
