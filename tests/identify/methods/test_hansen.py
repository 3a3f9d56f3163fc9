"""Original and modified Hansen scheme: the signals of S, and both formulas back to the plant."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.errors import BadInput
from afdsvc.identify.methods.hansen import (
    excited_loop,
    loop_is_stable,
    rebuilt_plant,
    settling_samples,
    youla_signals,
)
from afdsvc.lti.coprime import Factorisation
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.python_control import factorise
from afdsvc.lti.simulate import simulate
from afdsvc.lti.stability import is_stable
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.lti.yjbk import closed_loop, deviation_system, exchange

OMEGA = np.geomspace(10, 15_000, 60)


def _scaled(plant, factor):
    return StateSpace(factor * plant.A, plant.B, plant.C, plant.D, plant.dt)


def original_hansen_signals(fact: Factorisation, r1: Array, r2: Array, recording: InputOutputData) -> InputOutputData:
    """Return the recording of S for known external signals: ``eta = Ut r1 + Vt r2`` (thesis 4.25), eps as above.

    ``r1 (N, p)`` is added to the measurement the controller sees, ``r2 (N, m)`` to the plant's input; u and y of the
    recording are the plant's own. Unlike `youla_signals` this does not read the excitation off the measurements.
    """
    filtered = youla_signals(fact, recording)
    m, start = fact.plant.inputs, len(recording) - len(filtered)
    both, _ = simulate(fact.Lf, np.hstack([r2, -r1]))
    return InputOutputData(both[start:, :m], filtered.y, recording.dt, recording.name)


def rebuilt_plant_right(fact: Factorisation, S: StateSpace):
    """Return ``G(S) = (N + V S)(M + U S)^-1`` (thesis 4.33): drive R with ``beta = S alpha`` and solve for u."""
    driven = fact.R @ _graph(S)
    m = fact.plant.inputs
    return exchange(driven, range(m), range(m)).select(slice(m, None), slice(None))


def rebuilt_plant_left(fact: Factorisation, S: StateSpace):
    """Return ``G(S) = (Mt + S Ut)^-1 (Nt + S Vt)`` (thesis 4.34): ``beta - S alpha = 0`` solved for y."""
    m, p = fact.plant.inputs, fact.plant.outputs
    mismatch = _kernel(S) @ fact.Lf  # [u, y] -> beta - S alpha
    return exchange(mismatch, range(m, m + p), range(p)).select(slice(None), slice(0, m))


def _graph(S: StateSpace):
    """Return ``alpha -> [alpha; S alpha]``."""
    m = S.inputs
    return StateSpace(S.A, S.B, np.vstack([np.zeros((m, S.order)), S.C]), np.vstack([np.eye(m), S.D]), S.dt)


def _kernel(S: StateSpace):
    """Return ``[alpha; beta] -> beta - S alpha``."""
    p = S.outputs
    return StateSpace(S.A, np.hstack([S.B, np.zeros((S.order, p))]), -S.C, np.hstack([-S.D, np.eye(p)]), S.dt)


@given(st.floats(0.5, 1.0), st.floats(0.8, 1.1), st.booleans())
@settings(max_examples=20, deadline=None)
def test_three_ways_from_S_to_the_true_plant(bearing, observer_loop, nominal_scale, true_gain, static):
    nominal = _scaled(bearing, nominal_scale)
    true = StateSpace(bearing.A, true_gain * bearing.B, bearing.C, bearing.D, bearing.dt)
    fact = factorise(nominal, StateSpace.gain(0.01 * np.eye(2), bearing.dt)) if static else observer_loop(nominal)
    S = deviation_system(fact, true)
    assume(is_stable(S.A, S.dt))  # only a plant that the controller stabilises has an S
    truth = frequency_response(true, OMEGA)
    for rebuild in (rebuilt_plant, rebuilt_plant_right, rebuilt_plant_left):
        found = frequency_response(rebuild(fact, S), OMEGA)
        assert np.abs(found - truth).max() < 1e-9 * np.abs(truth).max()


def test_filtered_signals_are_alpha_and_beta_themselves(bearing, observer_loop, run_loop, binary):
    fact, rng = observer_loop(_scaled(bearing, 0.97)), np.random.default_rng(1)
    d = 0.35 * rng.standard_normal((3000, 2))
    record, alpha, beta = run_loop(fact, bearing, binary(rng, 3000), d)
    found = youla_signals(fact, record)
    assert len(found) == 3000 - settling_samples(fact.Lf)
    assert np.abs(found.u - alpha[-len(found) :]).max() < 1e-9
    assert np.abs(found.y - beta[-len(found) :]).max() < 1e-9


def test_original_scheme_makes_eta_from_the_references_and_eps_obeys_S(bearing, observer_loop, run_loop, binary):
    """beta = S eta + (Mt + S Ut) d with eta = Ut r1 + Vt r2: checked with the disturbance switched off and on."""
    fact, rng = observer_loop(_scaled(bearing, 0.97)), np.random.default_rng(2)
    r1, r2, zero = binary(rng, 4000), binary(rng, 4000), np.zeros((4000, 2))
    S = deviation_system(fact, bearing)
    for d in (zero, 0.3 * rng.standard_normal((4000, 2))):
        # the loop adds r1 to the controller's input: plant recording holds y_m without it, u includes r2
        record, _, _ = run_loop(fact, bearing, zero, d, r1, r2)
        found = original_hansen_signals(fact, r1, r2, record)
        direct = youla_signals(fact, record)
        assert np.abs(found.u - direct.u).max() < 1e-8
        noise, _ = simulate(closed_loop(fact, bearing).path("beta", "d"), d)
        predicted = simulate(S, original_whole(fact, r1, r2))[0] + noise
        assert np.abs(found.y - predicted[-len(found) :]).max() < 1e-8


def original_whole(fact, r1, r2):
    """eta from the first sample on."""
    return simulate(fact.Lf, np.hstack([r2, -r1]))[0][:, :2]


def test_recording_without_excitation_has_eta_zero(bearing, observer_loop, run_loop):
    fact = observer_loop(bearing)
    record, _, _ = run_loop(fact, bearing, np.zeros((3000, 2)), np.random.default_rng(3).standard_normal((3000, 2)))
    assert np.abs(youla_signals(fact, record).u).max() < 1e-10
    assert np.abs(record.u).max() > 0.1  # although the plant's input moves


def test_excited_loop_is_the_answer_of_plant_and_controller_to_alpha(bearing, observer_loop, run_loop, binary):
    fact, rng = observer_loop(_scaled(bearing, 0.9)), np.random.default_rng(4)
    record, alpha, _ = run_loop(fact, bearing, binary(rng, 1000), np.zeros((1000, 2)))
    out, _ = simulate(excited_loop(fact, bearing), alpha)
    assert np.abs(out - np.hstack([record.u, record.y])).max() < 1e-10


def test_stability_of_the_loop_is_reported(bearing):
    """P5's gain of the right sign stabilises the bearing, the printed one (-0.2) does not (max |z| = 1.0094)."""
    assert loop_is_stable(bearing, StateSpace.gain(0.2 * np.eye(2), bearing.dt))
    assert not loop_is_stable(bearing, StateSpace.gain(-0.2 * np.eye(2), bearing.dt))


def test_recording_shorter_than_the_filters_memory_is_named(bearing, observer_loop):
    fact = observer_loop(bearing)
    needed = settling_samples(fact.Lf)
    short = InputOutputData.of(np.zeros((needed, 2)), np.zeros((needed, 2)), bearing.dt, "short.mcap")
    with pytest.raises(BadInput, match=rf"short.mcap: {needed} samples, but the controller's filter needs {needed}"):
        youla_signals(fact, short)
