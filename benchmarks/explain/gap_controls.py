"""Simulated recordings whose truth is known, for the rates of the gap test: five plants, six excitations, seven kinds of noise, seven gaps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from scipy.signal import cont2discrete, lfilter

from afdsvc.explain.gap.signals import ResidualSignals

DT = 0.01
PLANTS = {  # A, B, C of continuous time; poles of 0.3 to 3 rad/s against a sample time of 0.01 s
    "speed": ([[-1.0]], [[1.0]], [[1.0]]),
    "axis": ([[0, 1], [0, -0.5]], [[0], [1.0]], [[1.0, 0]]),
    "oscillator": ([[0, 1], [-9.0, -0.3]], [[0], [1.0]], [[1.0, 0]]),
    "light damping": ([[0, 1], [-9.0, -0.06]], [[0], [1.0]], [[1.0, 0], [0, 1.0]]),
    "two masses": ([[0, 1, 0, 0], [-4, -0.3, 3, 0.1], [0, 0, 0, 1], [3, 0.1, -6, -0.4]], [[0], [1.0], [0], [0]], [[1.0, 0, 0, 0], [0, 0, 1.0, 0]]),
}
EXCITATIONS = ("staircase", "aprbs", "multisine", "repeated aprbs", "chirp", "decay")
NOISES = ("white", "fast", "slow", "pink", "narrow", "bursts", "process", "slow process")
GAPS = ("coulomb", "cubic stiffness", "saturation", "dead zone", "delay", "gain", "mode")


@dataclass(frozen=True)
class Control:
    """What was simulated: its names, one or more recordings, the share of the residual's power that is gap."""

    plant: str
    excitation: str
    noise: str
    effect: str
    share: float
    recordings: list[ResidualSignals]
    outputs: int
    states: int
    inputs: int


def simulate(A, B, C, u, x0, force: Callable | None = None, w=None):
    """Return states and outputs; ``force(x, u)`` is added to the input, ``w (n, 1)`` too. Held inputs."""
    F, G, *_ = cont2discrete((np.array(A, float), np.array(B, float), np.array(C, float), np.zeros((len(C), 1))), DT)
    u = u if w is None else u + w
    X = _modal(F, G, u, np.array(x0, float)) if force is None else _stepped(F, G, u, np.array(x0, float), force)
    return X, X @ np.array(C, float).T


def _modal(F, G, u, x0):
    poles, V = np.linalg.eig(F)
    b, z0 = np.linalg.solve(V, G[:, 0]), np.linalg.solve(V, x0)
    Z = [lfilter([0.0, b_i], [1.0, -q], u[:, 0].astype(complex), zi=np.array([z], complex))[0] for q, b_i, z in zip(poles, b, z0, strict=True)]
    return (V @ np.array(Z)).real.T


def _stepped(F, G, u, x, force):
    X = np.empty((len(u), len(F)))
    for t in range(len(u)):
        X[t] = x
        x = F @ x + G[:, 0] * (u[t, 0] + float(force(x, u[t])[0]))
    return X


