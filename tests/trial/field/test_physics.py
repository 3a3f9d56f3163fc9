"""Every family against its own equations, written here anew and solved by another integrator at tight tolerances."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from afdsvc.trial.effect import Truth
from afdsvc.trial.field.catalogue import FAMILIES, LAWS
from afdsvc.trial.field.generate import sizes
from afdsvc.trial.field.rig import Rig, Spot
from afdsvc.trial.field.simulation import CONTROLLED, OPEN, Run, play

SAMPLES = 80


def way(v: float, r: float) -> float:
    return v / math.hypot(v, r)


def motor(c, p, u, t, x):
    friction = p["dry", "force"] * (1 if x[0] > 0 else p["dry", "unevenness"]) * way(x[0], p["dry", "rounding"])
    return [c[0] * u[0] - c[1] * x[0] - friction, x[0]]


def axis(c, p, u, t, x):
    rest = 1 + (p["stribeck", "rest"] - 1) * math.exp(-abs(x[1] / p["stribeck", "speed"]) ** 1.3)
    return [x[1], c[0] * u[0] - c[2] * x[1] - p["stribeck", "force"] * rest * way(x[1], p["stribeck", "rounding"])]


def servo(c, p, u, t, x):
    a, at = x[0] * p["weight", "per_length"], p["weight", "attitude"]
    weight = math.sin(a + at) - math.sin(at) - a * math.cos(at) + 0.15 * (math.sin(2 * a) - 2 * a)
    return [x[1], c[0] * u[0] - c[1] * x[0] - c[2] * x[1] - p["weight", "force"] * weight]


def arm(c, p, u, t, x):
    thrust = math.copysign(abs(u[0] / p["power_curve", "at"]) ** (1 + p["power_curve", "exponent"]), u[0]) * p["power_curve", "at"]
    drag = p["slow_drag", "coefficient"] * abs(x[1]) ** 0.5 * x[1]
    return [x[1], c[0] * thrust - c[1] * x[0] - c[2] * x[1] - drag]


def pendulum(c, p, u, t, x):
    beyond = p["gap", "rounding"] * np.logaddexp(0, (abs(x[0]) - p["gap", "gap"]) / p["gap", "rounding"])
    return [x[1], -c[0] * math.sin(x[0]) - c[1] * x[1] - p["gap", "stiffness"] * beyond**1.3 * np.sign(x[0])]


def two_mass(c, p, u, t, x):
    w = p["loose_shaft", "half_width"]
    shaft = c[2] * (x[1] - w * math.tanh(x[1] / w)) + c[3] * (x[0] - x[2])
    return [c[0] * u[0] - c[1] * x[0] - shaft, x[0] - x[2], c[4] * shaft - c[5] * x[2], x[0]]


def damper(c, p, u, t, x):
    z, n, skew = x[1], p["bouc_wen", "exponent"], p["bouc_wen", "skew"]
    turning = skew + (1 - skew) * (1.0 if u[0] * z > 0 else -1.0)
    return [u[0], u[0] / p["bouc_wen", "width"] * (1 - abs(z) ** n * turning)]


def tanks(c, p, u, t, x):
    def out(k, i):
        return c[k] * x[i] * 2 / (1 + math.sqrt(max(1 + x[i] / p["root", "head"], 0))) if i == 0 else c[k] * x[i]

    over = p["spill", "rate"] * p["spill", "rounding"] * np.logaddexp(0, (x[0] - p["spill", "rim"]) / p["spill", "rounding"])
    return [c[0] * u[0] - out(1, 0) - over, c[2] / c[1] * out(1, 0) + over / 2 - out(3, 1)]


def stores(c, p, u, t, x):
    h = p["radiation", "above"]
    loss = c[3] * h / 4 * ((1 + x[1] / h) ** 4 - 1)
    more = p["store", "exchange"] * (x[0] - x[2])
    return [c[0] * u[0] - c[1] * (x[0] - x[1]) - more, c[2] * (x[0] - x[1]) - loss, p["store", "fill"] * (x[0] - x[2])]


def coil(c, p, u, t, x):
    z = (x[0] / p["inductance", "current"]) ** 2
    return [(c[0] * u[0] - c[1] * x[0]) * (1 + z / (1 + 0.2 * z)), x[0]]


def levitation(c, p, u, t, x):
    gap = p["magnet", "gap"]
    bias = -c[0] * gap / c[1]
    return [x[1], c[0] * gap / 2 * (1 - ((1 + u[0] / bias) / (1 + x[0] / gap)) ** 2) - c[2] * x[1]]


def mirror(c, p, u, t, x):
    w, tau = p["ringing", "frequency"], p["relaxing", "time"]
    first = x[4] + 0.1 * p["ringing", "damping_ratio"] / w * x[5]
    second = u[1] + p["relaxing", "share"] * (x[6] + 0.8 * x[7] + 0.6 * x[8]) / 2.4
    modes = []
    for k, (own, other) in enumerate([(first, second), (second, first)]):
        W, zeta, g, cross = c[4 * k : 4 * k + 4]
        modes += [x[2 * k + 1], W**2 * (g * own + cross * other - x[2 * k]) - 2 * zeta * W * x[2 * k + 1]]
    return [*modes, x[5], w * w * (u[0] - x[4]) - 2 * p["ringing", "damping_ratio"] * w * x[5], *((u[1] - x[6 + j]) / (tau * 4**j) for j in range(3))]


CASES = {  # laws with the number of their place, own states in all, equations, outputs
    "motor": ([("dry", 0)], 0, motor, lambda c, p, u, x: [x[0]]),
    "axis": ([("stribeck", 0)], 0, axis, lambda c, p, u, x: [x[0]]),
    "servo": ([("weight", 0)], 0, servo, lambda c, p, u, x: [x[0]]),
    "arm": ([("power_curve", 0), ("slow_drag", 0)], 0, arm, lambda c, p, u, x: [x[0]]),
    "pendulum": ([("gap", 0)], 0, pendulum, lambda c, p, u, x: [x[0]]),
    "two_mass": ([("loose_shaft", 0)], 0, two_mass, lambda c, p, u, x: [x[0], x[2]]),
    "damper": ([("bouc_wen", 0)], 1, damper, lambda c, p, u, x: [c[0] * u[0] + c[1] * x[0] + p["bouc_wen", "force"] * x[1]]),
    "tanks": ([("root", 0), ("spill", 0)], 0, tanks, lambda c, p, u, x: [x[1], x[0]]),
    "stores": ([("radiation", 0), ("store", 0)], 1, stores, lambda c, p, u, x: [x[1], x[0]]),
    "coil": ([("inductance", 0)], 0, coil, lambda c, p, u, x: [x[0]]),
    "levitation": ([("magnet", 0)], 0, levitation, lambda c, p, u, x: [x[0]]),
    "mirror": ([("ringing", 0), ("relaxing", 1)], 5, mirror, lambda c, p, u, x: [x[0], x[2]]),
}


def short(rig: Rig, g: np.random.Generator) -> Run:
    """Return a quiet run of held random levels (a smooth motion for what is moved from outside, or would fall)."""
    n, p = SAMPLES, len(rig.outputs)
    levels = np.repeat(g.uniform(-1, 1, (n // 8, len(rig.inputs))), 8, axis=0) * rig.level
    if rig.family in ("damper", "levitation"):
        levels = rig.level * np.sin(np.arange(n) * rig.dt / rig.tau)[:, None]
    run = Run("r", levels, np.zeros((n, p)), np.zeros(rig.order), np.zeros((n, p)), np.zeros((n, rig.order)), np.zeros(n), 0.0, 0, OPEN)
    if rig.controller is not None:
        return replace(run, alpha=0 * levels, ref=levels, mode=CONTROLLED)
    return replace(run, start=rig.swing) if rig.swing is not None else run


def solved(rig: Rig, rates, outputs, p: dict, run: Run, own: int) -> np.ndarray:
    """Solve sample by sample, commands held, the controller as its recursion."""
    c, x, K = rig.nominal, np.concatenate([run.start, np.zeros(own)]), rig.controller
    xk, y = np.zeros(K.order if K is not None else 0), []
    for k in range(SAMPLES):
        u = run.alpha[k]
        y.append(outputs(c, p, u, x)[: len(rig.outputs)])
        if K is not None:
            e = y[-1] - run.ref[k]
            u, xk = K.C @ xk + K.D @ e + u, K.A @ xk + K.B @ e
        x = solve_ivp(lambda t, x, u=u: rates(c, p, u, t, x), (0, rig.dt), x, method="DOP853", rtol=1e-10, atol=1e-10 * (rig.level or 1.0)).y[:, -1]
    return np.array(y)


@pytest.mark.parametrize("family", CASES)
def test_family_obeys_its_equations(family: str) -> None:
    laws, own, rates, outputs = CASES[family]
    g = np.random.default_rng(11)
    rig = FAMILIES[family](g)
    run = short(rig, g)
    size = sizes(rig, Truth(rig.nominal), run)
    effects = [LAWS[name].make(Spot(rig, size, i, g)).scaled(1.0 if family == "levitation" else 2.0) for name, i in laws]
    p = {(name, key): value for (name, _), e in zip(laws, effects, strict=True) for key, value in zip(e.names, e.values, strict=True)}
    made, bare = play(rig, Truth(rig.nominal, tuple(effects)), run).y, play(rig, Truth(rig.nominal), run).y
    expected = solved(rig, rates, outputs, p, run, own)
    effect = np.abs(made - bare).max()
    assert effect > 0.01 * np.abs(made).max()
    assert np.abs(made - expected).max() < 2e-3 * effect


@pytest.mark.parametrize("family", FAMILIES)
def test_without_laws_the_plant_is_the_linear_model_the_owner_writes_down(family: str) -> None:
    g = np.random.default_rng(12)
    rig = FAMILIES[family](g)
    if family == "pendulum":  # its model has a sine: a small swing is linear
        rig = replace(rig, swing=rig.swing * 1e-4)
    run = short(rig, g)
    played = play(rig, Truth(rig.nominal), run)
    A, B, C, D = rig.build(rig.nominal)
    x, y = np.zeros(len(A)), []
    if family == "pendulum":
        x, B, D = rig.swing, np.zeros((2, 0)), np.zeros((1, 0))
    for u in played.u:
        y.append(C @ x + D @ u)
        x = solve_ivp(lambda t, x, u=u: A @ x + B @ u, (0, rig.dt), x, method="DOP853", rtol=1e-10, atol=1e-10 * (rig.level or 1e-4)).y[:, -1]
    assert np.abs(played.y - np.array(y)).max() < 1e-5 * np.abs(played.y).max()
