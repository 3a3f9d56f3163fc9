"""The state map: on which of the machine's signals a disturbance must depend, and where it must enter, to be the residual.

Every group of columns is sent through the predictor and the whitening, what the nuisance parameters can imitate is taken
out, and the groups are chosen one after the other by a cross-validated regression. The F test of each is corrected for the
number of groups tried.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy import stats

from afdsvc.api.physics import Machine
from afdsvc.explain.locate_features import Group, groups
from afdsvc.explain.locate_sweep import responses
from afdsvc.explain.locate_view import View, per_run
from afdsvc.lti.statespace import Array
from afdsvc.stats.ar_noise import correlation_time

SURE = 1e-4  # false-acceptance probability of the map as a whole
FOLDS = 10
MOST, ATTEMPTS = 6, 4
WORTH = 0.05  # share of the first group's gain below which a further one is not worth saying
NEAR = 0.85  # share of the best group's gain from which another place explains nearly as much


@dataclass(frozen=True, slots=True, eq=False)
class Dependence:
    """A chosen group: its ``gain`` (fall of the cost), the p-value of its F test times the groups tried, the gain on samples
    kept out (``validated``), what it takes from the residual (``component``, per run, outputs' units, the nuisance refitted with
    it), and groups ``nearly`` as good.
    """

    group: Group
    gain: float
    f: float
    p: float
    validated: float
    component: tuple[Array, ...]
    nearly: tuple[Group, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Gram:
    """Inner products per fold: ``matrix (folds, b, b)``, ``vector (folds, b)`` with the residual, and the cost to lower; the
    projected responses ``columns (rows, b)`` themselves.

    ``rest (rows,)`` is the residual, ``outputs`` how many of its rows belong to one sample, and ``noisy`` says that the noise is
    known, so that the rows of a right model are white; otherwise what a group leaves tells how many of them count as one.
    """

    columns: Array
    rest: Array
    outputs: int
    noisy: bool
    matrix: Array
    vector: Array
    cost: float
    samples: int
    counts: float


def dependences(view: View, machine: Machine) -> list[Dependence]:
    """Return the groups the residual depends on, the largest first; none when nothing is significant."""
    library = groups(view, machine)
    if not library:
        return []
    gram, slices = _gram(view, library)
    chosen: list[int] = []
    found: list[Dependence] = []
    while len(chosen) < MOST:
        step = _next(gram, slices, chosen, library)
        if step is None or (found and step.gain < WORTH * found[0].gain):
            break
        best = library.index(step.group)
        chosen.append(best)
        found.append(step)
    return _with_components(view, gram, slices, chosen, found)


def _gram(view: View, library: Sequence[Group]) -> tuple[_Gram, list[slice]]:
    """Return the inner products of all responses with the nuisance projected out, fold by fold."""
    slices, start = [], 0
    for g in library:
        slices.append(slice(start, start + g.size))
        start += g.size
    t, width = view.tangent, start
    rows = [_rows(view, library, i, width) for i in range(len(view.runs))]
    everything = np.vstack(rows)
    q = t.q[: len(everything)]
    imitated = q.T @ everything
    everything -= q @ imitated
    rest = t.rest[: len(everything)]
    edges = np.linspace(0, len(everything), FOLDS + 1).astype(int)
    pieces = [(everything[a:b], rest[a:b]) for a, b in pairwise(edges)]
    matrix = np.stack([x.T @ x for x, _ in pieces])
    vector = np.stack([x.T @ r for x, r in pieces])
    noisy, p = view.base.limited == "noise", view.base.nominal.plant.outputs
    return _Gram(everything, rest, p, noisy, matrix, vector, float(t.rest @ t.rest), rest.size, view.counts), slices


def _rows(view: View, library: Sequence[Group], i: int, width: int) -> Array:
    columns = np.hstack([g.columns[i] for g in library])
    states = np.hstack([np.repeat(g.states[:, None], g.size, 1) for g in library])
    outputs = np.hstack([np.repeat(g.outputs[:, None], g.size, 1) for g in library])
    o = view.objective
    response = responses(o.simulator, view.point.theta, columns, states, outputs, o.whitener)
    gaps = ~np.isfinite(view.runs[i].Y)
    if gaps.any():
        response[gaps] = 0.0
    return response.reshape(-1, width)


def _next(gram: _Gram, slices: Sequence[slice], chosen: list[int], library: Sequence[Group]) -> Dependence | None:
    """Return the best further group that is significant and carries over to samples kept out, or None."""
    base = _gain(gram, _index(slices, chosen))
    order = []
    for k, g in enumerate(library):
        if k not in chosen:
            gain = _gain(gram, _index(slices, [*chosen, k])) - base
            worth = gain if gram.noisy else gram.counts * float(np.log((gram.cost - base) / max(gram.cost - base - gain, 1e-300)))
            order.append((worth - g.size * float(np.log(max(gram.counts, 3.0))), gain, k))
    order.sort(key=lambda o: -o[0])
    for score, gain, k in order[:ATTEMPTS]:
        found = _tested(gram, slices, chosen, library, k, (base, gain)) if score > 0 else None
        if found:
            near = [library[i] for _, g, i in order if i != k and g > NEAR * gain and library[i].size <= library[k].size + 3]
            return replace(found, nearly=tuple(near[:3]))
    return None


def _tested(
    gram: _Gram, slices: Sequence[slice], chosen: list[int], library: Sequence[Group], k: int, gains: tuple[float, float]
) -> Dependence | None:
    """Return group ``k`` with its tests, ``gains`` those of the chosen ones and its own; None when it fails one."""
    group, (base, gain) = library[k], gains
    index = _index(slices, [*chosen, k])
    freedom = max(_counts(gram, index) - len(index), 1.0)
    f = gain / group.size / max((gram.cost - base - gain) / freedom, 1e-300)
    p = min(1.0, float(stats.f.sf(f, group.size, freedom)) * len(library))
    folds = _validated(gram, index) - _validated(gram, _index(slices, chosen))
    return Dependence(group, gain, f, p, float(folds.sum()), (), ()) if p < SURE and _carries_over(folds) else None


def _counts(gram: _Gram, index: list[int]) -> float:
    """Return how many independent numbers are left when these columns are taken out."""
    if gram.noisy:
        return gram.counts
    c = _solve(gram.matrix.sum(0)[np.ix_(index, index)], gram.vector.sum(0)[index])
    left = (gram.rest - gram.columns[:, index] @ c).reshape(-1, gram.outputs)
    return gram.samples / max(correlation_time(left / np.maximum(left.std(0), 1e-300)), 1.0)


def _carries_over(folds: Array) -> bool:
    """Whether the gain on samples kept out is positive by two standard errors of its scatter between folds."""
    spread = float(folds.std(ddof=1)) * np.sqrt(len(folds))
    return bool(folds.sum() > max(2.0 * spread, 0.0))


def _index(slices: Sequence[slice], chosen: Sequence[int]) -> list[int]:
    return [i for k in chosen for i in range(slices[k].start, slices[k].stop)]


def _solve(matrix: Array, vector: Array) -> Array:
    """Return the least-squares coefficients, directions without weight left at zero."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = np.linalg.lstsq(matrix / np.outer(scale, scale), vector / scale, rcond=1e-9)[0]
    return np.asarray(scaled / scale)


