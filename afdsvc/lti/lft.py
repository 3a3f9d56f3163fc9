"""Linear fractional transformations: the star product, faults as directions, and the fault signature S(theta).

A fault of relative severity theta is ``w = theta z`` around a plant that has the additional input w and output z
(thesis 2.16-2.20: A. K. Sekunda, "Fault Diagnosis and Identification of Electro-Mechanical Systems", DTU 2017).
Severity 0 is the healthy plant, -1 total loss.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array, StateSpace, common_dt, solve_loop


def star(upper: StateSpace, lower: StateSpace, down: int, up: int) -> StateSpace:
    """Return the star product: the last ``down`` outputs of ``upper`` drive the first inputs of ``lower``, the first
    ``up`` outputs of ``lower`` drive the last inputs of ``upper``.

    Inputs and outputs that remain: first those of ``upper``, then those of ``lower``; states in the same order. With
    ``lower`` having nothing left this is the lower LFT, with ``upper`` having nothing left the upper LFT. Raises
    `IllConditioned` when the loop is not well posed, `BadInput` when widths do not fit.
    """
    p, m = upper.outputs - down, upper.inputs - up
    if min(p, m, lower.inputs - down, lower.outputs - up) < 0:
        raise BadInput(
            f"star product: {down} signals down and {up} up do not fit systems of {upper.outputs} x {upper.inputs} and "
            f"{lower.outputs} x {lower.inputs} outputs x inputs"
        )
    dt = common_dt(upper, lower)
    # The signals that remain see [A B; C D] + [into] (I - loop)^-1 [from], with v = [outputs down; outputs up].
    A, B, C, D, into_x, into_y, v_x, v_u, v_v = _side_by_side(upper, lower, p, m, down, up)
    inner = solve_loop(np.eye(down + up) - v_v)
    gain_x, gain_u = inner @ v_x, inner @ v_u
    return StateSpace(A + into_x @ gain_x, B + into_x @ gain_u, C + into_y @ gain_x, D + into_y @ gain_u, dt)


def _side_by_side(upper: StateSpace, lower: StateSpace, p: int, m: int, down: int, up: int) -> tuple[Array, ...]:
    """Return both systems unconnected, their connecting signals ``v = [down; up]`` split off."""
    A = _diag(upper.A, lower.A)
    B, C, D = (
        _diag(upper.B[:, :m], lower.B[:, down:]),
        _diag(upper.C[:p], lower.C[up:]),
        _diag(upper.D[:p, :m], lower.D[up:, down:]),
    )
    # v drives: the last inputs of upper take v_up, the first inputs of lower take v_down.
    into_x = _anti(upper.B[:, m:], lower.B[:, :down])
    into_y = _anti(upper.D[:p, m:], lower.D[up:, :down])
    v_x = _diag(upper.C[p:], lower.C[:up])
    v_u = _diag(upper.D[p:, :m], lower.D[:up, down:])
    v_v = _anti(upper.D[p:, m:], lower.D[:up, :down])
    return A, B, C, D, into_x, into_y, v_x, v_u, v_v


def _diag(a: Array, b: Array) -> Array:
    return np.block([[a, np.zeros((a.shape[0], b.shape[1]))], [np.zeros((b.shape[0], a.shape[1])), b]])


def _anti(a: Array, b: Array) -> Array:
    return np.block([[np.zeros((a.shape[0], b.shape[1])), a], [b, np.zeros((b.shape[0], a.shape[1]))]])


@dataclass(frozen=True, slots=True, eq=False)
class FaultDirection:
    """How one fault enters a plant of n states, m inputs, p outputs: ``w = theta z`` with r channels.

    ``x+ = .. + Bw w``, ``y = .. + Dyw w``, ``z = Cz x + Dzu u + Dzw w``. Shapes: ``Bw (n, r)``, ``Dyw (p, r)``,
    ``Cz (r, n)``, ``Dzu (r, m)``, ``Dzw (r, r)``. ``input`` (or ``output``) is set when the fault sits on that input
    (output) of the plant: then it also acts on what the other faults of an augmented plant do there.
    """

    name: str
    Bw: Array
    Dyw: Array
    Cz: Array
    Dzu: Array
    Dzw: Array
    input: int | None = None
    output: int | None = None

    @property
    def width(self) -> int:
        """Number of channels r."""
        return int(self.Bw.shape[1])


def actuator_gain(plant: StateSpace, name: str, input: int) -> FaultDirection:
    """Return the direction of a relative gain change of one input: ``u_i`` acts as ``(1 + theta) u_i``."""
    _index("input", input, plant.inputs)
    return FaultDirection(
        name,
        plant.B[:, [input]],
        plant.D[:, [input]],
        np.zeros((1, plant.order)),
        np.eye(plant.inputs)[[input]],
        np.zeros((1, 1)),
        input=input,
    )


def sensor_gain(plant: StateSpace, name: str, output: int) -> FaultDirection:
    """Return the direction of a relative gain change of one output: ``y_i`` reads ``(1 + theta)`` times its value."""
    _index("output", output, plant.outputs)
    return FaultDirection(
        name,
        np.zeros((plant.order, 1)),
        np.eye(plant.outputs)[:, [output]],
        plant.C[[output]],
        plant.D[[output]],
        np.zeros((1, 1)),
        output=output,
    )


def _index(what: str, index: int, count: int) -> None:
    if not 0 <= index < count:
        raise BadInput(f"{what} number {index} does not exist; the plant has {what}s 0 to {count - 1}")


@dataclass(frozen=True, slots=True, eq=False)
class AugmentedPlant:
    """A plant with its faults pulled out: ``system`` has inputs ``[w, u]`` and outputs ``[z, y]``, ``w = diag(theta)
    z``.

    ``widths`` counts the channels of every fault, in the order of ``fault_names``.
    """

    system: StateSpace
    fault_names: tuple[str, ...]
    widths: tuple[int, ...]

    @property
    def channels(self) -> int:
        """Number of channels of all faults together."""
        return sum(self.widths)

    @property
    def plant(self) -> StateSpace:
        """The healthy plant, from u to y."""
        return self.system.select(slice(self.channels, None), slice(self.channels, None))

    def channels_of(self, name: str) -> slice:
        """Return the positions of one fault's channels in w and z; raises `BadInput` for an unknown name."""
        if name not in self.fault_names:
            raise BadInput(f"fault '{name}' is not known; the plant has {', '.join(self.fault_names) or 'none'}")
        k = self.fault_names.index(name)
        return slice(sum(self.widths[:k]), sum(self.widths[: k + 1]))

    def severities(self, theta: Sequence[float] | Mapping[str, float] | Array) -> Array:
        """Return the severity of every channel, shape ``(channels,)``, from a vector in fault order or from names."""
        if isinstance(theta, Mapping):
            for name in theta:
                self.channels_of(name)
            theta = [theta.get(name, 0.0) for name in self.fault_names]
        values = np.asarray(theta, dtype=np.float64)
        if values.shape != (len(self.fault_names),) or not np.isfinite(values).all():
            raise BadInput(
                f"severities {values.tolist()}: expected {len(self.fault_names)} finite numbers, one for each fault"
            )
        return np.repeat(values, self.widths)

    def close(self, theta: Sequence[float] | Mapping[str, float] | Array) -> StateSpace:
        """Return the plant with the faults present (upper LFT, thesis 2.18); severity 0 gives the healthy plant."""
        th, k, s = self.severities(theta), self.channels, self.system
        if not th.any():
            return self.plant
        # w = th z with z = Cz x + Dzw w + Dzu u  gives  w = (I - th Dzw)^-1 th (Cz x + Dzu u)
        gain = solve_loop(np.eye(k) - th[:, None] * s.D[:k, :k]) * th[None, :]
        return StateSpace(
            s.A + s.B[:, :k] @ gain @ s.C[:k],
            s.B[:, k:] + s.B[:, :k] @ gain @ s.D[:k, k:],
            s.C[k:] + s.D[k:, :k] @ gain @ s.C[:k],
            s.D[k:, k:] + s.D[k:, :k] @ gain @ s.D[:k, k:],
            s.dt,
        )

    def reordered(self, names: Sequence[str]) -> AugmentedPlant:
        """Return the plant with these faults, in this order; faults left out stay at severity 0."""
        slices = [list(range(self.channels))[self.channels_of(name)] for name in names]
        keep = [c for part in slices for c in part]
        k, s = self.channels, self.system
        system = s.select([*keep, *range(k, s.outputs)], [*keep, *range(k, s.inputs)])
        return AugmentedPlant(system, tuple(names), tuple(len(part) for part in slices))

    def with_gain_faults(self, sites: Mapping[str, tuple[str, int]], order: Sequence[str]) -> AugmentedPlant:
        """Return the plant with gain faults ``name: ("input" or "output", index)`` added, all in the given order."""
        make = {"input": actuator_gain, "output": sensor_gain}
        return self.with_directions([make[kind](self.plant, name, i) for name, (kind, i) in sites.items()], order)

    def with_directions(self, directions: Sequence[FaultDirection], order: Sequence[str]) -> AugmentedPlant:
        """Return the plant with further faults, given as directions of its healthy plant, all in the given order."""
        k, s = self.channels, self.system
        inner = FaultDirection("", s.B[:, :k], s.D[k:, :k], s.C[:k], s.D[:k, k:], s.D[:k, :k])
        both = augment(self.plant, [inner, *directions])
        names = (*self.fault_names, *(d.name for d in directions))
        return AugmentedPlant(both.system, names, (*self.widths, *(d.width for d in directions))).reordered(order)


