"""Closed loops: inputs and simulated states without the outputs' noise.

The controller feeds the noise of the outputs into the inputs, and so into a simulation from measured inputs: past noise would
predict the residual of a perfect model. What a signal from outside the loop predicts of them holds no noise (the first stage of
two-stage least squares; L. Ljung, System Identification, 2nd ed., section 13.5). Each block is predicted by weights not fitted to
it, or a part of its own noise would come back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.random import Generator

from afdsvc.errors import BadInput
from afdsvc.explain.gap.prediction import predicted
from afdsvc.explain.gap.settings import GapSettings
from afdsvc.explain.gap.signals import ResidualSignals


def projected(recordings: Sequence[ResidualSignals], rng: Generator, settings: GapSettings) -> Sequence[ResidualSignals]:
    """Return the recordings with inputs and states replaced by what the references predict of them; as they are without one."""
    given = [r.reference for r in recordings if r.reference is not None]
    if not given:
        return recordings
    if len(given) < len(recordings):
        raise BadInput(f"gap test: {len(given)} of {len(recordings)} recordings have a reference; expected one in all or in none")
    targets = [np.hstack([r.inputs, r.states]) for r in recordings]
    posed = [ResidualSignals(t, g, t[:, :0], t[:, :0], r.dt) for t, g, r in zip(targets, given, recordings, strict=True)]
    names: list[list[str]] = [[f"signal {i}" for i in range(targets[0].shape[1])], [f"reference {i}" for i in range(given[0].shape[1])], [], []]
    found = [t.mean(0) + f for t, f in zip(targets, predicted(posed, names, rng, settings), strict=True)]
    parts = [np.split(f, [r.inputs.shape[1]], axis=1) for r, f in zip(recordings, found, strict=True)]
    return [replace(r, inputs=u, states=x) for r, (u, x) in zip(recordings, parts, strict=True)]
