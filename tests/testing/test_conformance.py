"""Everything that is shipped holds what is asked of others, and the suite fails what deserves it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from afdsvc.api.evidence import Evidence
from afdsvc.api.physics import Coefficient
from afdsvc.errors import BadInput
from afdsvc.plugins.manager import load
from afdsvc.plugins.physics.attach import at_input
from afdsvc.testing.conformance import checks, examine

EXAMPLES = {
    ("controllers", "proportional"): {"gain": 0.2},
    ("faults", "actuator_gain"): {"input": 0},
    ("faults", "sensor_gain"): {"output": 1},
    ("faults", "parameter"): {"parameter": "stiffness_hh"},
    ("retuners", "h2"): {"iterations": 30, "models": 2},
    ("retuners", "reference_controller"): {"D": [[0.3, 0.0], [0.0, 0.2]]},
    ("notifiers", "webhook"): {"url": "http://127.0.0.1:9/alarms"},
}
ELSEWHERE = {
    ("controllers", "state_space"), ("controllers", "pid"),  # need matrices of their own; tested in tests/plugins
    ("physics", "coloured_noise"),  # no law: named from the spectrum of what is left
}


class Example:
    """A plugin object with settings to try it with."""

    def __init__(self, thing, example):
        self._thing, self.example = thing, example

    def __getattr__(self, name):
        return getattr(self._thing, name)


def cases():
    for offer in load().offers:
        if (offer.family, offer.name) not in ELSEWHERE:
            for check in checks(offer.family):
                yield pytest.param(offer, check, id=f"{offer.name}-{check.__name__}")


@pytest.mark.parametrize(("offer", "check"), list(cases()))
def test_what_is_shipped_conforms(offer, check):
    example = EXAMPLES.get((offer.family, offer.name))
    check(Example(offer.thing, example) if example else offer.thing)


@dataclass
class Careless:
    """A detector with every fault a detector can have."""

    name: str = "careless"
    summary: str = "alarms always"

    def design(self, problem, settings):
        return self

    def start(self):
        return {"seen": []}

    def step(self, state, block):
        state["seen"].append(block.r.copy())
        inside = block.burst is not None
        e = Evidence("other", "m", block.k0, 0.0, float(np.abs(block.r).max()), float("nan"), True, "b", weights={"a": 0.2})
        return state, [e] if inside else []


def test_a_careless_detector_fails_where_it_should():
    failed = {r.check for r in examine("detectors", Careless()) if r.failure}
    assert failed >= {
        "refuses_unknown_settings", "is_quiet_on_a_healthy_machine", "decides_the_same_however_the_samples_are_cut",
        "steps_are_functions", "keeps_its_memory_bounded", "throws_away_a_burst_with_a_gap", "says_all_of_what_it_decides",
    }


FACTOR = 2.0


def leaning(p, z, m, dt, out):
    """A law that needs its module."""
    out[0] -= FACTOR * p[0] * z[0]


@dataclass
class Leaning:
    """A physics with two hypotheses of one key, a start outside its range, no word of what refutes it, and a law that needs its module."""

    name: str = "leaning"
    summary: str = "leans on its module"

    def hypotheses(self, machine):
        for port in machine.inputs[:1] * 2:
            yield at_input(port, leaning, physics=self.name, family="gain", parameters=[Coefficient("share", "", 0.0, 1.0, 0.1)], starts=[(2.0,)], predicts="x")


def test_a_careless_physics_fails_where_it_should():
    failed = {r.check for r in examine("physics", Leaning()) if r.failure}
    assert failed == {"makes_sense_somewhere", "tells_what_it_predicts", "laws_stand_alone"}


def test_an_unknown_family_is_named():
    with pytest.raises(BadInput, match="no plugin family 'colours'; there are controllers, detectors"):
        checks("colours")
