"""Plants by name."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from importlib import import_module
from typing import Any

from afdsvc.api.plant import PhysicalPlant
from afdsvc.errors import BadInput

PLANTS = {
    "amb_turboexpander": "afdsvc.plants.amb_turboexpander",
    "gas_bearing": "afdsvc.plants.gas_bearing",
    "unstable_second_order": "afdsvc.plants.examples",
}


def plant(name: str, **options: Any) -> PhysicalPlant:
    """Return a plant by name, with the options of its function; raises `BadInput` naming what exists.

    >>> plant("gas_bearing", rpm=1100).outputs[0].unit
    'um'
    """
    if name not in PLANTS:
        raise BadInput(f"there is no plant '{name}'; there are {', '.join(sorted(PLANTS))}")
    make: Callable[..., PhysicalPlant] = getattr(import_module(PLANTS[name]), name)
    known = inspect.signature(make).parameters
    for option, value in options.items():
        if option not in known:
            raise BadInput(f"plant '{name}' has no option '{option}'; it has {', '.join(known) or 'none'}")
        if isinstance(known[option].default, int | float) and not isinstance(value, int | float):
            raise BadInput(f"plant '{name}': option '{option}' is {value!r}; expected a number")
    return make(**options)
