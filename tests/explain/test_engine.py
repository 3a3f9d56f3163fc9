"""The simulation the search rests on, against an independent one, and a first look at measured data."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.api.model import Model
from afdsvc.api.signals import Channel, Trace
from afdsvc.dataset.experiment import prepare
from afdsvc.explain.baseline import baseline
from afdsvc.explain.fit import fit, screen
from afdsvc.explain.nominal import nominal
from afdsvc.explain.objective import tangent
from afdsvc.explain.simulator import Simulator
from afdsvc.explain.sizes import machine
from afdsvc.files.model.model_file import read_model
from afdsvc.files.tables.tables import read_table
from afdsvc.lti.simulate import simulate
from afdsvc.plants.gas_bearing import gas_bearing
from afdsvc.plugins.physics import afdsvc_physics


def bearing_model() -> Model:
    plant = gas_bearing()
    return Model(plant.name, plant.inputs, plant.outputs, plant.states, plant.continuous())


def test_without_effects_it_is_the_linear_plant():
    plant, model, rng = gas_bearing(), bearing_model(), np.random.default_rng(0)
    u = rng.standard_normal((2000, 2))
    y, _ = simulate(plant.discrete(), u)
    names = [f"u_{v.name}" for v in plant.inputs] + [f"y_{v.name}" for v in plant.outputs]
    trace = Trace("noise", plant.sample_time, tuple(Channel(n) for n in names), np.hstack([u, y]))
    (run,) = prepare(model, [trace])
    nom = nominal(model, plant.sample_time)
    found = Simulator(nom, np.zeros((nom.plant.order, 2))).run(run, np.zeros(len(nom.entries)), np.zeros(nom.plant.order))
    assert np.abs(found.y - y).max() < 1e-8 * np.abs(y).max()


def test_a_moved_entry_moves_the_simulation():
    plant, model, rng = gas_bearing(), bearing_model(), np.random.default_rng(0)
    u = rng.standard_normal((500, 2))
    names = [f"u_{v.name}" for v in plant.inputs] + [f"y_{v.name}" for v in plant.outputs]
    trace = Trace("noise", plant.sample_time, tuple(Channel(n) for n in names), np.hstack([u, 0 * u]))
    (run,) = prepare(model, [trace])
    nom = nominal(model, plant.sample_time)
    theta = np.zeros(len(nom.entries))
    theta[0] = 1.0
    moved = nom.at(theta)
    entry = nom.entries[0]
    assert abs(getattr(moved, entry.matrix)[entry.row, entry.column]) != abs(
        getattr(nom.plant, entry.matrix)[entry.row, entry.column]
    )
    still = Simulator(nom, np.zeros((nom.plant.order, 2)))
    a = still.run(run, theta, np.zeros(nom.plant.order)).y
    b = still.run(run, 0 * theta, np.zeros(nom.plant.order)).y
    assert np.abs(a - b).max() > 1e-6 * np.abs(b).max()


@pytest.mark.parametrize("physics", [p.name for p in afdsvc_physics()])
def test_every_hypothesis_has_a_name_of_the_field_and_says_what_it_is(physics):
    offered = next(p for p in afdsvc_physics() if p.name == physics)
    assert offered.summary
    assert offered.name == offered.name.lower().replace(" ", "_")


def test_the_oscillator_asks_for_a_cubic_stiffness(measured):
    """Screened and fitted on the estimation data, no hints: a hardening spring takes most of what is left.

    At these amplitudes a clearance, which hardens too, is its look-alike until the nominal parameters are refitted with each.
    """
    folder = measured / "silverbox"
    model, trace = read_model(folder / "model_physical.toml"), read_table(folder / "multisine.csv").span(0, 8192)
    base = baseline(nominal(model, trace.dt), prepare(model, [trace]))
    found = machine(base)
    here = tangent(base.objective, base.point)
    tried = sorted(
        (screen(here, h) for p in afdsvc_physics() for h in p.hypotheses(found)), key=lambda trial: trial.cost
    )
    fitted = sorted((fit(here, t.hypothesis, t.values) for t in tried[:8]), key=lambda trial: trial.cost)
    assert "cubic_stiffness" in [t.hypothesis.physics for t in fitted[:2]]
    assert fitted[0].cost < 0.5 * here.cost
