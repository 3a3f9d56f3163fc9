"""Observability of faults under excitation, with the reason where it fails."""

from __future__ import annotations

import numpy as np

from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.statistics.fault_curves import LoopResponse
from afdsvc.lti.statespace import Array

INVISIBLE = 1e-9  # gain, as a share of the largest, that is rounding


def unseen(problem: DetectionProblem, response: LoopResponse) -> dict[str, str]:
    """Return a sentence for every fault that no channel shows at any of the response's frequencies."""
    reached, shown = _into_faults(response), _out_of_faults(response)
    found = {}
    for name in problem.fault_names:
        own = problem.augmented.channels_of(name)
        into, out = float(reached[:, own].max(initial=0.0)), float(shown[:, :, own].max(initial=0.0))
        if into <= INVISIBLE * reached.max(initial=0.0):
            found[name] = "no excitation reaches the signal this fault multiplies"
        elif out <= INVISIBLE * shown.max(initial=0.0):
            found[name] = "the signal this fault multiplies is excited, but its change reaches no output"
    return found


def blind_pairs(problem: DetectionProblem, pairs: Array, inputs: tuple[str, ...]) -> list[dict[str, str]]:
    """Return the pairs of input and output that cannot show a fault; ``pairs (K, L, p, m)`` are efficiencies."""
    largest, blind = pairs.max(initial=0.0), []
    for k, name in enumerate(problem.fault_names):
        for i, output in enumerate(problem.output_names):
            for j, input_ in enumerate(inputs):
                if pairs[k, :, i, j].max(initial=0.0) <= INVISIBLE * largest:
                    blind.append({"fault": name, "input": input_, "output": output})
    return blind


def _into_faults(response: LoopResponse) -> Array:
    """Return ``|Gzu u|`` per unit alpha in the healthy loop, shape ``(L, channels)``, the largest over inputs."""
    k = response.augmented.channels
    z = response.plant[:, :k, k:] @ response.healthy().u[0]
    return np.asarray(np.abs(z).max(axis=-1, initial=0.0))


def _out_of_faults(response: LoopResponse) -> Array:
    """Return the response of r to what faults add, in the healthy loop, shape ``(L, p, channels)``."""
    k = response.augmented.channels
    G, Gyw = response.plant[:, k:, k:], response.plant[:, k:, :k]
    m, p = G.shape[2], G.shape[1]
    Kuy = response.controller[:, :m, :p]
    y = np.linalg.solve(np.eye(p) - G @ Kuy, Gyw)
    return np.asarray(np.abs(response.residual[:, :, :p] @ y + response.residual[:, :, p:] @ (Kuy @ y)))
