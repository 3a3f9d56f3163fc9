"""The step that takes what slow noise moved out of a residual."""

import importlib.util
from pathlib import Path

import numpy as np

from afdsvc.dataset.experiment import prepare
from afdsvc.explain.locate.residual import by_innovations
from afdsvc.explain.noise.surrogates import autoregressive, whiten
from afdsvc.explain.search.build import build
from afdsvc.explain.search.fit import Coordinates, fit, weighted
from afdsvc.explain.settings import Settings
from afdsvc.explain.simulate.nominal import nominal

_spec = importlib.util.spec_from_file_location("motor", Path(__file__).parents[1] / "motor.py")
motor = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(motor)
ORDER = 20


def test_the_step_by_innovations_ends_where_they_and_the_prior_cost_least():
    model = motor.model()
    runs = prepare(model, [motor.recording(0.0, s, noise=8.0, name=f"r{s}") for s in (1, 2)])
    p = build(nominal(model, runs[0].dt), runs, Settings())
    f = fit(p, p.start(), 0.0, 20.0)
    c = Coordinates(p, f.point)
    a = autoregressive([e[:, 0] for e in f.residuals], ORDER)

    def innovations(q):
        return np.concatenate([whiten(e[:, 0], a) for e in weighted(p, c.unpack(q), 0.0)])

    q = c.pack(f.point)
    sd = innovations(q).std()

    def cost(q):
        return 0.5 * float(((innovations(q) / sd) ** 2).sum()) + c.penalty(q)

    found = c.pack(by_innovations(p, f, 0.0, ORDER))
    assert cost(found) < cost(q) - 0.1
    for k in range(c.size):
        for step in (-0.1, 0.1):
            moved = found.copy()
            moved[k] += step
            assert cost(moved) > cost(found) - 1e-3
