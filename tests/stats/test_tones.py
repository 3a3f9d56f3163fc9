"""Tones in what does not repeat: heard in all runs together, and never in noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal, stats

from afdsvc.dataset.experiment import Run
from afdsvc.stats.tones import HEARD, _together, tones

DT, PERIOD, PERIODS, OMEGA = 1e-3, 2000, 5, 110.9


def run() -> Run:
    n = PERIOD * PERIODS
    nothing = np.zeros((n, 1))
    return Run("r", DT, 0.0, nothing, nothing, np.zeros((n, 0)), nothing, (), period=PERIOD)


def noise(rng: np.random.Generator) -> np.ndarray:
    return rng.standard_normal((PERIOD * PERIODS, 1))


def with_tone(rng: np.random.Generator, amplitude: float, omega: float = OMEGA) -> np.ndarray:
    t = DT * np.arange(PERIOD * PERIODS)
    return noise(rng) + amplitude * np.sin(omega * t + rng.uniform(0, 2 * np.pi))[:, None]


def test_a_weak_tone_is_heard_in_two_runs_where_one_may_miss_it():
    alone, found = 0, []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        two = [with_tone(rng, 0.12) for _ in range(2)]
        alone += bool(tones([run()], two[:1]))
        found += tones([run()] * 2, two)[:1]
    assert alone <= 24
    assert len(found) >= 28
    assert [t.omega for t in found] == pytest.approx([OMEGA] * len(found), abs=np.pi / (PERIOD * PERIODS * DT))
    assert np.median([t.amplitude for t in found]) == pytest.approx(0.12, rel=0.2)


def test_noise_has_no_tones():
    """Sixty machines of which one in hundreds may say otherwise; what is left of noise where its repeating part was taken out counts."""
    rng = np.random.default_rng(7)
    assert sum(bool(tones([run()] * 3, [noise(rng) for _ in range(3)])) for _ in range(60)) <= 1


@pytest.mark.parametrize("count", [1, 2, 5])
def test_heights_together_are_as_improbable_as_a_single_one_of_that_height(count):
    """Oracle: the exponential law of one line of white noise, by its median."""
    rng = np.random.default_rng(count)
    heights = [np.sqrt(rng.exponential(size=20000) / np.log(2)) for _ in range(count)]
    assert stats.kstest(np.log(2) * _together(heights) ** 2, "expon").pvalue > 1e-3


def test_what_towers_beyond_all_numbers_is_no_infinity():
    loud = np.array([1e6])
    assert np.isfinite(_together([loud, loud])[0])
    assert _together([loud, loud])[0] > 1e6 > HEARD


def test_weak_mains_are_heard_beside_a_line_of_the_excitation():
    """49.95 Hz, a twentieth of a hertz from a line, where other tones are not looked for."""
    found = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        found += tones([run()] * 2, [with_tone(rng, 0.14, 2 * np.pi * 49.95) for _ in range(2)])[:1]
    assert len(found) >= 18
    assert [t.omega for t in found] == pytest.approx([2 * np.pi * 49.95] * len(found), abs=2 * np.pi * 0.06)


def test_an_excitation_that_the_model_answers_wrongly_at_every_line_is_no_mains():
    t = DT * np.arange(PERIOD * PERIODS)
    for seed in range(10):
        rng = np.random.default_rng(seed)
        lines = np.arange(70, 131, 3)  # of 0.5 Hz, 50 Hz among them
        left = [noise(rng) + 0.14 * np.sin(2 * np.pi * np.outer(t, lines) / 2 + rng.uniform(0, 6, lines.size)).sum(1)[:, None] for _ in range(2)]
        assert not tones([run()] * 2, left)


def test_a_tone_is_heard_in_a_recording_without_inputs():
    """A free decay has no drive, so every frequency is free of it."""
    decay = run()
    decay = Run("r", DT, 0.0, np.zeros((len(decay), 0)), decay.Y, np.zeros((len(decay), 0)), decay.Y, ())
    found = tones([decay], [with_tone(np.random.default_rng(0), 0.5)])
    assert [t.omega for t in found] == pytest.approx([OMEGA], abs=np.pi / (PERIOD * PERIODS * DT))


def driven(omega: float, sine: float = 0.0, width: float = 2.7) -> tuple[Run, np.ndarray]:
    """Return a run under random levels held 20 samples, a sine of the input among them, and what a resonance of 30 rad/s, that decays with the rate ``width``, makes of it."""
    rng, n = np.random.default_rng(int(omega)), 16000
    t = DT * np.arange(n)
    u = np.repeat(rng.uniform(-1, 1, n // 20), 20) + sine * np.sin(omega * t)
    pole = np.exp((-width + 30j) * DT)
    left = signal.lfilter([30 * DT], np.real(np.poly([pole, pole.conjugate()])), u) * DT * 30
    return Run("r", DT, 0.0, u[:, None], left[:, None], np.zeros((n, 0)), np.zeros((n, 1)), ()), (left + 0.05 * rng.standard_normal(n))[:, None]


@pytest.mark.parametrize("omega", [41.0, 63.3, 90.0])
def test_a_single_line_where_the_excitation_has_power_is_a_tone(omega):
    run, left = driven(omega)
    left = left + 0.2 * np.sin(omega * DT * np.arange(len(left)) + 1)[:, None]
    assert [t.omega for t in tones([run], [left])] == pytest.approx([omega], abs=np.pi / (len(left) * DT))


def test_a_resonance_that_the_excitation_drives_is_no_tone():
    """Its peak is fourteen lines wide; of 60 random levels, one in hundreds may say otherwise."""
    assert sum(bool(tones([run], [left])) for run, left in (driven(100.0 + k) for k in range(60))) <= 1


def test_a_line_of_the_input_is_no_tone_of_another_recording():
    """Two recordings of one length; a sine drives one of them, which the model answers wrongly."""
    (sine, left), (levels, other) = driven(63.3, 4.0), driven(64.0)
    left = left + 0.5 * np.sin(63.3 * DT * np.arange(len(left)))[:, None]
    assert not tones([levels, sine], [other, left])


def test_a_resonance_that_one_recording_drives_is_no_tone_of_all():
    """A recording at rest has no excitation that could explain it."""
    rng = np.random.default_rng(1)
    levels, left = driven(64.0, width=0.9)
    rest = replace(levels, U=0 * levels.U)
    assert not tones([rest, levels], [0.05 * rng.standard_normal(left.shape), left])


@pytest.mark.parametrize("known", [False, True])
def test_a_tone_that_the_controller_answers_is_one_where_the_excitation_has_none(known):
    """The input of a loop has a line where the output has one; the reference, or what is added to the controller's output, does not."""
    run, left = driven(63.3)
    tone = 0.2 * np.sin(63.3 * DT * np.arange(len(left)) + 1)[:, None]
    loop = replace(run, U=run.U + 5 * tone, **({"W": run.U} if known else {"REF": run.U}))
    assert not tones([replace(run, U=run.U + 5 * tone)], [left + tone])
    assert [t.omega for t in tones([loop], [left + tone])] == pytest.approx([63.3], abs=np.pi / (len(left) * DT))
