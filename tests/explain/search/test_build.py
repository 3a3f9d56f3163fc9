"""How a plant that falls over by itself is simulated: in its loop where that can be closed, else corrected by the recordings."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import pytest

from afdsvc.dataset.experiment import prepare
from afdsvc.explain.search.build import build
from afdsvc.explain.settings import Settings
from afdsvc.explain.simulate.nominal import nominal

_spec = importlib.util.spec_from_file_location("odd_machines", Path(__file__).parents[1] / "test_odd_machines.py")
odd = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(odd)


@pytest.mark.parametrize(("known", "open_heldout", "closed"), [(True, False, True), (True, True, False), (False, False, False)])
def test_the_loop_is_closed_where_all_recordings_allow_it(known, open_heldout, closed):
    model = odd.falling(known)
    fitted, held = prepare(model, [odd.balanced(0, 0.3), odd.balanced(1, 0.2)])
    problem = build(nominal(model, odd.DT), [fitted], Settings(), [replace(held, W=None) if open_heldout else held])
    assert problem.closed == closed
    assert problem.settings.horizons == ((0.0,) if closed else Settings().horizons)
