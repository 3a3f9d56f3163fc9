"""What is claimed and what is withdrawn."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from afdsvc.explain.explain import _by_heldout
from afdsvc.explain.explanation import OutputFit
from afdsvc.explain.verdict import Judgement, _absorbed, _explained_by_laws, _too_little
from afdsvc.explain.verify import Explained
from afdsvc.stats.periodic import Repeating, Share


@pytest.mark.parametrize(("fraction", "sd", "p_left", "withdrawn"), [
    (0.70, 0.05, 1e-6, True), (0.74, 0.05, 1e-6, True),
    (0.76, 0.05, 1e-6, False),  # within a standard error of enough
    (0.70, 0.05, 1e-3, False),  # what is left may be noise
    (0.90, 0.01, 1e-9, False),  # a law is never exact
])
def test_names_are_withdrawn_where_surely_too_little_goes_with_them(fraction, sd, p_left, withdrawn):
    assert _too_little(Explained(fraction, sd, None, None, p_left)) == withdrawn


@pytest.mark.parametrize(("before", "withdrawn"), [(1e-5, False), (1e-7, True)])
def test_a_constant_that_takes_strain_away_is_not_held_to_a_gap_that_would_not_count(before, withdrawn):
    repeats = Repeating(Share(500.0, 120.0, before, 2800), {}, (), 50000)
    assert _too_little(Explained(0.0, 0.28, repeats, repeats, before)) == withdrawn


@pytest.mark.parametrize(("residual", "said"), [(10.0, True), (12.0, False)])
def test_what_other_numbers_had_absorbed_is_said_where_it_is_most_of_the_evidence(residual, said):
    words = _absorbed(search(residual))
    assert ("1 standard deviations from what is stated instead of 5" in words) == said


@pytest.mark.parametrize(("physics", "before", "after", "explained"), [
    ("sensor_misalignment", [3.0, 4.0], [0.0, 1.0], 44 + 24),
    ("sensor_misalignment", [0.0, 1.0], [3.0, 4.0], 44),  # what the law itself puts on the numbers is no merit of it
    ("parameter_change", [3.0, 4.0], [0.0, 1.0], 0),
])
def test_a_law_explains_what_it_takes_off_the_model_s_numbers_too(physics, before, after, explained):
    assert _explained_by_laws(search(12.0, before, after, physics)) == pytest.approx(explained)


@pytest.mark.parametrize(("after", "claimed"), [((0.3, 0.5), True), ((0.43, 0.42), True), ((0.3, 0.6), False), ((0.3, np.inf), False)])
def test_names_that_do_worse_on_recordings_held_out_are_not_claimed(after, claimed):
    """Before: 0.4 and 0.4, together 0.57; beyond a tenth more nothing is claimed."""
    fits = [OutputFit(name, 0.4, value, None) for name, value in zip("ab", after, strict=True)]
    best = SimpleNamespace(ruling=SimpleNamespace(rivals=[SimpleNamespace(candidate=SimpleNamespace(key="cubic_stiffness@state:v"))]))
    judgement = _by_heldout(Judgement("omitted_physics", ("99 % of the gap is explained",), True), fits, SimpleNamespace(steps=[best]))
    assert judgement.keeps == claimed
    assert (judgement.verdict == "unexplained") != claimed
    assert claimed or "cubic_stiffness@state:v first) do worse" in judgement.sentences[0]


def test_what_names_noise_alone_is_not_held_to_it():
    named = Judgement("omitted_physics", ("coloured",), True)
    assert _by_heldout(named, [OutputFit("a", 0.4, 0.6, None)], SimpleNamespace(steps=[])) is named


def search(residual: float, before: Sequence[float] = (3.0, 4.0), after: Sequence[float] = (0.0, 1.0), physics: str = "law") -> Any:
    """Return the ends of a search: the strain falls from 25 to 1, the sum of squares from that of the residual to 100."""
    start, end = (
        SimpleNamespace(
            objective=SimpleNamespace(vector=lambda point, e=e: np.array([e])),
            point=SimpleNamespace(theta=np.array(theta), effects=[SimpleNamespace(hypothesis=SimpleNamespace(physics=physics))]),
        )
        for e, theta in ((residual, before), (10.0, after))
    )
    return SimpleNamespace(start=start, end=end)
