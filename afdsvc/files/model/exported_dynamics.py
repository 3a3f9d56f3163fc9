"""A plant, matrices or Python code, with laws at its inputs, forces and outputs as a Python simulator; needs numpy, nothing else.

The text below this line is copied into the file beside an improved MODEL.toml, so that the file runs anywhere.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np


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


def code(folder: Path, reference: str) -> Any:
    """Return the object ``file.py:name``, relative to the folder, or ``package.module:name``."""
    place, _, name = reference.rpartition(":")
    if not place.endswith(".py"):
        return getattr(importlib.import_module(place), name)
    spec = importlib.util.spec_from_file_location("nominal", folder / place)
    if spec is None or spec.loader is None:
        raise ImportError(f"{folder / place} is no Python file")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return getattr(module, name)


@dataclass
class Dynamics:
    """``A, B, C, D`` (continuous, or sampled every ``plant_dt``) and the laws.

    ``nominal`` is Python code with ``f`` and ``h`` that is simulated instead, the matrices then being its linear part. ``aux``
    holds the mean of every auxiliary signal; ``p["aux_NAME"]``, where given, is its value at the moment. ``dt`` is the sample
    time of the recordings, ``substeps`` the steps per sample, ``held`` what one such step makes of state, input and force, and
    half a step of state and input.
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
    held: tuple[np.ndarray, ...] = ()
    nominal: Any = None

    @property
    def linear(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]:
        """The plant without its laws, for whoever needs a linear model: A, B, C, D and its sample time (0: continuous)."""
        return self.A, self.B, self.C, self.D, self.plant_dt

    def _rate(self, t: float, x: np.ndarray, u: np.ndarray, p: Mapping[str, float]) -> np.ndarray:
        """Return the rates of change of the states without laws (the next states of sampled code)."""
        return np.asarray(self.A @ x + self.B @ u if self.nominal is None else self.nominal.f(t, x, u, p), dtype=float).reshape(-1)

    def _output(self, t: float, x: np.ndarray, u: np.ndarray, p: Mapping[str, float]) -> np.ndarray:
        """Return the outputs without laws."""
        return np.asarray(self.C @ x + self.D @ u if self.nominal is None else self.nominal.h(t, x, u, p), dtype=float).reshape(-1)

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
        step = 0.5 * self.dt / self.substeps  # friction rounds its jump so that Runge-Kutta steps of twice this length can follow it
        acting = s.u.copy()
        self._apply("input", s, acting, p, step, none)
        rates = self._rate(t, s.x.copy(), acting, p)
        self._apply("force", s, rates, p, step, none)
        return rates

    def h(self, t: float, x: np.ndarray, u: np.ndarray, p: Mapping[str, float]) -> np.ndarray:
        """Return the outputs."""
        s, none = self._signals(t, x, u, p), [np.zeros(0)] * len(self.laws)
        acting = s.u.copy()
        self._apply("input", s, acting, p, self.dt, none)
        y = self._output(t, s.x.copy(), acting, p)
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
        y = self._output(t, state.copy(), acting, p)
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
        """Advance the plant, forces taken at the predicted middle of the step and held over it."""
        phi, gam, gx, phih, gamh = self.held
        step, push = self.dt / self.substeps, np.zeros(len(state))
        rate = None if self.nominal is None else self._rate(s.t, state.copy(), acting, p)
        if rate is None:
            new: np.ndarray = phi @ state + gam @ acting
            middle = sorted({i for law in self.laws if law.stage == "force" for kind, i in law.reads if kind == "x"})
            s.x[middle] = (phih @ state + gamh @ acting)[middle]
        elif self.plant_dt:
            new = rate
            s.x[:] = (state + new) / 2
        else:
            s.x[:] = state + step / 2 * rate
        self._apply("force", s, push, p, step, memory)
        if rate is None or self.plant_dt:
            return np.asarray(new + gx @ push)
        return self._runge_kutta(s.t, step, state, acting, p, push, rate)

    def _runge_kutta(
        self, t: float, step: float, x: np.ndarray, u: np.ndarray, p: Mapping[str, float], push: np.ndarray, rate: np.ndarray
    ) -> np.ndarray:
        a = rate + push
        b = self._rate(t + step / 2, x + step / 2 * a, u, p) + push
        c = self._rate(t + step / 2, x + step / 2 * b, u, p) + push
        d = self._rate(t + step, x + step * c, u, p) + push
        return np.asarray(x + step / 6 * (a + 2 * b + 2 * c + d))

    def _memories(self, together: np.ndarray) -> list[np.ndarray]:
        ends = np.cumsum([law.memory for law in self.laws])[:-1]
        return [part.copy() for part in np.split(together, ends)]
