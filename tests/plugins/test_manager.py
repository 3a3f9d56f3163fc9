"""Plugins: built-ins through the same door as others; a wrong one is named and stops no other."""

from __future__ import annotations

import types

import pluggy
import pytest

from afdsvc.errors import BadInput
from afdsvc.plugins.hookspecs import hookimpl
from afdsvc.plugins.manager import load


class Thing:
    """A plugin's offer."""

    summary = "for tests"

    def __init__(self, name: str) -> None:
        self.name = name


def module(name: str, **hooks) -> types.SimpleNamespace:
    return types.SimpleNamespace(__name__=name, **hooks)


def marked(function):
    return hookimpl(function)


def test_built_ins_come_through_the_entry_points():
    found = load()
    assert found.broken == {}
    assert {"lqg", "proportional", "state_space"} <= {o.name for o in found.family("controllers")}
    assert {"actuator_gain", "sensor_gain"} <= {o.name for o in found.family("faults")}
    assert load(discover=False).offers == ()


def test_a_third_party_plugin_is_offered_beside_them():
    def afdsvc_faults():
        return [Thing("rust")]

    found = load([module("rusty", afdsvc_faults=marked(afdsvc_faults))])
    assert found.get("faults", "rust").name == "rust"


@pytest.mark.parametrize(
    ("hooks", "why"),
    [
        ({"afdsvc_fautls": marked(lambda: [])}, "unknown hook 'afdsvc_fautls'"),
        ({"afdsvc_faults": lambda: []}, "not marked with @hookimpl"),
        ({"afdsvc_faults": marked(lambda nonsense: [])}, "nonsense"),
        ({"afdsvc_faults": marked(lambda: [Thing("actuator_gain")])}, "already offered by plugin 'faults'"),
        ({"afdsvc_faults": marked(lambda: 1 / 0)}, "ZeroDivisionError"),
    ],
)
def test_a_wrong_plugin_is_named_and_stops_no_other(hooks, why):
    found = load([module("wrong", **hooks)])
    assert why in found.broken["wrong"]
    assert found.get("controllers", "lqg").name == "lqg"


def test_an_unknown_name_lists_what_there_is():
    with pytest.raises(
        BadInput, match="no plugin 'fuzzy' among the controllers; installed are: lqg, pid, proportional, state_space"
    ):
        load().get("controllers", "fuzzy")


def test_the_marker_is_the_projects_own():
    assert isinstance(hookimpl, pluggy.HookimplMarker)
