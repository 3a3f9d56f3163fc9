"""Measured machines, no hints given: what is named first, and how much of the held-out error goes, beside published figures.

Sources: Janot, Gautier, Brunot 2019 (positioning axis); Wigren, Schoukens 2013 (oscillator); Hori-Fujimoto laboratory's motor
bench. Skipped where AFDSVC_DATA names no folder of recordings.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from afdsvc.api.signals import Trace
from afdsvc.explain.pipeline import explain
from afdsvc.explain.report.explanation import Estimate, Explanation
from afdsvc.explain.search.problem import NUISANCE
from afdsvc.explain.simulate.steps import substep_matrices
from afdsvc.files.model.model_file import read_model
from afdsvc.files.tables.tables import read_table
from afdsvc.lti.statespace import Array
from afdsvc.plugins.physics import afdsvc_physics


def answered(folder: Path, model: str, recording: Trace, held: str) -> Explanation:
    return explain(read_model(folder / model), [recording], [read_table(folder / held)], afdsvc_physics())


@pytest.mark.long
def test_the_positioning_axis_shows_dry_friction_then_an_offset(measured):
    """Published: Coulomb friction 20.39 N (with viscous friction beside it), offset 3.16 N."""
    folder = measured / "emps"
    answer = answered(folder, "model.toml", read_table(folder / "estimation.csv"), "pulses.csv")
    assert answer.verdict == "omitted_physics"
    assert "coloured_noise" not in [n.physics for n in answer.named]  # the model limits here, and what it leaves is coloured
    friction, offset = dry_friction(answer)
    assert friction.value == pytest.approx(20.39, abs=2 * friction.sd)
    assert friction.sd < 0.15 * friction.value
    assert abs(offset) == pytest.approx(3.16, rel=0.25)
    assert force_error(answer, read_table(folder / "pulses.csv")) <= 0.061


def dry_friction(answer: Explanation) -> tuple[Estimate, float]:
    """Return the friction named first and the constant load [N], which every fit of an integrating axis has."""
    assert answer.named[0].physics == "coulomb_friction"
    (load,) = (e.values[0] for e in answer.point.effects if e.hypothesis.physics == NUISANCE)
    return answer.named[0].parameters["force"], load / answer.nominal.at(answer.point.theta).B[1, 0]


def force_error(answer: Explanation, trace: Trace) -> float:
    """Return the relative error of the force in closed loop, the drive's position and velocity loops closed around the model.

    The published controller (kp 160.18, kv 243.45, 10 V, 35.15 N/V) acts on the simulated position; what the recording adds to
    its own command is added to the simulated one.
    """
    nominal, point = answer.nominal, answer.point
    dt, n = trace.dt, len(trace)
    ref, u, q = (trace.column(c) for c in ("ref_position", "u_force", "y_position"))
    commanded = _commands(ref, q, dt)
    added = u - commanded
    s = substep_matrices(nominal.at(point.theta), dt)  # one step of the model at a time: the loop is closed here, not in the simulation
    x, forces = np.array([q[0], 0.0]), np.zeros(n)
    memories = [np.zeros(e.hypothesis.memory) for e in point.effects]
    previous = q[0]
    for k in range(n):
        rate = (x[0] - previous) / dt if k else 0.0
        previous = x[0]
        volts = np.clip(160.18 * 243.45 * (ref[k] - x[0]) - 243.45 * rate, -10, 10)
        forces[k] = 35.15 * volts + added[k]
        push = np.zeros(2)
        for e, m in zip(point.effects, memories, strict=True):
            out = np.zeros(len(e.hypothesis.writes))
            e.hypothesis.law(e.values, np.array([x[r.index] for r in e.hypothesis.reads]), m, dt, out)
            for w, o in zip(e.hypothesis.writes, out, strict=True):
                push[w.index] += o
        x = s.phi @ x + s.gam[:, 0] * forces[k] + s.gx @ push
    return float(np.linalg.norm(u - forces) / np.linalg.norm(u))


def _commands(ref: Array, q: Array, dt: float) -> Array:
    rate = np.concatenate([[0.0], np.diff(q) / dt])
    return np.asarray(35.15 * np.clip(160.18 * 243.45 * (ref - q) - 243.45 * rate, -10, 10))


@pytest.mark.long
@pytest.mark.timeout(1200)
def test_the_oscillator_is_a_cubic_spring(measured):
    """Published arrow test: 13.55 mV for the best linear model of second order, 1.17 mV with one cubic term."""
    folder = measured / "silverbox"
    answer = answered(folder, "model_physical.toml", read_table(folder / "multisine.csv"), "arrow.csv")
    assert answer.named[0].physics == "cubic_stiffness"
    assert answer.named[0].weight > 0.99
    assert all(n.weight <= 0.8 and n.share_of_gap < 0.5 for n in answer.named[1:])  # of what a cubic term leaves; the circuit's own small errors
    (held,) = [c for c in answer.courses if c.role == "heldout"]
    assert np.sqrt(np.mean(held.residual_after**2)) < 0.7e-3


@pytest.mark.long
@pytest.mark.timeout(1200)
def test_the_two_mass_bench_shows_its_flexible_mode_first(measured):
    """Published: resonance about 77 Hz; a model of two inertias leaves 17.6 % and 15.9 % of the angles."""
    folder = measured / "two_mass"
    answer = answered(folder, "model.toml", read_table(folder / "multisine_A.csv"), "multisine_B.csv")
    assert answer.named[0].physics == "flexible_mode"
    assert answer.named[0].parameters["frequency"].value / (2 * np.pi) == pytest.approx(76.5, abs=1.0)
    assert all(f.after_nrmse < 0.166 for f in answer.fit)
    assert answer.remainder is not None
    assert answer.remainder.present
    assert {place.output for place in answer.located[:2]} == {"motor", "load"}
