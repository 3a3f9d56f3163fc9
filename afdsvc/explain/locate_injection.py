"""The injection point: can one scalar signal, entering at one actuator, force axis or sensor, be all that repeats?

At every line the repeating residual is a vector over the outputs. A signal entering at one place makes it a multiple of the
nominal transfer column from there. What remains across that column, after the nuisance parameters have done their best
within their prior, is chi-square distributed for the right place. Needs two outputs or more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from afdsvc.api.physics import Machine
from afdsvc.dataset.periods import fold
from afdsvc.explain.locate_sweep import push
from afdsvc.explain.locate_view import View
from afdsvc.explain.sizes import bandwidth
from afdsvc.lti.statespace import Array
from afdsvc.stats.ar_noise import Whitener

REFUSED = 1e-4  # p-value below which a place cannot be the only one


@dataclass(frozen=True, slots=True)
class Entry:
    """A place of entry: the share of what repeats (beyond noise) one signal there explains, and the p-value of the rest."""

    site: str
    share: float
    p: float
    input: int | None = None
    output: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class _Lines:
    """All lines of all runs, whitened: residual ``(L, p)`` and nuisance Jacobian ``(L, p, k)`` in units of noise, points on the
    unit circle, and where the nuisance stands in its prior."""

    residual: Array
    jacobian: Array
    z: Array
    theta: Array


def injection(view: View, machine: Machine, cleaned: Sequence[Array]) -> list[Entry]:
    """Return every place, best first; empty with one output or when nothing repeats.

    ``cleaned`` are the residuals without what is no answer to the excitation.
    """
    if view.base.nominal.plant.outputs < 2:
        return []
    lines = _lines(view, cleaned)
    if lines is None:
        return []
    whole = _rest(lines, None)
    freedom = 2 * lines.residual.size
    excess = whole - freedom
    out = []
    for site, column, i, j in _columns(view, machine, lines.z):
        rest = _rest(lines, column)
        left = 2 * lines.residual.shape[0] * (lines.residual.shape[1] - 1)
        share = 1 - max(rest - left, 0.0) / max(excess, 1e-300)
        out.append(Entry(site, float(share), float(stats.chi2.sf(rest, left)), i, j))
    return sorted(out, key=lambda e: -e.share) if excess > 5 * np.sqrt(2 * freedom) else []


def _lines(view: View, cleaned: Sequence[Array]) -> _Lines | None:
    """Return residual and Jacobian at the lines of the repeating excitation up to its upper edge, whitened line by line."""
    top = bandwidth(view.runs)
    k = len(view.point.theta)
    pieces, row = [], 0
    for run, e in zip(view.runs, cleaned, strict=True):
        rows = slice(row, row + run.Y.size)
        row += run.Y.size
        folded = fold(run, view.objective.whitener(e))
        if folded is None:
            continue
        count, n = folded.shape[:2]
        last = int(np.clip(top * n * run.dt / (2 * np.pi), 4, n // 2 - 1))
        spectrum = np.fft.rfft(folded, axis=1)[:, 1 : last + 1]
        mean = spectrum.mean(0)
        scatter = np.sqrt((np.abs(spectrum - mean) ** 2).sum((0, 1)) / ((count - 1) * last) / count / 2)
        jacobian = _jacobian(view, run.Y.shape, rows, k, n, last)
        z = np.exp(2j * np.pi * np.arange(1, last + 1) / n)
        pieces.append((mean / scatter, jacobian / scatter[:, None], z))
    if not pieces:
        return None
    residual, jacobian, z = (np.concatenate(part) for part in zip(*pieces, strict=True))
    return _Lines(residual, jacobian, z, view.point.theta)


def _jacobian(view: View, shape: tuple[int, ...], rows: slice, k: int, n: int, last: int) -> Array:
    """Return the nuisance's part of the last period's spectrum, shape ``(lines, p, k)``."""
    t = view.tangent
    data = (t.q[rows] @ t.r)[:, :k].reshape(*shape, k)[-n:]
    return np.asarray(np.fft.rfft(data, axis=0)[1 : last + 1])


def _rest(lines: _Lines, column: Array | None) -> float:
    """Return the chi-square of what the nuisance and (if given) one signal through the column leave."""
    r, J = lines.residual, lines.jacobian
    if column is not None:
        unit = column / np.maximum(np.linalg.norm(column, axis=1, keepdims=True), 1e-300)
        r = r - unit * (unit.conj() * r).sum(1, keepdims=True)
        J = J - unit[:, :, None] * (unit.conj()[:, :, None] * J).sum(1, keepdims=True)
    k = J.shape[2]
    stacked = np.vstack([J.real.reshape(r.size, k), J.imag.reshape(r.size, k), np.eye(k)])
    wanted = np.concatenate([r.real.ravel(), r.imag.ravel(), lines.theta])
    rest = wanted - stacked @ np.linalg.lstsq(stacked, wanted, rcond=None)[0]
    return float(rest @ rest)


def _columns(view: View, machine: Machine, z: Array) -> list[tuple[str, Array, int | None, int | None]]:
    """Return per place the transfer column ``(L, p)`` from a signal there to the whitened residual."""
    o, theta = view.objective, view.point.theta
    plant, gain = view.base.nominal.at(theta), o.simulator.gain
    s = view.base.nominal.steps(theta, 4 if o.simulator.ramped else 1)
    a = np.linalg.matrix_power(s.phi, s.nsub) - gain @ plant.C
    by_input, by_rate = push(o.simulator, theta)
    resolvent = np.linalg.inv(z[:, None, None] * np.eye(plant.order) - a) if plant.order else np.zeros((len(z), 0, 0))
    seen = plant.C @ resolvent
    out: list[tuple[str, Array, int | None, int | None]] = []
    for port in machine.inputs:
        out.append((f"input:{port.name}", seen @ by_input[:, port.index] + plant.D[:, port.index], port.index, None))
    for axis in machine.axes:
        out.append((f"state:{axis.rate.name}", seen @ by_rate[:, axis.rate.index], None, None))
    for port in machine.outputs:
        unit = np.eye(plant.outputs)[port.index]
        out.append((f"output:{port.name}", unit - seen @ gain @ unit, None, port.index))
    whitening = _whitening(o.whitener, z)
    return [(site, np.einsum("lij,lj->li", whitening, c), i, j) for site, c, i, j in out]


def _whitening(whitener: Whitener, z: Array) -> Array:
    """Return the frequency response of the whitening filter, ``(L, p, p)``."""
    p = len(whitener.chol)
    response = np.repeat(np.eye(p, dtype=np.complex128)[None], len(z), axis=0)
    for i, a in enumerate(whitener.a):
        response -= z[:, None, None] ** -(i + 1) * a
    return np.asarray(np.linalg.inv(whitener.chol) @ response)
