"""Every kind that can be hidden shows in the recordings as asked, where it is hidden, and as its physics says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.errors import BadInput, Refused
from afdsvc.trial import NOTHING, Options, generate_several, generate_trial
from afdsvc.trial.catalogue import changes_at, outside_at, physics_at
from afdsvc.trial.conditions import TRAIN
from afdsvc.trial.effect import Truth
from afdsvc.trial.generate import BlindTrial, TrialRequest, difference, effect_visibility
from afdsvc.trial.simulation import play_run, replay

BEARING = Options(controller="proportional", periods=1)
AXIS = Options(machine="positioning_axis", periods=1)
VOCABULARY = """transport_delay actuator_lag resonant_actuator dead_zone saturation backlash hysteresis creep slew_limit
static_nonlinearity coulomb_friction stribeck_friction quadratic_damping cubic_stiffness quadratic_stiffness clearance
flexible_mode gyroscopic_coupling cross_coupled_stiffness unbalance constant_load gain_follows_aux stiffness_follows_aux
sensor_lag sensor_misalignment sensor_crosstalk sensor_offset sensor_drift sensor_nonlinearity sensor_rectification
sensor_saturation quantisation runout periodic_disturbance coloured_noise""".split()


def once(options: Options) -> list[tuple[str, str]]:
    """Return every name with every sort of site, on the first axis only."""
    machine = options.build()
    return [(n, s) for n, s in physics_at(machine) + outside_at(machine) + changes_at(machine) if "vertical" not in s]


def hidden(physics: str, site: str, options: Options = BEARING, rho: float = 0.3, seed: int = 11) -> BlindTrial:
    return generate_trial(physics, site, rho, np.random.default_rng(seed), options)


def effect_of(trial: BlindTrial, run: int = 0) -> np.ndarray:
    """What the effect adds to the recorded outputs under the same commands, shape (n, p)."""
    return difference(trial.machine, trial.truth, trial.runs[run], "commands")


def test_every_name_of_the_vocabulary_can_be_hidden_in_the_bearing() -> None:
    names = {name for name, _ in physics_at(BEARING.build())}
    assert names == set(VOCABULARY)
    assert len({name for name, _ in outside_at(BEARING.build())}) == 5


@pytest.mark.parametrize(("physics", "site"), once(BEARING))
def test_bearing_kind_is_seen_as_asked_where_it_is(physics: str, site: str) -> None:
    trial = hidden(physics, site)
    effect = trial.answer.hidden[0]
    assert effect.rho == pytest.approx(0.3, rel=0.05)
    assert (effect.physics, effect.site) == (physics.split(":")[0], site)
    if site != "machine":
        assert trial.answer.seen["horizontal"] > 3 * trial.answer.seen["vertical"]
    if not physics.startswith("parameter_change"):
        assert effect.parameters


BEYOND = {"creep", "static_nonlinearity", "gain_follows_aux", "quadratic_stiffness", "sensor_nonlinearity", "sensor_rectification"}


@pytest.mark.long
@pytest.mark.parametrize(("options", "rho", "beyond"), [(BEARING, 0.1, set()), (BEARING, 1.0, BEYOND), (AXIS, 0.1, set()), (AXIS, 1.0, set())])
def test_every_kind_at_every_site_reaches_rho(options: Options, rho: float, beyond: set[str]) -> None:
    """All but those that as large as the noise take the rotor out of its bearing, or have no such size."""
    machine = options.build()
    refused = []
    for physics, site in physics_at(machine) + outside_at(machine) + changes_at(machine):
        try:
            trial = hidden(physics, site, options, rho)
        except Refused:
            refused.append((physics, rho))
            continue
        assert trial.answer.hidden[0].rho == pytest.approx(rho, rel=0.05), (physics, site)
    assert {name for name, _ in refused} == beyond


@pytest.mark.parametrize(("physics", "site"), [x for x in once(AXIS) if x[0] in ("backlash", "stick_slip_events", "flexible_mode")])
def test_axis_kind_is_seen_as_asked(physics: str, site: str) -> None:
    assert hidden(physics, site, AXIS).answer.hidden[0].rho == pytest.approx(0.3, rel=0.05)


def test_visibility_is_what_a_bystander_measures() -> None:
    """Simulated twice by hand, with and without, under the commands of the recording."""
    trial = hidden("coulomb_friction", "state:vertical_rate")
    squares = []
    for run, signals in zip(trial.runs[:TRAIN], trial.played, strict=False):
        without = replay(trial.machine, Truth(trial.truth.theta), run, signals.u)
        squares.append((signals.y - without.y)[run.skip :] ** 2)
    rho = np.sqrt(np.mean(np.vstack(squares)) / np.mean(trial.machine.sigma**2))
    assert trial.answer.hidden[0].rho == pytest.approx(rho, rel=1e-9)


def test_closed_loop_visibility_differs_and_is_noted() -> None:
    trial = hidden("constant_load", "state:horizontal_rate")
    rho, _ = effect_visibility(trial.machine, trial.truth, trial.runs[:TRAIN], "loop")
    assert trial.answer.hidden[0].rho_loop == pytest.approx(rho)
    assert rho > 1.5 * trial.answer.hidden[0].rho  # positive feedback of position makes the loop softer at rest


def test_constant_load_moves_the_mean_by_the_static_stiffness() -> None:
    trial = hidden("constant_load", "state:horizontal_rate")
    A, _, C = trial.machine.matrices(trial.truth.theta)
    push = np.zeros(A.shape[0])
    push[2] = trial.answer.hidden[0].parameters["force"]["value"]
    assert effect_of(trial).mean(axis=0) == pytest.approx(-C @ np.linalg.solve(A, push), rel=0.05, abs=1e-3)


def test_offset_is_constant_and_drift_moves_towards_its_end() -> None:
    offset = effect_of(hidden("sensor_offset", "output:horizontal"))
    assert offset.std(axis=0).max() < 1e-9
    assert not offset[:, 1].any()
    drift = effect_of(hidden("sensor_drift", "output:horizontal"))[:, 0]
    assert (np.diff(np.abs(drift)) > 0).all()


def test_delay_and_lag_of_the_sensor_shift_the_output_by_their_time() -> None:
    for physics, name in (("transport_delay", "delay"), ("sensor_lag", "time_constant")):
        trial = hidden(physics, "output:horizontal", rho=0.5)
        tau = trial.answer.hidden[0].parameters[name]["value"]
        run = trial.runs[0]
        bare = replay(trial.machine, Truth(trial.truth.theta), run.quiet(), trial.played[0].u).y[run.skip :, 0]
        late = effect_of(trial)[:, 0]
        shift = -np.sum(late * np.gradient(bare)) / np.sum(np.gradient(bare) ** 2) * trial.machine.dt
        assert shift == pytest.approx(tau, rel=0.2), physics


def test_crosstalk_and_misalignment_mix_the_outputs() -> None:
    crosstalk = hidden("sensor_crosstalk", "output:horizontal")
    bare = crosstalk.played[0].y - difference_all(crosstalk)
    share = crosstalk.answer.hidden[0].parameters["share"]["value"]
    noiseless = bare - crosstalk.runs[0].noise
    assert np.allclose(difference_all(crosstalk)[:, 0], share * noiseless[:, 1], atol=1e-9)
    turned = effect_of(hidden("sensor_misalignment", "machine"))
    assert (turned.std(axis=0) > 0.05).all()


def difference_all(trial: BlindTrial) -> np.ndarray:
    whole = replace(trial.runs[0], skip=0)
    return difference(trial.machine, trial.truth, whole, "commands")


def test_runout_and_unbalance_turn_with_the_rotor() -> None:
    options = replace(BEARING, periods=4)
    for physics, site, lines in (("runout", "output:horizontal", 3), ("unbalance", "machine", 1)):
        trial = hidden(physics, site, options)
        seen = effect_of(trial)[:, 0]
        angle = trial.runs[0].aux[trial.runs[0].skip : -1, trial.machine.aux.index("angle")]
        power = [2 * abs(np.mean(seen * np.exp(-1j * n * angle))) ** 2 for n in range(1, 6)]
        assert sum(power[:lines]) > 0.9 * seen.var(), physics


def test_periodic_disturbance_keeps_its_frequency_and_changes_phase_between_recordings() -> None:
    trial = hidden("periodic_disturbance", "output:horizontal", replace(BEARING, periods=4))
    omega = trial.answer.hidden[0].parameters["frequency"]["value"]
    phases = []
    for i in range(TRAIN):
        seen = effect_of(trial, i)[:, 0]
        t = np.arange(seen.size) * trial.machine.dt
        line = np.mean(seen * np.exp(-1j * omega * t)) * 2
        assert abs(line) == pytest.approx(trial.answer.hidden[0].parameters["amplitude"]["value"], rel=0.05)
        phases.append(np.angle(line))
    assert abs(phases[0] - phases[1]) > 0.1


def test_coloured_noise_is_slow_and_ignores_the_excitation() -> None:
    trial = hidden("coloured_noise", "output:horizontal", replace(BEARING, periods=4))
    seen = effect_of(trial)[:, 0]
    assert np.corrcoef(seen[1:], seen[:-1])[0, 1] > 0.75
    assert abs(np.corrcoef(seen, trial.runs[0].alpha[trial.runs[0].skip :, 0])[0, 1]) < 0.05


def test_quantised_readings_lie_on_one_grid() -> None:
    trial = hidden("quantisation", "output:horizontal")
    p = trial.answer.hidden[0].parameters
    y = trial.recordings[0].column("y_horizontal")
    steps = (y - p["grid"]["value"]) / p["step"]["value"]
    assert np.abs(steps - np.round(steps)).max() < 1e-9


@pytest.mark.long
def test_gain_follows_the_pressure() -> None:
    trial = hidden("gain_follows_aux", "input:horizontal", replace(BEARING, periods=4))
    run = trial.runs[0]
    pressure = run.aux[run.skip : -1, trial.machine.aux.index("pressure")]
    sensed = np.abs(effect_of(trial)[:, 0])
    far = np.abs(pressure - pressure.mean()) > pressure.std()
    near = np.abs(pressure - pressure.mean()) < 0.3 * pressure.std()
    assert sensed[far].mean() > 2 * sensed[near].mean()


def test_stiffness_follows_the_pressure_on_both_axes() -> None:
    assert (effect_of(hidden("stiffness_follows_aux", "machine")).std(axis=0) > 0.03).all()


@pytest.mark.parametrize(
    ("parameter", "site", "row", "columns", "power"),
    [
        ("stiffness", "state:horizontal_rate", 2, slice(0, 2), 1),
        ("damping", "state:horizontal_rate", 2, slice(2, 4), 1),
        ("mass", "state:horizontal_rate", 2, slice(0, 6), -1),
        ("actuator gain", "input:vertical", slice(2, 4), 5, 1),
    ],
)
def test_parameter_change_moves_the_right_entries(parameter, site, row, columns, power) -> None:
    trial = hidden(f"parameter_change:{parameter}", site)
    change = trial.answer.hidden[0].parameters["change"]["value"]
    before, _, _ = trial.machine.matrices(trial.truth.theta)
    after, _, _ = trial.machine.matrices(trial.truth.constants())
    expected = before.copy()
    expected[row, columns] *= (1 + change) ** power
    assert np.allclose(after, expected)
    assert trial.answer.hidden[0].in_prior == pytest.approx(abs(change) / 0.02)


def test_lost_gains_are_losses() -> None:
    for parameter, site in (("actuator gain", "input:horizontal"), ("sensor gain", "output:horizontal")):
        assert hidden(f"parameter_change:{parameter}", site).answer.hidden[0].parameters["change"]["value"] < 0


def test_two_effects_are_both_there_each_with_its_own_rho() -> None:
    wishes = [TrialRequest("coulomb_friction", "state:horizontal_rate", 0.4), TrialRequest("sensor_offset", "output:vertical", 0.2)]
    trial = generate_several(wishes, np.random.default_rng(1), BEARING)
    assert [h.rho for h in trial.answer.hidden] == pytest.approx([0.4, 0.2], rel=0.05)
    seen = effect_of(trial)
    assert seen[:, 0].std() > 0.1
    assert abs(seen[:, 1].mean()) > 0.05


@pytest.mark.long
def test_dirt_is_small_unrelated_and_not_the_question() -> None:
    options = replace(BEARING, dirty=True)
    trial = generate_trial("dead_zone", None, 0.5, np.random.default_rng(2), options)
    assert len(trial.answer.minor) == 4
    assert {h.physics for h in trial.answer.minor}.isdisjoint({"dead_zone"})
    assert all(h.rho == pytest.approx(0.04, rel=0.06) for h in trial.answer.minor)
    assert len(trial.answer.hidden) == 1


@pytest.mark.parametrize(("kind", "ratio"), [("quieter", 0.5), ("louder", 2.0), ("coloured", 1.0)])
def test_noise_variants_change_what_they_say(kind: str, ratio: float) -> None:
    trial = generate_trial(NOTHING, None, 0.0, np.random.default_rng(6), replace(BEARING, noise=kind))
    noise = trial.runs[0].noise
    assert noise.std(axis=0) / trial.machine.sigma == pytest.approx([ratio] * 2, rel=0.15)
    lag_one = np.corrcoef(noise[1:, 0], noise[:-1, 0])[0, 1]
    assert (lag_one > 0.7) == (kind == "coloured")


def test_process_noise_drives_the_states() -> None:
    trial = generate_trial(NOTHING, None, 0.0, np.random.default_rng(6), replace(BEARING, noise="process"))
    run = trial.runs[0]
    calm = replace(run, push=0 * run.push)
    apart = (trial.played[0].y - play_run(trial.machine, trial.truth, calm).y)[run.skip :]
    assert apart.std(axis=0) / trial.machine.sigma == pytest.approx([0.4, 0.4], rel=0.2)


def test_unknown_names_and_sites_are_refused_by_name() -> None:
    with pytest.raises(BadInput, match="no place for 'phlogiston'"):
        hidden("phlogiston", None)  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="no site 'input:diagonal'"):
        hidden("dead_zone", "input:diagonal")
    with pytest.raises(BadInput, match="makes no sense"):
        hidden("dead_zone", "output:horizontal")
    with pytest.raises(Refused, match="a smaller one is wanted"):
        hidden("saturation", "input:horizontal", rho=50.0)
    with pytest.raises(BadInput, match="option noise is 'pink'"):
        Options(noise="pink")
