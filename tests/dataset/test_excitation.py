"""What all recordings together excite: one frequency only where none of them has more."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.dataset.excitation import SINE, check_excitation
from afdsvc.dataset.experiment import prepare
from afdsvc.lti.statespace import StateSpace

N, DT = 1200, 0.01
T = np.arange(N) * DT


def _sine(frequency: float, level: float = 5.0) -> np.ndarray:
    return level * np.sin(2 * np.pi * frequency * T)


STEPS = np.repeat(np.random.default_rng(1).uniform(-1, 1, N // 50), 50)


@pytest.mark.parametrize(
    ("inputs", "sines", "said"),
    [
        ([_sine(1.0)], True, "one sine (1 Hz)"),
        ([_sine(1.0), _sine(1.0, 2.0)], True, "one sine"),
        ([_sine(1.0), _sine(1 / 0.99)], True, "one sine"),
        ([_sine(1.0), _sine(2.0)], True, "two sines (1 and 2 Hz)"),
        ([_sine(1.0), _sine(2.0), _sine(4.0)], False, "3 lines from 1 to 4 Hz"),
        ([_sine(1.0), STEPS], False, "non-periodic"),
    ],
    ids=["one", "one at two levels", "nearly one", "two", "three", "a loud sine and steps"],
)
def test_one_frequency_is_said_of_all_recordings_together(inputs, sines, said):
    plant = StateSpace(-np.eye(1), np.eye(1), np.eye(1), np.zeros((1, 1)))
    model = Model("motor", (Variable("voltage", "V"),), (Variable("speed", "rad/s"),), (Variable("speed", "rad/s"),), plant)
    traces = [Trace(f"log{k}", DT, (Channel("u_voltage"), Channel("y_speed")), np.column_stack([u, u])) for k, u in enumerate(inputs)]
    (finding,) = check_excitation(model, prepare(model, traces))
    assert (finding.topic == SINE) is sines
    assert said in finding.sentence
