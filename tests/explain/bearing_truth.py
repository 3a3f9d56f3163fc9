"""A small truth simulator of the gas bearing in closed loop, for these tests only.

It shares nothing with the simulation under test: classical Runge-Kutta of the continuous plant at five steps per sample,
and functional forms of its own (arctan friction, smooth dead zone, another hysteresis exponent, a fifth-order term beside
the cubic).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from afdsvc.api.model import Model
from afdsvc.api.signals import Channel, Trace
from afdsvc.lti.riccati import kalman_predictor_gain, lqr
from afdsvc.lti.statespace import StateSpace
from afdsvc.plants.gas_bearing import gas_bearing

DT, SUB = 2e-4, 5
SIGMA = np.sqrt([0.12, 0.15])
KINDS = (
    "nothing", "transport_delay", "actuator_lag", "resonant_actuator", "dead_zone", "saturation", "backlash", "hysteresis",
    "creep", "slew_limit", "static_nonlinearity", "coulomb_friction", "stribeck_friction", "quadratic_damping",
    "cubic_stiffness", "quadratic_stiffness", "clearance", "flexible_mode", "gyroscopic_coupling", "cross_coupled_stiffness",
    "unbalance", "constant_load", "gain_follows_aux", "stiffness_follows_aux", "sensor_lag", "sensor_misalignment",
    "sensor_crosstalk", "sensor_offset", "sensor_drift", "sensor_nonlinearity", "sensor_rectification", "sensor_saturation",
    "runout", "periodic_disturbance", "actuator_gain", "sensor_gain", "stiffness", "damping", "force_hysteresis",
)
SITES = {
    **dict.fromkeys(KINDS[1:11], "input:horizontal"), **dict.fromkeys(KINDS[11:17], "state:horizontal_rate"),
    "flexible_mode": "machine", "gyroscopic_coupling": "machine", "cross_coupled_stiffness": "machine", "unbalance": "machine",
    "constant_load": "state:horizontal_rate", "gain_follows_aux": "input:horizontal", "stiffness_follows_aux": "state:horizontal_rate",
    **{k: "output:horizontal" for k in KINDS if k.startswith("sensor_")}, "sensor_misalignment": "machine",
    "runout": "output:horizontal", "periodic_disturbance": "output:horizontal", "actuator_gain": "input:horizontal",
    "stiffness": "state:horizontal_rate", "damping": "state:horizontal_rate", "force_hysteresis": "state:horizontal_rate",
}


@dataclass(frozen=True)
class Loop:
    """Nominal model and controller."""

    model: Model
    A: np.ndarray
    B: np.ndarray


def loop(relative_sd: float = 0.02) -> Loop:
    """Return the nominal model with its LQG controller, weights moderate enough to leave the resonances visible."""
    plant = gas_bearing()
    c, d = plant.continuous(), plant.discrete()
    F = lqr(d, np.diag([0.02, 0.02, 1e-7, 1e-7, 0, 0]), np.eye(2))
    L = kalman_predictor_gain(d, 0.01 * np.eye(6), np.eye(2))
    K = StateSpace(d.A + d.B @ F + L @ d.C, -L, F, np.zeros((2, 2)), DT)
    sd = {k: np.where(np.isin(np.abs(m), (0, 1)), 0, relative_sd * np.abs(m)) for k, m in (("A", c.A), ("B", c.B))}
    sd |= {"C": np.zeros_like(c.C), "D": np.zeros_like(c.D)}
    model = Model("gas bearing", plant.inputs, plant.outputs, plant.states, c, entry_sd=sd, output_sd=SIGMA, controller=K)
    return Loop(model, c.A, c.B)


@njit(cache=True)
def _truth(kind, p, A, B, KA, KB, KC, alpha, noise, aux, sub, dt, process):  # type: ignore[no-untyped-def]  # noqa: C901, PLR0915 - one compiled loop, a branch an effect
    n = alpha.shape[0]
    u_out, y_out = np.zeros((n, 2)), np.zeros((n, 2))
    x, xk = np.zeros(6), np.zeros(KA.shape[0])
    w = np.zeros(12)
    ring = np.zeros(4096)
    h = dt / sub
    kx = np.zeros((4, 6))
    tick = 0
    for k in range(n):
        y = x[:2].copy()
        if kind == 24:
            y[0] = w[0]
        elif kind == 25:
            a = y[0] - p[0] * y[1]
            y[1] = y[1] + p[0] * y[0]
            y[0] = a
        elif kind == 26:
            y[0] += p[0] * y[1]
        elif kind == 27:
            y[0] += p[0]
        elif kind == 28:
            y[0] += p[0] * (np.exp(k * dt / 8.0) - 1)
        elif kind == 29:
            y[0] += p[0] * (np.sinh(y[0] / 3.0) * 3.0 - y[0] + 0.3 * y[0] * y[0])
        elif kind == 30:
            y[0] += p[0] * (np.sqrt(y[0] * y[0] + 1e-3) - 0.03)
        elif kind == 31:
            y[0] = y[0] / (1 + (abs(y[0]) / p[0]) ** 12) ** (1 / 12)
        elif kind == 32:
            y[0] += p[0] * (np.cos(aux[k, 1] + 0.4) + 0.5 * np.cos(2 * aux[k, 1] + 1.0))
        elif kind == 33:
            y[0] += p[0] * np.cos(2 * np.pi * 50.3 * k * dt + 0.7)
        elif kind == 35:
            y[0] *= 1 + p[0]
        y += noise[k]
        y_out[k] = y
        u = KC @ xk + alpha[k]
        xk = KA @ xk + KB @ y
        u_out[k] = u
        up = u.copy() + process[k]
        for _ in range(sub):
            ue = up.copy()
            ring[tick % 4096] = up[0]
            if kind == 1:
                d = p[0] / h
                j = int(d)
                f = d - j
                ue[0] = (1 - f) * ring[(tick - j) % 4096] + f * ring[(tick - j - 1) % 4096] if tick > j + 1 else 0.0
            elif kind == 2:
                w[0] += h / p[0] * (up[0] - w[0]) if h < p[0] else (up[0] - w[0])
                ue[0] = w[0]
            elif kind == 3:
                w[1] += h * (p[0] ** 2 * (up[0] - w[0]) - 0.6 * p[0] * w[1])
                w[0] += h * w[1]
                ue[0] = w[0]
            elif kind == 4:
                ue[0] = up[0] - p[0] * np.tanh(up[0] / p[0])
            elif kind == 5:
                ue[0] = up[0] / (1 + (abs(up[0]) / p[0]) ** 10) ** 0.1
            elif kind == 6:
                w[0] = min(max(w[0], up[0] - p[0] / 2), up[0] + p[0] / 2)
                ue[0] = w[0]
            elif kind == 7:
                du = up[0] - w[1]
                w[1] = up[0]
                w[0] += du / 0.6 * (1 - (0.6 * np.sign(du * w[0]) + 0.4) * w[0] ** 2)
                w[0] = min(max(w[0], -1.0), 1.0)
                ue[0] = up[0] + p[0] * w[0]
            elif kind == 8:
                s = 0.0
                for i in range(5):
                    tau = 0.01 * 4.0**i
                    w[i] += h / tau * (up[0] - w[i])
                    s += w[i]
                ue[0] = up[0] + p[0] * s / 5
            elif kind == 9:
                w[0] += p[0] * h * np.tanh((up[0] - w[0]) / (0.5 * p[0] * h))
                ue[0] = w[0]
            elif kind == 10:
                ue[0] = up[0] + p[0] * (np.exp(up[0] / 1.2) - 1 - up[0] / 1.2)
            elif kind == 22:
                ue[0] = up[0] * (1 + p[0] * aux[k, 2])
            elif kind == 34:
                ue[0] = up[0] * (1 + p[0])
            tick += 1
            for s in range(4):
                xs = x.copy()
                if s > 0:
                    xs = x + h * (0.5 if s < 3 else 1.0) * kx[s - 1]
                dx = A @ xs + B @ ue
                q, v = xs[0], xs[2]
                if kind == 11:
                    dx[2] -= p[0] * 2 / np.pi * np.arctan(v / 20.0)
                elif kind == 12:
                    dx[2] -= p[0] * 2 / np.pi * np.arctan(v / 20.0) * (1 + 1.2 / (1 + (v / 400.0) ** 2))
                elif kind == 13:
                    dx[2] -= p[0] * v * np.sqrt(v * v + 1e4)
                elif kind == 14:
                    dx[2] -= p[0] * (q**3 + 0.02 * q**5)
                elif kind == 15:
                    dx[2] -= p[0] * q * q * (1 + 0.02 * q)
                elif kind == 16:
                    over = abs(q) - 1.5
                    dx[2] -= p[0] * np.sign(q) * 0.05 * np.log1p(np.exp(min(over / 0.05, 50.0)))
                elif kind == 18:
                    g = p[0] * aux[k, 0] / 100
                    dx[2] -= g * xs[3]
                    dx[3] += g * xs[2]
                elif kind == 19:
                    dx[2] -= p[0] * xs[1]
                    dx[3] += p[0] * xs[0]
                elif kind == 20:
                    a = aux[k, 1] + aux[k, 0] * (tick * h - k * dt)
                    dx[2] += p[0] * (aux[k, 0] / 100) ** 2 * np.cos(a + 0.3)
                    dx[3] += p[0] * (aux[k, 0] / 100) ** 2 * np.sin(a + 0.3)
                elif kind == 21:
                    dx[2] += p[0]
                elif kind == 23:
                    dx[2] -= p[0] * aux[k, 2] * q
                elif kind == 36:
                    dx[2] += p[0] * A[2, 0] * q
                elif kind == 37:
                    dx[2] += p[0] * A[2, 2] * v
                elif kind == 38:
                    dx[2] -= p[0] * w[0]
                kx[s] = dx
            if kind == 17:
                w[1] += h * (2200.0**2 * (x[4] - w[0]) - 2 * 0.03 * 2200.0 * w[1])
                w[0] += h * w[1]
            if kind == 38:
                dq = h * x[2]
                w[0] += dq / 0.8 * (1 - (0.7 * np.sign(dq * w[0]) + 0.3) * abs(w[0]) ** 1.6)
                w[0] = min(max(w[0], -1.0), 1.0)
            x = x + h / 6 * (kx[0] + 2 * kx[1] + 2 * kx[2] + kx[3])
            if kind == 24:
                w[0] += (1 - np.exp(-h / p[0])) * (x[0] - w[0])
    return u_out, y_out


@dataclass(frozen=True)
class Settings:
    """How a recording is made."""

    level: float
    speed: float
    periods: int = 5
    period: int = 2500
    sine: bool = False


def excitation(s: Settings, rng: np.random.Generator, top: float = 600.0) -> np.ndarray:
    """Return alpha (n, 2): odd random-phase multisines on interleaved odd lines, one line in four left out."""
    f0 = 1 / (s.period * DT)
    odd = np.arange(1, int(top / f0), 2)
    t = np.arange(s.period)
    out = np.zeros((s.period, 2))
    for channel in range(2):
        lines = odd[channel::2]
        lines = lines[: len(lines) // 4 * 4].reshape(-1, 4)
        keep = np.ones(lines.shape, bool)
        keep[np.arange(len(lines)), rng.integers(0, 4, len(lines))] = False
        used = lines[keep] if not s.sine else np.array([31 + 2 * channel])
        for k in used:
            out[:, channel] += np.cos(2 * np.pi * k * t / s.period + rng.uniform(0, 2 * np.pi))
    out *= s.level / out.std(0)
    return np.tile(out, (s.periods, 1))


def record(
    loop: Loop, kind: str, size: float, s: Settings, theta: tuple, rng: np.random.Generator, name: str,
    noise: float = 1.0, process: float = 0.0, colour: float = 0.0,
) -> Trace:
    """Return one recording."""
    A, B = theta
    K = loop.model.controller
    alpha = excitation(s, rng)
    n = len(alpha)
    t = np.arange(n) * DT
    phase = rng.uniform(0, 2 * np.pi)
    slow = np.sin(2 * np.pi * rng.uniform(0.6, 1.1) * t + rng.uniform(0, 6)) + 0.3 * (s.level - 1)
    aux = np.column_stack([np.full(n, s.speed), np.mod(s.speed * t + phase, 2 * np.pi), slow])
    e = rng.standard_normal((n, 2))
    for k in range(1, n):
        e[k] += colour * e[k - 1]
    d = process * rng.standard_normal((n, 2))
    mode = KINDS.index(kind)
    if kind == "flexible_mode":
        A, B = _with_mode(A, B, size)
        u, y = _linear(A, B, K, alpha, noise * SIGMA * e, d)
    else:
        u, y = _truth(mode, np.array([size]), A, B, K.A, K.B, K.C, alpha, noise * SIGMA * e * np.sqrt(1 - colour**2), aux, SUB, DT, d)
    names = ("u_horizontal", "u_vertical", "y_horizontal", "y_vertical", "alpha_horizontal", "alpha_vertical",
             "aux_speed", "aux_angle", "aux_pressure")
    return Trace(name, DT, tuple(Channel(c) for c in names), np.hstack([u, y, alpha, aux]))


def _with_mode(A: np.ndarray, B: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Append an oscillator pushed by the horizontal valve and pushing the shaft back."""
    w, z = 2200.0, 0.03
    big = np.zeros((8, 8))
    big[:6, :6] = A
    big[6, 7] = 1.0
    big[7, 6], big[7, 7], big[7, 4] = -w * w, -2 * z * w, w * w
    big[2, 6] = size
    return big, np.vstack([B, np.zeros((2, 2))])


