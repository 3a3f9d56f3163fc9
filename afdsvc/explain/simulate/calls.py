"""Memory and functions reached by their address from compiled code."""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

NUMBERS = types.CPointer(types.float64)  # type: ignore[no-untyped-call]
DYNAMICS = types.void(types.float64, NUMBERS, NUMBERS, NUMBERS, NUMBERS)  # t, x, u, p, out


@intrinsic
def pointer(typingctx, address):  # type: ignore[no-untyped-def]
    """Return an address as a pointer, so that views of memory can be made without counting references."""

    def build(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return builder.inttoptr(arguments[0], cgutils.voidptr_t)

    return types.voidptr(address), build


@intrinsic
def call_dynamics(typingctx, function, t, x, u, p, out):  # type: ignore[no-untyped-def]
    """Call a function of signature `DYNAMICS` by its address; the arrays are given by theirs."""

    def build(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        numbers = ir.DoubleType().as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [ir.DoubleType(), *[numbers] * 4])
        target = builder.inttoptr(arguments[0], kind.as_pointer())
        builder.call(target, [arguments[1], *(builder.inttoptr(a, numbers) for a in arguments[2:])])
        return context.get_dummy_value()

    return types.void(types.int64, types.float64, *[types.uintp] * 4), build
