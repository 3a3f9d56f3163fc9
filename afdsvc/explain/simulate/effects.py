"""Effects laid out for the kernel: laws compiled once, signals and memories as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from types import FunctionType
from typing import Any

import numpy as np
from numba import carray, cfunc, njit  # type: ignore[attr-defined]
from numba.core.errors import NumbaError
from numpy.typing import NDArray

from afdsvc.api.physics import Hypothesis, Law, Signal
from afdsvc.errors import BadInput
from afdsvc.explain.simulate import kernel
from afdsvc.explain.simulate.kernel import LAW
from afdsvc.lti.statespace import Array

_STAGE = {"input": kernel.INPUT, "force": kernel.FORCE, "output": kernel.OUTPUT, "parameter": kernel.PARAMETER}
IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class PlacedEffect:
    """A hypothesis with values for its parameters, shape ``(len(parameters),)``.

    ``begun`` is what the unsettled part of the law's memory begins every recording with, one array per recording; empty: zero.
    """

    hypothesis: Hypothesis
    values: Array
    begun: tuple[Array, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Effects as arrays; ``laws`` are addresses of compiled code, ``forced`` states feel forces, ``middle`` states are read by them; ``along`` are the
    signals that forces act along, their kinds (1: input) and the states that they are written to; in the plan these are written beyond the last state."""

    laws: IntArray
    plan: IntArray
    par: Array
    forced: IntArray
    middle: IntArray
    along: IntArray

    def memory(self, begun: Sequence[Array] = ()) -> Array:
        """Return the memory of all effects as a recording begins; ``begun`` is its unsettled part, effect by effect, else zero."""
        cells = np.zeros(int(self.plan[-1, 5]) if len(self.plan) else 0)
        for first, part in zip(self.plan[:, 4], begun, strict=False):
            cells[first : first + len(part)] = part
        return cells


def table(effects: Sequence[PlacedEffect], m: int, n: int, p: int, a: int) -> Table:
    """Return the effects on a machine of ``m`` inputs, ``n`` states, ``p`` outputs and ``a`` auxiliary signals."""
    k = len(effects)
    laws = np.array([compiled(e.hypothesis.law).address for e in effects], dtype=np.int64)
    plan = np.zeros((k, kernel.READS + 2 * kernel.MOST_SIGNALS), np.int64)
    par = np.zeros((k, max([len(e.values) for e in effects], default=0)))
    start, first = 0, kernel.READS + kernel.MOST_SIGNALS
    along: list[tuple[int, bool, int]] = []
    for i, e in enumerate(effects):
        h = e.hypothesis
        plan[i, : kernel.READS] = _stage(h), len(h.reads), len(h.writes), len(e.values), start, start + h.memory
        plan[i, kernel.READS : kernel.READS + len(h.reads)] = [_address(s, m, n, p, a) for s in h.reads]
        plan[i, first : first + len(h.writes)] = [s.index for s in h.writes] if h.along is None else n + len(along)
        along += [] if h.along is None else [(h.along.index, h.along.kind == "u", h.writes[0].index)]
        par[i, : len(e.values)] = e.values
        start += h.memory
    forces = [e.hypothesis for e in effects if _stage(e.hypothesis) == kernel.FORCE]
    forced = np.array([*sorted({s.index for h in forces for s in h.writes if h.along is None}), *range(n, n + len(along))], dtype=np.int64)
    middle = np.unique(np.array([s.index for h in forces for s in h.reads if s.kind == "x"], dtype=np.int64))
    return Table(laws, plan, par, forced, middle, np.array(along, dtype=np.int64).reshape(-1, 3))


def _stage(h: Hypothesis) -> int:
    """Return when the kernel evaluates a law: friction without memory is implicit in the state it acts on, inputs to come are as measured."""
    if ahead := [s for s in h.reads if s.ahead]:
        if h.stage != "input" or any(s.kind != "u" or not 0 < s.ahead <= kernel.AHEAD for s in ahead):
            raise BadInput(f"{h.key}: reads samples to come; expected those of inputs, {kernel.AHEAD} at most, and stage 'input'")
        return kernel.RECORDED
    read = {s.index for s in h.reads if s.kind == "x"}
    rubs = h.stage == "force" and h.family == "friction" and not h.memory and any(s.index in read for s in h.writes)
    return kernel.FRICTION if rubs else _STAGE[h.stage]


def _address(signal: Signal, m: int, n: int, p: int, a: int) -> int:
    start = {"u": 0, "x": m, "y": m + n, "aux": m + n + p, "t": m + n + p + a, "p": m + n + p + a + 1 + kernel.AHEAD * m}[signal.kind]
    if signal.ahead:
        start = m + n + p + a + 1 + (signal.ahead - 1) * m
    return start + signal.index


def _called(p: Any, np_: int, z: Any, nz: int, m: Any, nm: int, dt: float, out: Any, nout: int) -> None:
    """Call a law, a global of this function's copy, on arrays at the addresses given."""
    law(carray(p, np_), carray(z, nz), carray(m, nm), dt, carray(out, nout))  # type: ignore[name-defined]  # noqa: F821


@cache  # its code must outlive every simulation that holds its address
def compiled(law: Law) -> Any:
    """Return the law as a compiled callback; raises `BadInput` with the compiler's first complaint when it cannot be.

    The callback bears the name, file and line of the law: numba keeps it until that file changes.
    """
    own = law.__code__
    code = _called.__code__.replace(co_filename=own.co_filename, co_firstlineno=own.co_firstlineno, co_name=own.co_name, co_qualname=own.co_qualname)
    scope = {"law": njit(error_model="numpy")(law), "carray": carray, "__name__": law.__module__}
    callback = FunctionType(code, scope)
    try:
        return cfunc(LAW, cache=True, error_model="numpy")(callback)
    except NumbaError as error:
        why = str(error).strip().splitlines()[0]
        raise BadInput(f"law '{law.__qualname__}' does not compile: {why}") from error
    except RuntimeError:  # a function without a file has nowhere to keep its compiled form
        return cfunc(LAW, error_model="numpy")(callback)
