"""What the recordings say of a signal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.model import Variable
from afdsvc.api.physics import Signal
from afdsvc.api.signals import Channel, Trace
from afdsvc.dataset.experiment import prepare
from afdsvc.explain.search.build import build
from afdsvc.explain.search.fit import fit
from afdsvc.explain.search.machine import _sizes, bandwidth, hypotheses, machine
from afdsvc.explain.settings import Settings
from afdsvc.explain.simulate.nominal import nominal
from afdsvc.plugins.physics.parameter_change import ParameterChange
from afdsvc.testing.conformance.physics import machines


@pytest.mark.parametrize(("low", "high", "reverses"), [(-1.0, 1.0, True), (-0.2, 1.0, True), (-0.02, 1.0, False), (0.5, 1.0, False), (-1.0, -0.5, False)])
def test_a_signal_reverses_where_both_signs_are_more_than_noise_about_rest(low, high, reverses):
    (size,) = _sizes([Variable("w", "rad/s")], np.linspace(low, high, 1000)[:, None])
    assert size.reverses is reverses


def test_a_signal_reaches_as_far_from_its_mean_as_its_peak():
    (size,) = _sizes([Variable("gap", "mm")], np.concatenate([np.full(999, 5.0), [9.0]])[:, None])
    assert size.reach == pytest.approx(4.0, rel=1e-3)


@pytest.mark.parametrize(("bias", "shift", "positive"), [(0.0, 0.0, False), (0.0, 10.0, True), (10.0, -10.0, False)])
def test_a_sensor_that_lost_the_sign_reads_what_the_model_reverses_fitted_or_as_stated(spring, recorded, bias, shift, positive):
    """The reading is never negative; nor is the simulation, once its zero is fitted to the reading, or of the model as stated under a constant force."""
    trace = recorded(1)
    rectified: Trace = replace(trace, values=np.column_stack([trace.values[:, 0] + bias, np.abs(trace.values[:, 1])]))
    problem = build(nominal(spring, trace.dt), prepare(spring, [rectified]), Settings())
    base = fit(problem, replace(problem.start(), offset=np.array([shift])), 0.0, 1.0, iterations=0)
    fitted, stated = (np.vstack([s.y for s in problem.simulated(point, 0.0)])[400:] for point in (base.point, problem.start()))
    assert ((fitted > 0).all(), (stated > 0).all()) == (positive, bias > 0)
    assert machine(problem, base, 0.0).outputs[0].reverses


@pytest.mark.parametrize("bias", [0.0, 2.0])
def test_where_no_input_moves_the_band_is_that_of_the_outputs(spring, recorded, bias):
    """A spring at 100 rad/s that decays; the input is recorded, and at rest."""
    trace = recorded(1, decay=True, periods=1, noise=1e-4)
    still = replace(trace, channels=(Channel("u_force"), *trace.channels), values=np.column_stack([np.full(len(trace), bias), trace.values]))
    assert bandwidth(prepare(spring, [still])) == pytest.approx(100, rel=0.2)


@pytest.mark.parametrize(("unit", "found"), [("mm/s", True), ("N", False)])
def test_waves_are_looked_for_along_the_integral_of_a_speed_that_is_an_input(spring, recorded, unit, found):
    """The reading holds a wave of 4 rad per unit of the integral of the input."""
    trace = recorded(1)
    u = 5.0 + trace.values[:, 0]
    wavy: Trace = replace(trace, values=np.column_stack([u, trace.values[:, 1] + 5.0 + 2 * np.cos(4.0 * np.cumsum(u) * trace.dt)]))
    model = replace(spring, inputs=(replace(spring.inputs[0], unit=unit),))
    problem = build(nominal(model, wavy.dt), prepare(model, [wavy]), Settings())
    base = fit(problem, problem.start(), 0.0, 1.0, iterations=0)
    waves = machine(problem, base, 0.0).waves.get(Signal("u", 0), ())
    assert bool(waves) is found
    assert not found or waves[0] == pytest.approx(4.0, rel=0.1)


@pytest.mark.parametrize(("parts", "driven"), [((1.0,), True), ((0.0,), False), ((0.02,), False), ((0.0, 0.1), True)])
def test_a_machine_is_driven_where_an_input_goes_on_changing_in_some_recording(spring, recorded, parts, driven):
    traces = []
    for k, part in enumerate(parts):
        trace = recorded(k)
        values = trace.values.copy()
        values[len(values) // 2 :, 0] = 3.0 + part * values[len(values) // 2 :, 0]
        traces.append(replace(trace, values=values))
    problem = build(nominal(spring, traces[0].dt), prepare(spring, traces), Settings())
    assert machine(problem, fit(problem, problem.start(), 0.0, 1.0, iterations=0), 0.0).driven is driven


def test_laws_that_read_more_signals_than_the_simulation_carries_are_left_out():
    motor = machines()[2]
    gain = next(iter(ParameterChange().hypotheses(motor)))

    class Wide:
        name, summary = "wide", ""

        def hypotheses(self, machine):
            return [replace(gain, reads=gain.reads * k) for k in (16, 17)]

    assert [len(h.reads) for h in hypotheses([Wide()], motor)] == [16]
