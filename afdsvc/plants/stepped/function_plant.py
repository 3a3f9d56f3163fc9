"""A Python function as a plant: its state is a value it is handed and hands back."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array

Step = Callable[..., tuple[Any, Any]]


class FunctionPlant:
    """A `SteppedPlant` around ``function(x, u, dt, **options) -> (x, y)``.

    ``x`` is whatever the function calls its state, None at the start; ``u (m,)`` are the inputs, held for ``dt`` seconds (at the
    start they are 0 and so is ``dt``); what comes back is the state and the outputs ``y (p,)`` at the end. The function must not
    change the state it was given: that is what makes it possible to begin anew, and to repeat a step.
    """

    def __init__(self, function: Step, name: str, inputs: int, outputs: int, options: Mapping[str, Any] | None = None) -> None:
        self._function, self._name, self._m, self._p = function, name, inputs, outputs
        self._options = dict(options or {})
        self._x: Any = None

    def begin(self) -> Array:
        """Start at rest and return the outputs there; raises `BadInput` when the function fails or answers wrongly."""
        self._x = None
        return self.advance(np.zeros(self._m), 0.0)

    def advance(self, u: Array, dt: float) -> Array:
        """Hold the inputs for ``dt`` and return the outputs at the end."""
        try:
            self._x, y = self._function(self._x, u, dt, **self._options)
            found = np.atleast_1d(np.asarray(y, dtype=np.float64))
        except Exception as error:
            raise BadInput(f"simulator {self._name} fails: {type(error).__name__}: {error}") from error
        if found.shape != (self._p,):
            raise BadInput(f"simulator {self._name} returns outputs of shape {found.shape}; expected ({self._p},)")
        return finite_outputs(found, self._name)

    def states(self) -> Array:
        """Return the state, where it is a vector of numbers."""
        try:
            x = np.asarray(self._x, dtype=np.float64)
        except (TypeError, ValueError):
            return np.zeros(0)
        return x if x.ndim == 1 else np.zeros(0)

    def close(self) -> None:
        """Forget the state."""
        self._x = None


def finite_outputs(y: Array, name: str) -> Array:
    """Return outputs that are all finite; raises `BadInput` naming the simulator and the output that is not."""
    if not np.isfinite(y).all():
        at = int(np.flatnonzero(~np.isfinite(y))[0])
        raise BadInput(f"simulator {name} returns {y[at]} for output {at}; expected finite numbers")
    return y
