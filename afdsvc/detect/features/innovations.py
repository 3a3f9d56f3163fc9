"""The residual as a stream: the innovations filter applied sample by sample.

`afdsvc.lti.simulate` adds in a fixed order, so the residual is the same to the last bit however the samples are cut
into blocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from afdsvc.errors import BadInput
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import Array, StateSpace


@dataclass(frozen=True, slots=True, eq=False)
class StreamingFilter:
    """A discrete system whose state is a value: ``step(state, inputs) -> (state, outputs)``."""

    system: StateSpace

    def __post_init__(self) -> None:
        if self.system.order and not self.system.discrete:
            raise BadInput("a continuous-time system cannot filter samples; expected a discrete one (dt > 0)")

    def start(self) -> Array:
        """Return the state at rest, shape ``(order,)``."""
        return np.zeros(self.system.order)

    def step(self, state: Array, inputs: Array) -> tuple[Array, Array]:
        """Return the state after the samples ``inputs (n, inputs)`` and the outputs ``(n, outputs)``."""
        outputs, after = simulate(self.system, inputs, state)
        return after, outputs

    def settling(self, to: float = 1e-4) -> int:
        """Return after how many samples what the filter started with has decayed to the share ``to``."""
        return decay(self.system, to)


@dataclass(frozen=True, slots=True, eq=False)
class ResidualFilter:
    """The filter from ``[y; u]`` to the white residual r: ``xh+ = (A - Kp C) xh + (B - Kp D) u + Kp y, r = y - C xh -
    D u``.

    ``innovations`` is that filter with p outputs; ``step(state, y, u) -> (state, r)`` with y ``(n, p)``, u ``(n,
    m)``. After a block with NaN the filter starts again from rest: what NaN touched would otherwise stay in its state
    for ever.
    """

    innovations: StateSpace

    def start(self) -> Array:
        """Return the state at rest."""
        return StreamingFilter(self.innovations).start()

    def step(self, state: Array, y: Array, u: Array) -> tuple[Array, Array]:
        """Return the state after the block and the residual r, shape ``(n, p)``."""
        filtered = StreamingFilter(self.innovations)
        after, r = filtered.step(state, np.hstack([y, u]))
        return (after if np.isfinite(after).all() else filtered.start()), r

    def settling(self, to: float = 1e-4) -> int:
        """Return after how many samples what the filter started with has decayed to the share ``to``."""
        return decay(self.innovations, to)


def decay(system: StateSpace, to: float = 1e-4) -> int:
    """Return the samples after which the slowest mode of a stable system has decayed to the share ``to`` (0 if
    static).
    """
    if not system.order:
        return 0
    slowest = float(np.abs(system.poles()).max())
    if slowest >= 1:
        raise BadInput(f"the system has a pole of modulus {slowest:.6g}; expected a stable one")
    return 1 if slowest < 1e-12 else int(np.ceil(np.log(to) / np.log(slowest)))
