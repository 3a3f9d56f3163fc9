"""Running the nominal model with effects over a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from afdsvc.dataset.experiment import Run, sampled
from afdsvc.errors import BadInput
from afdsvc.explain.simulate import kernel
from afdsvc.explain.simulate.effects import PlacedEffect, Table, table
from afdsvc.explain.simulate.nominal import PYTHON_SUBSTEPS, Nominal
from afdsvc.explain.simulate.predictor import driven
from afdsvc.explain.simulate.steps import Steps, contiguous, ways
from afdsvc.lti.statespace import Array, StateSpace

NOWHERE = np.zeros((0, 2))
HELD = 1e-4  # error of an input held over a sub-step, over its rms


@dataclass(frozen=True, slots=True, eq=False)
class Simulated:
    """What a simulation gives: outputs ``y (n, p)``, inputs before effects ``u (n, m)``, states ``x (n, order)``."""

    y: Array
    u: Array
    x: Array


@dataclass(frozen=True, slots=True, eq=False)
class Simulator:
    """A nominal model and the predictor gain ``Kp (n, p)`` its states are corrected with (zero: pure simulation).

    ``ramped`` takes measured inputs to run smoothly between samples, as those of an analogue source do, instead of held. ``substeps`` of
    a sample are taken at least. ``tables`` keeps effects as arrays: they are the same for every recording.
    """

    nominal: Nominal
    gain: Array
    ramped: bool = False
    substeps: int = 1
    tables: dict[tuple[PlacedEffect, ...], Table] = field(default_factory=dict, init=False, repr=False)

    @property
    def notes(self) -> tuple[str, ...]:
        """What a person should know about this simulation: code that could not be compiled."""
        return self.nominal.program.notes if self.nominal.program else ()

    def run(
        self, run: Run, theta: Array, x0: Array, effects: Sequence[PlacedEffect] = (), closed: bool = False, free: bool = False,
        begun: Sequence[Array] = (), outputs_only: bool = False,
    ) -> Simulated:
        """Simulate one recording from the state ``x0``, and effects from the memory ``begun``, one array per effect.

        ``closed`` feeds the simulated output back through the model's controller; ``free`` leaves out the correction of
        the states, for a simulation from the measured input alone. A simulation that diverges is nan from there on.
        With ``outputs_only`` inputs and states are not kept, which takes less time.
        """
        least = max([self.substeps, _fineness(run.U) if self.ramped and self.nominal.python else 1, *(e.hypothesis.substeps for e in effects)])
        theta = np.asarray(theta, dtype=np.float64)
        steps = self.nominal.steps(theta, least, kernel.DEGREE if self.ramped and not closed and not self.nominal.python else 0)
        rows = 0 if outputs_only and not self.nominal.program else len(run)
        simulated = self._play(run, theta, steps, x0, effects, closed, free, begun, rows)
        finer = self._needed(simulated, theta, steps.nsub)
        if finer > steps.nsub:
            simulated = self._play(run, theta, self.nominal.steps(theta, finer), x0, effects, closed, free, begun, rows)
        return simulated

    def _play(
        self, run: Run, theta: Array, steps: Steps, x0: Array, effects: Sequence[PlacedEffect], closed: bool, free: bool,
        begun: Sequence[Array], rows: int,
    ) -> Simulated:
        key = tuple(effects)
        if key not in self.tables:
            self.tables[key] = table(effects, run.U.shape[1], self.nominal.plant.order, run.Y.shape[1], run.AUX.shape[1])
        placed = self.tables[key]
        memory = placed.memory(begun)
        if run.steady and len(memory) and len(run) > run.period:  # effects remember what drove the machine before the recording
            self._record(run.span(0, run.period), theta, steps, x0, placed, memory, closed, free, 0)
        return self._record(run, theta, steps, x0, placed, memory, closed, free, rows)

    def _record(
        self, run: Run, theta: Array, steps: Steps, x0: Array, placed: Table, memory: Array, closed: bool, free: bool, rows: int
    ) -> Simulated:
        """Simulate one recording, effects beginning with ``memory`` and leaving there what they remember at its end; inputs and states are
        kept for ``rows`` samples, all or none."""
        plant = self.nominal.plant if self.nominal.python else self.nominal.at(theta)
        n, p, m = len(run), plant.outputs, plant.inputs
        K, U = self._loop(run, closed)
        y, u, x = np.empty((n, p)), np.empty((rows, m)), np.empty((rows, plant.order))
        gx, along = self._along(plant, steps, placed) if len(placed.along) else (steps.gx, NOWHERE)
        gain = np.zeros_like(self.gain) if free or closed else self.gain
        kernel.simulate_compiled(
            closed, self.ramped and not closed, self._direct(plant), steps.nsub, run.dt, run.begins,
            steps.phi, steps.gam, gx, steps.phih, steps.gamh, contiguous(plant.C), contiguous(plant.D), self.nominal.felt, contiguous(gain),
            placed.forced, placed.middle, *self._code(theta), *K, U, run.Y, run.REF, run.AUX,
            np.array(x0, dtype=np.float64), placed.laws, placed.plan, placed.par, memory, along, y, u, x,
        )
        return Simulated(y, u, x)

    def _along(self, plant: StateSpace, steps: Steps, placed: Table) -> tuple[Array, Array]:
        """Return ``gx`` with a column more for every force along a signal, and these signals with their gains."""
        directions, gains = ways(plant, driven(self.nominal.model, plant.order), placed.along)
        return contiguous(np.hstack([steps.gx, steps.gx @ directions])), np.column_stack([placed.along[:, 0], gains])

    def _direct(self, plant: StateSpace) -> bool:
        """Whether the inputs reach the outputs at once."""
        return self.nominal.program.direct if self.nominal.program else bool(plant.D.any())

    def _code(self, theta: Array) -> tuple[int, int, int, Array]:
        """Return the kind of plant, the addresses of its functions, and its parameter values."""
        code = self.nominal.program
        if code is None:
            return kernel.LINEAR, 0, 0, np.zeros(0)
        kind = kernel.DISCRETE if self.nominal.plant.discrete else kernel.CONTINUOUS
        return kind, code.rate_address, code.output_address, self.nominal.parameters(theta)

    def _needed(self, simulated: Simulated, theta: Array, nsub: int) -> int:
        """Return the sub-steps that Python code needs where it has been: its poles may be faster there than at the start."""
        code = self.nominal.program
        if code is None or self.nominal.plant.discrete:
            return nsub
        if not np.isfinite(simulated.y).all():
            return min(8 * nsub, PYTHON_SUBSTEPS)
        where = [*simulated.x.argmin(0), *simulated.x.argmax(0), len(simulated.x) // 2]
        slopes = np.empty((len(where), self.nominal.plant.order, self.nominal.plant.order))
        kernel.slopes(code.rate_address, simulated.x[where], simulated.u[where], self.nominal.parameters(theta), slopes)
        sizes = np.abs(slopes)
        fastest = min(float(sizes.sum(1).max(initial=0.0)), float(sizes.sum(2).max(initial=0.0)))  # a norm is no less than any pole
        if self.nominal.substeps(fastest, np.inf) <= 2 * nsub:
            return nsub
        fastest = float(np.abs(np.linalg.eigvals(slopes)).max(initial=0.0))
        needed = self.nominal.substeps(fastest, fastest / max(float(np.abs(self.nominal.at(theta).poles()).max(initial=0.0)), 1e-300))
        return needed if needed > 2 * nsub else nsub

    def _loop(self, run: Run, closed: bool) -> tuple[tuple[Array, Array, Array, Array], Array]:
        m, p = run.U.shape[1], run.Y.shape[1]
        if not closed:
            return (np.zeros((0, 0)), np.zeros((0, p)), np.zeros((m, 0)), np.zeros((m, p))), run.U
        K = controller_of(self.nominal, run.dt)
        if K is None or run.W is None:
            raise BadInput(f"{run.name}: the controller or what was added to its output is unknown; the loop cannot be closed")
        return (contiguous(K.A), contiguous(K.B), contiguous(K.C), contiguous(K.D)), run.W


def _fineness(U: Array) -> int:
    """Return the sub-steps, 4 at most, in which Python code may hold an input that runs smoothly at the middle of each.

    Holding it over ``h`` where it curves by ``u''`` is wrong by ``h^2 u'' / 24``.
    """
    size = float(np.sqrt(np.mean((U - U.mean(0)) ** 2)))
    curved = float(np.sqrt(np.mean(np.diff(U, 2, axis=0) ** 2))) if len(U) > 2 else np.inf
    return int(np.clip(np.ceil(np.sqrt(curved / (24 * HELD * size))), 1, 4)) if size > 0 and np.isfinite(curved) else 4


def controller_of(nominal: Nominal, dt: float) -> StateSpace | None:
    """Return the model's controller at the sample time, if there is one."""
    return None if nominal.model.controller is None else sampled(nominal.model.controller, dt)
