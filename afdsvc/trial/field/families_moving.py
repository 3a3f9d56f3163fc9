"""Machines that move: motor, geared axis, servo, arm, pendulum, two masses, damper."""

from __future__ import annotations

import numpy as np

from afdsvc.api.model import Variable
from afdsvc.lti.statespace import Array
from afdsvc.trial.field import plants
from afdsvc.trial.field.rig import Axis, Matrices, Rig, spread
from afdsvc.trial.machines.machine import filtered_pd

Generator = np.random.Generator
PENDULUM = '''"""Pendulum, angle from hanging down."""
import math


class machine:
    @staticmethod
    def f(t, x, u, p):
        q, w = x
        return [w, -p["g_over_l"] * math.sin(q) - p["damping"] * w]

    @staticmethod
    def h(t, x, u, p):
        return [x[0]]
'''
SECOND = '''"""Position servo: goal in, position out."""


class machine:
    @staticmethod
    def f(t, x, u, p):
        q, w = x
        return [w, p["drive"] * u[0] - p["stiffness"] * q - p["damping"] * w]

    @staticmethod
    def h(t, x, u, p):
        return [x[0]]
'''


def motor(g: Generator) -> Rig:
    """Return a DC motor with nothing but its speed measured, in rad/s or rpm."""
    tau, rpm = spread(g, 0.05, 0.8), bool(g.random() < 0.5)
    nominal = np.array([spread(g, 5.0, 60.0) * (9.55 if rpm else 1.0) / tau, 1.0 / tau])
    speed = Variable("speed", "rpm" if rpm else "rad/s")
    return Rig(
        family="motor", plant=plants.FIRST, inputs=(Variable("voltage", "V"),), outputs=(speed,), states=(speed,),
        axes=(Axis(1, 0, "state:speed"),), nominal=nominal, loose=np.ones(2), names=("gain", "damping"), build=first_order, order=2,
        tau=tau, fast=tau / 2, dt=tau / spread(g, 12, 60), level=spread(g, 3.0, 24.0), push=first_push,
    )


def first_order(c: Array) -> Matrices:
    """Return A, B, C, D of x' = -c1 x + c0 u, y = x."""
    return np.array([[-c[1]]]), np.array([[c[0]]]), np.eye(1), np.zeros((1, 1))


def first_push(c: Array, x: Array, u: Array) -> Array:
    """Return what the command does to the rate."""
    return np.asarray(c[0] * u[:, :1])


def second_order(c: Array) -> Matrices:
    """Return A, B, C, D of q'' = c0 u - c1 q - c2 q', y = q."""
    return np.array([[0.0, 1.0], [-c[1], -c[2]]]), np.array([[0.0], [c[0]]]), np.array([[1.0, 0.0]]), np.zeros((1, 1))


def second_push(c: Array, x: Array, u: Array) -> Array:
    """Return the force of command and spring together, the larger of the two parts."""
    parts = np.hstack([c[0] * u[:, :1], c[1] * x[:, :1]])
    return parts[:, [int(np.argmax(np.square(parts).mean(axis=0)))]]


def axis(g: Generator) -> Rig:
    """Return a geared axis under a sampled PD controller that half of the owners know."""
    tau, unit = spread(g, 0.2, 2.0), str(g.choice(["m", "mm", "rad"]))
    b, wc = spread(g, 0.05, 20.0), spread(g, 8.0, 20.0) / tau
    dt = spread(g, 0.03, 0.1) / wc
    K = filtered_pd(wc * wc / b, 1.4 * wc / b, 3 * dt, dt)
    q, v = Variable("position", unit), Variable("velocity", f"{unit}/s", rate_of="position")
    return Rig(
        family="axis", plant=plants.SECOND, inputs=(Variable("drive", "N"),), outputs=(q,), states=(q, v),
        axes=(Axis(0, 1, "state:velocity"),), nominal=np.array([b, 0.0, 1.0 / tau]), loose=np.array([1.0, 0.0, 1.0]),
        names=("gain", "stiffness", "damping"), build=second_order, order=2, tau=6.0 / wc, fast=1 / wc, dt=dt,
        level=spread(g, 0.02, 0.5) * (1000.0 if unit == "mm" else 1.0), push=second_push, controller=K,
        known_controller=bool(g.random() < 0.5),
    )


def servo(g: Generator) -> Rig:
    """Return a servo of which only goal and angle are recorded: its own loop is part of the machine."""
    w, zeta = spread(g, 6.0, 40.0), spread(g, 0.35, 1.1)
    q, v = Variable("angle", "rad"), Variable("rate", "rad/s", rate_of="angle")
    return Rig(
        family="servo", plant=plants.SECOND, inputs=(Variable("goal", "rad"),), outputs=(q,), states=(q, v),
        axes=(Axis(0, 1, "state:rate"),), nominal=np.array([w * w, w * w, 2 * zeta * w]), loose=np.array([0.3, 0.3, 1.0]),
        names=("drive", "stiffness", "damping"), build=second_order, order=2, tau=3.0 / w, fast=1 / w,
        dt=spread(g, 0.03, 0.25) / w, level=spread(g, 0.3, 1.5), push=second_push, code=SECOND if g.random() < 0.5 else "",
    )


