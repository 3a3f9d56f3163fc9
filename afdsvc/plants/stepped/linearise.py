"""The linear part of a stepped simulator, estimated from small perturbations.

The free run is taken off everything. Where states can be looked at, ``x+ = A x + B u`` is solved for them by least squares from the
answer to random pushes of all inputs (the simulator has no noise; where it is not linear, this is its best linear approximation for
pushes of that size). Where not, every input gets a pulse of one step, and the responses are realised: B. L. Ho and R. E. Kalman, "Effective
construction of linear state-variable models from input/output functions", Regelungstechnik 14 (1966) 545-548. Random pushes that
took no part then say how far the simulator is linear.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from afdsvc.api.model import Model, SteppedPlant
from afdsvc.api.signals import Trace
from afdsvc.errors import BadInput
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import Array, StateSpace

MOST_STATES = 30
SMALLEST = 1e-7  # singular value, over the largest, that is taken for rounding
WORST = 0.5  # share of the answer to a random push that a linear part may miss
STILL = 1e-6  # of the answer's size: what counts as rest
_ROWS = 600  # of the Hankel matrix


@dataclass(frozen=True, slots=True, eq=False)
class LinearPart:
    """What was found: the plant (sampled every ``plant.dt``, D = 0), outputs at rest ``rest (p,)``, and how well it holds.

    ``missed`` is the share of the answer to a random push of this size that it misses, ``bent`` the change of a pulse response,
    over itself, when the push is doubled, ``drift`` how far the outputs move by themselves over the answer's size.
    """

    plant: StateSpace
    rest: Array
    missed: float
    bent: float
    drift: float


def linear_part(
    unit: SteppedPlant, push: Array, dt: float, samples: int, rng: np.random.Generator, order: int | None = None, name: str = ""
) -> LinearPart:
    """Return the linear part of a simulator around its start, for pushes of the sizes ``push (m,)`` over so many samples.

    Raises `BadInput` naming the simulator when nothing answers, or when no linear part answers for half of what it does.
    """
    m = len(push)
    still = _run(unit, np.zeros((samples, m)), dt)
    pulses = [_pulse(unit, i, push, dt, samples, still) for i in range(m)]
    size = max(float(np.abs(y).max()) for y, _ in pulses)
    if not size > 0:
        raise BadInput(f"simulator {name} answers to no input pushed by {push.tolist()}; expected larger pushes or other inputs")
    fit, judge = (rng.choice([-1.0, 1.0], size=(samples, m)) * push for _ in range(2))
    if still[1].shape[1]:
        y, x = _run(unit, fit, dt)
        plant = _solved(fit, x - still[1], y - still[0], dt)
    else:
        plant = _realised([y for y, _ in pulses], push, dt, order)
    missed = _missed(plant, judge, _run(unit, judge, dt)[0] - still[0], name)
    double, _ = _pulse(unit, 0, 2 * push, dt, samples, still)
    bent = _share(double / 2 - pulses[0][0], pulses[0][0])
    return LinearPart(plant, still[0][0], missed, bent, float(np.abs(still[0] - still[0][0]).max()) / size)


def _run(unit: SteppedPlant, u: Array, dt: float) -> tuple[Array, Array]:
    """Return outputs and states at the beginning of every step, as a sampled plant has them: ``(n, p)``, ``(n, states)``."""
    y, x = [unit.begin()], [unit.states()]
    for held in u[:-1]:
        y.append(unit.advance(held, dt))
        x.append(unit.states())
    n = len(x[-1])
    return np.array(y), np.array([v if len(v) == n else np.zeros(n) for v in x])


def _pulse(unit: SteppedPlant, i: int, push: Array, dt: float, samples: int, still: tuple[Array, Array]) -> tuple[Array, Array]:
    u = np.zeros((samples, len(push)))
    u[0, i] = push[i]
    y, x = _run(unit, u, dt)
    return y - still[0], x - still[1]


def _solved(u: Array, x: Array, y: Array, dt: float) -> StateSpace:
    """Return A and B from the states that were looked at, and C from the outputs beside them."""
    n, size = x.shape[1], np.maximum(np.abs(x).max(axis=0), 1e-300)
    push = np.abs(u).max(axis=0)
    both = np.linalg.lstsq(np.hstack([x[:-1] / size, u[:-1] / push]), x[1:] / size, rcond=1e-13)[0].T
    A = both[:, :n] * size[:, None] / size
    B = both[:, n:] * size[:, None] / push
    C = np.linalg.lstsq(x / size, y, rcond=1e-13)[0].T / size
    return StateSpace.of(A, B, C, np.zeros((y.shape[1], u.shape[1])), dt)


def _realised(responses: list[Array], push: Array, dt: float, order: int | None) -> StateSpace:
    """Return the balanced realisation of pulse responses ``(samples, p)`` each (what comes at the very sample is 0)."""
    h = np.stack([y / a for y, a in zip(responses, push, strict=True)], axis=2)[1:]  # (k, p, m), h[0] = C B
    p, m = h.shape[1:]
    rows = min((len(h) - 1) // 2, max(_ROWS // max(p, m), 2))
    hankel = np.block([[h[i + j] for j in range(rows)] for i in range(rows)])
    later = np.block([[h[i + j + 1] for j in range(rows)] for i in range(rows)])
    U, s, Vt = np.linalg.svd(hankel)
    n = order or min(int((s > SMALLEST * s[0]).sum()), MOST_STATES)
    root = np.sqrt(s[:n])
    A = (U[:, :n] / root).T @ later @ (Vt[:n].T / root)
    return StateSpace.of(A, root[:, None] * Vt[:n, :m], U[:p, :n] * root, np.zeros((p, m)), dt)


def _missed(plant: StateSpace, u: Array, y: Array, name: str) -> float:
    predicted, _ = simulate(plant, u)
    missed = _share(y - predicted, y)
    if not missed <= WORST:
        raise BadInput(
            f"simulator {name}: a linear part of order {plant.order} misses {100 * min(missed, 99.0):.0f} % of its answer to a random push; "
            "expected other states, a smaller push or more samples (section 'perturbation')"
        )
    return missed


def _share(part: Array, whole: Array) -> float:
    size = float(np.sqrt(np.square(whole).sum()))
    return float(np.sqrt(np.square(part).sum())) / size if size else 0.0


MOST_SAMPLES = 20_000


def linearisation_notes(model: Model, traces: Sequence[Trace]) -> list[str]:
    """Return a sentence per recording on what the simulator behind a model makes of its inputs; [] where there is none.

    Both start from rest; errors are ``|y - yhat| / |y - mean|``, like everywhere. A failure of the simulator is reported, not raised.
    """
    if model.opened is None or model.plant is None:
        return []
    unit = model.opened()
    try:
        return [_sentence(model, unit, trace) for trace in traces]
    finally:
        unit.close()


def _sentence(model: Model, unit: SteppedPlant, trace: Trace) -> str:
    n = min(len(trace), MOST_SAMPLES)
    u = np.column_stack([trace.column(f"u_{v.name}")[:n] for v in model.inputs])
    y = np.column_stack([trace.column(f"y_{v.name}")[:n] for v in model.outputs])
    try:
        real = _simulated(unit, u, trace.dt)
    except BadInput as error:
        return f"{trace.name}: the simulator itself could not follow the recorded inputs: {error}"
    plant = model.plant
    assert plant is not None  # noqa: S101 - looked at by the caller
    sampled = plant if plant.discrete else sample_zoh(plant, trace.dt)
    linear, _ = simulate(sampled, u)
    parts = [
        f"{v.name} {100 * _nrmse(y[:, i], real[:, i]):.3g} % by the simulator itself, {100 * _nrmse(y[:, i], linear[:, i]):.3g} % by its linear part "
        f"(the two differ by {100 * round(_nrmse(real[:, i], linear[:, i]), 9):.2g} %)"
        for i, v in enumerate(model.outputs)
    ]
    return f"{trace.name}, simulated from its inputs and from rest, error over variation: {'; '.join(parts)}"


def _simulated(unit: SteppedPlant, u: Array, dt: float) -> Array:
    rest = unit.begin()
    y = [rest, *(unit.advance(held, dt) for held in u[:-1])]
    return np.array(y) - rest


def _nrmse(measured: Array, simulated: Array) -> float:
    there = np.isfinite(measured)
    variation = float(np.sqrt(np.square(measured[there] - measured[there].mean()).sum()))
    error = float(np.sqrt(np.square(measured[there] - simulated[there]).sum()))
    return error / variation if variation else float(error > 0)
