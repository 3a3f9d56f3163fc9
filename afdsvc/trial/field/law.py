"""A law that can be hidden in a field trial: where, how it is made up there, and which names for it are right."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from afdsvc.lti.statespace import Array
from afdsvc.trial.effects.effect import Effect
from afdsvc.trial.field.rig import Rig


@dataclass(frozen=True, slots=True, eq=False)
class Sizes:
    """Root mean squares with nothing hidden: commands u, outputs y; positions q, speeds v and driving forces per axis; largest
    position of each axis; states x."""

    u: Array
    y: Array
    q: Array
    v: Array
    push: Array
    x: Array


@dataclass(frozen=True, slots=True, eq=False)
class Spot:
    """One place of one machine: number ``i`` of the command, axis, characteristic, branch or output; a generator for shapes."""

    rig: Rig
    sizes: Sizes
    i: int
    g: np.random.Generator

    @property
    def u(self) -> float:
        """Size of the command."""
        return float(self.sizes.u[self.i])

    @property
    def y(self) -> float:
        """Size of the output."""
        return float(self.sizes.y[self.i])

    @property
    def travel(self) -> float:
        """Size of the axis' position."""
        return float(self.sizes.q[self.i])

    @property
    def speed(self) -> float:
        """Size of the axis' speed."""
        return float(self.sizes.v[self.i])

    @property
    def push(self) -> float:
        """Size of what drives the axis."""
        return float(self.sizes.push[self.i])

    def draw(self, low: float, high: float) -> float:
        """Return a number between two."""
        return float(self.g.uniform(low, high))

    def sign(self) -> float:
        """Return 1 or -1."""
        return float(self.g.choice([-1.0, 1.0]))

    def on_command(self, *args: Any, **more: Any) -> Effect:
        """Return an effect on the command; see `effect`."""
        return self.effect(f"input:{self.rig.inputs[self.i].name}", *args, **more)

    def on_axis(self, *args: Any, **more: Any) -> Effect:
        """Return a force on the axis; see `effect`."""
        return self.effect(self.rig.axes[self.i].site, *args, **more)

    def on_output(self, *args: Any, **more: Any) -> Effect:
        """Return an effect on the sensor; see `effect`."""
        return self.effect(f"output:{self.rig.outputs[self.i].name}", *args, **more)

    def inside(self, *args: Any, **more: Any) -> Effect:
        """Return an effect inside the process; see `effect`."""
        return self.effect("machine", *args, **more)

    def effect(self, site: str, code: int, *values: tuple[str, float, float], free: tuple[int, ...] = (0,), states: int = 0) -> Effect:
        """Return an effect here; every value is ``(name, value, power of the severity)``."""
        names, base, powers = zip(*values, strict=True)
        return Effect("", site, code, (self.i,), base, powers, names, ("",) * len(names), free, states)


@dataclass(frozen=True, slots=True)
class Law:
    """A law under the name the generator gives it.

    ``place``: command, axis, characteristic, branch, sensor, constant. ``accept`` are canonical names that are right (none: the law
    is outside of the vocabulary, so that "unexplained" is right too), ``partial`` those that are defensible, ``words`` parts of further
    names that are right. ``needs`` are features a family must have (`afdsvc.trial.field.catalogue.FEATURES`).
    """

    name: str
    place: str
    make: Callable[[Spot], Effect]
    accept: tuple[str, ...]
    partial: tuple[str, ...]
    words: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()

    @property
    def outside(self) -> bool:
        """Whether no canonical name is right."""
        return not self.accept

    @property
    def label(self) -> str:
        """The first right name, or "outside"."""
        return self.accept[0] if self.accept else "outside"
