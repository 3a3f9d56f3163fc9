"""positioning axis with what its model left out: cubic_stiffness at state:v.

Written by `afdsvc explain`. Parameters come from the MODEL.toml beside this file, by name; matrices are the refitted ones.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.linalg import expm


@dataclass(frozen=True)
class Law:
    """One law: where it acts ("input", "force", "output"), what it reads and writes, its parameters and its memory.

    ``reads`` holds pairs (kind, number) of "u", "x", "y", "aux", "t". ``names`` are keys of ``p``, "" for a constant of the
    law, whose value is in ``values``; ``factors`` turn a value in people's units into the one the law works with.
    """

    stage: str
    function: Callable[[Any, Any, Any, float, Any], None]
    reads: tuple[tuple[str, int], ...]
    writes: tuple[int, ...]
    names: tuple[str, ...]
    values: tuple[float, ...]
    factors: tuple[float, ...]
    memory: int = 0

    def parameters(self, p: Mapping[str, float]) -> np.ndarray:
        """Return the parameters in the law's own units; what ``p`` does not hold is as it was fitted."""
        held = [p.get(name, value) if name else value for name, value in zip(self.names, self.values, strict=True)]
        return np.array(held, dtype=float) * self.factors


@dataclass
class Signals:
    """What the laws see now."""

    u: np.ndarray
    x: np.ndarray
    y: np.ndarray
    aux: np.ndarray
    t: float

    def read(self, law: Law) -> np.ndarray:
        """Return the signals a law reads, in its order."""
        return np.array([self.t if kind == "t" else getattr(self, kind)[i] for kind, i in law.reads], dtype=float)


