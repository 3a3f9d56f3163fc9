"""Laws in motion: a machine stepped with the law against scipy's integration of the physics as textbooks write it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from afdsvc.plugins.physics.actuator_lag import direction_dependent, low_pass
from afdsvc.plugins.physics.asymmetric_damping import _damper
from afdsvc.plugins.physics.asymmetric_damping import _joint as shock_absorber
from afdsvc.plugins.physics.attach import in_proportion
from afdsvc.plugins.physics.back_emf import _coil
from afdsvc.plugins.physics.clearance import _joint as gap
from afdsvc.plugins.physics.clearance import _joint_play as shaft_play
from afdsvc.plugins.physics.clearance import _play as play
from afdsvc.plugins.physics.clearance import _side as one_side
from afdsvc.plugins.physics.cogging import _ripple
from afdsvc.plugins.physics.constant_load import drifting
from afdsvc.plugins.physics.coulomb_friction import _joint, along, asymmetric, coulomb_force, jenkins, loaded, reaction
from afdsvc.plugins.physics.cubic_damping import _cubic
from afdsvc.plugins.physics.cubic_stiffness import _about
from afdsvc.plugins.physics.dead_zone import about_centre
from afdsvc.plugins.physics.exchange import conducted, turbulent
from afdsvc.plugins.physics.gain_follows_level import _orifice
from afdsvc.plugins.physics.gain_follows_position import geared, through_coil
from afdsvc.plugins.physics.gravity import _in_place, _weight
from afdsvc.plugins.physics.hysteresis import over_integral
from afdsvc.plugins.physics.joint import spring
from afdsvc.plugins.physics.magnetic_force import pair, single
from afdsvc.plugins.physics.parameter_follows_state import saturating
from afdsvc.plugins.physics.quadratic_damping import _in_place as drag_about
from afdsvc.plugins.physics.quadratic_damping import _joint as turbulent_damper
from afdsvc.plugins.physics.quadratic_stiffness import _about as spring_about
from afdsvc.plugins.physics.repulsion import _growing as growing
from afdsvc.plugins.physics.saturation import (
    ceiling,
    cut_above,
    cut_below,
    largest_error,
    overflow,
    relieved,
    relieved_both_ways,
    two_limits,
)
from afdsvc.plugins.physics.self_heating import warming
from afdsvc.plugins.physics.slew_limit import rate_limited
from afdsvc.plugins.physics.slow_mode import relaxing
from afdsvc.plugins.physics.static_nonlinearity import (
    curve_about,
    outflow,
    outflow_about,
    power,
    signed_square,
    thrust,
    two_slopes,
)
from afdsvc.plugins.physics.stribeck_friction import presliding
from afdsvc.plugins.physics.supply_droop import droop

H, N, HOLD = 1e-3, 1500, 10  # step in s, steps, steps over which the input is held


@dataclass
class Case:
    """A linear machine ``A, B`` with a law, and what the whole is: ``rates(x, u)`` of its states and then those of the physics left out."""

    name: str
    law: Callable
    p: tuple
    rates: Callable
    A: list
    B: list
    reads: tuple = (("x", 1),)
    writes: tuple = (1,)
    stage: str = "force"
    memory: int = 0
    hidden: tuple = ()
    level: float = 1.0
    mean: float = 0.0
    start: tuple | None = None
    tolerance: float = 3e-3


def inputs(case: Case) -> np.ndarray:
    steps = np.random.default_rng(4).standard_normal(N // HOLD)
    return case.mean + case.level * np.repeat(np.convolve(steps, np.ones(8) / 4, "same"), HOLD)


def stepped(case: Case) -> np.ndarray:
    """The machine by exact steps, forces taken at the predicted middle of the step and held over it, inputs at its beginning."""
    A, B = np.array(case.A, float), np.array(case.B, float)
    n = len(A)
    whole = np.zeros((2 * n + 1, 2 * n + 1))
    whole[:n] = np.hstack([A, B[:, None], np.eye(n)])
    full, half = expm(whole * H), expm(whole * H / 2)
    p, m, x = np.array(case.p, float), np.zeros(case.memory), np.array(case.start or np.zeros(n), float)
    seen = []
    for u in inputs(case):
        seen.append(x)
        middle, out = half[:n, :n] @ x + half[:n, n] * u, np.zeros(len(case.writes))
        felt = x if case.stage == "input" else middle
        case.law(p, np.array([{"x": felt, "u": [u]}[kind][i] for kind, i in case.reads]), m, H, out)
        acting, push = u, np.zeros(n)
        if case.stage == "input":
            acting = u + out[0]
        else:
            push[list(case.writes)] = out
        x = full[:n, :n] @ x + full[:n, n] * acting + full[:n, n + 1 :] @ push
    return np.array(seen)


def true(case: Case) -> np.ndarray:
    u, n = inputs(case), len(case.A)
    x, rows = np.array([*(case.start or np.zeros(n)), *case.hidden], float), []
    for k in range(0, N, HOLD):
        t = np.arange(HOLD + 1) * H
        part = solve_ivp(lambda _, s, now=u[k]: case.rates(s, now), (0, t[-1]), x, t_eval=t, rtol=1e-7, atol=1e-9).y.T
        rows.append(part[:-1])
        x = part[-1]
    return np.vstack(rows)[:, :n]


K, D, G = 40.0, 1.5, 30.0  # stiffness, damping and input gain of an axis
AXIS = {"A": [[0, 1], [-K, -D]], "B": [0, G]}
SPEED = {"A": [[-D]], "B": [G], "writes": (0,)}
TANK = {"A": [[-0.8, 0], [0.5, -0.4]], "B": [1.0, 0.0], "reads": (("x", 0),), "writes": (0, 1), "mean": 1.5, "level": 0.3, "start": (1.0, 1.0)}
MODES = {"A": [[0, 1, 0, 0], [-K, -D, 0, 0], [0, 0, 0, 1], [0, 0, -3 * K, -D]], "B": [0, G, 0, G], "writes": (1, 3)}


def axis(force: Callable) -> Callable:
    """Rates of an axis with a further acceleration of position, velocity and input."""
    return lambda x, u: [x[1], -K * x[0] - D * x[1] + G * u + force(x[0], x[1], u)]


def smooth(v: float) -> float:
    return float(np.tanh(v / 0.1))


def magnet(x: np.ndarray, i: float, bias: float = 2.0, gap: float = 1.3) -> list[float]:
    """One magnet that pulls to positive q against a constant weight; its gain at rest is G."""
    k = G * gap**2 / (2 * bias)
    return [x[1], -3 * K * x[0] - D * x[1] + k * ((bias + i) / (gap - x[0])) ** 2 - k * (bias / gap) ** 2]


def magnets(x: np.ndarray, i: float, bias: float = 2.0, gap: float = 1.3) -> list[float]:
    k = G * gap**2 / (4 * bias)
    return [x[1], -3 * K * x[0] - D * x[1] + k * ((bias + i) / (gap - x[0])) ** 2 - k * ((bias - i) / (gap + x[0])) ** 2]


BENT = {"A": [[0, 1], [-3 * K + G * 2.0 / 1.3, -D]], "B": [0, G], "reads": (("u", 0), ("x", 0)), "level": 0.4}  # the magnet's straight part is in A


def motor(x: np.ndarray, u: float) -> list[float]:
    """Speed and current: inertia 0.2, friction 0.3, torque constant 0.5, 2 ohm, 0.06 H."""
    return [(0.5 * x[1] - 0.3 * x[0]) / 0.2, (u - 2 * x[1] - 0.5 * x[0]) / 0.06]


def speaker(x: np.ndarray, u: float) -> list[float]:
    """Current, position, velocity of a coil whose force factor, in its force and in the voltage it induces, follows the position."""
    d = (x[1] - 0.1) / 0.5
    factor = 1 + 0.2 * d - 0.15 * d**2
    return [60 * u - 20 * x[0] - 3 * factor * x[2], x[2], 25 * factor * x[0] - K * x[1] - D * x[2]]


MOTOR_GAIN = 0.5 / 2 / 0.2


def lugre(x: np.ndarray, u: float) -> list[float]:
    size = 4.0 + 3.0 * np.exp(-((x[1] / 0.5) ** 2))
    stiff = 7.0 / (0.02 + 4 * 7.0 * H * H)
    rate = x[1] - stiff * abs(x[1]) * x[2] / size
    return [x[1], -K * x[0] - D * x[1] + G * u - stiff * x[2] - 2 * 0.6 * np.sqrt(stiff) * rate, rate]


def two(x: np.ndarray, u: float, push: Callable) -> list[float]:
    """Two modes with a joint that deflects by the first less 0.7 of the second."""
    f = push(x[0] - 0.7 * x[2], x[1] - 0.7 * x[3])
    return [x[1], -K * x[0] - D * x[1] + G * u - f, x[3], -3 * K * x[2] - D * x[3] + G * u + 0.7 * f]


def shaft(x: np.ndarray, u: float) -> list[float]:
    """Two masses, the second four times the first, on a shaft with play."""
    d = x[0] - x[2]
    f = K * (d - np.clip(d, -0.05, 0.05) + (0.02 * (x[1] - x[3]) if abs(d) > 0.05 else 0.0))
    return [x[1], -f - D * x[1] + G * u, x[3], 0.25 * f - D * x[3]]


def beside(x: np.ndarray, u: float, damper: Callable) -> list[float]:
    """The masses of `shaft`, on their spring without play, with a damper beside it."""
    f = K * (x[0] - x[2]) + DAMPED * (x[1] - x[3]) + damper(x[1] - x[3])
    return [x[1], -f - D * x[1] + G * u, x[3], 0.25 * f - D * x[3]]


def bolted(x: np.ndarray, u: float) -> list[float]:
    """A spring of 20 that slips once it is stretched by 0.05, as a slider that its ends drag along."""
    rate, stretched = x[1] - x[3], x[0] - x[2] - x[4]
    slips = abs(stretched) >= 0.05 and rate * stretched > 0
    return [*beside(x, u, lambda v: 20.0 * np.clip(stretched, -0.05, 0.05)), rate if slips else 0.0]


DAMPED = 0.02 * K  # of the shaft
SHAFT = {"A": [[0, 1, 0, 0], [-K, -D - DAMPED, K, DAMPED], [0, 0, 0, 1], [0.25 * K, 0.25 * DAMPED, -0.25 * K, -D - 0.25 * DAMPED]], "B": [0, G, 0, 0], "writes": (1, 3)}


def tank(out: Callable, share: float = 0.5 / 0.8) -> Callable:
    return lambda x, u: [u - out(x[0]), share * out(x[0]) - 0.4 * x[1]]


def bouc(x: np.ndarray, u: float) -> list[float]:
    """A lag whose input u is a velocity with a Bouc-Wen loop of exponent 1 over its way beside it."""
    return [-D * x[0] + G * (u + 0.4 * x[1]), u / 0.05 * (1 - (abs(x[1]) if u * x[1] > 0 else 0.0))]


CASES = [
    Case("asymmetric friction", asymmetric, (6.0, 2.0, 0.1 - 6e-3), axis(lambda q, v, u: -(6.0 if v > 0 else 2.0) * smooth(v)), **AXIS, tolerance=5e-3),
    Case("friction under the input", loaded, (2.0, 0.3, 0.1, G), axis(lambda q, v, u: -(2 + 0.3 * abs(G * u)) * np.tanh(v / (0.1 + (2 + 0.3 * abs(G * u)) * H))), **AXIS, reads=(("x", 1), ("u", 0))),
    Case("friction under what is passed on", loaded, (2.0, 0.3, 0.1, G, K), axis(lambda q, v, u: -(2 + 0.3 * abs(G * u + K * q)) * np.tanh(v / (0.1 + (2 + 0.3 * abs(G * u + K * q)) * H))), **AXIS, reads=(("x", 1), ("u", 0), ("x", 0))),
    Case("friction along the way", along, (3.0, 1.0, 2.0, 0.1, 0.2, 0.5), axis(lambda q, v, u: -(f := 3 + 2 * (q - 0.2) + 8 * (q - 0.2) ** 2) * np.tanh(v / (0.1 + f * H))), **AXIS, reads=(("x", 1), ("x", 0))),
    Case("asymmetric damping", _damper, (3.0, -1.0), axis(lambda q, v, u: -(3.0 if v > 0 else -1.0) * v), **AXIS),
    Case("spring", in_proportion, (25.0,), axis(lambda q, v, u: -25.0 * q), **AXIS, reads=(("x", 0),)),
    Case("damper", in_proportion, (3.0,), axis(lambda q, v, u: -3.0 * v), **AXIS),
    Case("dead time", coulomb_force, (12.0, 0.05), lambda x, u: [-D * x[0] + G * u - 12.0 * np.tanh(x[0] / (0.05 + 12.0 * H))], **SPEED, reads=(("x", 0),), tolerance=5e-3),
    Case("cubic damping", _cubic, (0.2,), axis(lambda q, v, u: -0.2 * v**3), **AXIS),
    Case("spring held away from its middle", _about, (400.0, -0.1, 0.0), axis(lambda q, v, u: -400 * (q**3 + 0.3 * q**2 + 0.03 * q)), **AXIS, reads=(("x", 0),)),
    Case("spring held at a load", _about, (400.0, -0.1, 0.05), axis(lambda q, v, u: -400 * ((q + 0.1) ** 3 - 0.15**3)), **AXIS, reads=(("x", 0),)),
    Case("spring about a deflection", spring_about, (60.0, 0.1, -5.0), axis(lambda q, v, u: -60 * (q**2 - 0.2 * q + 0.01) + 5.0), **AXIS, reads=(("x", 0),)),
    Case("drag about a speed", drag_about, (0.4, -1.2, 0.3), lambda x, u: [-D * x[0] + G * u - 0.4 * (x[0] * abs(x[0]) + 1.44 - 2.4 * (x[0] + 1.2)) - 0.3], **SPEED, reads=(("x", 0),)),
    Case("input curve about a level", curve_about, (0.3, 0.1, 0.5, 0.4, 0.2), lambda x, u: [-D * x[0] + G * (u + 0.6 * (u - 0.4) ** 2 + 0.4 * (u - 0.4) ** 3 - 0.2)], **SPEED, reads=(("u", 0),), stage="input"),
    Case("weight in degrees", _weight, (1500.0, 400.0, np.pi / 180), axis(lambda q, v, u: -1500 * np.sin(np.deg2rad(q)) - 400 * np.cos(np.deg2rad(q))), **AXIS, reads=(("x", 0),), level=60.0),
    Case("pendulum for a spring", _in_place, (K, -K, 1.0), lambda x, u: [x[1], -K * np.sin(x[0]) - D * x[1] + G * u], **AXIS, reads=(("x", 0),)),
    Case("one magnet", single, (2.0, 1.3, G, 1.0, 0.0, 0.0), magnet, **BENT),
    Case("two magnets", pair, (2.0, 1.3, G, 1.0, 0.0, 0.0), magnets, A=[[0, 1], [-3 * K + G * 2.0 / 1.3, -D]], B=[0, G], reads=(("u", 0), ("x", 0)), level=0.6),
    Case("coil", _coil, (0.03, 0.5, 0.0), motor, A=[[-1.5]], B=[MOTOR_GAIN], reads=(("u", 0), ("x", 0)), writes=(0,), stage="input", memory=3, hidden=(0.0,), level=5.0),
    Case("coil of a motor with its damping", _coil, (0.03, 0.5, 0.5), motor, A=[[-1.5 - 0.5 * MOTOR_GAIN]], B=[MOTOR_GAIN], reads=(("u", 0), ("x", 0)), writes=(0,), stage="input", memory=3, hidden=(0.0,), level=5.0),
    Case("cogging", _ripple, (7.0, 3.0, -2.0), axis(lambda q, v, u: 3 * np.cos(7 * q) - 2 * np.sin(7 * q)), **AXIS, reads=(("x", 0),)),
    Case("gain along the way", geared, (0.3, 0.1, 0.2, 0.5, G), axis(lambda q, v, u: G * u * (0.3 * (q - 0.2) / 0.5 + 0.1 * ((q - 0.2) / 0.5) ** 2)), **AXIS, reads=(("u", 0), ("x", 0))),
    Case("flow from a supply", _orifice, (12.0, G), lambda x, u: [-D * x[0] + G * u * np.sqrt(max(1 - np.sign(u) * x[0] / 12, 0.0))], **SPEED, reads=(("u", 0), ("x", 0)), tolerance=5e-3),
    Case("flow from a supply through a valve that is reversed", _orifice, (12.0, -G), lambda x, u: [-D * x[0] - G * u * np.sqrt(max(1 + np.sign(u) * x[0] / 12, 0.0))], **(SPEED | {"B": [-G]}), reads=(("u", 0), ("x", 0)), tolerance=5e-3),
    Case("force factor of a coil", through_coil, (0.2, -0.15, 0.1, 0.5, 25.0, -3.0), speaker, A=[[-20, 0, -3.0], [0, 0, 1], [25.0, -K, -D]], B=[60.0, 0, 0], reads=(("x", 0), ("x", 1), ("x", 2)), writes=(2, 0)),
    Case("bristles", presliding, (4.0, 3.0, 0.5, 0.02, 0.6), lugre, **AXIS, memory=1, hidden=(0.0,), tolerance=5e-3),
    Case("load that grows", drifting, (5.0, 2.0), lambda x, u: [-D * x[0] + G * u + 5 + 2 * x[1], 1.0], **SPEED, reads=(), memory=1, hidden=(0.0,)),
    Case("droop", droop, (0.3, 0.4, 0.8), lambda x, u: [-D * x[0] + G * u * (1 - 0.3 * x[1] / 0.8), (abs(u) - x[1]) / 0.4], **SPEED, reads=(("u", 0),), stage="input", memory=1, hidden=(0.0,), tolerance=5e-3),
    Case("lag that falls slowly", low_pass, (0.05, 0.4), lambda x, u: [-D * x[0] + G * x[1], (u - x[1]) / (0.05 if u > x[1] else 0.4)], **SPEED, reads=(("u", 0),), stage="input", memory=1, hidden=(0.0,)),
    Case("speed that falls slowly", direction_dependent, (0.5, -0.6, -D, G), lambda x, u: [(r := -D * x[0] + G * u) * (1.5 if r > 0 else 0.4)], **SPEED, reads=(("x", 0), ("u", 0)), tolerance=5e-3),
    Case("speed that changes at most so fast", rate_limited, (12.0, 7.0, -D, G), lambda x, u: [np.clip(-D * x[0] + G * u, -7, 12)], **SPEED, reads=(("x", 0), ("u", 0)), tolerance=5e-3),
    Case("two slopes", two_slopes, (0.3,), lambda x, u: [-D * x[0] + G * (u + 0.3 * abs(u))], **SPEED, reads=(("u", 0),), stage="input"),
    Case("rotor with a thrust", thrust, (1.2, 0.05), lambda x, u: [-D * x[0] + G * x[1] * abs(x[1]) / 1.2, (u - x[1]) / 0.05], **SPEED, reads=(("u", 0),), stage="input", memory=1, hidden=(0.0,)),
    Case("thrust", power, (1.2, 2.0), lambda x, u: [-D * x[0] + G * u * abs(u) / 1.2], **SPEED, reads=(("u", 0),), stage="input"),
    Case("signed square", signed_square, (0.3, 1.2), lambda x, u: [-D * x[0] + G * (u + 0.3 * u * abs(u) / 1.2)], **SPEED, reads=(("u", 0),), stage="input"),
    Case("dead zone about a centre", about_centre, (0.2, 0.3, 0.1), lambda x, u: [-D * x[0] + G * (0.2 + max(u - 0.5, 0) + min(u - 0.1, 0))], **SPEED, reads=(("u", 0),), stage="input"),
    Case("limit above", cut_above, (0.5,), lambda x, u: [-D * x[0] + G * min(u, 0.5)], **SPEED, reads=(("u", 0),), stage="input"),
    Case("limit below", cut_below, (-0.3,), lambda x, u: [-D * x[0] + G * max(u, -0.3)], **SPEED, reads=(("u", 0),), stage="input"),
    Case("limit that falls with the speed", ceiling, (0.9, 0.4, G), lambda x, u: [-D * x[0] + G * np.clip(u, -0.9 - 0.4 * x[0], 0.9 - 0.4 * x[0])], **SPEED, reads=(("u", 0), ("x", 0)), tolerance=1e-2),
    Case("limits of the error", largest_error, (0.4, 0.7, K, -0.95), lambda x, u: [x[1], K * np.clip(u - 0.95 * x[0], -0.7, 0.4) - D * x[1]], A=[[0, 1], [-0.95 * K, -D]], B=[0, K], reads=(("u", 0), ("x", 0)), tolerance=5e-3),
    Case("two limits", two_limits, (0.5, -0.3), lambda x, u: [-D * x[0] + G * np.clip(u, -0.3, 0.5)], **SPEED, reads=(("u", 0),), stage="input"),
    Case("loop over a way", over_integral, (0.4, 0.05, 1.0), bouc, **SPEED, reads=(("u", 0),), stage="input", hidden=(0.0,), memory=3, tolerance=2e-2),
    Case("second store", relaxing, (0.9, 0.6), lambda x, u: [u - 0.8 * x[0] - 0.9 * (x[0] - x[2]), 0.5 * x[0] - 0.4 * x[1], (x[0] - x[2]) / 0.6], **(TANK | {"writes": (0,)}), hidden=(1.0,), memory=2),
    Case("leak between tanks", conducted, (0.7, 0.5), lambda x, u: [u - 0.8 * x[0] - 0.7 * (x[0] - x[1]), 0.5 * x[0] - 0.4 * x[1] + 0.35 * (x[0] - x[1])], **(TANK | {"reads": (("x", 0), ("x", 1))})),
    Case("valve between tanks", turbulent, (0.7, 0.5, 0.3), lambda x, u: [u - 0.8 * x[0] - (q := 0.7 * 0.3 * np.sign(x[0] - x[1]) * np.sqrt(abs(x[0] - x[1]) / 0.3)), 0.5 * x[0] - 0.4 * x[1] + 0.5 * q], **(TANK | {"reads": (("x", 0), ("x", 1))}), tolerance=1e-2),
    Case("relief valve", relieved, (1.4, 2.5), lambda x, u: [u - 0.8 * x[0] - 2.5 * max(x[0] - 1.4, 0), 0.5 * x[0] - 0.4 * x[1]], **(TANK | {"writes": (0,)})),
    Case("relief valves both ways", relieved_both_ways, (0.4, 9.0), lambda x, u: [-D * x[0] + G * u - 9.0 * (x[0] - np.clip(x[0], -0.4, 0.4))], **SPEED, reads=(("x", 0),)),
    Case("Torricelli", outflow, (0.5, 2.0, 0.8, 0.625), tank(lambda x: 0.8 * np.sqrt(2.0 * x)), **TANK),
    Case("Torricelli about a level", outflow_about, (0.5, 2.0, 0.8, 0.625), tank(lambda x: 0.8 * 4 * (np.sqrt(1 + x / 2) - 1)), **TANK),
    Case("joint with a cubic spring", spring, (300.0, 3.0, -0.7, 1.0), lambda x, u: two(x, u, lambda d, v: 300 * d**3), **MODES, reads=(("x", 0), ("x", 2))),
    Case("joint with a gap", gap, (200.0, 0.1, -0.7, 1.0), lambda x, u: two(x, u, lambda d, v: 200 * (d - np.clip(d, -0.1, 0.1))), **MODES, reads=(("x", 0), ("x", 2)), tolerance=5e-3),
    Case("stop above", one_side, (300.0, 0.1, 1.0), axis(lambda q, v, u: -300 * max(q - 0.1, 0.0)), **AXIS, reads=(("x", 0),), tolerance=5e-3),
    Case("stop below", one_side, (300.0, 0.05, -1.0), axis(lambda q, v, u: 300 * max(0.05 - q, 0.0)), **AXIS, reads=(("x", 0),), tolerance=5e-3),
    Case("repulsion above", growing, (30.0, 0.05, 0.2, 1.0), axis(lambda q, v, u: -30 * np.exp((q - 0.2) / 0.05)), **AXIS, reads=(("x", 0),)),
    Case("repulsion below", growing, (20.0, 0.08, -0.2, -1.0), axis(lambda q, v, u: 20 * np.exp((-0.2 - q) / 0.08)), **AXIS, reads=(("x", 0),)),
    Case("core that saturates", saturating, (-0.5, 0.8, 0.0, -D, G), lambda x, u: [(-D * x[0] + G * u) / (1 - 0.5 * x[0] ** 2 / (0.64 + x[0] ** 2))], **SPEED, reads=(("x", 0), ("u", 0)), level=0.2, tolerance=1e-2),
    Case("capacitance about a voltage", saturating, (2.0, 0.5, 0.3, -D, G), lambda x, u: [(-D * x[0] + G * u) * (1 + 2 * 0.09 / 0.34) / (1 + 2 * x[0] ** 2 / (0.25 + x[0] ** 2))], **SPEED, reads=(("x", 0), ("u", 0)), level=0.2, tolerance=1e-2),
    Case("coil that warms", warming, (3.0, 0.3, 0.8, 1.0), lambda x, u: [-D * x[0] + G * u - 3.0 * x[1] * x[0], ((x[0] / 0.8) ** 2 - x[1]) / 0.3], **SPEED, reads=(("x", 0),), memory=1, hidden=(0.0,), level=0.1),
    Case("winding that warms", warming, (0.3, 0.4, 0.7, 0.5, -0.25), lambda x, u: [-D * x[0] + G * (u - 0.3 * x[1] * (i := 0.5 * u - 0.25 * x[0])), ((i / 0.7) ** 2 - x[1]) / 0.4], **SPEED, reads=(("u", 0), ("x", 0)), stage="input", memory=1, hidden=(0.0,), tolerance=1e-2),
    Case("play in a spring", play, (K, 0.1), axis(lambda q, v, u: K * np.clip(q, -0.1, 0.1)), **AXIS, reads=(("x", 0),), tolerance=5e-3),
    Case("play in a shaft", shaft_play, (K, 0.05, 0.02, -1.0, 0.25), shaft, **SHAFT, reads=(("x", 0), ("x", 2), ("x", 1), ("x", 3)), tolerance=5e-3),
    Case("shock absorber", shock_absorber, (9.0, 2.0, -1.0, 0.25), lambda x, u: beside(x, u, lambda v: (9.0 if v > 0 else 2.0) * v), **SHAFT, reads=(("x", 1), ("x", 3))),
    Case("bolted joint", jenkins, (20.0, 0.05, -1.0, 0.25), bolted, **SHAFT, reads=(("x", 0), ("x", 2)), memory=1, hidden=(0.0,), tolerance=1e-2),
    Case("turbulent damper", turbulent_damper, (3.0, -1.0, 0.25), lambda x, u: beside(x, u, lambda v: 3.0 * v * abs(v)), **SHAFT, reads=(("x", 1), ("x", 3))),
    Case("joint that rubs", _joint, (3.0, 0.1, -0.7, 1.0), lambda x, u: two(x, u, lambda d, v: 3 * np.tanh(v / (0.1 + 3 * 1.49 * H))), **MODES, reads=(("x", 1), ("x", 3))),
]


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.name.replace(" ", "-"))
def test_the_law_makes_of_the_machine_what_the_physics_says(case):
    whole, plain = true(case), stepped(Case(**(vars(case) | {"law": lambda p, z, m, dt, out: None})))
    size = np.abs(whole).max(0)
    assert (np.abs(plain - whole).max(0) > 0.02 * size).any()  # the physics matters in this test
    assert (np.abs(stepped(case) - whole).max(0) < case.tolerance * size).all()


def test_a_tank_that_overflows_stays_full_and_the_rest_goes_on():
    case = Case("", overflow, (1.3, 0.25, 0.625), lambda x, u: [], **TANK)
    levels, u = stepped(case), inputs(case)
    full = levels[:, 0] > 1.299
    assert 0.2 < full.mean() < 0.9
    assert levels[:, 0].max() < 1.3 + 0.5 * H * u.max()
    lost = np.where(full, np.maximum(u - 0.8 * 1.3, 0), 0.0)
    second = solve_ivp(
        lambda t, x: 0.5 * np.interp(t, np.arange(N) * H, levels[:, 0]) + 0.25 * 0.625 * np.interp(t, np.arange(N) * H, lost) - 0.4 * x,
        (0, (N - 1) * H), [1.0], t_eval=np.arange(N) * H, rtol=1e-8, max_step=H,
    ).y[0]
    assert levels[:, 1] == pytest.approx(second, abs=5e-3)


def test_the_force_of_a_friction_element_follows_the_velocity_that_is_imposed():
    out = np.zeros(1)
    reaction(np.array([250.0, 0.02]), np.array([0.0, -0.05]), np.zeros(0), H, out)
    assert out[0] == pytest.approx(-250 * np.tanh(2.5))
