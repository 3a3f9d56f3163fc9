"""The Hansen scheme: a closed-loop problem turned into an open-loop one, in its original and its modified form.

With a controller known in coprime form, the unknown plant is ``G(S)`` and S is driven by a signal free of the noise:

    eps = S eta + (Mt + S Ut) d,     eta = alpha + Ut r1 + Vt r2      (thesis 4.19-4.36)

*Modified*: the excitation is played into alpha inside the controller and beta read there; ``eta = alpha``, ``eps =
beta``. *Original*: excitation enters through a reference; ``eta = Vt u - Ut y_m`` and ``eps = Mt y_m - Nt u`` are
filtered from what was measured. The same filter serves recordings with alpha where beta was not kept. (A. K. Sekunda,
"Fault Diagnosis and Identification of Electro-Mechanical Systems", PhD thesis, DTU 2017, chapter 4; F. Hansen, PhD
thesis, Stanford 1989.)
"""

from __future__ import annotations

import numpy as np

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.errors import BadInput
from afdsvc.lti.coprime import Factorisation
from afdsvc.lti.lft import star
from afdsvc.lti.simulate import simulate
from afdsvc.lti.stability import worst_pole
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.yjbk import interconnection, plant_from

#: Where filter transients count as died out.
_SETTLED = 1e-4


def youla_signals(fact: Factorisation, recording: InputOutputData) -> InputOutputData:
    """Return the recording of S, input eta and output eps, filtered from plant input u and measured output y.

    ``[eta; eps] = [Vt -Ut; -Nt Mt][u; y]``; samples before the filter has settled are left out. Whatever excites the
    loop (alpha, a reference, a disturbance added to u) is contained in eta; sensor noise is not. Raises `BadInput` when
    the recording is not twice as long as the filter needs.
    """
    m = fact.plant.inputs
    out, _ = simulate(fact.Lf, np.hstack([recording.u, recording.y]))
    start = settling_samples(fact.Lf)
    if len(recording) < 2 * start:
        raise BadInput(
            f"{recording.name}: {len(recording)} samples, but the controller's filter needs {start} to settle; "
            f"expected at least {2 * start} samples, or a recording that holds beta"
        )
    return InputOutputData(out[start:, :m], out[start:, m:], recording.dt, recording.name)


def settling_samples(system: StateSpace, level: float = _SETTLED) -> int:
    """Return after how many samples a stable filter has forgotten its initial state down to ``level``."""
    if not system.order:
        return 0
    radius = 1 - worst_pole(system.A, system.dt)[1]
    return 0 if radius <= 0 else int(np.ceil(np.log(level) / np.log(min(radius, 1 - 1e-9))))


def rebuilt_plant(fact: Factorisation, S: StateSpace) -> StateSpace:
    """Return ``G(S) = F_u(J_G, S)``: the plant that belongs to an identified S, of order S plus R."""
    return plant_from(fact, S)


def loop_is_stable(plant: StateSpace, controller: StateSpace) -> bool:
    """Whether the controller stabilises the plant (positive feedback)."""
    return worst_pole(star(plant, controller, plant.outputs, plant.inputs).A, plant.dt)[1] > 0


def excited_loop(fact: Factorisation, plant: StateSpace) -> StateSpace:
    """Return the loop of a plant with the controller, from alpha to ``[u, y]``: how a model answers an excitation."""
    p, m = plant.outputs, plant.inputs
    n = plant.order
    shown = StateSpace(
        plant.A,
        plant.B,
        np.vstack([np.zeros((m, n)), plant.C, plant.C]),
        np.vstack([np.eye(m), plant.D, plant.D]),
        plant.dt,
    )
    loop = star(shown, interconnection(fact), p, m)
    return loop.select(slice(0, m + p), slice(None))