@dataclass
class Dynamics:
    """``A, B, C, D`` (continuous, or sampled every ``plant_dt``) and the laws.

    ``aux`` holds the mean of every auxiliary signal; ``p["aux_NAME"]``, where given, is its value at the moment.

    ``dt`` is the sample time of the recordings, ``substeps`` the steps per sample.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    laws: Sequence[Law]
    dt: float
    substeps: int = 1
    aux: Mapping[str, float] = field(default_factory=dict)
    plant_dt: float = 0.0

    @property
    def linear(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]:
        """The plant without its laws, for whoever needs a linear model: A, B, C, D and its sample time (0: continuous)."""
        return self.A, self.B, self.C, self.D, self.plant_dt

    def _signals(self, t: float, x: np.ndarray, u: np.ndarray, p: Mapping[str, float]) -> Signals:
        aux = np.array([p.get(f"aux_{name}", mean) for name, mean in self.aux.items()], dtype=float)
        return Signals(np.array(u, dtype=float), np.array(x, dtype=float), np.zeros(len(self.C)), aux, t)

    def _apply(
        self, stage: str, s: Signals, target: np.ndarray, p: Mapping[str, float], step: float, memory: Sequence[np.ndarray]
    ) -> None:
        """Add to the target what every law of the stage contributes; laws at inputs and outputs see the ones before them."""
        for law, own in zip(self.laws, memory, strict=True):
            if law.stage != stage:
                continue
            out = np.zeros(len(law.writes))
            law.function(law.parameters(p), s.read(law), own, step, out)
            for j, change in zip(law.writes, out, strict=True):
                target[j] += change
                if stage != "force":
                    (s.u if stage == "input" else s.y)[j] = target[j]

    def _stages(self) -> set[str]:
        return {law.stage for law in self.laws}


class Continuous(Dynamics):
    """``dx/dt = f(t, x, u, p)``, ``y = h(t, x, u, p)``: for laws without memory, for any integrator."""

    def f(self, t: float, x: np.ndarray, u: np.ndarray, p: Mapping[str, float]) -> np.ndarray:
        """Return the rates of change of the states."""
        s, none = self._signals(t, x, u, p), [np.zeros(0)] * len(self.laws)
        step = self.dt / self.substeps  # some laws round their corners so that this step can follow them
        acting = s.u.copy()
        self._apply("input", s, acting, p, step, none)
        rates: np.ndarray = self.A @ s.x + self.B @ acting
        self._apply("force", s, rates, p, step, none)
        return rates

    def h(self, t: float, x: np.ndarray, u: np.ndarray, p: Mapping[str, float]) -> np.ndarray:
        """Return the outputs."""
        s, none = self._signals(t, x, u, p), [np.zeros(0)] * len(self.laws)
        acting = s.u.copy()
        self._apply("input", s, acting, p, self.dt, none)
        y: np.ndarray = self.C @ s.x + self.D @ acting
        s.y[:] = y
        self._apply("output", s, y, p, self.dt, none)
        return y


class Sampled(Dynamics):
    """``x+ = f(t, x, u, p)``, ``y = h(t, x, u, p)``, one call per sample: for laws that remember.

    The state is the plant's, then the memories of the laws, then the input that acted during the sample before.
    """

    def f(self, t: float, x: np.ndarray, u: np.ndarray, p: Mapping[str, float]) -> np.ndarray:
        """Return the state one sample later."""
        return self._sample(t, x, u, p)[1]

    def h(self, t: float, x: np.ndarray, u: np.ndarray, p: Mapping[str, float]) -> np.ndarray:
        """Return the outputs."""
        return self._sample(t, x, u, p)[0]

    def _sample(self, t: float, x: np.ndarray, u: np.ndarray, p: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        n, m = len(self.A), self.B.shape[1]
        state, memory = np.array(x[:n], dtype=float), self._memories(np.array(x[n : len(x) - m], dtype=float))
        s = self._signals(t, state, u, p)
        command, acting, direct = s.u.copy(), s.u.copy(), bool(self.D.any())
        if direct:  # the input reaches the output at once, so its laws come first
            self._apply("input", s, acting, p, self.dt, memory)
        y = self.C @ state + (self.D @ acting if direct else 0.0)
        s.y[:], s.u[:] = y, x[len(x) - m :]
        self._apply("output", s, y, p, self.dt, memory)
        s.u[:] = acting
        if not direct and self.substeps == 1:
            self._apply("input", s, acting, p, self.dt, memory)
        held = acting.copy()
        s.u[:] = acting
        for _ in range(self.substeps):
            if not direct and self.substeps > 1:
                acting = command.copy()
                s.u[:] = acting
                self._apply("input", s, acting, p, self.dt / self.substeps, memory)
                held = acting.copy()
            state = self._step(s, state, acting, p, memory)
            s.t += self.dt / self.substeps
        return y, np.concatenate([state, *memory, held])

    def _step(
        self, s: Signals, state: np.ndarray, acting: np.ndarray, p: Mapping[str, float], memory: Sequence[np.ndarray]
    ) -> np.ndarray:
        """Advance the plant exactly, forces taken at the predicted middle of the step and held over it."""
        phi, gam, gx, phih, gamh = self._matrices()
        new: np.ndarray = phi @ state + gam @ acting
        if "force" in self._stages():
            middle = sorted({i for law in self.laws if law.stage == "force" for kind, i in law.reads if kind == "x"})
            s.x[middle] = (phih @ state + gamh @ acting)[middle]
            push = np.zeros(len(state))
            self._apply("force", s, push, p, self.dt / self.substeps, memory)
            new += gx @ push
        return new

    def _memories(self, together: np.ndarray) -> list[np.ndarray]:
        ends = np.cumsum([law.memory for law in self.laws])[:-1]
        return [part.copy() for part in np.split(together, ends)]

    def _matrices(self) -> tuple[np.ndarray, ...]:
        if not hasattr(self, "_held"):
            self._held = (*_over(self, self.dt / self.substeps), *_over(self, self.dt / self.substeps / 2)[:2])
        return self._held


def _over(plant: Dynamics, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what a step makes of state, held input and held force; a sampled plant takes its own step as it is."""
    n, m = plant.B.shape
    if plant.plant_dt:
        return plant.A, plant.B, np.eye(n) * plant.plant_dt
    big = np.zeros((2 * n + m, 2 * n + m))
    big[:n] = np.hstack([plant.A, plant.B, np.eye(n)])
    e = expm(big * step)
    return e[:n, :n], e[:n, n : n + m], e[:n, n + m :]


import math


def cubic_stiffness_cubic(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-k3 q^3``."""
    out[0] -= p[0] * z[0] ** 3


A = np.array([[0.0, 1.0], [-10030.26187329272, -80.04011962919273]]).reshape(2, 2)
B = np.array([[0.0], [10009.745094483713]]).reshape(2, 1)
C = np.array([[1.0, 0.0]]).reshape(1, 2)
D = np.array([[0.0]]).reshape(1, 1)
LAWS = (
    Law('force', cubic_stiffness_cubic, (('x', 0),), (1,), ('stiffness of cubic_stiffness at state:v',),
        (0.29584119609226506,), (10009.745094483713,), 0),
)
model = Continuous(A, B, C, D, LAWS, dt=0.002, substeps=1, aux={}, plant_dt=0.0)