def augment(plant: StateSpace, directions: Sequence[FaultDirection]) -> AugmentedPlant:
    """Return the plant with all the faults pulled out at once.

    Faults on inputs and outputs compose with all others (an actuator fault acts on a sensor fault through D, and by
    a parameter that multiplies u). Products of parameters do not follow from separate directions: build those plants
    with `afdsvc.lti.parametric.parametric_plant`. Raises `BadInput` for repeated names or sites and for wrong shapes.
    """
    _unique(directions)
    for d in directions:
        _fits(plant, d)
    Dzw = np.zeros((sum(d.width for d in directions),) * 2)
    starts = np.cumsum([0, *(d.width for d in directions)])
    for i, to in enumerate(directions):
        for j, origin in enumerate(directions):
            Dzw[starts[i] : starts[i + 1], starts[j] : starts[j + 1]] = to.Dzw if i == j else _coupling(to, origin)
    stack = [
        np.zeros((plant.order, 0)),
        np.zeros((plant.outputs, 0)),
        np.zeros((0, plant.order)),
        np.zeros((0, plant.inputs)),
    ]
    Bw, Dyw = np.hstack([stack[0], *(d.Bw for d in directions)]), np.hstack([stack[1], *(d.Dyw for d in directions)])
    Cz, Dzu = np.vstack([stack[2], *(d.Cz for d in directions)]), np.vstack([stack[3], *(d.Dzu for d in directions)])
    system = StateSpace(
        plant.A, np.hstack([Bw, plant.B]), np.vstack([Cz, plant.C]), np.block([[Dzw, Dzu], [Dyw, plant.D]]), plant.dt
    )
    return AugmentedPlant(system, tuple(d.name for d in directions), tuple(d.width for d in directions))


