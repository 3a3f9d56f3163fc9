"""The turboexpander: unstable, with the published sizes; small model, faults and controllers judged by the full one."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.api.control_plugins import DesignedController
from afdsvc.lti.coprime import Factorisation
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.lft import fault_signature, star
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.whitening import whitening_filter
from afdsvc.lti.yjbk import deviation_system
from afdsvc.plants.amb_turboexpander import BALANCE_GRADE, RECOMMENDED, amb_turboexpander, turboexpander_rotor
from afdsvc.plugins.controllers.lqg import Lqg
from afdsvc.plugins.controllers.pid import Pid

BAND = np.concatenate([[0.0], np.geomspace(30.0, 20000.0, 40)])  # rad/s
STIFFNESSES = ("stiffness_a_x", "stiffness_b_y")


def designed(kind: str, plant: StateSpace | None = None) -> DesignedController:
    plugin = {"lqg": Lqg(), "pid": Pid()}[kind]
    return plugin.design(amb_turboexpander().discrete() if plant is None else plant, RECOMMENDED[kind])


def decibels(small: StateSpace, full: StateSpace) -> np.ndarray:
    """Return the largest difference of singular values at every frequency of the band."""
    a, b = (np.linalg.svd(frequency_response(g, BAND), compute_uv=False) for g in (small, full))
    return np.abs(20 * np.log10(a / b)).max(axis=1)


def test_sizes_are_the_published_ones() -> None:
    """P1 section 3: 40 nodes, 320 states, 8 after reduction, four currents in, four displacements out, unstable."""
    full, plant = turboexpander_rotor(31500.0), amb_turboexpander()
    assert full.rotor.nodes == 40
    assert full.full_system(plant.values()).order == 320
    G = plant.continuous()
    assert (G.order, G.inputs, G.outputs) == (8, 4, 4)
    assert (G.poles().real > 100).sum() == 4


def test_eight_states_agree_with_the_full_model_in_the_band_of_control() -> None:
    """Within 1 dB to 15,000 rad/s and within 2.5 dB to 20,000; with the first two bending pairs within 0.3 dB throughout."""
    rotor, values = turboexpander_rotor(31500.0), amb_turboexpander().values()
    full = rotor.full_system(values)
    eight, sixteen = decibels(amb_turboexpander().continuous(), full), decibels(amb_turboexpander(states=16).continuous(), full)
    assert eight[BAND <= 15000].max() < 1.0
    assert eight.max() < 2.5
    assert sixteen.max() < 0.3


@pytest.mark.parametrize("states", [8, 16])
@pytest.mark.parametrize("theta", [-0.5, 0.5])
def test_mapped_stiffness_change_is_that_of_the_changed_full_model(states: int, theta: float) -> None:
    """P1 eqs. 48-52. The oracle reduces the changed full model anew; 1e-4 where 1e-2 was asked for."""
    plant, rotor = amb_turboexpander(states=states), turboexpander_rotor(31500.0)
    for name in STIFFNESSES:
        changed = plant.values({name: plant.parameters[name].value * (1 + theta)})
        a = frequency_response(plant.continuous(**{name: changed[name]}), BAND)
        b = frequency_response(rotor.reduced(changed, states), BAND)
        nominal = frequency_response(plant.continuous(), BAND)
        error = np.linalg.norm(a - b, 2, (1, 2)) / np.linalg.norm(b, 2, (1, 2))
        assert error.max() < 1e-4
        assert (np.linalg.norm(nominal - b, 2, (1, 2)) / np.linalg.norm(b, 2, (1, 2))).max() > 0.05


def test_current_gain_is_the_full_models() -> None:
    plant, rotor = amb_turboexpander(states=16), turboexpander_rotor(31500.0)
    found = frequency_response(plant.continuous(current_gain_b_x=120.0), BAND)
    wanted = frequency_response(rotor.full_system(plant.values({"current_gain_b_x": 120.0})), BAND)
    ratio = np.abs(found - wanted).max(axis=(1, 2)) / np.abs(wanted).max(axis=(1, 2))
    assert ratio[BAND < 5000].max() < 0.01


def test_sampled_faults_are_those_of_the_sampled_changed_plant() -> None:
    plant = amb_turboexpander()
    augmented = plant.faults()
    assert len(augmented.fault_names) == 12
    for name in STIFFNESSES:
        wanted = plant.discrete(**{name: plant.parameters[name].value * 0.8})
        found = augmented.close({name: -0.2})
        assert all(np.allclose(getattr(found, m), getattr(wanted, m), rtol=0, atol=1e-10) for m in "ABCD")


@pytest.mark.parametrize("kind", ["lqg", "pid"])
def test_recommended_controllers_hold_the_full_rotor_and_every_fault(kind: str) -> None:
    """Robustness is judged on 320 states the design never saw: stable, sensitivity peak below 2 (6 dB)."""
    plant = amb_turboexpander()
    K = designed(kind).factorisation.K
    full = sample_zoh(turboexpander_rotor(31500.0).full_system(plant.values()), plant.sample_time)
    assert np.abs(star(full, K, 4, 4).poles()).max() < 1
    w = np.geomspace(10, 30000, 80)
    loop = np.eye(4) - frequency_response(full, w) @ frequency_response(K, w)
    assert (1 / np.linalg.svd(loop, compute_uv=False)[:, -1]).max() < 2.0
    augmented = plant.faults()
    for name in augmented.fault_names:
        for theta in (-0.5, 0.5):
            assert np.abs(star(augmented.close({name: theta}), K, 4, 4).poles()).max() < 1, (name, theta)


def bezout_residual(f: Factorisation) -> float:
    w = np.geomspace(1, 30000, 40)
    R, Lf = frequency_response(f.R, w), frequency_response(f.Lf, w)
    return float(np.abs(Lf @ R - np.eye(R.shape[1])).max())


@pytest.mark.parametrize("kind", ["lqg", "pid"])
@pytest.mark.parametrize("rpm", [6000, 31500])
def test_identities_hold_on_it(kind: str, rpm: int) -> None:
    """Double Bezout identity; S(0) = 0; S(theta) is the deviation of the changed plant; the residual is white."""
    plant = amb_turboexpander(rpm)
    G = plant.discrete()
    design = designed(kind, G)
    assert bezout_residual(design.factorisation) < 1e-9
    w = np.geomspace(10, 30000, 60)
    augmented = plant.faults(["stiffness_a_x", "b_y_sensor"])
    S = fault_signature(augmented, design.interconnection, {"stiffness_a_x": 0.5, "b_y_sensor": -0.2})
    assert S.is_stable()
    found = frequency_response(S, w)
    other = frequency_response(
        deviation_system(design.factorisation, augmented.close({"stiffness_a_x": 0.5, "b_y_sensor": -0.2})), w
    )
    assert np.abs(found - other).max() < 1e-9 * np.abs(found).max()
    healthy = frequency_response(fault_signature(augmented, design.interconnection, [0, 0]), w)
    assert np.abs(healthy).max() < 1e-9 * np.abs(found).max()
    filter_, covariance = whitening_filter(design.factorisation, plant.output_cov)
    noise = frequency_response(filter_ @ design.factorisation.Mt, w)
    spectrum = noise @ plant.output_cov @ np.swapaxes(noise.conj(), 1, 2)
    assert np.abs(spectrum - covariance).max() < 1e-6 * np.abs(covariance).max()
    # an unstable plant with output noise alone: det Xi / det Rv is the product of its unstable poles squared
    unstable = np.abs(G.poles())[np.abs(G.poles()) > 1]
    assert np.linalg.det(covariance) / np.linalg.det(plant.output_cov) == pytest.approx(np.prod(unstable) ** 2, rel=1e-6)


def test_unbalance_of_grade_2_5_is_an_eccentricity_of_three_quarters_of_a_micrometre() -> None:
    """ISO 21940: 2.5 mm/s at 31,500 rpm is 0.758 um; the free rotor whirls about its centre of mass with just that."""
    rotor, plant = turboexpander_rotor(31500.0), amb_turboexpander()
    currents = rotor.unbalance(BALANCE_GRADE)
    y = frequency_response(rotor.full_system(plant.values()), [rotor.speed])[0] @ currents
    eccentricity = BALANCE_GRADE * 1e3 / rotor.speed
    assert eccentricity == pytest.approx(0.758, abs=1e-3)
    assert np.abs(y) == pytest.approx(np.full(4, eccentricity), rel=0.25)
    assert np.allclose(y[1::2] / y[0::2], -1j, atol=1e-3)
    assert not turboexpander_rotor(0.0).unbalance(BALANCE_GRADE).any()


@pytest.mark.parametrize("rpm", [0.0, 6000.0, 21000.0])
def test_speed_is_a_parameter_of_the_same_states(rpm: float) -> None:
    """The basis of full speed serves every speed: the oracle is the model reduced anew from the full rotor turning so."""
    speed = 2 * np.pi * rpm / 60
    plant, rotor = amb_turboexpander(), turboexpander_rotor(31500.0)
    assert plant.at_speed is not None
    slower = plant.at_speed(speed)
    a, b = (frequency_response(g, BAND) for g in (slower.continuous(), rotor.full_system(slower.values())))
    own = frequency_response(turboexpander_rotor(rpm).reduced(slower.values(), 8), BAND) if rpm else a
    error = np.linalg.norm(a - own, 2, (1, 2)) / np.linalg.norm(own, 2, (1, 2))
    assert error.max() < 5e-3
    assert np.abs(20 * np.log10(np.linalg.norm(a, 2, (1, 2)) / np.linalg.norm(b, 2, (1, 2))))[BAND < 15000].max() < 1.1
    assert slower.speed == speed
    assert slower.unbalance == pytest.approx(rotor.unbalance(BALANCE_GRADE) * (rpm / 31500) ** 2, rel=1e-12)


def test_speed_is_pulled_out_as_a_fraction_of_itself() -> None:
    plant = amb_turboexpander()
    assert plant.at_speed is not None
    found, wanted = plant.faults(["speed"]).close([-0.2]), plant.at_speed(0.8 * plant.speed).discrete()
    assert all(np.allclose(getattr(found, m), getattr(wanted, m), rtol=0, atol=1e-10) for m in "ABCD")
