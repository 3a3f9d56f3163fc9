"""Laws made callable from the kernel: each plain Python function is compiled once."""

from __future__ import annotations

from functools import cache
from typing import Any

from numba import cfunc
from numba.core.errors import NumbaError

from afdsvc.api.physics import Law
from afdsvc.errors import BadInput
from afdsvc.explain.simulate.kernel import LAW


@cache  # its code must outlive every simulation that holds its address
def compiled(law: Law) -> Any:
    """Return the law as a compiled callback; raises `BadInput` with the compiler's first complaint when it cannot be."""
    try:
        return cfunc(LAW, cache=True, error_model="numpy")(law)
    except NumbaError as error:
        why = str(error).strip().splitlines()[0]
        raise BadInput(f"law '{law.__qualname__}' does not compile: {why}") from error
    except RuntimeError:  # a function without a file has nowhere to keep its compiled form
        return cfunc(LAW, error_model="numpy")(law)
