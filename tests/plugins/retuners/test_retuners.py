"""The built-in retuners: they conform, and the reference controller is realised exactly."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.api.retuning import DiagnosedFault
from afdsvc.app.commissioning import commission
from afdsvc.app.pipelines import tuning_design
from afdsvc.errors import BadInput, Refused
from afdsvc.files.site import parse_site
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.lft import star
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins import retuners
from afdsvc.plugins.manager import load
from afdsvc.plugins.retuners.h2 import H2
from afdsvc.plugins.retuners.reference_controller import ReferenceController
from afdsvc.retune.cost import loop_cost
from afdsvc.testing.conformance import checks, examine
from afdsvc.testing.machines import bearing_problem

FOUND = DiagnosedFault("horizontal_actuator", -0.35, -0.25)


class Quick(H2):
    """The H2 design with few iterations."""

    example = {"iterations": 30, "models": 2}  # noqa: RUF012


class Stronger(ReferenceController):
    """A proportional controller of another gain."""

    example = {"D": [[0.3, 0.0], [0.0, 0.2]]}  # noqa: RUF012


@pytest.mark.parametrize("check", checks("retuners"), ids=lambda c: c.__name__)
@pytest.mark.parametrize("thing", [Quick(), Stronger()], ids=["h2", "reference_controller"])
def test_what_is_shipped_conforms(thing, check):
    check(thing)


def test_the_family_is_found_by_its_hook():
    offers = {o.name for o in load(extra=[retuners], discover=False).family("retuners")}
    assert offers == {"h2", "reference_controller"}


def test_the_reference_controller_runs_in_the_loop():
    problem = bearing_problem("lqg")
    rng = np.random.default_rng(0)
    A, B, C, D = 0.5 * np.eye(2), rng.standard_normal((2, 2)), 0.02 * rng.standard_normal((2, 2)), 0.1 * np.eye(2)
    Q = ReferenceController().design(problem, FOUND, loop_cost(problem, {}), {"A": A, "B": B, "C": C, "D": D})
    omega = np.geomspace(1, 15000, 50)
    again = frequency_response(star(problem.interconnection, Q, 2, 2), omega)
    assert np.abs(again - frequency_response(StateSpace(A, B, C, D, 2e-4), omega)).max() < 1e-9


def test_a_controller_the_healthy_machine_does_not_bear_is_refused():
    problem = bearing_problem("proportional")
    with pytest.raises(Refused, match="does not hold the healthy machine"):
        ReferenceController().design(problem, FOUND, loop_cost(problem, {}), {"D": [[5.0, 0.0], [0.0, 5.0]]})
    with pytest.raises(BadInput, match="the controller is 1 x 1; expected 2 x 2"):
        ReferenceController().design(problem, FOUND, loop_cost(problem, {}), {"D": [[5.0]]})


def test_a_careless_retuner_fails_where_it_is_careless():
    class Careless:
        name, summary = "careless", "an unstable Q whatever is asked"

        def design(self, problem, found, cost, settings):
            return StateSpace.of([[1.1]], [[1.0, 0.0]], [[1e-3], [0.0]], None, problem.plant.dt)

    failed = {r.check for r in examine("retuners", Careless()) if r.failure}
    assert failed == {"refuses_unknown_settings", "q_is_stable", "the_damaged_machine_is_stable"}


@pytest.mark.parametrize(
    ("settings", "why"),
    [({"models": "five"}, "models is 'five'; expected a whole number of at least 1"), ({"doubt": -1.0}, "doubt is -1.0"), ({"switch_seconds": "soon"}, "expected a number or a list of numbers"), ({"switch_seconds": []}, "or a list of numbers"), ({"doubt": [0.1]}, "expected a number of at least 0")],
)
def test_a_setting_of_another_kind_is_refused(settings, why):
    problem = bearing_problem("proportional")
    with pytest.raises(BadInput, match=why):
        H2().design(problem, FOUND, loop_cost(problem, {}), settings)


def test_what_the_site_states_holds_for_the_proof_too():
    problem, plugins = bearing_problem("proportional"), load()
    text = """
    site = "t"
    [[machines]]
    id = "bearing"
    plant = "gas_bearing"
    controller = {kind = "proportional", settings = {gain = 0.2}}
    retune = {settings = {models = 2, iterations = 30, rectangles = 1}, cost = {input_weight = 1.0}}
    """
    machine = commission(parse_site(text, "t").machines[0], plugins)
    with pytest.raises(Refused, match="could not be proved between grid points with 1 rectangles"):
        tuning_design(machine, plugins)(problem, DiagnosedFault("horizontal_actuator", -0.5, -0.2))
