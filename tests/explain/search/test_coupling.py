"""Which forces are tried along a signal: those on axes of a mechanism that one input moves together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.model import Model, Variable
from afdsvc.api.physics import Axis, Machine, Signal, Size
from afdsvc.api.signals import Channel, Trace
from afdsvc.explain.pipeline import explain
from afdsvc.explain.search.machine import hypotheses
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics import afdsvc_physics
from afdsvc.testing.conformance.physics import machines

LIBRARY = list(afdsvc_physics())
SHAFT, STRUCTURE = 8, 6
CART, POLE, ARM = 0.9, 0.25, 0.3
INVERSE = np.linalg.inv([[CART + POLE, POLE * ARM], [POLE * ARM, POLE * ARM**2]])


def plant(weight: float = -9.81, damping: float = -0.006) -> StateSpace:
    """A cart with a pole that hangs from it: cart, angle and their rates; all forces act through the inverse of the masses."""
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [INVERSE @ np.diag([-20.0, weight * POLE * ARM]), INVERSE @ np.diag([-2.0, damping])]])
    return StateSpace(A, np.vstack([np.zeros((2, 1)), INVERSE[:, :1]]), np.eye(2, 4), np.zeros((2, 1)))


def cart(plant: StateSpace, code: bool = False) -> Machine:
    states = tuple(Size(i, n, u, 0.0, 1.0, 3.0) for i, (n, u) in enumerate((("cart", "m"), ("angle", "rad"), ("v", "m/s"), ("w", "rad/s"))))
    axes = tuple(Axis(states[2 + i].name, states[i], states[2 + i], 20.0, 0, float(plant.B[2 + i, 0]), "N") for i in range(2))
    force = (Size(0, "force", "N", 0.0, 3.0, 9.0),)
    return Machine(force, states[:2], states, axes, {}, 0.01, 30.0, 20.0, plant, np.array([0.1, 0.1]), code=code)


def along(machine: Machine) -> dict[str, Signal]:
    return {h.key: h.along for h in hypotheses(LIBRARY, machine) if h.along}


def test_a_force_on_the_cart_acts_as_the_input_and_one_on_the_pole_as_the_pole_s_own_forces():
    found = along(cart(plant()))
    assert found["coulomb_friction@state:v#as force acts"] == Signal("u", 0)
    assert found["coulomb_friction@state:v#asymmetric; as force acts"] == Signal("u", 0)
    assert found["coulomb_friction@state:w#as w acts"] == Signal("x", 3)
    assert found["cubic_stiffness@state:w#as angle acts"] == Signal("x", 1)
    assert not any("#as force acts" in k for k in found if "state:w" in k)


@pytest.mark.parametrize(("machine", "own"), [
    (cart(plant(), code=True), set()), (cart(plant(damping=0.0)), {Signal("x", 1)}), (cart(plant(0.0, 0.0)), {Signal("u", 0)}),
])
def test_forces_on_the_pole_are_tried_along_what_acts_on_it(machine, own):
    """Of code only inputs are followed; without damping the weight acts on it; without either, only the input is known to."""
    found = along(machine)
    assert {v for k, v in found.items() if k.startswith("coulomb_friction@state:w")} == own
    assert found["coulomb_friction@state:v#as force acts"] == Signal("u", 0)


def undriven(machine: Machine, *axes: int) -> Machine:
    return replace(machine, axes=tuple(replace(a, input=None) if i in axes else a for i, a in enumerate(machine.axes)))


@pytest.mark.parametrize("machine", [undriven(machines()[SHAFT], 1), machines()[STRUCTURE], undriven(cart(plant()), 0, 1)])
def test_two_masses_on_a_spring_and_modes_have_none(machine):
    """A motor moves its own mass; a mode's own forces move that mode alone; nor is there any where no input acts."""
    assert along(machine) == {}


def test_a_shape_along_a_signal_counts_as_its_law():
    found = {h.key: h for h in hypotheses(LIBRARY, cart(plant()))}
    plain, shape = found["gravity@state:w#sine in place of a line"], found["gravity@state:w#sine in place of a line; as angle acts"]
    assert shape.notes["of"] == plain.notes.get("of", plain.notes.get("variant"))
    assert shape.linear is None


def test_friction_of_a_cart_is_named_with_its_size_though_the_pole_moves_with_it():
    """Simulated by the masses; added to the cart alone, no friction follows both readings."""
    model = Model("cart", (Variable("force", "N"),), (Variable("cart", "m"), Variable("angle", "rad")), (Variable("cart", "m"), Variable("angle", "rad"), Variable("v", "m/s", rate_of="cart"), Variable("w", "rad/s", rate_of="angle")), plant())

    def recording(seed: int) -> Trace:
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.uniform(-8, 8, 60), 25)
        x, seen, A, B = np.zeros(4), [], model.plant.A, model.plant.B[:, 0]
        for now in u:
            seen.append(x[:2])
            for _ in range(20):
                x = x + 5e-4 * (A @ x + B * (now - 1.2 * np.tanh(x[2] / 0.005)))
        y = np.array(seen) + [2e-4, 1e-3] * rng.standard_normal((len(u), 2))
        return Trace(f"r{seed}", 0.01, (Channel("u_force", "N"), Channel("y_cart", "m"), Channel("y_angle", "rad")), np.column_stack([u, y]))

    some = [p for p in LIBRARY if p.name in ("coulomb_friction", "stribeck_friction", "flexible_mode", "cubic_stiffness", "quadratic_damping", "transport_delay")]
    *given, held = (recording(s) for s in (1, 2, 3))
    found = explain(model, given, [held], some, experiment=False)
    assert (found.named[0].physics, found.named[0].site) == ("coulomb_friction", "state:v")
    assert found.named[0].parameters["force"].value == pytest.approx(1.2, rel=0.03)
    assert max(e.after_nrmse for e in found.fit) < 0.01
