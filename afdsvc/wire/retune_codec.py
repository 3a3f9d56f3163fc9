"""Requests to let a Q act beside the running controller, to bytes and back."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from afdsvc.api.retuning import Diagnosed, Promise, Tuning
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.wire import afdsvc_pb2 as pb
from afdsvc.wire.keys import checked_machine
from afdsvc.wire.messages import RetuneRequest
from afdsvc.wire.parsing import build_message, count, nanoseconds, parse, positive, required, stamp


def encode_retune_request(request: RetuneRequest) -> bytes:
    """Return the message; raises `BadInput` for values out of range."""
    Q, tuning, found = request.tuning.Q, request.tuning, request.found
    message = build_message(
        pb.RetuneRequest, timestamp=stamp(request.t_ns), machine=request.machine, name=request.name, states=Q.order, inputs=Q.outputs,
        outputs=Q.inputs, matrices=_flat(Q.A, Q.B, Q.C, Q.D), dt=Q.dt, rise=tuning.rise, fall=tuning.fall, promise=_promise_message(tuning.promise),
        fault=found.fault, low=found.low, high=found.high, lease=request.lease, asked_by=request.asked_by, session=request.session,
        k=request.k, proof=request.proof,
    )  # fmt: skip
    return message.SerializeToString(deterministic=True)


def decode_retune_request(data: bytes) -> RetuneRequest:
    """Return the request; raises `BadInput` naming what is missing or unsound, NaN in a matrix included."""
    m = parse(pb.RetuneRequest, data)
    required(m, "machine", "timestamp", "name", "inputs", "outputs", "asked_by", "fault")
    n, rows, columns = count(m, "states"), count(m, "inputs"), count(m, "outputs")
    if len(m.matrices) != (n + rows) * (n + columns):
        raise BadInput(f"RetuneRequest message with {len(m.matrices)} numbers; expected {(n + rows) * (n + columns)}, those of Q with {n} states, {rows} x {columns}")
    _finite(m.matrices, [m.rise, m.fall, m.low, m.high])
    if min(m.rise, m.fall) < 0:
        raise BadInput(f"RetuneRequest message with times {m.rise} and {m.fall} s; expected 0 or more")
    A, B, C, D = _split(np.array(m.matrices, dtype=float), n, rows, columns)
    tuning = Tuning(StateSpace(A, B, C, D, positive(m, "dt")), m.rise, m.fall, _promise(m, rows, columns))
    return RetuneRequest(
        checked_machine(m.machine), m.name, tuning, Diagnosed(m.fault, m.low, m.high), positive(m, "lease"), m.asked_by,
        nanoseconds(m.timestamp), m.session, count(m, "k"), m.proof,
    )  # fmt: skip


def _flat(*matrices: Array) -> list[float]:
    return [float(v) for M in matrices for v in M.ravel()]


def _split(values: Array, n: int, rows: int, columns: int) -> tuple[Array, Array, Array, Array]:
    shapes = ((n, n), (n, columns), (rows, n), (rows, columns))
    ends = np.cumsum([a * b for a, b in shapes])[:-1]
    A, B, C, D = (part.reshape(shape) for part, shape in zip(np.split(values, ends), shapes, strict=True))
    return A, B, C, D


def _promise_message(promise: Promise | None) -> pb.Promise | None:
    if promise is None:
        return None
    return build_message(pb.Promise, output=_flat(promise.output), input=_flat(promise.input), cost=promise.cost, seconds=promise.seconds)


def _promise(message: pb.RetuneRequest, rows: int, columns: int) -> Promise | None:
    if not message.HasField("promise"):
        return None
    p = message.promise
    if (len(p.output), len(p.input)) != (columns**2, rows**2):
        raise BadInput(f"RetuneRequest message with weights of {len(p.output)} and {len(p.input)} numbers; expected {columns**2} and {rows**2}")
    _finite(p.output, p.input)
    output, weight = np.array(p.output, dtype=float).reshape(columns, columns), np.array(p.input, dtype=float).reshape(rows, rows)
    return Promise(output, weight, positive(p, "cost"), positive(p, "seconds"))


def _finite(*numbers: Iterable[float]) -> None:
    if not all(math.isfinite(v) for values in numbers for v in values):
        raise BadInput("RetuneRequest message contains NaN or infinity; expected finite numbers")
