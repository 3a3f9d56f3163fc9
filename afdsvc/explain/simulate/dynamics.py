"""A Python simulator as the kernel calls it: compiled where numba can, through the interpreter elsewhere."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import carray, cfunc  # type: ignore[attr-defined]
from numba.core.errors import NumbaError

from afdsvc.api.dynamics import Function, array_function
from afdsvc.api.model import Model
from afdsvc.errors import BadInput
from afdsvc.explain.simulate import kernel
from afdsvc.explain.simulate.translate import Untranslatable, translated
from afdsvc.lti.statespace import Array

_CALLBACK = ctypes.CFUNCTYPE(None, ctypes.c_double, *[ctypes.c_void_p] * 4)


@dataclass(frozen=True, slots=True, eq=False)
class Program:
    """The functions f and h of a model by address, and f plain, as ``rate(t, x, u, values) -> (n,)``.

    ``direct``: the outputs depend on the inputs at once. ``notes`` says what could not be compiled and therefore runs in the
    interpreter. ``keep`` holds what the addresses need.
    """

    rate: Function
    rate_address: int
    output_address: int
    direct: bool
    notes: tuple[str, ...]
    keep: tuple[Any, ...]


def program(model: Model) -> Program:
    """Return the functions of a model with ``dynamics``; raises `BadInput` when they fail or return the wrong number of values."""
    sizes = len(model.states), len(model.inputs), len(model.outputs)
    rate = array_function(model, "f", sizes[0])
    output = array_function(model, "h", sizes[2])
    found = [_reachable(model, which, function, size, sizes) for which, function, size in (("f", rate, sizes[0]), ("h", output, sizes[2]))]
    notes = tuple(note for _, note, _ in found if note)
    return Program(rate, found[0][0], found[1][0], _direct(model, output), notes, tuple(kept for _, _, kept in found))


def _direct(model: Model, output: Function) -> bool:
    rng = np.random.default_rng(0)
    x, u = rng.standard_normal(len(model.states)), rng.standard_normal(len(model.inputs))
    values = np.array([q.value for q in model.parameters.values()])
    return not np.array_equal(output(0.0, x, u, values), output(0.0, x, 0.0 * u, values), equal_nan=True)


def _reachable(model: Model, which: str, plain: Function, size: int, sizes: tuple[int, int, int]) -> tuple[int, str, Any]:
    """Return the address of f or h, a note (empty when compiled) and what must be kept alive."""
    names = tuple(model.parameters)
    plain(0.0, np.zeros(sizes[0]), np.zeros(sizes[1]), np.array([q.value for q in model.parameters.values()]))
    try:
        code = _compiled(translated(getattr(model.dynamics, which), names, size), sizes[0], sizes[1], len(names), size)
        _check(code.address, plain, model, size)
        return int(code.address), "", code
    except (Untranslatable, NumbaError, NotImplementedError, TypeError, LookupError, AttributeError, SyntaxError) as error:
        why = (str(error).strip().splitlines() or [type(error).__name__])[0]
        callback = _interpreted(plain, sizes[0], sizes[1], len(names), size)
        address = ctypes.cast(callback, ctypes.c_void_p).value or 0
        return address, f"{which} of model '{model.name}' is not compiled ({why}); the simulation is slow", callback


def _compiled(function: Any, n: int, m: int, k: int, size: int) -> Any:
    @cfunc(kernel.DYNAMICS, error_model="numpy")
    def entry(t, x, u, p, out):  # type: ignore[no-untyped-def]
        function(t, carray(x, n), carray(u, m), carray(p, k), carray(out, size))

    return entry


def _interpreted(plain: Function, n: int, m: int, k: int, size: int) -> Any:
    def call(t: float, x: int, u: int, p: int, out: int) -> None:
        result = _view(out, size)
        try:
            result[:] = plain(t, _view(x, n), _view(u, m), _view(p, k))
        except BadInput:
            result[:] = np.nan  # the simulation ends here; an exception cannot pass compiled code

    return _CALLBACK(call)


def _view(address: int, size: int) -> Array:
    return np.ctypeslib.as_array((ctypes.c_double * size).from_address(address)) if size else np.zeros(0)


def _check(address: int, plain: Function, model: Model, size: int) -> None:
    """Compare compiled and plain code at a few points; raises `Untranslatable` when they differ."""
    values = np.array([q.value for q in model.parameters.values()])
    call = _CALLBACK(address)
    out = np.empty(size)
    rng = np.random.default_rng(0)
    for scale in (0.0, 1e-3, 1.0, 1.0):
        x, u = scale * rng.standard_normal(len(model.states)), scale * rng.standard_normal(len(model.inputs))
        expected = plain(0.5, x, u, values)
        call(0.5, x.ctypes.data, u.ctypes.data, values.ctypes.data, out.ctypes.data)
        finite = np.isfinite(expected)
        if not np.allclose(out[finite], expected[finite], rtol=1e-9, atol=1e-12 * np.abs(expected[finite]).max(initial=0.0)):
            raise Untranslatable("compiled code gives other values")


def linearised(address: int, size: int, x: Array, u: Array, values: Array) -> tuple[Array, Array]:
    """Return the derivatives of code that gives ``size`` values with respect to state ``(size, n)`` and input ``(size, m)`` at a point."""
    slopes = np.empty((1, size, len(x) + len(u)))
    kernel.slopes(address, x[None], u[None], values, slopes)
    return slopes[0, :, : len(x)], slopes[0, :, len(x) :]