def _coupling(to: FaultDirection, origin: FaultDirection) -> Array:
    """Return the direct path from the w of one fault to the z of another: through an input, or onto an output."""
    if to.output is not None:
        return origin.Dyw[[to.output]]
    if origin.input is not None:
        return to.Dzu[:, [origin.input]] if to.input is None else np.zeros((to.width, origin.width))
    return np.zeros((to.width, origin.width))


def _unique(directions: Sequence[FaultDirection]) -> None:
    names = [d.name for d in directions]
    sites = [f"input {d.input}" for d in directions if d.input is not None]
    sites += [f"output {d.output}" for d in directions if d.output is not None]
    for what, values in (("name", names), ("site", sites)):
        repeated = [v for v in values if values.count(v) > 1]
        if repeated:
            raise BadInput(f"two faults have the {what} {repeated[0]}; every {what} may appear once")


def _fits(plant: StateSpace, d: FaultDirection) -> None:
    r = d.width
    shapes = {
        "Bw": (plant.order, r),
        "Dyw": (plant.outputs, r),
        "Cz": (r, plant.order),
        "Dzu": (r, plant.inputs),
        "Dzw": (r, r),
    }
    for field, shape in shapes.items():
        if getattr(d, field).shape != shape:
            raise BadInput(f"fault '{d.name}': {field} has shape {getattr(d, field).shape}; expected {shape} for this plant")


def signature_interconnection(augmented: AugmentedPlant, J_K: StateSpace) -> StateSpace:
    """Return the healthy closed loop from ``[w, alpha]`` to ``[z, beta]``: S(theta) is its upper LFT with diag(theta).

    Its blocks are ``[Gzw + Gzu U Mt Gyw, Gzu M; Mt Gyw, 0]`` (thesis 2.19), all stable.
    """
    s, k = augmented.system, augmented.channels
    return star(s, J_K, s.outputs - k, s.inputs - k)


def fault_signature(
    augmented: AugmentedPlant, J_K: StateSpace, theta: Sequence[float] | Mapping[str, float] | Array
) -> StateSpace:
    """Return ``S(theta)`` from alpha to beta, by closing the faulty plant with J_K (inputs ``[y, alpha]``).

    Closing loops instead of multiplying factors keeps the order at plant plus J_K and shows unstable modes as poles.
    """
    faulty = augmented.close(theta)
    return star(faulty, J_K, faulty.outputs, faulty.inputs)
