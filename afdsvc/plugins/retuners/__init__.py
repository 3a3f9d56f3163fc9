"""Built-in retuners."""

from __future__ import annotations

from collections.abc import Iterable

from afdsvc.api.retuning import RetunerDesign
from afdsvc.plugins.hookspecs import hookimpl
from afdsvc.plugins.retuners.h2 import H2
from afdsvc.plugins.retuners.reference_controller import ReferenceController


@hookimpl
def afdsvc_retuners() -> Iterable[RetunerDesign]:
    """Offer the H2 design over several models, and the Q of a controller that is given."""
    return [H2(), ReferenceController()]
