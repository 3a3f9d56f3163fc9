"""Saturation: a signal, or a state, that is held within a limit."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from afdsvc.api.physics import Axis, Coefficient, Hypothesis, Law, Machine, Signal, Size
from afdsvc.plugins.physics.attach import (
    at_drive,
    at_force,
    at_input,
    at_state,
    constant,
    decaying,
    downstream,
    quantity,
    state,
    store_states,
    velocity,
)

NO_LOAD = 1.1  # times the largest velocity: where a search begins with nothing left to give
SERVO = 0.1  # difference from one of the gain at rest up to which a position follows an input
SHARP, SOFT = 1e-3, 0.4  # shares of the limit over which the corner may be rounded


def soft_limit(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """The input is held within ``+-limit``, the corner rounded by a parabola over ``+-knee limit``."""
    corner = p[1] * p[0]
    beyond = abs(z[0]) - p[0]
    if beyond > -corner:
        lost = beyond if beyond >= corner else (beyond + corner) ** 2 / (4 * corner)
        out[0] -= math.copysign(lost, z[0])


def two_limits(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """The input is held between ``p[1]`` and ``p[0]``."""
    out[0] += min(max(z[0], p[1]), p[0]) - z[0]


def cut_above(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """The signal is cut above the limit only."""
    out[0] -= max(z[0] - p[0], 0.0)


def cut_below(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """The signal is cut below the limit only, as by a pump that cannot suck."""
    out[0] += max(p[0] - z[0], 0.0)


def ceiling(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """The input of gain ``p[2]`` is held between ``-p[0] - p[1] v`` and ``p[0] - p[1] v``: a supply has less to give against the voltage that motion induces."""
    out[0] += p[2] * (min(max(z[0], -p[0] - p[1] * z[1]), p[0] - p[1] * z[1]) - z[0])


def largest_error(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """Of the error ``u + p[3] q``, multiplied by ``p[2]``, what lies between ``-p[1]`` and ``p[0]`` drives: the motor inside a servo has no more to give."""
    error = z[0] + p[3] * z[1]
    out[0] += p[2] * (min(max(error, -p[1]), p[0]) - error)


def _held(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """A state beyond ``+-limit`` is brought back within one step."""
    out[0] -= math.copysign(max(abs(z[0]) - p[0], 0.0), z[0]) / dt


def overflow(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """What is above ``limit`` leaves within one step; a share ``p[1]`` of it goes the way of the outflow, ``p[2:]`` per unit lost."""
    lost = max(z[0] - p[0], 0.0) / dt
    out[0] -= lost
    for k in range(1, len(out)):
        out[k] += p[1] * p[1 + k] * lost


def relieved(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """What is above ``limit`` leaves at the rate ``p[1]``: a valve that opens there, or an overflow that is narrow."""
    out[0] -= max(z[0] - p[0], 0.0) * (1 - math.exp(-p[1] * dt)) / dt


def relieved_both_ways(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """`relieved` beyond ``+-limit``, as a difference of pressures is by two relief valves."""
    out[0] -= math.copysign(max(abs(z[0]) - p[0], 0.0) * (1 - math.exp(-p[1] * dt)) / dt, z[0])


def emptied(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """A state below the limit is brought back within one step: a tank that is empty, a flow that a check valve does not let turn back."""
    out[0] += max(p[0] - z[0], 0.0) / dt


class Saturation:
    """A limit at every input, on one side or both, or falling with the velocity it drives; of the error of a servo, of every velocity, of every force that is a state,
    of every store, full, relieved or empty, and of what else decays, relieved both ways. All lie inside the range the recordings use."""

    name = "saturation"
    summary = "commands, speeds or levels beyond a limit are cut"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return hypotheses started at limits between a third of the largest value and a little above it."""
        for port in machine.inputs:
            yield from self._of_input(port)
        for axis in machine.axes:
            if axis.input is not None:
                yield self._falling(axis, machine)
                yield from self._inside_a_servo(axis, machine)
            yield at_force(axis, _held, [velocity(axis)], **self._of_state(axis.rate))
        for store in store_states(machine):
            if quantity(store.unit) == "force":
                yield at_state(store, _held, [state(store)], **self._of_state(store))
            else:
                yield self._of_store(store, machine)
                yield self._relieved(store, machine, relieved, "gradual", _full(store), [_part(store, s) for s in (0.0, 0.5, 1.0, 1.5)])
                yield self._empty(store)
        for held, _ in decaying(machine):
            if held.reverses and quantity(held.unit) != "force":
                starts = [s * held.peak for s in (0.2, 0.4, 0.6, 0.8)]
                yield self._relieved(held, machine, relieved_both_ways, "gradual both ways", _limit(held), starts)

    def _of_state(self, size: Size) -> dict[str, Any]:
        return {
            "physics": self.name, "family": "limit", "parameters": [_limit(size)], "starts": [(s * size.peak,) for s in (0.4, 0.6, 0.8, 0.95)],
            "predicts": "a value that stays the same whatever drives it", "refuted_by": "values beyond the limit",
        }

    def _of_input(self, port: Size) -> Iterable[Hypothesis]:
        words: dict[str, Any] = {
            "physics": self.name, "family": "input curve", "predicts": "nothing below a level; above it missing peaks of the input",
            "refuted_by": "distortion in recordings whose input never reaches the limit",
        }
        peak, step = port.peak, 0.02 * port.peak
        yield at_input(
            port, soft_limit, parameters=[_limit(port), Coefficient("knee", "", SHARP, SOFT, 0.05, nuisance=True)],
            starts=[(share * peak, 0.1) for share in (0.35, 0.6, 0.85, 0.95)], **words,
        )
        top, low = port.mean - port.rms, port.mean + port.rms
        upper = Coefficient("upper limit", port.unit, top, max(1.4 * peak, top + port.rms), step)
        lower = Coefficient("lower limit", port.unit, min(-1.4 * peak, low - port.rms), low, step)
        for law, limit, way, variant in ((cut_above, upper, 1, "above"), (cut_below, lower, -1, "below")):
            starts = [(port.mean + way * s * port.rms,) for s in (0.0, 0.5, 0.95, 1.5)]
            yield at_input(port, law, parameters=[limit], starts=starts, notes={"variant": variant, "of": ""}, **words)
        yield at_input(
            port, two_limits, parameters=[upper, lower],
            starts=[(port.mean + a * port.rms, port.mean - b * port.rms) for a, b in ((0.9, 0.9), (0.5, 0.95), (0.95, 0.5))],
            notes={"variant": "asymmetric", "of": ""}, **words,
        )

    def _falling(self, axis: Axis, machine: Machine) -> Hypothesis:
        port, v = machine.inputs[axis.input or 0], axis.rate
        way = math.copysign(port.peak / v.peak, axis.gain)
        limit = Coefficient("limit at rest", port.unit, 0.1 * port.peak, 20 * port.peak, 0.05 * port.peak)
        fall = Coefficient("fall with the velocity", f"{port.unit}/({v.unit})", min(0.0, 20 * way), max(0.0, 20 * way), 0.05 * abs(way))
        return at_drive(
            axis, machine, ceiling, [Signal("u", port.index), velocity(axis)], physics=self.name, family="limit",
            notes={"variant": f"falls with {v.name}", "of": ""}, parameters=[limit, fall, constant("gain", "", axis.gain)],
            starts=[(a * port.peak, a * way / NO_LOAD, axis.gain) for a in (1.2, 2.5, 6.0)],
            predicts="missing peaks of the input at high velocity only, while it speeds up and not while it brakes", refuted_by="the same limit at every velocity",
        )

    def _inside_a_servo(self, axis: Axis, machine: Machine) -> Iterable[Hypothesis]:
        port, q = machine.inputs[axis.input or 0], axis.position
        spring = 0.0 if q is None or machine.plant is None else float(machine.plant.A[axis.rate.index, q.index])
        if q is None or not spring or abs(axis.gain + spring) > SERVO * abs(axis.gain):
            return
        weight = spring / axis.gain
        yield at_drive(
            axis, machine, largest_error, [Signal("u", port.index), state(q)], physics=self.name, family="limit", notes={"variant": "of the error", "of": ""},
            parameters=[
                *(Coefficient(f"largest error {way}", port.unit, 1e-3 * port.peak, 2 * port.peak, 0.02 * port.peak) for way in ("above", "below")),
                constant("gain", "", axis.gain), constant("weight", "", weight),
            ],
            starts=[(share * port.peak, share * port.peak, axis.gain, weight) for share in (0.03, 0.1, 0.3, 0.8)],
            predicts="steps of any height are followed at the same speed", refuted_by="steps that take the same time at every height",
        )

    def _of_store(self, store: Size, machine: Machine) -> Hypothesis:
        ways = downstream(machine, store)
        return at_state(
            store, overflow, [state(store)], [state(store), *(Signal("x", i) for i, _ in ways)], physics=self.name, family="limit",
            parameters=[
                _full(store), Coefficient("share passed on", "", 0.0, 1.0, 0.1, nuisance=True) if ways else constant("share passed on", "", 0.0),
                *(constant("per unit lost", "", v) for _, v in ways),
            ],
            starts=[(_part(store, s), 0.5 if ways else 0.0, *(v for _, v in ways)) for s in (0.3, 0.8, 1.3, 2.0)],
            predicts="a level that stays at the same value whatever flows in", refuted_by="levels above the limit",
        )

    def _relieved(self, held: Size, machine: Machine, law: Law, variant: str, limit: Coefficient, starts: Sequence[float]) -> Hypothesis:
        own = next(rate for s, rate in decaying(machine) if s.index == held.index)
        return at_state(
            held, law, [state(held)], physics=self.name, family="limit", notes={"variant": variant, "of": ""},
            parameters=[limit, Coefficient("rate of what is beyond", "1/s", 0.01 * own, max(1 / machine.dt, 3 * own), own)], starts=[(start, 3 * own) for start in starts],
            predicts="a level that is harder to raise beyond a value", refuted_by="a level that is raised alike everywhere",
        )

    def _empty(self, store: Size) -> Hypothesis:
        low, top = store.mean - store.reach, store.mean + store.rms
        return at_state(
            store, emptied, [state(store)], physics=self.name, family="limit", notes={"variant": "below"},
            parameters=[Coefficient("lower limit", store.unit, low, top, 0.02 * store.reach)], starts=[(store.mean - s * store.rms,) for s in (0.3, 0.8, 1.3, 2.0)],
            predicts="a level that stays at the same value whatever flows out", refuted_by="levels below the limit",
        )


def _limit(size: Size) -> Coefficient:
    return Coefficient("limit", size.unit, 0.02 * size.peak, 1.4 * size.peak, 0.02 * size.peak)


def _full(store: Size) -> Coefficient:
    return Coefficient("limit", store.unit, store.mean - store.rms, 1.4 * store.peak, 0.02 * store.peak)


def _part(store: Size, share: float) -> float:
    """Return the mean and a share of the rms, inside the range of `_full`."""
    return min(store.mean + share * store.rms, 1.35 * store.peak)