def arm(g: Generator) -> Rig:
    """Return an arm lifted by a fan: voltage in, angle out, lightly damped."""
    w, zeta, level = spread(g, 3.0, 10.0), spread(g, 0.08, 0.35), spread(g, 1.0, 10.0)
    gain = w * w * spread(g, 0.3, 0.9) / level
    q, v = Variable("angle", "rad"), Variable("rate", "rad/s", rate_of="angle")
    return Rig(
        family="arm", plant=plants.SECOND, inputs=(Variable("fan", "V"),), outputs=(q,), states=(q, v),
        axes=(Axis(0, 1, "state:rate"),), nominal=np.array([gain, w * w, 2 * zeta * w]), loose=np.array([1.0, 0.15, 1.0]),
        names=("gain", "stiffness", "damping"), build=second_order, order=2, tau=3.0 / w, fast=1 / w,
        dt=spread(g, 0.03, 0.15) / w, level=level, push=second_push,
    )


def pendulum(g: Generator) -> Rig:
    """Return a pendulum let go from some angle: no input, a Python model with its sine."""
    w, zeta = spread(g, 2.0, 8.0), spread(g, 0.002, 0.02)
    q, v = Variable("angle", "rad"), Variable("rate", "rad/s", rate_of="angle")
    return Rig(
        family="pendulum", plant=plants.PENDULUM, inputs=(), outputs=(q,), states=(q, v), axes=(Axis(0, 1, "state:rate"),),
        nominal=np.array([w * w, 2 * zeta * w]), loose=np.array([0.05, 1.0]), names=("g_over_l", "damping"),
        build=lambda c: second_order(np.array([0.0, *c])), order=2, tau=4.0 / w, fast=1 / w, dt=spread(g, 0.03, 0.2) / w,
        level=0.0, push=lambda c, x, u: c[0] * np.sin(x[:, :1]), code=PENDULUM, swing=np.array([spread(g, 0.4, 1.6), 0.0]),
    )


def two_mass(g: Generator) -> Rig:
    """Return motor and load on a shaft; the load's speed is measured too on half of the machines."""
    tau, ratio, w = spread(g, 0.3, 1.2), spread(g, 0.4, 2.5), spread(g, 15.0, 60.0)
    k = w * w / (1 + ratio)
    c = np.array([spread(g, 5.0, 80.0), 1 / tau, k, 2 * spread(g, 0.01, 0.05) * w / (1 + ratio), ratio, 0.7 / tau])
    names = ("motor_speed", "twist", "load_speed")
    states = tuple(Variable(n, "rad" if n == "twist" else "rad/s") for n in names)
    outputs = (states[0], states[2]) if g.random() < 0.5 else states[:1]
    return Rig(
        family="two_mass", plant=plants.TWO_MASS, inputs=(Variable("torque", "N m"),), outputs=outputs, states=states,
        axes=(Axis(3, 0, "state:motor_speed"), Axis(3, 2, "state:load_speed")), nominal=c,
        loose=np.array([1.0, 1.0, 0.15, 1.0, 0.3, 1.0]), names=("gain", "motor_damping", "stiffness", "loss", "ratio", "load_damping"),
        build=lambda c: _shaft(c, len(outputs)), order=4, tau=tau, fast=1 / w, dt=spread(g, 0.06, 0.2) / w,
        level=spread(g, 0.2, 5.0), push=lambda c, x, u: np.column_stack([c[0] * u[:, 0], c[4] * c[2] * x[:, 1]]),
    )


def _shaft(c: Array, outputs: int) -> Matrices:
    A = np.array([[-c[1] - c[3], -c[2], c[3]], [1.0, 0.0, -1.0], [c[4] * c[3], c[4] * c[2], -c[4] * c[3] - c[5]]])
    return A, np.array([[c[0]], [0.0], [0.0]]), np.eye(3)[[0, 2][:outputs]], np.zeros((outputs, 1))


def damper(g: Generator) -> Rig:
    """Return a damper moved by an exciter: speed in, force out."""
    w, level = spread(g, 3.0, 30.0), spread(g, 0.02, 0.4)
    c = spread(g, 100.0, 5000.0)
    return Rig(
        family="damper", plant=plants.IMPOSED, inputs=(Variable("velocity", "m/s"),), outputs=(Variable("force", "N"),),
        states=(Variable("stroke", "m"),), axes=(Axis(0, -1, "output:force"),), nominal=np.array([c, spread(g, 0.05, 0.6) * c * w]),
        loose=np.ones(2), names=("damping", "stiffness"), order=1, tau=2.0 / w, fast=1 / w, dt=spread(g, 0.02, 0.1) / w, level=level,
        build=lambda c: (np.zeros((1, 1)), np.ones((1, 1)), np.array([[c[1]]]), np.array([[c[0]]])),
        push=lambda c, x, u: c[0] * u[:, :1],
    )
