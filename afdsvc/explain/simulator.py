"""Running the nominal model with effects over a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from afdsvc.api.physics import Hypothesis, Signal
from afdsvc.dataset.experiment import Run, sampled
from afdsvc.errors import BadInput
from afdsvc.explain import kernel
from afdsvc.explain.compiled import compiled, idle
from afdsvc.explain.nominal import Nominal
from afdsvc.lti.statespace import Array, StateSpace

_STAGE = {"input": kernel.INPUT, "force": kernel.FORCE, "output": kernel.OUTPUT}
IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Effect:
    """A hypothesis with values for its parameters, shape ``(len(parameters),)``.

    ``bend = (c1, c2, reference)`` multiplies the law by ``1 + c1 w + c2 w^2``, ``w`` the size of its first signal over the
    reference: a test of the law's shape.
    """

    hypothesis: Hypothesis
    values: Array
    bend: tuple[float, float, float] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Simulated:
    """What a simulation gives: outputs ``y (n, p)``, inputs before effects ``u (n, m)``, states ``x (n, order)``."""

    y: Array
    u: Array
    x: Array


@dataclass(frozen=True, slots=True, eq=False)
class Simulator:
    """A nominal model and the predictor gain ``Kp (n, p)`` its states are corrected with (zero: pure simulation).

    ``ramped`` takes measured inputs to run smoothly between samples, as those of an analogue source do, instead of held.
    """

    nominal: Nominal
    gain: Array
    ramped: bool = False

    def run(
        self, run: Run, theta: Array, x0: Array, effects: Sequence[Effect] = (), closed: bool = False, free: bool = False
    ) -> Simulated:
        """Simulate one run from the state ``x0``.

        ``closed`` feeds the simulated output back through the model's controller; ``free`` leaves out the correction of
        the states, for a simulation from the measured input alone.
        """
        s = self.nominal.steps(theta, max([4 if self.ramped else 1, *(e.hypothesis.substeps for e in effects)]))
        plant = self.nominal.at(theta)
        n, p, m = len(run), plant.outputs, plant.inputs
        K, U = self._loop(run, closed)
        table = _table(effects, m, plant.order, p, run.AUX.shape[1])
        y, u, x = np.empty((n, p)), np.empty((n, m)), np.empty((n, plant.order))
        gain = np.zeros_like(self.gain) if free or closed else self.gain
        kernel.simulate_linear(  # type: ignore[call-arg]
            closed, self.ramped and not closed, s.nsub, run.dt, run.t0 if run.clock is None else run.clock, s.phi, s.gam, s.gx, s.phih, s.gamh, _c(plant.C), _c(plant.D), _c(gain),
            table.forced, table.middle, *K, U, run.Y, run.REF, run.AUX, np.array(x0, dtype=np.float64), *table.arguments(), y, u, x,
        )
        return Simulated(y, u, x)

    def _loop(self, run: Run, closed: bool) -> tuple[tuple[Array, Array, Array, Array], Array]:
        m, p = run.U.shape[1], run.Y.shape[1]
        if not closed:
            return (np.zeros((0, 0)), np.zeros((0, p)), np.zeros((m, 0)), np.zeros((m, p))), run.U
        K = controller_of(self.nominal, run.dt)
        if K is None or run.W is None:
            raise BadInput(f"{run.name}: the controller or what was added to its output is unknown; the loop cannot be closed")
        return (_c(K.A), _c(K.B), _c(K.C), _c(K.D)), run.W


def controller_of(nominal: Nominal, dt: float) -> StateSpace | None:
    """Return the model's controller at the sample time, if there is one."""
    return None if nominal.model.controller is None else sampled(nominal.model.controller, dt)


@dataclass(frozen=True, slots=True, eq=False)
class _Table:
    """Effects laid out for the kernel; ``forced`` states feel forces, ``middle`` states are read by them."""

    laws: tuple[object, ...]
    plan: IntArray
    par: Array
    forced: IntArray
    middle: IntArray

    def arguments(self) -> tuple[object, ...]:
        memory = np.zeros(int(self.plan[-1, 5]) if len(self.plan) else 0)
        return (*self.laws, self.plan, self.par, memory)


def _table(effects: Sequence[Effect], m: int, n: int, p: int, a: int) -> _Table:
    k = len(effects)
    if k > kernel.MOST_EFFECTS:
        raise BadInput(f"{k} effects at once; at most {kernel.MOST_EFFECTS} can be simulated")
    laws = [compiled(e.hypothesis.law) for e in effects] + [idle()] * (kernel.MOST_EFFECTS - k)
    plan = np.zeros((k, kernel.READS + 2 * kernel.MOST_SIGNALS), np.int64)
    par = np.zeros((k, max([len(e.values) for e in effects], default=0) + 3))
    start = 0
    for i, e in enumerate(effects):
        h = e.hypothesis
        fixed = _STAGE[h.stage], len(h.reads), len(h.writes), len(e.values), start, start + h.memory, e.bend is not None
        plan[i, : kernel.READS] = fixed
        plan[i, kernel.READS : kernel.READS + len(h.reads)] = [_address(s, m, n, p, a) for s in h.reads]
        first = kernel.READS + kernel.MOST_SIGNALS
        plan[i, first : first + len(h.writes)] = [s.index for s in h.writes]
        par[i, : len(e.values)] = e.values
        par[i, -3:] = e.bend or (0.0, 0.0, 1.0)
        start += h.memory
    forces = [e.hypothesis for e in effects if e.hypothesis.stage == "force"]
    forced = np.unique(np.array([s.index for h in forces for s in h.writes], dtype=np.int64))
    middle = np.unique(np.array([s.index for h in forces for s in h.reads if s.kind == "x"], dtype=np.int64))
    return _Table(tuple(laws), plan, par, forced, middle)


def _address(signal: Signal, m: int, n: int, p: int, a: int) -> int:
    start = {"u": 0, "x": m, "y": m + n, "aux": m + n + p, "t": m + n + p + a}[signal.kind]
    return start + signal.index


def _c(matrix: Array) -> Array:
    return np.ascontiguousarray(matrix)
