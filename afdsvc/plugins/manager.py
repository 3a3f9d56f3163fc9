"""Finding plugins: built-ins and third parties use the same entry points."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any

import pluggy

from afdsvc.errors import BadInput
from afdsvc.plugins import hookspecs

FAMILIES = {
    "controllers": "afdsvc_controllers",
    "faults": "afdsvc_faults",
    "detectors": "afdsvc_detectors",
    "physics": "afdsvc_physics",
    "retuners": "afdsvc_retuners",
    "drivers": "afdsvc_drivers",
    "notifiers": "afdsvc_notifiers",
}


@dataclass(frozen=True, slots=True)
class Offer:
    """One object a plugin hands out: its family, name, one-line summary, the plugin it comes from, and the object."""

    family: str
    name: str
    summary: str
    plugin: str
    thing: Any


@dataclass(frozen=True, slots=True)
class Plugins:
    """Everything installed, and what could not be loaded (plugin name to reason): one bad plugin stops no other."""

    offers: tuple[Offer, ...]
    broken: dict[str, str]

    def family(self, family: str) -> list[Offer]:
        """Return the offers of one family, in order of their names."""
        return sorted((o for o in self.offers if o.family == family), key=lambda o: o.name)

    def get(self, family: str, name: str) -> Any:
        """Return one object by name; raises `BadInput` that lists what there is."""
        for offer in self.family(family):
            if offer.name == name:
                return offer.thing
        known = ", ".join(o.name for o in self.family(family)) or "none"
        hint = "".join(f"; plugin '{p}' did not load: {why}" for p, why in self.broken.items())
        raise BadInput(f"no plugin '{name}' among the {family}; installed are: {known}{hint}")


def load(extra: Iterable[Any] = (), discover: bool = True) -> Plugins:
    """Load every installed plugin and the ``extra`` modules or objects.

    A misspelt hook (a name starting with ``afdsvc_`` that no specification knows) makes that plugin broken, by name.
    """
    manager = pluggy.PluginManager(hookspecs.PROJECT)
    manager.add_hookspecs(hookspecs)
    broken: dict[str, str] = {}
    for point in entry_points(group=hookspecs.PROJECT) if discover else ():
        _register(manager, _import(point, broken), point.name, broken)
    for thing in extra:
        _register(manager, thing, str(getattr(thing, "__name__", type(thing).__name__)), broken)
    return Plugins(tuple(_collect(manager, broken)), broken)


def _import(point: EntryPoint, broken: dict[str, str]) -> Any | None:
    try:
        return point.load()
    except Exception as error:
        broken[point.name] = f"{type(error).__name__}: {error}"
        return None


def _register(manager: pluggy.PluginManager, thing: Any | None, name: str, broken: dict[str, str]) -> None:
    if thing is None:
        return
    try:
        manager.register(thing, name=name)
        manager.check_pending()  # pluggy ignores a misspelt hook unless asked
        _refuse_unmarked(thing)
    except (pluggy.PluginValidationError, ValueError) as error:
        broken[name] = str(error)
        if manager.has_plugin(name):
            manager.unregister(name=name)


def _refuse_unmarked(thing: Any) -> None:
    """A function named like a hook but without ``@hookimpl`` would be ignored in silence."""
    for attribute in dir(thing):
        if attribute.startswith("afdsvc_") and not hasattr(getattr(thing, attribute), "afdsvc_impl"):
            raise ValueError(f"'{attribute}' looks like a hook but is not marked with @hookimpl")


def _collect(manager: pluggy.PluginManager, broken: dict[str, str]) -> list[Offer]:
    offers: list[Offer] = []
    seen: dict[tuple[str, str], str] = {}
    for family, hook in FAMILIES.items():
        for impl in getattr(manager.hook, hook).get_hookimpls():
            try:
                for thing in impl.function():
                    offer = Offer(family, thing.name, thing.summary, impl.plugin_name, thing)
                    other = seen.setdefault((family, offer.name), impl.plugin_name)
                    if other != impl.plugin_name:
                        raise BadInput(f"{family} '{offer.name}' is already offered by plugin '{other}'")
                    offers.append(offer)
            except Exception as error:  # a plugin's own fault must not take the service down
                broken[impl.plugin_name] = f"{type(error).__name__}: {error}"
    return offers
