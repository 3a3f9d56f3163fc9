"""Location on closed-loop recordings of the trial generator: the right output, what it depends on, and silence on noise.

The generator integrates by other means and uses other laws than the map's columns, so agreement is no identity.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from afdsvc.dataset.experiment import Run, prepare
from afdsvc.explain.baseline import Baseline, baseline
from afdsvc.explain.locate import locate
from afdsvc.explain.nominal import nominal
from afdsvc.files.model.model_file import read_model
from afdsvc.trial import Options, generate
from afdsvc.trial.generate import Trial
from afdsvc.trial.model_text import model_text

CASES = {
    # physics, site: output, words that must be among depends_on, input; all at rho 0.3
    ("coulomb_friction", "state:horizontal_rate"): ("horizontal", {"velocity sign"}, None),
    ("cubic_stiffness", "state:vertical_rate"): ("vertical", {"position", "amplitude"}, None),
    ("transport_delay", "input:vertical"): ("vertical", {"input", "frequency"}, "vertical"),
    ("hysteresis", "input:horizontal"): ("horizontal", {"input", "history"}, "horizontal"),
    ("unbalance", "machine"): ("horizontal", {"rotor angle"}, None),
    ("runout", "output:vertical"): ("vertical", {"rotor angle"}, None),
    ("periodic_disturbance", "output:horizontal"): ("horizontal", {"time"}, None),
    ("sensor_drift", "output:horizontal"): ("horizontal", {"time"}, None),
    ("sensor_crosstalk", "output:vertical"): ("vertical", {"output horizontal"}, None),
}


def prepared(trial: Trial, folder: Path) -> tuple[Baseline, list[Run]]:
    path = folder / "model.toml"
    path.write_text(model_text(trial.machine, trial.options.known_controller))
    model = read_model(path)
    runs = prepare(model, trial.recordings)
    return baseline(nominal(model, runs[0].dt), runs[:2]), runs[2:]


@cache
def _trial(physics: str, site: str | None, rho: float, seed: int) -> Trial:
    return generate(physics, site, rho, np.random.default_rng(seed), Options(periods=3))


@pytest.mark.parametrize(("physics", "site"), CASES)
def test_an_effect_is_found_where_it_is_hidden(physics: str, site: str, tmp_path: Path):
    output, words, port = CASES[physics, site]
    base, more = prepared(_trial(physics, site, 0.3, 3), tmp_path)
    places = locate(base, more)
    assert places
    assert places[0].output == output
    assert words <= set(places[0].depends_on)
    assert places[0].input == port
    assert 0.01 < places[0].share_of_residual_power < 0.5
    assert places[0].evidence.startswith(f"output {output}: ")


def test_noise_alone_is_nowhere(tmp_path: Path):
    """Parameters are off by their stated uncertainty, nothing is hidden: no place is named."""
    for seed in range(2):
        base, more = prepared(generate("nothing", None, 0.0, np.random.default_rng([7, seed]), Options(periods=3)), tmp_path)
        assert locate(base, more) == ()


@pytest.mark.long
@pytest.mark.parametrize("noise", ["white", "coloured", "process", "louder"])
def test_false_locations_are_rarer_than_one_in_ten(noise: str, tmp_path: Path):
    """60 recordings of each kind of noise: at most two false locations refute a rate of 10 % at 95 % confidence."""
    count = 60
    false = 0
    for seed in range(count):
        trial = generate("nothing", None, 0.0, np.random.default_rng([11, seed]), Options(noise=noise))
        base, more = prepared(trial, tmp_path)
        false += bool(locate(base, more))
    assert stats.binomtest(false, count, 0.1, alternative="less").pvalue < 0.05


def test_a_tone_is_told_from_an_answer_to_the_excitation(tmp_path: Path):
    """A mains tone that fits the period of the excitation repeats with it, but is equally tall at every level."""
    base, more = prepared(_trial("periodic_disturbance", "output:horizontal", 0.3, 1), tmp_path)
    (place,) = locate(base, more)
    assert place.kind == "noise"
    assert place.band_hz[0] == pytest.approx(50.0, abs=0.2)
    assert "mains" in place.evidence