def excitation(kind: str, n: int, rng: Generator) -> tuple[np.ndarray, int]:
    """Return ``u (n, 1)`` and its period."""
    hold = max(4, int(n * rng.uniform(0.01, 0.06)))
    if kind == "decay":
        return np.zeros((n, 1)), 0
    if kind == "chirp":
        t = np.arange(n) / n
        return np.sin(2 * np.pi * n * DT * (0.02 * t + 0.5 * rng.uniform(0.2, 2) * t**2))[:, None], 0
    if kind == "multisine":
        period = n // int(rng.integers(2, 9))
        lines = np.arange(1, max(3, min(period // 4, 60)))
        S = np.zeros(period // 2 + 1, complex)
        S[lines] = np.exp(2j * np.pi * rng.uniform(size=len(lines)))
        u = np.fft.irfft(S, period)
        return np.tile(u / u.std(), n // period + 1)[:n, None], period
    if kind == "repeated aprbs":
        period = n // int(rng.integers(2, 7))
        one = np.repeat(rng.normal(size=period // hold + 1), hold)[:period]
        return np.tile(one, n // period + 1)[:n, None], period
    levels = rng.normal(size=n // hold + 1) if kind == "aprbs" else np.cumsum(rng.choice([-0.5, 0.5], size=n // (2 * hold) + 1))
    u = np.repeat(levels, hold if kind == "aprbs" else 2 * hold)[:n]
    return u[:, None], 0


def ar1(n: int, time: float, rng: Generator, columns: int = 1) -> np.ndarray:
    """Return stationary noise with this correlation time [samples]."""
    a = np.exp(-1 / time)
    return lfilter([np.sqrt(1 - a * a)], [1, -a], rng.normal(size=(n + int(10 * time), columns)), axis=0)[-n:]


def noise(kind: str, plant, n: int, rng: Generator) -> np.ndarray:
    """Return noise at the outputs ``(n, p)`` of unit size per column."""
    p = len(plant[2])
    if kind in ("process", "slow process"):
        w = rng.normal(size=(n, 1)) if kind == "process" else ar1(n, n * rng.uniform(0.01, 0.1), rng)
        out = simulate(*plant, np.zeros((n, 1)), np.zeros(len(plant[0])), w=w)[1]
    elif kind == "pink":
        f = np.maximum(np.fft.rfftfreq(2 * n), 0.5 / n)
        out = np.fft.irfft((rng.normal(size=(len(f), p)) + 1j * rng.normal(size=(len(f), p))) * (f ** -0.5)[:, None], axis=0)[:n]
    elif kind == "narrow":
        q = np.exp(-1 / (n * rng.uniform(0.005, 0.05)) + 2j * np.pi * rng.uniform(0.002, 0.1))
        out = lfilter([1], [1, -2 * q.real, abs(q) ** 2], rng.normal(size=(2 * n, p)), axis=0)[n:]
    elif kind == "bursts":
        out = ar1(n, 5, rng, p) * np.exp(1.5 * ar1(n, n / 20, rng))
    else:
        times = {"white": 0.1, "fast": rng.uniform(2, 20), "slow": n * rng.uniform(0.03, 0.1)}
        out = ar1(n, times[kind], rng, p)
    return out / np.maximum(out.std(0), 1e-12)


def effect(name: str, u: np.ndarray, X: np.ndarray) -> Callable:
    """Return the force ``(x, u) -> added input`` of a gap, of a size that matters for this motion."""
    size, speed, position = u.std() or X[:, 0].std(), X[:, -1].std() if X.shape[1] == 1 else X[:, 1].std(), X[:, 0].std()
    last = 0 if X.shape[1] == 1 else 1
    return {
        "coulomb": lambda x, v: -0.2 * size * np.tanh(20 * x[last] / speed) + 0 * v,
        "cubic stiffness": lambda x, v: -0.5 * size * (x[0] / position) ** 3 / 3 + 0 * v,
        "saturation": lambda x, v: np.clip(v, -size, size) - v,
        "dead zone": lambda x, v: -np.clip(v, -0.3 * size, 0.3 * size),
        "gain": lambda x, v: -0.2 * v - (0.2 * size * x[0] / position if not v.any() else 0.0),
    }[name]


def gapped(name: str, plant, u: np.ndarray, x0, rng: Generator) -> np.ndarray:
    """Return the outputs with a gap."""
    X, Y = simulate(*plant, u, x0)
    if name == "delay":
        return np.vstack([np.repeat(Y[:1], 12, 0), Y[:-12]])
    if name == "mode":
        q = np.exp(-0.03 + 0.2j)
        return Y + 0.3 * lfilter([0.03], [1, -2 * q.real, abs(q) ** 2], Y - Y[0], axis=0)
    return simulate(*plant, u, x0, effect(name, u, X))[1]


def control(rng: Generator, name: str = "", share: float = 0.0, excitations=EXCITATIONS, noises=NOISES, samples=(800, 6000)) -> Control:
    """Return a control drawn at random; with a gap of this share of the residual's power when one is named."""
    kind, driven, coloured = (str(rng.choice(list(k))) for k in (list(PLANTS), excitations, noises))
    plant = PLANTS[kind]
    recordings = [_recording(plant, driven, coloured, name, share, int(np.exp(rng.uniform(*np.log(samples)))), rng) for _ in range(int(rng.integers(1, 4)))]
    return Control(kind, driven, coloured, name, share, recordings, len(plant[2]), len(plant[0]), recordings[0].inputs.shape[1])


def _recording(plant, driven: str, coloured: str, name: str, share: float, n: int, rng: Generator) -> ResidualSignals:
    u, period = excitation(driven, n, rng)
    x0 = rng.normal(size=len(plant[0])) * (1.0 if driven == "decay" else 0.1)
    X, Y = simulate(*plant, u, x0)
    e = noise(coloured, plant, n, rng)
    if name:
        e = mixed(_fitted(gapped(name, plant, u, x0, rng) - Y, plant), e, share)
    return ResidualSignals(_fitted(e, plant), np.zeros((n, 0)) if driven == "decay" else u, X, np.zeros((n, 0)), DT, period)


def mixed(gap: np.ndarray, e: np.ndarray, share: float) -> np.ndarray:
    """Return gap and noise with this share of gap in the power of each output."""
    return np.sqrt(share) * gap / np.maximum(gap.std(0), 1e-12) + np.sqrt(1 - share) * e


def _fitted(e: np.ndarray, plant) -> np.ndarray:
    """Return the residual after the initial state was fitted to it, as a simulation does."""
    n, k = len(e), len(plant[0])
    free = np.stack([simulate(*plant, np.zeros((n, 1)), row)[1].ravel() for row in np.eye(k)], axis=1)
    return e - (free @ np.linalg.lstsq(free, e.ravel(), rcond=None)[0]).reshape(e.shape)
