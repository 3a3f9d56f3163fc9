"""Built-in controllers."""

from __future__ import annotations

from collections.abc import Iterable

from afdsvc.api.control_plugins import ControllerDesign
from afdsvc.plugins.controllers.lqg import Lqg
from afdsvc.plugins.controllers.pid import Pid
from afdsvc.plugins.controllers.proportional import Proportional
from afdsvc.plugins.controllers.state_space import Linear
from afdsvc.plugins.hookspecs import hookimpl


@hookimpl
def afdsvc_controllers() -> Iterable[ControllerDesign]:
    """Offer the proportional, the LQG, the PID and the general linear controller."""
    return [Proportional(), Lqg(), Pid(), Linear()]
