"""Plants by name, and the two smaller plants."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.errors import BadInput
from afdsvc.plants.examples import random_stable, unstable_second_order
from afdsvc.plants.registry import PLANTS, plant


@pytest.mark.parametrize("name", sorted(PLANTS))
def test_every_plant_is_whole(name: str) -> None:
    p = plant(name)
    G = p.discrete()
    assert (len(p.outputs), len(p.inputs), len(p.states)) == (G.outputs, G.inputs, G.order)
    assert p.output_cov.shape == (G.outputs, G.outputs)
    assert p.output_limit.shape == (G.outputs,)
    assert p.input_limit.shape == (G.inputs,)
    faults = p.faults()
    assert faults.fault_names
    healthy = faults.close({})
    assert all(np.allclose(getattr(healthy, m), getattr(G, m), rtol=1e-13, atol=0) for m in "ABCD")
    assert p.source


def test_options_reach_the_plant_and_unknown_ones_are_named() -> None:
    assert plant("gas_bearing", rpm=1100).parameters["pole_h"].value == 898.9
    with pytest.raises(BadInput, match=r"there is no plant 'toaster'; there are .*gas_bearing"):
        plant("toaster")
    with pytest.raises(BadInput, match="plant 'gas_bearing' has no option 'rmp'; it has rpm, parameters, form, sample_time"):
        plant("gas_bearing", rmp=0)


def test_p4_faults_are_its_input_gains() -> None:
    p = unstable_second_order()
    faults = p.faults()
    assert faults.fault_names == ("b1", "b2")
    assert faults.close([-0.1, 0.0]).B[:, 0] == pytest.approx([1.8, 3.0], abs=1e-15)
    with_uncertainty = p.faults(["b1", "a11", "actuator"]).close([-0.1, 0.01, -0.5])
    assert with_uncertainty.A[0, 0] == pytest.approx(1.01, abs=1e-15)
    assert with_uncertainty.B[:, 0] == pytest.approx([0.9, 1.5], abs=1e-15)
    with pytest.raises(BadInput, match="discrete by nature"):
        p.continuous()


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("order", [1, 4, 5])
def test_random_plants_are_stable_and_repeatable(dt: float, order: int) -> None:
    true, model = random_stable(np.random.default_rng(1), order, 2, 3, dt)
    again, _ = random_stable(np.random.default_rng(1), order, 2, 3, dt)
    assert true.is_stable()
    assert np.array_equal(true.A, again.A)
    assert np.array_equal(model.A, 0.7 * true.A)
    assert (true.order, true.inputs, true.outputs) == (order, 2, 3)
    with pytest.raises(BadInput, match="at least one each"):
        random_stable(np.random.default_rng(1), 0)
