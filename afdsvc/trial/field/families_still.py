"""Machines in which nothing turns: tanks, heat stores, coil, levitation, piezo mirror."""

from __future__ import annotations

import numpy as np

from afdsvc.api.model import Variable
from afdsvc.lti.statespace import Array
from afdsvc.trial.field import plants
from afdsvc.trial.field.families_moving import first_order, first_push
from afdsvc.trial.field.rig import Axis, Matrices, Rig, spread
from afdsvc.trial.machines.machine import filtered_pd

Generator = np.random.Generator


def tanks(g: Generator) -> Rig:
    """Return two tanks one above the other about an operating point; the upper level is measured too on a third of them."""
    tau = spread(g, 20.0, 200.0)
    a1, a2, level = 1.0 / tau, spread(g, 0.4, 1.5) / tau, spread(g, 0.5, 5.0)
    names = ("lower", "upper") if g.random() < 1 / 3 else ("lower",)
    lower, upper = Variable("lower", "m"), Variable("upper", "m")
    return Rig(
        family="tanks", plant=plants.TANKS, inputs=(Variable("pump", "V"),), outputs=tuple(Variable(n, "m") for n in names),
        states=(upper, lower), axes=(), nominal=np.array([a1 * spread(g, 0.05, 0.3) / level, a1, a1 * spread(g, 0.6, 1.2), a2]),
        loose=np.array([1.0, 0.5, 0.5, 0.5]), names=("pump", "outflow_1", "inflow_2", "outflow_2"), order=2, tau=tau, fast=tau / 2,
        build=lambda c: _cascade(np.array([[-c[1], 0.0], [c[2], -c[3]]]), c[0], len(names)), dt=tau / spread(g, 15, 60), level=level,
        push=_none, offsets=True,
    )


def stores(g: Generator) -> Rig:
    """Return a heated body in a housing that loses heat to the surroundings, about an operating point."""
    tau = spread(g, 30.0, 600.0)
    a12, a21, loss = 1 / tau, spread(g, 0.1, 0.6) / tau, spread(g, 0.1, 0.4) / tau
    level = spread(g, 5.0, 100.0)
    names = ("housing", "heater") if g.random() < 1 / 3 else ("housing",)
    body, housing = Variable("heater", "K"), Variable("housing", "K")
    return Rig(
        family="stores", plant=plants.STORES, inputs=(Variable("power", "W"),), outputs=tuple(Variable(n, "K") for n in names),
        states=(body, housing), axes=(), nominal=np.array([spread(g, 10.0, 60.0) * loss * a12 / a21 / level, a12, a21, loss]),
        loose=np.array([1.0, 0.5, 0.5, 0.5]), names=("heating", "exchange", "uptake", "loss"), order=2, tau=1.5 / loss, fast=tau / 2,
        build=lambda c: _cascade(np.array([[-c[1], c[1]], [c[2], -c[2] - c[3]]]), c[0], len(names)), dt=1 / loss / spread(g, 30, 120),
        level=level, push=_none, offsets=True,
    )


def _cascade(A: Array, gain: float, outputs: int) -> Matrices:
    return A, np.array([[gain], [0.0]]), np.array([[0.0, 1.0], [1.0, 0.0]])[:outputs], np.zeros((outputs, 1))


def _none(c: Array, x: Array, u: Array) -> Array:
    return np.zeros((u.shape[0], 0))


def coil(g: Generator) -> Rig:
    """Return a coil driven by a voltage, its current measured."""
    tau, resistance = spread(g, 2e-4, 5e-2), spread(g, 0.3, 30.0)
    current = Variable("current", "A")
    return Rig(
        family="coil", plant=plants.FIRST, inputs=(Variable("voltage", "V"),), outputs=(current,), states=(current,), axes=(),
        nominal=np.array([1 / (tau * resistance), 1 / tau]), loose=np.ones(2), names=("inverse_inductance", "decay"), build=first_order,
        order=2, tau=tau, fast=tau / 2, dt=tau / spread(g, 8, 40), level=spread(g, 2.0, 50.0), push=first_push,
    )


def levitation(g: Generator) -> Rig:
    """Return a body under a magnet about its operating point, held by a sampled PD controller its owner knows."""
    w = spread(g, 20.0, 80.0)
    ky, ki = w * w, -spread(g, 2.0, 30.0)
    wc = spread(g, 1.6, 2.6) * w
    dt = spread(g, 0.03, 0.09) / wc
    K = filtered_pd((ky + wc * wc) / ki, 1.6 * wc / ki, 3 * dt, dt)
    q, v = Variable("gap", "m"), Variable("gap_rate", "m/s", rate_of="gap")
    return Rig(
        family="levitation", plant=plants.LEVITATION, inputs=(Variable("current", "A"),), outputs=(q,), states=(q, v),
        axes=(Axis(0, 1, "state:gap_rate"),), nominal=np.array([ky, ki, spread(g, 0.02, 0.2) * w]), loose=np.array([0.5, 0.5, 1.0]),
        names=("pull_of_gap", "pull_of_current", "damping"), build=_magnet, order=2, tau=6 / wc, fast=1 / wc, dt=dt,
        level=spread(g, 2e-4, 2e-3), push=lambda c, x, u: c[0] * x[:, :1], controller=K, offsets=True,
    )


def _magnet(c: Array) -> Matrices:
    A = np.array([[0.0, 1.0], [c[0], -c[2]]])
    return A, np.array([[0.0], [c[1]]]), np.array([[1.0, 0.0]]), np.zeros((1, 1))


def mirror(g: Generator) -> Rig:
    """Return a mirror on two piezo drives: a sampled black-box model whose states mean nothing."""
    w, level = spread(g, 300.0, 3000.0), spread(g, 2.0, 50.0)
    gain = spread(g, 0.05, 2.0)
    modes = [[w * s, spread(g, 0.05, 0.3), gain * s, gain * g.uniform(-0.1, 0.1)] for s in (1.0, spread(g, 0.8, 1.25))]
    turn = np.linalg.qr(g.standard_normal((4, 4)))[0] * np.exp(g.uniform(-1, 1, 4))
    names = tuple(f"{n}_{i}" for i in (1, 2) for n in ("frequency", "damping_ratio", "gain", "crosstalk"))
    return Rig(
        family="mirror", plant=plants.MODES, inputs=(Variable("piezo1", "V"), Variable("piezo2", "V")),
        outputs=(Variable("tip", "urad"), Variable("tilt", "urad")), states=tuple(Variable(f"x{i}", "") for i in range(1, 5)), axes=(),
        nominal=np.array(modes).ravel(), loose=np.tile([0.05, 0.5, 0.1, 0.5], 2), names=names, build=lambda c: _turned(c, turn),
        order=4, tau=4 / w, fast=1 / w, dt=spread(g, 0.08, 0.4) / w, level=level, push=_none, black_box=True,
    )


def _turned(c: Array, turn: Array) -> Matrices:
    """Return the two modes in states turned and scaled by a random matrix."""
    A, B, C = np.zeros((4, 4)), np.zeros((4, 2)), np.zeros((2, 4))
    for k, (w, zeta, own, other) in enumerate(c.reshape(2, 4)):
        o = 2 * k
        A[o : o + 2, o : o + 2] = [[0.0, 1.0], [-w * w, -2 * zeta * w]]
        B[o + 1, k], B[o + 1, 1 - k], C[k, o] = w * w * own, w * w * other, 1.0
    scaled = np.diag(np.tile([1.0, c[0]], 2)) @ turn
    back = np.linalg.inv(scaled)
    return back @ A @ scaled, back @ B, C @ scaled, np.zeros((2, 2))