@njit(cache=True)
def _linear_loop(Ad, Bd, KA, KB, KC, alpha, noise, process):  # type: ignore[no-untyped-def]
    n = alpha.shape[0]
    u, y = np.zeros((n, 2)), np.zeros((n, 2))
    x, xk = np.zeros(Ad.shape[0]), np.zeros(KA.shape[0])
    for k in range(n):
        y[k] = x[:2] + noise[k]
        u[k] = KC @ xk + alpha[k]
        xk = KA @ xk + KB @ y[k]
        x = Ad @ x + Bd @ (u[k] + process[k])
    return u, y


def _linear(A, B, K, alpha, noise, process):
    from afdsvc.lti.sampling import sample_zoh

    d = sample_zoh(StateSpace(A, B, np.zeros((2, len(A))), np.zeros((2, 2))), DT)
    return _linear_loop(np.ascontiguousarray(d.A), np.ascontiguousarray(d.B), K.A, K.B, K.C, alpha, noise, process)


def moved(loop: Loop, rng: np.random.Generator, sds: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """Return the true matrices: every uncertain entry off by about half its standard deviation."""
    A = loop.A + sds * loop.model.entry_sd["A"] * rng.standard_normal(loop.A.shape)
    B = loop.B + sds * loop.model.entry_sd["B"] * rng.standard_normal(loop.B.shape)
    for i in (4, 5):
        B[i, i - 4] = -A[i, i]
    return A, B


DIRECT = {"transport_delay": (1e-5, 2e-3), "actuator_lag": (1e-5, 2e-3), "sensor_lag": (1e-5, 2e-3), "saturation": (20.0, 0.1),
          "slew_limit": (1e5, 50.0), "resonant_actuator": (3e4, 900.0), "sensor_saturation": (40.0, 0.2), "dead_zone": (1e-4, 2.0),
          "backlash": (1e-4, 3.0)}


def dataset(kind: str, rho: float, seed: int, lp: Loop | None = None, **options):
    """Return (model, four traces): the effect's rms in the outputs is ``rho`` times the noise's."""
    lp = lp or loop()
    rng = np.random.default_rng(seed)
    theta = moved(lp, rng)
    sine = options.pop("sine", False)
    plans = [Settings(1.0, 120.0, sine=sine), Settings(0.5, 90.0, sine=sine), Settings(0.75, 105.0, sine=sine), Settings(0.8, 110.0, sine=sine)]
    size = severity(lp, kind, rho, plans[:2], theta, seed)
    traces = [record(lp, kind, size, s, theta, np.random.default_rng([seed, i]), f"r{i}", **options) for i, s in enumerate(plans)]
    return lp.model, traces, size


def severity(lp: Loop, kind: str, rho: float, plans, theta, seed: int) -> float:
    """Return the size whose effect in the noise-free outputs has ``rho`` times the noise's rms, by bisection."""
    if kind == "nothing":
        return 0.0
    low, high = DIRECT.get(kind, (1e-6, 1e7))
    falling = low > high

    def effect(size: float) -> float:
        out = []
        for i, s in enumerate(plans):
            pair = [record(lp, k, z, s, theta, np.random.default_rng([seed, i]), "", noise=0.0).role("y") for k, z in ((kind, size), ("nothing", 0.0))]
            out.append(((pair[0] - pair[1]) / SIGMA)[s.period :])
        total = float(np.sqrt((np.vstack(out) ** 2).mean()))
        return total if np.isfinite(total) else 1e9

    size = float(np.sqrt(low * high))
    for _ in range(40):
        found = effect(size)
        if abs(np.log(max(found, 1e-9) / rho)) < 0.02:
            break
        low, high = (size, high) if found < rho else (low, size)
        guess = size * rho / found if 1e-4 < found < 1e3 and not falling else 0.0
        size = guess if low < guess < high else float(np.sqrt(low * high))
    return size
