"""afdsvc: active fault diagnosis for closed-loop machines, and why a model disagrees with its recordings.

From arrays, data frames and files::

    motor = afdsvc.Model.from_system(([12.0], [0.08, 1]), {"voltage": "V"}, {"speed": "rad/s"})  # or afdsvc.load("MODEL.toml")
    afdsvc.check(motor, frame)                 # do model and recording fit together? seconds
    afdsvc.explain(motor, frame)               # why simulation and recording differ
    afdsvc.identify(voltage, speed, dt=0.005)  # a plant from data
    afdsvc.diagnose("run.mcap")                # faults in a recording with bursts
    afdsvc.design("site.toml")                 # burst, thresholds and smallest faults of a machine

Each answer has ``sentences``, ``rows()``, ``to_pandas()`` and ``plot()``; what cannot be used raises `BadInput`. ``help(afdsvc.explain)``
and so on have examples that run; docs/reference/python.md leads through them.

The packages below, from mathematics to the command line; each imports only from those above it:

- `errors`: every deliberate error
- `lti`: state-space algebra: coprime factors, YJBK, LFT, whitening, reduction, frequency response
- `api`: the nouns and protocols every room speaks
- `dataset`: recordings as arrays: experiments, periods, screening, glitches, angles, columns
- `stats`: whiteness, periodic parts, tones, coloured noise, fit measures, Levenberg-Marquardt
- `plants`: physics with named parameters and units; rotors; simulators that only step
- `detect`: features, statistics and thresholds of the detectors
- `retune`: Q for a damaged machine beside the running controller: its design, and the proof before anything moves
- `excite`: design of bursts within limits
- `identify`: closed-loop identification
- `explain`: why simulation and recordings differ
- `plugins`: hook specifications, manager, controllers, faults, detectors, physics
- `wire`: protobuf codec and every zenoh key
- `files`: recordings, tables, model files and the site file
- `diagnosis`: from blocks to evidence and alarms, live and offline alike
- `transport`: zenoh sessions, outgoing queues, access rules, certificates
- `hal`: the rig's side: agent, control loop, simulator, replay, hardware
- `service`: the background service of a site: hub, bursts, notifications, sinks
- `present`: terminal, HTML pages, Rerun
- `trial`: blind trials of `explain`: a truth written apart from everything it tests
- `app`: the use cases, one file per command
- `testing`: for plugin authors: conformance suites, and new plugins as packages
- `cli`: arguments, nothing else
"""

from __future__ import annotations

import importlib
import os
import sys
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from afdsvc.api.model import Model as Model
    from afdsvc.api.signals import Trace as Trace
    from afdsvc.errors import BadInput as BadInput

# Compiled loops are kept apart from the package: an uninstall would leave them, and a folder of their own in its place. Read by numba at import.
os.environ.setdefault("NUMBA_CACHE_DIR", os.path.join(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"), "afdsvc"))
# One thread for linear algebra: the matrices are small, processes run side by side. Read by numpy once, when it is imported.
for _library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

__version__ = "0.1.0"


def is_compiled() -> bool:
    """Whether compiled loops of an earlier run are kept on this computer; compiling all of them takes up to a minute."""
    return any(Path(os.environ["NUMBA_CACHE_DIR"]).rglob("*.nbi"))


_PLACES = {"Model": "api.model", "Trace": "api.signals", "BadInput": "errors"}  # every other name comes from `app.interface`
__all__ = ["BadInput", "Model", "Trace", "check", "design", "diagnose", "explain", "identify", "load"]


def __getattr__(name: str) -> Any:
    """Import what a name of the interface needs when it is asked for: the command line must start fast."""
    if name not in __all__:
        raise AttributeError(f"module 'afdsvc' has no attribute '{name}'")
    return getattr(importlib.import_module(f"afdsvc.{_PLACES.get(name, 'app.interface')}"), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]


class _Interface(ModuleType):
    """`afdsvc.identify` and `afdsvc.explain` are functions here and packages below: importing a package must not take the function away."""

    def __setattr__(self, name: str, value: object) -> None:
        if not (name in __all__ and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Interface
