"""Numbers of a model that change with time: slowly, or at one moment."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.physics import LONG_AGO
from afdsvc.explain.search.ranking import mechanism
from afdsvc.plugins.physics.offset_step import OffsetStep
from afdsvc.plugins.physics.parameter_change import ParameterChange
from afdsvc.plugins.physics.parameter_drift import drifting_gain, drifting_inertia, drifting_terms
from afdsvc.plugins.physics.parameter_step import ParameterStep, stepping, stepping_inertia
from afdsvc.testing.conformance.physics import machines


def test_a_number_that_drifts_levels_off_keeps_its_sign_and_at_most_doubles():
    """``c = rate tau (1 - exp(-t / tau))``, of a gain, of the terms of a balance, and of a mass."""
    t, tau, rate = 0.01 * np.arange(300), 0.5, -0.4
    c = rate * tau * (1 - np.exp(-t / tau))
    for law, constants, signals, expected in (
        (drifting_gain, (), [3.0], 3.0 * c), (drifting_terms, (2.0, -1.0), [3.0, 4.0], 2.0 * c), (drifting_inertia, (2.0, -1.0), [3.0, 4.0], 2.0 / (1 + c) - 2.0),
    ):
        memory, found = np.zeros(1), []
        for _ in t:
            out = np.zeros(1)
            law(np.array([rate, tau, *constants]), np.array(signals), memory, 0.01, out)
            found.append(out[0])
        assert found == pytest.approx(expected, abs=1e-12)
        for rate_, ends in ((-9.0, {drifting_gain: -2.97, drifting_terms: -1.98, drifting_inertia: 198.0}), (9.0, {drifting_gain: 3.0, drifting_terms: 2.0, drifting_inertia: -1.0})):
            out = np.zeros(1)
            law(np.array([rate_, tau, *constants]), np.array(signals), np.array([9.0]), 0.01, out)
            assert out[0] == pytest.approx(ends[law])


def test_a_number_that_changes_at_one_moment_is_as_stated_before_and_keeps_its_new_value():
    change, moment, takes = -0.4, 10.0, 2.0
    for t, reached in ((0.0, 0.0), (9.0, 0.0), (9.5, 0.15625), (10.0, 0.5), (10.5, 0.84375), (11.0, 1.0), (1e9, 1.0)):
        c = change * reached
        for law, constants, signals, expected in (
            (stepping, [], [], c), (stepping, [1.0], [3.0], 3.0 * c), (stepping, [2.0, -1.0], [3.0, 4.0], 2.0 * c), (stepping_inertia, [2.0, -1.0], [3.0, 4.0], 2.0 / (1 + c) - 2.0),
        ):
            out = np.zeros(1)
            law(np.array([change, moment, takes, *constants]), np.array([*signals, t]), np.zeros(0), 0.01, out)
            assert out[0] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(("law", "constants", "signals", "changed"), [(stepping, [], [], -0.4), (stepping, [1.0], [3.0], -1.2), (stepping_inertia, [2.0, -1.0], [3.0, 4.0], 2.0 / 0.6 - 2.0)])
def test_a_change_in_one_recording_is_undone_where_the_next_begins(law, constants, signals, changed):
    """It comes at 10 s. A moment long ago, with which the improved model has it, has come in every recording."""
    for begins, moment, expected in ((0.0, 10.0, [0.0, changed]), (9.0, 10.0, [0.0, changed]), (15.0, 10.0, [0.0, 0.0]), (15.0, LONG_AGO, [changed, changed])):
        memory, found = np.zeros(2), []
        for t in (begins, begins + 12.0):
            out = np.zeros(1)
            law(np.array([-0.4, moment, 2.0, *constants]), np.array([*signals, t]), memory, 0.01, out)
            found.append(out[0])
        assert found == pytest.approx(expected, abs=1e-12)


def test_only_several_recordings_have_a_change_in_one_of_them():
    motor = machines()[2]
    for physics, seam in ((ParameterStep(), ", "), (OffsetStep(), "#")):
        one, two = ({h.key: mechanism(h) for h in physics.hypotheses(replace(motor, recordings=n))} for n in (1, 2))
        assert two == one | {f"{key}{seam}in one recording": same for key, same in one.items()}


def test_after_its_moment_a_number_is_what_it_would_be_if_it_differed_from_the_beginning():
    arm = machines()[3]
    changes = {h.notes["variant"]: h for h in ParameterChange().hypotheses(arm)}
    for h in ParameterStep().hypotheses(arm):
        constant = changes[h.notes["variant"]]
        assert "gauge" not in h.notes  # a product that changes has two places
        fixed = [c.low for c in constant.parameters[1:]]
        later = h.linear(arm.plant, [-0.4, 3.0, 0.5, *(c.low for c in h.parameters[3:])])
        expected = constant.linear(arm.plant, [-0.4, *fixed])
        assert all(np.allclose(getattr(later, name), getattr(expected, name), atol=1e-12) for name in "ABCD")
        assert not np.allclose(np.vstack([later.A, later.C]), np.vstack([arm.plant.A, arm.plant.C])) or not np.allclose(later.B, arm.plant.B)
