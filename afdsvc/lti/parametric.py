"""From a function of physical parameters to a plant with those parameters pulled out as faults.

The matrices ``[A B; C D]`` are sampled at changed parameter values, fitted exactly as polynomials in the relative
changes ``theta`` (or in ``theta / (1 + theta)`` for a parameter that divides, like a mass), products of parameters
included, and realised as a linear fractional transformation. No fault matrix has to be written, and the result is
checked against the function itself before it is handed out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from afdsvc.errors import BadInput
from afdsvc.lti.lft import AugmentedPlant
from afdsvc.lti.matrix_polynomial import Polynomial, compressed, factored
from afdsvc.lti.statespace import Array, StateSpace

MAX_DEGREE = 10
MIXED_DEGREE = 5  # of powers of p and 1/p together
MAX_BUILDS = 8192
TOLERANCE = 1e-10  # of the largest value an entry takes

Build = Callable[[Mapping[str, float]], StateSpace]


@dataclass(frozen=True, slots=True)
class Dependence:
    """How the matrices depend on one parameter: a sum of powers of theta up to ``up`` and of s up to ``down``.

    ``p = p0 (1 + theta)`` and ``s = theta / (1 + theta)``, so ``p0 / p = 1 - s``: any sum of powers of p and 1/p fits.
    """

    name: str
    up: int
    down: int

    def basis(self, theta: float) -> Array:
        """Return ``1, theta, .., theta^up, s, .., s^down``."""
        s = theta / (1 + theta) if self.down else 0.0
        return np.array([theta**k for k in range(self.up + 1)] + [s**k for k in range(1, self.down + 1)])

    def exponents(self, k: int) -> tuple[int, int]:
        """Return the powers of theta and of s in basis function k."""
        return (k, 0) if k <= self.up else (0, k - self.up)

    def nodes(self) -> Array:
        """Return the severities to sample at: 0 and as many others as there are powers."""
        count = self.up + self.down
        k = np.arange(1, count + 1)
        # an even number of Chebyshev points never hits zero
        return np.concatenate([[0.0], 0.5 * np.cos(np.pi * (k - 0.5) / (count + count % 2))])


def _candidates(name: str) -> Iterator[Dependence]:
    """Yield dependences from the simplest: few powers first, those of p before those of 1/p."""
    for total in range(1, MAX_DEGREE + 1):
        for down in range(total + 1) if total <= MIXED_DEGREE else (0, total):
            yield Dependence(name, total - down, down)


def parametric_plant(build: Build, values: Mapping[str, float], names: Sequence[str]) -> AugmentedPlant:
    """Return the plant with the named parameters pulled out: ``p = p0 (1 + theta)``, all at once, in the given order.

    ``build`` maps parameter values by name to a system. Raises `BadInput` when a parameter is unknown, zero (a relative
    change of zero is nothing), acts in a way that is neither polynomial in p nor in 1/p, or when too many multiply.
    """
    family = _Family(build, dict(values), tuple(names))
    nominal = build(dict(values))
    dependences = [_dependence(family, i) for i in range(len(names))]
    polynomial = _polynomial(family, dependences)
    augmented = _assemble(polynomial, dependences, nominal)
    _verify(family, augmented)
    return augmented


class _Family:
    """The packed matrices ``[A B; C D]`` as a function of severities."""

    def __init__(self, build: Build, values: dict[str, float], names: tuple[str, ...]) -> None:
        self.build, self.values, self.names = build, values, names
        for name in names:
            if name not in values:
                raise BadInput(f"the plant has no parameter '{name}'; it has {', '.join(values)}")
            if values[name] == 0:
                raise BadInput(
                    f"parameter '{name}' is 0, so a relative change of it is undefined; give it a value or leave it out"
                )

    def __call__(self, severities: Mapping[int, float]) -> Array:
        changed = dict(self.values)
        for i, theta in severities.items():
            changed[self.names[i]] = self.values[self.names[i]] * (1 + theta)
        s = self.build(changed)
        return np.block([[s.A, s.B], [s.C, s.D]])


def _dependence(family: _Family, i: int) -> Dependence:
    """Return the simplest dependence that reproduces the matrices at severities it was not fitted to."""
    probes = {theta: family({i: theta}) for theta in (-0.47, -0.21, 0.13, 0.41)}
    size = np.max([np.abs(m) for m in probes.values()], axis=0)
    for d in _candidates(family.names[i]):
        table = np.linalg.solve(_basis_matrix(d), _flat([family({i: float(t)}) for t in d.nodes()]))
        errors = [np.abs((d.basis(t) @ table).reshape(size.shape) - m) for t, m in probes.items()]
        if (np.max(errors, axis=0) <= TOLERANCE * size).all():
            return d
    raise BadInput(
        f"parameter '{family.names[i]}' does not enter the plant as a sum of powers of p (up to {MAX_DEGREE}) and 1/p; "
        "reformulate the plant with a parameter that does"
    )


def _basis_matrix(d: Dependence) -> Array:
    return np.array([d.basis(t) for t in d.nodes()])


def _flat(matrices: Sequence[Array]) -> Array:
    return np.array([m.ravel() for m in matrices])


def _polynomial(family: _Family, dependences: list[Dependence]) -> Polynomial:
    """Return the coefficients by powers of (theta, s) of every parameter; those that multiply are sampled together."""
    q = len(dependences)
    total: Polynomial = {(0,) * (2 * q): family({})}
    for group in _multiplying(family, q):
        members = [dependences[i] for i in group]
        grids = [d.nodes() for d in members]
        if np.prod([len(g) for g in grids]) > MAX_BUILDS:
            names = ", ".join(d.name for d in members)
            raise BadInput(f"parameters {names} all multiply each other; pull out fewer of them at once")
        samples = {}
        for index in product(*(range(len(g)) for g in grids)):
            samples[index] = family({i: float(g[k]) for i, g, k in zip(group, grids, index, strict=True)})
        scale = np.max([np.abs(m) for m in samples.values()], axis=0)
        for index, matrix in _fit(samples, members).items():
            cleaned = np.where(np.abs(matrix) > 1e-13 * scale, matrix, 0.0)
            if any(index) and cleaned.any():
                exponents = {i: d.exponents(k) for i, d, k in zip(group, members, index, strict=True)}
                total[tuple(e for i in range(q) for e in exponents.get(i, (0, 0)))] = cleaned
    return total


def _multiplying(family: _Family, q: int) -> list[list[int]]:
    """Return the largest sets of parameters that all multiply each other somewhere in the matrices."""
    near: list[set[int]] = [set() for _ in range(q)]
    base, single = family({}), [family({i: 0.37}) for i in range(q)]
    for i, j in combinations(range(q), 2):
        both = family({i: 0.37, j: 0.37})
        scale = np.max([np.abs(m) for m in (base, single[i], single[j], both)], axis=0)
        if (np.abs(both - single[i] - single[j] + base) > 1e-12 * scale).any():
            near[i].add(j)
            near[j].add(i)
    return list(_cliques(near, [], set(range(q)), set()))


def _cliques(near: list[set[int]], chosen: list[int], open_: set[int], closed: set[int]) -> Iterator[list[int]]:
    """Yield the maximal cliques of a graph given by neighbours (Bron and Kerbosch)."""
    if not open_ and not closed and chosen:
        yield sorted(chosen)
    for i in sorted(open_):
        yield from _cliques(near, [*chosen, i], open_ & near[i], closed & near[i])
        open_, closed = open_ - {i}, closed | {i}


def _fit(samples: dict[tuple[int, ...], Array], dependences: Sequence[Dependence]) -> dict[tuple[int, ...], Array]:
    """Return the coefficient of every product of basis functions from samples on a tensor grid, axis by axis."""
    shape = tuple(d.up + d.down + 1 for d in dependences)
    table = np.array([samples[k] for k in product(*map(range, shape))])
    table = table.reshape(*shape, *table.shape[1:])
    for axis, d in enumerate(dependences):
        table = np.moveaxis(np.tensordot(np.linalg.inv(_basis_matrix(d)), table, (1, axis)), 0, axis)
    return {k: table[k] for k in product(*map(range, shape))}


def _assemble(polynomial: Polynomial, dependences: list[Dependence], nominal: StateSpace) -> AugmentedPlant:
    """Return the LFT of a matrix polynomial as an augmented plant, channels grouped by parameter."""
    lft = compressed(factored(polynomial))
    order = np.argsort(lft.variable, kind="stable")
    variable = lft.variable[order]  # 2 i for theta and 2 i + 1 for s of parameter i
    Dzw = lft.Dzw[np.ix_(order, order)].copy()
    # w = s z with s = theta / (1 + theta) is w = theta (z - w)
    Dzw[np.diag_indices_from(Dzw)] -= variable % 2
    Bw, Cz, n = lft.Bw[:, order], lft.Cz[order], nominal.order
    system = StateSpace(
        nominal.A,
        np.hstack([Bw[:n], nominal.B]),
        np.vstack([Cz[:, :n], nominal.C]),
        np.block([[Dzw, Cz[:, n:]], [Bw[n:], nominal.D]]),
        nominal.dt,
    )
    widths = tuple(int((variable // 2 == i).sum()) for i in range(len(dependences)))
    return AugmentedPlant(system, tuple(d.name for d in dependences), widths)


def _verify(family: _Family, augmented: AugmentedPlant) -> None:
    """Raise `BadInput` unless the LFT reproduces the function at severities not used in the fit."""
    base = np.abs(family({}))
    for k in range(3 if family.names else 0):
        theta = 0.45 * np.sin(1.0 + k + 2.3 * np.arange(len(family.names)))
        found, exact = augmented.close(theta), family(dict(enumerate(theta)))
        difference = np.abs(np.block([[found.A, found.B], [found.C, found.D]]) - exact)
        size = np.maximum(np.abs(exact), base)
        noise = np.minimum(size.max(axis=1, keepdims=True), size.max(axis=0, keepdims=True))
        if (difference > 1e-9 * size + 1e-12 * noise).any():
            raise BadInput(
                f"parameters {', '.join(family.names)} together enter the plant in a way that is not polynomial in p "
                f"and "
                f"1/p (largest difference {difference.max():.2g}); pull them out one at a time or reformulate"
            )
