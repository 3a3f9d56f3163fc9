"""A seed gives the plan and the recordings it gave when the page of blind trials was made."""

from __future__ import annotations

import hashlib
import json

import numpy as np
import pytest

from afdsvc.trial import make_trial, plan

PLAN = "79bb788944edd7de44917fd403f1f3b50b0e3bb867c3aec9958bf6c2cd753594"
RMS = {  # root mean square of every column of the holdout
    0: [0.96807363, 0.966739734, 2.14953966, 2.22430926, 0.868320765, 0.868320765, 130.001841, 3.63398394, 6.02651542, 32.1572712],
    163: [552.348993, 0.00123818212, 497.077896, 0.00085054038, 48.2465314, 32.0520038],
    272: [0.744217072, 1.06015079, 1.67812355, 2.62059443, 0.446130188, 0.446130188, 129.993685, 3.63385562, 6.04708403, 32.054196],
}


def test_plan_of_the_published_study_is_unchanged() -> None:
    text = json.dumps([request.as_json() for request in plan(300, 2040)])
    assert hashlib.sha256(text.encode()).hexdigest() == PLAN


@pytest.mark.parametrize("number", RMS)
def test_recordings_of_the_published_study_are_unchanged(number: int) -> None:
    holdout = make_trial(plan(300, 2040)[number]).holdout.values
    assert np.sqrt(np.mean(np.square(holdout), axis=0)) == pytest.approx(RMS[number], rel=1e-7)
