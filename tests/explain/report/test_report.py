"""Where recordings are too short to tell a gap from noise, that is the verdict."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from afdsvc.api.model import Model, Variable
from afdsvc.explain.report.report import _excited, _moved, _nearest
from afdsvc.explain.simulate.nominal import Entry, nominal
from afdsvc.explain.verdict.verdict import Verdict
from afdsvc.lti.transfer_function import from_polynomials


@pytest.mark.parametrize(
    ("word", "present", "enough", "claims", "said"),
    [
        ("consistent", False, False, (), "insufficient_excitation"), ("consistent", False, True, (), "consistent"),
        ("unexplained", False, False, (), "insufficient_excitation"), ("unexplained", True, False, (), "unexplained"),
        ("unexplained", False, True, (), "unexplained"), ("omitted_physics", False, False, ("a name",), "omitted_physics"),
    ],
)  # fmt: skip
def test_recordings_too_short_to_tell_a_gap_from_noise_are_insufficient(word, present, enough, claims, said):
    gap = SimpleNamespace(present=present, enough=enough)
    answer = _excited(Verdict(word, claims, ("the gap",), gap, None, (0.0, 0.0)), [])
    assert answer.verdict == said
    assert answer.sentences[-1] == "the gap"
    assert (len(answer.sentences) > 1) == (said == "insufficient_excitation")


@pytest.mark.parametrize(
    ("word", "accepted", "listed"),
    [("unexplained", False, 1), ("insufficient_excitation", True, 1), ("insufficient_excitation", False, 0), ("consistent", True, 0), ("omitted_physics", True, 0)],
)
def test_laws_that_come_nearest_are_listed_where_none_is_named(word, accepted, listed):
    law = SimpleNamespace(hypothesis=SimpleNamespace(physics="coulomb_friction", site="state:speed"), evidence=SimpleNamespace(explained=0.82))
    shape = SimpleNamespace(hypothesis=law.hypothesis, evidence=SimpleNamespace(explained=0.81))
    found = SimpleNamespace(steps=[SimpleNamespace(candidates=[shape, law], accepted=accepted)])
    near = _nearest(found, Verdict(word, (), (), None, None, (0.0, 0.0)))
    assert len(near) == listed
    assert all("coulomb friction would close 82 % of the gap" in n.sentence for n in near)


@pytest.mark.parametrize(
    ("moved", "said"),
    [
        ([0.4, -0.2], []),
        ([-3.3, 0.0], ["A[speed, speed] from -3 to -4.65 (-3.3 stated standard deviations)"]),
        ([-1.2, 2.0], ["B[speed, voltage] from 6 to 8 (+2.0 stated standard deviations), A[speed, speed] from -3 to -3.6 (-1.2 stated standard deviations)"]),
    ],
)
def test_the_numbers_that_the_fit_moved_are_listed_the_farthest_first(moved, said):
    entries = (Entry("A", 0, 0, 0.5, "A[1,1]"), Entry("B", 0, 0, 1.0, "B[1,1]"))
    model = SimpleNamespace(states=(Variable("speed"),), inputs=(Variable("voltage"),))
    nominal = SimpleNamespace(transfer=False, entries=entries, model=model, values=lambda theta: {"A[1,1]": -3 + 0.5 * theta[0], "B[1,1]": 6 + theta[1]})
    final = SimpleNamespace(point=SimpleNamespace(theta=np.array(moved)))
    assert list(_moved(nominal, final)) == [f"the fit moves numbers of the model: {s}" for s in said]


@pytest.mark.parametrize(
    ("matrix", "said"), [("A", "voltage to speed from 6 / (0.5 s + 1) to 8 / (0.6667 s + 1)"), ("B", "voltage to speed from 6 / (0.5 s + 1) to 7.5 / (0.5 s + 1)")]
)
def test_of_a_transfer_function_what_the_fit_moved_is_shown_as_one(matrix, said):
    stated = nominal(Model.from_system(([6.0], [0.5, 1]), {"voltage": "V"}, {"speed": "rad/s"}), 0.01)
    theta = np.array([5.0 if e.matrix == matrix else 0.0 for e in stated.entries])
    (found,) = _moved(stated, SimpleNamespace(point=SimpleNamespace(theta=theta)))
    assert found == f"the fit moves the model, its coefficients by 5.0 stated standard deviations at most: from {said}"
    assert not list(_moved(stated, SimpleNamespace(point=SimpleNamespace(theta=0 * theta + 0.9))))


def test_transfer_functions_that_the_fit_left_alone_are_not_shown():
    system = from_polynomials([[[6.0], [4.0]]], [[[0.5, 1], [0.5, 1]]])
    stated = nominal(replace(Model.from_system(system, {"voltage": "V", "load": "N*m"}, {"speed": "rad/s"}), transfer=True), 0.01)
    theta = np.array([5.0 * (e.matrix == "B" and e.column == 1) for e in stated.entries])
    (found,) = _moved(stated, SimpleNamespace(point=SimpleNamespace(theta=theta)))
    assert found.endswith("at most: from load to speed from 4 / (0.5 s + 1) to 5 / (0.5 s + 1)")


def test_no_more_numbers_are_listed_than_can_be_read():
    nominal = SimpleNamespace(transfer=False, entries=[Entry("parameter", k, 0, 1.0, f"p{k}") for k in range(9)], values=lambda theta: {f"p{k}": t for k, t in enumerate(theta)})
    (said,) = _moved(nominal, SimpleNamespace(point=SimpleNamespace(theta=np.arange(9.0) + 2)))
    assert said.startswith("the fit moves numbers of the model: p8 from 0 to 10 (+10.0")
    assert said.endswith("p5 from 0 to 7 (+7.0 stated standard deviations) and 5 more")
