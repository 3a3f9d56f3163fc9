"""From a function of physical parameters to a plant with those parameters pulled out as faults.

The matrices ``[A B; C D]`` are sampled at changed parameter values, fitted exactly as polynomials in the relative
changes ``theta`` (or in ``theta / (1 + theta)`` for a parameter that divides, like a mass), products of parameters
included, and realised as a linear fractional transformation. Nobody writes a fault matrix by hand, and the result is
checked against the function itself before it is handed out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from afdsvc.errors import BadInput
from afdsvc.lti.lft import AugmentedPlant, FaultDirection
from afdsvc.lti.matrix_polynomial import Polynomial, compressed, factored
from afdsvc.lti.statespace import Array, StateSpace

MAX_DEGREE = 10
MAX_BUILDS = 8192
TOLERANCE = 1e-10  # of the largest value an entry takes

Build = Callable[[Mapping[str, float]], StateSpace]


@dataclass(frozen=True, slots=True)
class Dependence:
    """How the matrices depend on one parameter: degree, in theta or (``reciprocal``) in ``theta / (1 + theta)``."""

    name: str
    degree: int
    reciprocal: bool

    def variable(self, theta: float) -> float:
        """Return the variable the matrices are polynomials in."""
        return theta / (1 + theta) if self.reciprocal else theta

    def nodes(self) -> Array:
        """Return the severities to sample at: 0 and ``degree`` others."""
        k = np.arange(1, self.degree + 1)
        others = 0.5 * np.cos(np.pi * (k - 0.5) / (self.degree + self.degree % 2))  # an even count never hits zero
        return np.concatenate([[0.0], others])


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


def parameter_direction(build: Build, values: Mapping[str, float], name: str, fault: str = "") -> FaultDirection:
    """Return the direction of a relative change of one physical parameter, named ``fault`` (or like the parameter)."""
    a = parametric_plant(build, values, [name])
    s, k = a.system, a.channels
    return FaultDirection(fault or name, s.B[:, :k], s.D[k:, :k], s.C[:k], s.D[:k, k:], s.D[:k, :k])


class _Family:
    """The packed matrices ``[A B; C D]`` as a function of severities."""

    def __init__(self, build: Build, values: dict[str, float], names: tuple[str, ...]) -> None:
        self.build, self.values, self.names = build, values, names
        for name in names:
            if name not in values:
                raise BadInput(f"the plant has no parameter '{name}'; it has {', '.join(values)}")
            if values[name] == 0:
                raise BadInput(
                    f"parameter '{name}' is 0, so a relative change of it means nothing; give it a value or leave it "
                    f"out"
                )

    def __call__(self, severities: Mapping[int, float]) -> Array:
        changed = dict(self.values)
        for i, theta in severities.items():
            changed[self.names[i]] = self.values[self.names[i]] * (1 + theta)
        s = self.build(changed)
        return np.block([[s.A, s.B], [s.C, s.D]])


def _dependence(family: _Family, i: int) -> Dependence:
    """Return the lowest degree that reproduces the matrices at severities it was not fitted to."""
    probes = {theta: family({i: theta}) for theta in (-0.47, -0.21, 0.13, 0.41)}
    size = np.max([np.abs(m) for m in probes.values()], axis=0)
    for degree in range(1, MAX_DEGREE + 1):
        for reciprocal in (False, True):
            d = Dependence(family.names[i], degree, reciprocal)
            coefficients = _fit({(k,): family({i: t}) for k, t in enumerate(d.nodes())}, [d])
            errors = [np.abs(_evaluate(coefficients, [d.variable(t)]) - m) for t, m in probes.items()]
            if (np.max(errors, axis=0) <= TOLERANCE * size).all():
                return d
    raise BadInput(
        f"parameter '{family.names[i]}' enters the plant neither as a polynomial of degree {MAX_DEGREE} in p nor in "
        f"1/p; "
        "reformulate the plant with a parameter that does"
    )


def _polynomial(family: _Family, dependences: list[Dependence]) -> Polynomial:
    """Return the coefficients by multi-index over all parameters; only those that multiply are sampled together."""
    q = len(dependences)
    total: Polynomial = {(0,) * q: family({})}
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
                total[_spread(index, group, q)] = cleaned
    return total


def _spread(index: tuple[int, ...], group: Sequence[int], q: int) -> tuple[int, ...]:
    full = [0] * q
    for i, k in zip(group, index, strict=True):
        full[i] = k
    return tuple(full)


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


def _fit(samples: dict[tuple[int, ...], Array], dependences: Sequence[Dependence]) -> Polynomial:
    """Return the polynomial through samples on a tensor grid, one axis after the other."""
    shape = tuple(d.degree + 1 for d in dependences)
    table = np.array([samples[k] for k in product(*map(range, shape))])
    table = table.reshape(*shape, *table.shape[1:])
    for axis, d in enumerate(dependences):
        nodes = np.array([d.variable(t) for t in d.nodes()])
        inverse = np.linalg.inv(np.vander(nodes, increasing=True))
        table = np.moveaxis(np.tensordot(inverse, table, (1, axis)), 0, axis)
    return {k: table[k] for k in product(*map(range, shape))}


def _evaluate(polynomial: Polynomial, variables: Sequence[float]) -> Array:
    return np.asarray(
        sum(m * np.prod([v**k for v, k in zip(variables, index, strict=True)]) for index, m in polynomial.items())
    )


def _assemble(polynomial: Polynomial, dependences: list[Dependence], nominal: StateSpace) -> AugmentedPlant:
    """Return the LFT of a matrix polynomial as an augmented plant, channels grouped by parameter."""
    lft = compressed(factored(polynomial))
    order = np.argsort(lft.variable, kind="stable")
    variable = lft.variable[order]
    Dzw = lft.Dzw[np.ix_(order, order)].copy()
    # w = s z with s = theta / (1 + theta) is w = theta (z - w)
    Dzw[np.diag_indices_from(Dzw)] -= np.array([dependences[v].reciprocal for v in variable], dtype=float)
    Bw, Cz, n = lft.Bw[:, order], lft.Cz[order], nominal.order
    system = StateSpace(
        nominal.A,
        np.hstack([Bw[:n], nominal.B]),
        np.vstack([Cz[:, :n], nominal.C]),
        np.block([[Dzw, Cz[:, n:]], [Bw[n:], nominal.D]]),
        nominal.dt,
    )
    widths = tuple(int((variable == i).sum()) for i in range(len(dependences)))
    return AugmentedPlant(system, tuple(d.name for d in dependences), widths)


def _verify(family: _Family, augmented: AugmentedPlant) -> None:
    """Raise `BadInput` unless the LFT reproduces the function at severities nobody fitted."""
    base = np.abs(family({}))
    for k in range(3 if family.names else 0):
        theta = 0.45 * np.sin(1.0 + k + 2.3 * np.arange(len(family.names)))
        found, wanted = augmented.close(theta), family(dict(enumerate(theta)))
        difference = np.abs(np.block([[found.A, found.B], [found.C, found.D]]) - wanted)
        size = np.maximum(np.abs(wanted), base)
        noise = np.minimum(size.max(axis=1, keepdims=True), size.max(axis=0, keepdims=True))
        if (difference > 1e-9 * size + 1e-12 * noise).any():
            raise BadInput(
                f"parameters {', '.join(family.names)} together enter the plant in a way that is not polynomial in p "
                f"and "
                f"1/p (largest difference {difference.max():.2g}); pull them out one at a time or reformulate"
            )
