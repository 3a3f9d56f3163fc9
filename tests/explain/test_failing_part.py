"""A number of the model that changes at one moment, within a recording or between two, is named with its new value."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.explain.pipeline import explain
from afdsvc.files.model.improved import write_improved
from afdsvc.files.model.model_file import read_model
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics import BUILT_IN

DT, DECAY, GAIN, LOSS, NOISE = 0.01, 4.0, 20.0, -0.3, 0.3
SOME = ("offset_step", "parameter_step", "parameter_drift", "parameter_change", "supply_droop", "clock_offset", "actuator_lag")
MOTOR = Model(
    "motor", (Variable("voltage", "V"),), (Variable("speed", "rad/s"),), (Variable("speed", "rad/s"),), StateSpace.of([[-DECAY]], [[GAIN]], [[1.0]]),
    entry_sd={"A": np.array([[0.2]]), "B": np.array([[1.0]])},
)


def recording(seed: int, samples: int, fails: float, begins: float = 0.0, loss: float = LOSS, load: float = 0.0, bias: float = 0.0) -> Trace:
    """A motor whose gain falls at the time ``fails``, or that is loaded [V] or read with a bias from then on, exactly for a held voltage that fades in;
    recordings begin at their time ``begins``."""
    rng = np.random.default_rng(seed)
    t = begins + DT * np.arange(samples)
    u = np.repeat(rng.normal(size=samples // 10 + 1), 10)[:samples] * np.minimum(1, np.arange(samples) / (samples / 4))
    keep, speed, x = np.exp(-DECAY * DT), [], 0.0
    for now, volts in zip(t, u, strict=True):
        speed.append(x + (bias if now >= fails else 0.0))
        x = keep * x + (1 - keep) * GAIN / DECAY * (volts + (loss * volts + load if now >= fails else 0.0))
    y = np.array(speed) + NOISE * rng.standard_normal(samples)
    return Trace(f"r{seed}", DT, (Channel("u_voltage", "V"), Channel("y_speed", "rad/s")), np.column_stack([u, y]), t0=begins)


def within() -> tuple[list[Trace], Trace]:
    """One recording, and one after it, on the same clock."""
    return [recording(1, 3000, 12.0)], recording(2, 1500, 12.0, 40.0)


def between() -> tuple[list[Trace], Trace]:
    """Twelve recordings that each begin at zero: the first three are of the machine as stated."""
    return [recording(k, 1500, np.inf if k < 3 else 0.0) for k in range(12)], recording(20, 1500, 0.0)


def undone() -> tuple[list[Trace], Trace]:
    """It fails within the first of two recordings, or of none that says which came first, and once more in the one held out."""
    return [recording(1, 3000, 12.0), recording(3, 1500, np.inf)], recording(2, 1500, 7.0)


@pytest.mark.parametrize(("recorded", "first", "last"), [(within, 11.0, 13.0), (between, 41.0, 49.0), (undone, 11.0, 13.0)])
def test_a_gain_that_falls_at_one_moment_is_named_and_modelled_as_it_is_then(recorded, first, last, tmp_path: Path):
    given, held = recorded()
    found = explain(MOTOR, given, [held], [p() for p in BUILT_IN if p.name in SOME], experiment=False)
    assert {(n.physics, n.site) for n in found.named} == {("parameter_step", "input:voltage"), ("parameter_step", "output:speed")}  # their product is seen
    for named in found.named:
        assert next(iter(named.parameters.values())).value == pytest.approx(LOSS, abs=0.03)
        assert first < named.parameters["moment"].value < last
    assert found.fit[0].after_nrmse == pytest.approx(NOISE / held.values[:, 1].std(), rel=0.05)
    (at,) = {float(m[1]) for s in found.sentences if (m := re.search(f"the change comes at (.*) s of {'r[23]' if recorded is between else 'r1'};", s))}
    assert at <= 15.0
    (written,) = write_improved(found, tmp_path / "MODEL.toml", {})
    plant = read_model(written).plant
    assert -(plant.C @ plant.B / plant.A).item() == pytest.approx((1 + LOSS) * GAIN / DECAY, rel=0.05)


@pytest.mark.parametrize(("event", "site"), [({"load": 0.4}, "state:speed"), ({"bias": 1.5}, "output:speed")])
def test_a_load_and_a_bias_that_begin_at_one_moment_are_distinguished(event, site):
    given, held = [recording(1, 3000, 12.0, loss=0.0, **event), recording(3, 1500, np.inf)], recording(2, 1500, 7.0, loss=0.0, **event)
    found = explain(MOTOR, given, [held], [p() for p in BUILT_IN if p.name in SOME], experiment=False)
    first = found.named[0]
    assert (first.physics, first.site) == ("offset_step", site)
    assert next(iter(first.parameters.values())).value == pytest.approx(next(iter(event.values())), rel=0.05)
    assert 11.5 < first.parameters["moment"].value < 12.5
    assert found.fit[0].after_nrmse == pytest.approx(NOISE / held.values[:, 1].std(), rel=0.05)
