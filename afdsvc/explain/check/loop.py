"""The loop: is the nominal model stable, is the controller known, what drove the machine?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from afdsvc.dataset.experiment import Run
from afdsvc.dataset.sample_checks import Finding
from afdsvc.explain.simulate.nominal import Nominal

MARGIN = 1e-9


def loop(nominal: Nominal, runs: Sequence[Run]) -> Iterator[Finding]:
    """Yield what there is to say on stability and feedback."""
    stable = _stable(nominal)
    if not stable:
        yield Finding(
            "warning", "stability",
            "the nominal model is not stable by itself (a pole at zero or beyond): it is not simulated freely but corrected by the "
            "measured outputs, or with the controller closed",
        )
    known = nominal.model.controller is not None and any(r.W is not None for r in runs)
    driven = any(r.commanded or np.ptp(r.REF, axis=0).max(initial=0.0) > 0 for r in runs)
    if known:
        yield Finding("ok", "controller", "the controller is known: the loop can be simulated closed")
    elif nominal.model.controller is not None:
        yield Finding("warning", "controller", "the controller is given, but gaps or its sample time keep the loop from being reconstructed")
    elif driven:
        yield Finding(
            "warning", "controller",
            "the inputs come from a controller that is not given: nothing can be simulated in closed loop, predictions from "
            "the measured inputs are compared",
        )


def _stable(nominal: Nominal) -> bool:
    plant = nominal.plant
    poles = plant.poles()
    if plant.discrete:
        return bool((np.abs(poles) < 1 - MARGIN).all())
    return bool((poles.real < -MARGIN).all())
