"""Physics hypotheses: asked about machines of several kinds; every law compiled, called, and found quiet at rest."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from afdsvc.api.physics import Axis, Hypothesis, Machine, Signal, Size
from afdsvc.explain.simulate.effects import compiled
from afdsvc.lti.statespace import StateSpace

STAGES = ("input", "force", "output", "parameter")


@lru_cache(maxsize=1)
def machines() -> tuple[Machine, ...]:
    """Return examples: a rotor on two axes with all auxiliary signals, a black box, a motor of which only the speed is a state,
    an arm, a magnet, two tanks, a structure in modal coordinates, a damper whose motion is imposed, two masses on a shaft, by their angles and by its twist,
    a coil whose current is a state, a camera that tilts on a column that turns, a mass that nothing holds, and a reactor that is code."""
    return _rotor(), _black_box(), _motor(), _arm(), _magnet(), _tanks(), _structure(), _damper(), _shaft(), _twisted_shaft(), _coil(), _gimbal(), _cart(), _reactor()


def _size(index: int, name: str, unit: str, rms: float, step: float = 0.0) -> Size:
    return Size(index, name, unit, 0.1 * rms, rms, 3 * rms, step)


def _rotor() -> Machine:
    motion = [("x", "um", 2.0), ("vx", "um/s", 900.0), ("y", "um", 2.0), ("vy", "um/s", 900.0)]
    around = [("speed", "rad/s", 115.0), ("angle", "rad", 3.0), ("pressure", "bar", 0.2), ("temperature", "K", 2.0)]
    states = tuple(_size(i, *row) for i, row in enumerate(motion))
    axes = tuple(Axis(n, states[2 * i], states[2 * i + 1], 4e5, i, 2e4, "V") for i, n in enumerate(("x", "y")))
    aux = {row[0]: _size(i, *row) for i, row in enumerate(around)}
    A = np.array([[0, 1, 0, 0], [-4e5, -300, 0, 0], [0, 0, 0, 1], [0, 0, -4e5, -300.0]])
    B = np.array([[0, 0], [2e4, 0], [0, 0], [0, 2e4]])
    C = np.array([[1, 0, 0, 0], [0, 0, 1, 0.0]])
    plant = StateSpace(A, B, C, np.zeros((2, 2)))
    inputs = tuple(_size(i, n, "V", 1.0) for i, n in enumerate(("horizontal", "vertical")))
    outputs = tuple(_size(i, n, "um", 2.0, 0.01) for i, n in enumerate(("horizontal", "vertical")))
    return Machine(inputs, outputs, states, axes, aux, 2e-4, 10.0, 3000.0, plant, np.array([0.3, 0.3]), (115.0, 314.0), (640.0,))


def _black_box() -> Machine:
    a, b, c, d = (np.array([[v]]) for v in (-3.0, 2.0, 1.0, 0.0))
    plant = StateSpace(a, b, c, d, 0.0)
    port = (_size(0, "u", "V", 1.0),)
    return Machine(port, (_size(0, "y", "V", 0.5),), (_size(0, "s", "", 0.5),), (), {}, 1e-3, 10.0, 200.0, plant, np.array([0.05]))


def _plain(
    inputs: Sequence[tuple[str, str, float]], states: Sequence[tuple[str, str, float]], outputs: Sequence[tuple[str, str, float]],
    matrices: Sequence[Any], axes: Sequence[tuple[int | None, int]], step: float,
) -> Machine:
    """Return a machine of ports and states (name, unit, rms), and axes by the numbers of their position and velocity."""
    u, x, y = (tuple(_size(i, *row) for i, row in enumerate(rows)) for rows in (inputs, states, outputs))
    A, B, C, D = (np.array(matrix, dtype=float) for matrix in matrices)
    plant = StateSpace(A, B, C, D)
    motions = tuple(
        Axis(x[v].name, None if q is None else x[q], x[v], float(abs(B[v, 0])) * u[0].rms, 0, float(B[v, 0]), u[0].unit)
        for q, v in axes
    )
    return Machine(u, y, x, motions, {}, step, 1e4 * step, 0.3 / step, plant, np.array([0.1 * size.rms for size in y]))


def _motor() -> Machine:
    shaft = [("w", "rad/s", 20.0)]
    return _plain([("voltage", "V", 5.0)], shaft, shaft, ([[-8.0]], [[40.0]], [[1.0]], [[0.0]]), [(None, 0)], 1e-2)


def _arm() -> Machine:
    motion = [("q", "rad", 0.4), ("w", "rad/s", 3.0)]
    return _plain([("torque", "N*m", 0.5)], motion, motion[:1], ([[0, 1], [-60, -1.5]], [[0], [50]], [[1, 0]], [[0]]), [(0, 1)], 5e-3)


def _magnet() -> Machine:
    motion = [("q", "mm", 0.1), ("v", "mm/s", 8.0)]
    return _plain([("current", "A", 0.4)], motion, motion[:1], ([[0, 1], [5e3, -10]], [[0], [2e3]], [[1, 0]], [[0]]), [(0, 1)], 1e-3)


def _tanks() -> Machine:
    levels = [("h1", "m", 0.3), ("h2", "m", 0.3)]
    return _plain([("pump", "V", 2.0)], levels, levels[1:], ([[-0.02, 0], [0.013, -0.006]], [[0.003], [0]], [[0, 1]], [[0]]), [], 4.0)


def _structure() -> Machine:
    motion = [("q1", "m", 1e-4), ("v1", "m/s", 2e-3), ("q2", "m", 5e-5), ("v2", "m/s", 2e-3), ("q3", "m", 2e-5), ("v3", "m/s", 2e-3)]
    A = np.zeros((6, 6))
    for k, w in enumerate((20.0, 45.0, 90.0)):
        A[2 * k, 2 * k + 1], A[2 * k + 1, 2 * k], A[2 * k + 1, 2 * k + 1] = 1.0, -w * w, -0.02 * w
    matrices = (A, [[0], [1], [0], [1], [0], [1]], [[1, 0, 1, 0, -1, 0]], [[0]])
    return _plain([("shaker", "N", 1.0)], motion, [("motion", "m", 1e-4)], matrices, [(0, 1), (2, 3), (4, 5)], 2e-3)


def _damper() -> Machine:
    force = [("force", "N", 300.0)]
    damper = _plain([("speed", "m/s", 0.2)], force, force, ([[-50.0]], [[7e4]], [[1.0]], [[0.0]]), [], 5e-3)
    return replace(damper, waves={Signal("u", 0): (40.0,)})


def _shaft() -> Machine:
    motion = [("q1", "rad", 40.0), ("w1", "rad/s", 9.0), ("q2", "rad", 40.0), ("w2", "rad/s", 8.0)]
    matrices = ([[0, 1, 0, 0], [-900, -2, 900, 0], [0, 0, 0, 1], [300, 0, -300, -1]], [[0], [50], [0], [0]], [[0, 1, 0, 0], [0, 0, 0, 1]], [[0], [0]])
    machine = _plain([("torque", "N*m", 1.0)], motion, [("motor", "rad/s", 9.0), ("load", "rad/s", 8.0)], matrices, [(0, 1), (2, 3)], 2e-3)
    return replace(machine, deflections={(0, 2): _size(0, "q1 - q2", "rad", 0.05)})


def _twisted_shaft() -> Machine:
    motion = [("w1", "rad/s", 9.0), ("w2", "rad/s", 8.0), ("twist", "rad", 0.05)]
    matrices = ([[-2, 0, -900], [0, -1, 300], [1, -1, 0]], [[50], [0], [0]], [[1, 0, 0], [0, 1, 0]], [[0], [0]])
    return _plain([("torque", "N*m", 1.0)], motion, [("motor", "rad/s", 9.0), ("load", "rad/s", 8.0)], matrices, [(None, 0), (None, 1)], 2e-3)


def _coil() -> Machine:
    motion = [("i", "A", 1.0), ("q", "mm", 2.0), ("v", "mm/s", 500.0)]
    matrices = ([[-1500, 0, -1.4], [0, 0, 1], [4e5, -1.6e5, -90]], [[250], [0], [0]], [[0, 1, 0]], [[0]])
    machine = _plain([("voltage", "V", 8.0)], motion, motion[1:2], matrices, [(1, 2)], 2.5e-4)
    (axis,) = machine.axes
    return replace(machine, axes=(Axis("v", axis.position, axis.rate, 4e5),), waves={Signal("x", 1): (3.1,), Signal("y", 0): (3.1, 0.8)})


def _gimbal() -> Machine:
    motion = [("tilt", "deg", 10.0), ("tilt_rate", "deg/s", 40.0), ("turn_rate", "deg/s", 60.0)]
    matrices = ([[0, 1, 0], [-16, -1.5, 0], [0, 0, -1.7]], [[0, 0], [570, 0], [0, 490]], [[0, 1, 0], [0, 0, 1]], np.zeros((2, 2)))
    machine = _plain([("tilt_current", "A", 0.4), ("turn_current", "A", 0.5)], motion, motion[1:], matrices, [(0, 1), (None, 2)], 1e-2)
    tilt, turn = machine.axes
    return replace(machine, axes=(tilt, replace(turn, push=245.0, input=1, gain=490.0)))


def _cart() -> Machine:
    motion = [("q", "m", 0.4), ("v", "m/s", 0.7)]
    return _plain([("force", "N", 3.0)], motion, motion[:1], ([[0, 1], [0, 0]], [[0], [0.5]], [[1, 0]], [[0]]), [(0, 1)], 1e-2)


def _reactor() -> Machine:
    stores = [("concentration", "mol/L", 0.1), ("temperature", "K", 5.0)]
    matrices = ([[-0.03, -6e-4], [1.0, -0.01]], [[0], [0.03]], np.eye(2), np.zeros((2, 1)))
    numbers = (Size(0, "volume", "L", 100.0, 1.0, 100.0, reverses=False), Size(2, "rate", "1/s", 0.02, 1e-3, 0.02, reverses=False))
    return replace(_plain([("jacket", "K", 4.0)], stores, stores, matrices, [], 4.0), code=True, parameters=numbers)


def _offered(thing: Any) -> Iterator[Hypothesis]:
    for machine in machines():
        yield from thing.hypotheses(machine)


def makes_sense_somewhere(thing: Any) -> None:
    """Offers a hypothesis for one of the example machines, and every one under another key."""
    assert list(_offered(thing)), "no hypothesis for any of the example machines"
    for machine in machines():
        keys = [h.key for h in thing.hypotheses(machine)]
        assert len(set(keys)) == len(keys), f"two hypotheses have the same key: {sorted(keys)}"


def tells_what_it_predicts(thing: Any) -> None:
    """Says what it predicts that others do not, and what would refute it; parameters have names and a start within their range."""
    for h in _offered(thing):
        assert h.predicts, f"{h.key}: 'predicts' is empty"
        assert h.refuted_by, f"{h.key}: 'refuted_by' is empty"
        assert h.stage in STAGES, f"{h.key}: stage '{h.stage}'; expected one of {', '.join(STAGES)}"
        assert h.starts, f"{h.key}: there is no start"
        names, free = [p.name for p in h.parameters], [p.name for p in h.parameters if p.free]
        assert len(set(free)) == len(free), f"{h.key}: two of the parameters that are fitted share a name: {free}"
        for start in h.starts:
            assert len(start) == len(names), f"{h.key}: a start has {len(start)} values for {len(names)} parameters"
            for value, p in zip(start, h.parameters, strict=True):
                assert p.low <= value <= p.high, f"{h.key}: {p.name} starts at {value}, outside {p.low} to {p.high}"


def laws_compile_and_stay_finite(thing: Any) -> None:
    """Every law compiles, and stays finite for a thousand samples of ordinary signals at every start."""
    rng = np.random.default_rng(0)
    for h in _offered(thing):
        law = h.law
        compiled(law)
        for start in h.starts:
            values, memory = np.array(start, dtype=float), np.zeros(max(h.memory, 1))
            for z in rng.standard_normal((200, max(len(h.reads), 1))):
                out = np.zeros(max(len(h.writes), 1))
                law(values, z, memory, 1e-4, out)
                assert np.isfinite([*out, *memory]).all(), f"{h.key}: not finite at {start}, {z}"


def laws_stand_alone(thing: Any) -> None:
    """Every law can be copied into a file of its own: it uses nothing of its module but ``math``."""
    for h in _offered(thing):
        code = h.law.__code__
        foreign = {*code.co_freevars, *(n for n in code.co_names if n in h.law.__globals__ and n != "math")}
        assert not foreign, f"{h.key}: the law uses {', '.join(sorted(foreign))} from outside itself"


CHECKS = (makes_sense_somewhere, tells_what_it_predicts, laws_compile_and_stay_finite, laws_stand_alone)