def _gain(gram: _Gram, index: list[int]) -> float:
    if not index:
        return 0.0
    G, b = gram.matrix.sum(0)[np.ix_(index, index)], gram.vector.sum(0)[index]
    return float(b @ _solve(G, b))


def _validated(gram: _Gram, index: list[int]) -> Array:
    """Return the fall of the cost in every fold by coefficients fitted on the others, shape ``(folds,)``."""
    if not index:
        return np.zeros(FOLDS)
    where = np.ix_(index, index)
    G, b = gram.matrix.sum(0)[where], gram.vector.sum(0)[index]
    out = np.zeros(FOLDS)
    for k in range(FOLDS):
        own, left = gram.matrix[k][where], gram.vector[k][index]
        c = _solve(G - own, b - left)
        out[k] = 2 * c @ left - c @ own @ c
    return out


def _with_components(
    view: View, gram: _Gram, slices: Sequence[slice], chosen: list[int], found: Sequence[Dependence]
) -> list[Dependence]:
    """Return the chosen groups with what each adds to the outputs, all fitted together."""
    index = _index(slices, chosen)
    if not index:
        return []
    c = _solve(gram.matrix.sum(0)[np.ix_(index, index)], gram.vector.sum(0)[index])
    out, start = [], 0
    for d in found:
        own = slice(start, start + d.group.size)
        start = own.stop
        taken = gram.columns[:, index[own]] @ c[own]
        out.append(replace(d, component=tuple(per_run(taken, view.objective))))
    return out
