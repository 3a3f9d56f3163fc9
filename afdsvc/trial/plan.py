"""The trials of a study: how many of which question, at which severity, on which machine, under which controller."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from afdsvc.errors import Refused
from afdsvc.trial.effects.catalogue import changes_at, outside_at, physics_at
from afdsvc.trial.field.catalogue import STREAM, FieldOptions, draws
from afdsvc.trial.field.generate import FieldTrial, make
from afdsvc.trial.generate import BlindTrial, TrialRequest, generate_several
from afdsvc.trial.options import Options

FIELD = "field"  # the part whose trials `field_plan` gives
RHOS = (0.1, 0.3, 1.0)
MIX = {  # trials in 300
    "bearing": 156, "axis": 44, "nothing": 24, "change": 20, "two": 16, "outside": 14, "dirty": 10, "noise": 10, "excitation": 6,
}
ALIKE = (  # pairs from one of these sets can cancel each other in the recordings; they are not hidden together
    {"constant_load", "sensor_offset", "sensor_drift"},
    {"transport_delay", "actuator_lag", "sensor_lag", "resonant_actuator"},
    {"coulomb_friction", "stribeck_friction", "hysteresis", "backlash"},
    {"cubic_stiffness", "clearance", "saturation", "sensor_saturation"},
    {"sensor_misalignment", "sensor_crosstalk"},
)


@dataclass(frozen=True, slots=True)
class Request:
    """One trial to be made: number, part of the study, what to hide, how to stage it, seed."""

    number: int
    part: str
    wishes: tuple[TrialRequest, ...]
    options: Options | FieldOptions
    seed: tuple[int, ...]

    def as_json(self) -> dict[str, Any]:
        """Return the request as plain values."""
        return asdict(self)


def plan(count: int, seed: int) -> list[Request]:
    """Return the requests of a study of about ``count`` trials (at least one per part), mixed as in `MIX`."""
    generator = np.random.default_rng(seed)
    requests: list[Request] = []
    for part, share in MIX.items():
        for k, (wishes, options) in zip(range(max(1, round(count * share / 300))), PARTS[part](generator), strict=False):
            number = len(requests)
            requests.append(Request(number, part, tuple(wishes), options, (seed, number, k)))
    return requests


def field_plan(count: int, seed: int) -> list[Request]:
    """Return the requests of a study of field trials, numbered from 0; another count gives the same first ones."""
    requests = []
    for k, (options, share, labels) in zip(range(count), draws(seed), strict=False):
        wishes = tuple(TrialRequest(label, None, share) for label in labels)
        requests.append(Request(k, FIELD, wishes, options, (seed, STREAM, k)))
    return requests


def make_trial(request: Request) -> BlindTrial | FieldTrial:
    """Return the trial, as asked where the machine allows it.

    What no severity can give inside the machine's reach is tried under the proportional controller, at other sites and
    shapes (three seeds), and then at 0.6 and 0.3 of the rho. Raises `Refused` when all of that fails.
    """
    if isinstance(request.options, FieldOptions):
        return make(request.options, max((w.rho for w in request.wishes), default=0.0), request.seed)
    name = "/".join(map(str, request.seed))
    for share in (1.0, 0.6, 0.3):
        wishes = [TrialRequest(w.physics, w.site, w.rho * share) for w in request.wishes]
        for attempt in range(4):
            controller = request.options.controller if attempt == 0 else "proportional"
            options = replace(request.options, controller=controller)
            try:
                return generate_several(wishes, np.random.default_rng([*request.seed, attempt]), options, f"{name}/{attempt}")
            except Refused:
                continue
    raise Refused(f"trial {name}: nothing like {request.wishes} fits the machine")


Draw = tuple[list[TrialRequest], Options]


def _bearing(generator: np.random.Generator, rho: float = 0.0) -> Options:
    """Return the bearing under either controller; the observer controller only where rho is small enough for its loop."""
    lqg = rho <= 0.3 and generator.random() < 0.4
    return Options(
        controller="lqg" if lqg else "proportional", injection="youla" if generator.random() < 0.5 else "added"
    )


def _names(options: Options) -> list[str]:
    return sorted({name for name, _ in physics_at(options.build())})


def _every(options: Options, generator: np.random.Generator) -> Iterator[tuple[str, float]]:
    """Yield every name at every rho, over and over, in an order that mixes both."""
    names = _names(options)
    while True:
        for turn in range(len(RHOS)):
            for i in generator.permutation(len(names)):
                yield names[i], RHOS[(int(i) + turn) % len(RHOS)]


def _on_bearing(generator: np.random.Generator) -> Iterator[Draw]:
    for name, rho in _every(Options(), generator):
        yield [TrialRequest(name, None, rho)], _bearing(generator, rho)


def _on_axis(generator: np.random.Generator) -> Iterator[Draw]:
    options = Options(machine="positioning_axis")
    for name, rho in _every(options, generator):
        yield [TrialRequest(name, None, rho)], options


def _nothing(generator: np.random.Generator) -> Iterator[Draw]:
    while True:
        for k in range(6):
            yield [], Options(machine="positioning_axis") if k == 5 else _bearing(generator)


def _change(generator: np.random.Generator) -> Iterator[Draw]:
    places = changes_at(Options().build())
    while True:
        for i in generator.permutation(len(places)):
            (name, site), rho = places[i], float(generator.choice([0.3, 0.5, 1.0]))
            yield [TrialRequest(name, site, rho)], _bearing(generator, rho)


def _two(generator: np.random.Generator) -> Iterator[Draw]:
    options = Options(controller="proportional")
    names = _names(options)
    while True:
        pair = {str(name) for name in generator.choice(names, 2, replace=False)}
        if not any(pair <= alike for alike in ALIKE):
            yield [TrialRequest(name, None, 0.6) for name in sorted(pair)], options


def _outside(generator: np.random.Generator) -> Iterator[Draw]:
    names = sorted({name for name, _ in outside_at(Options().build())})
    while True:
        for k, name in enumerate(names):
            rho = RHOS[1 + k % 2]
            yield [TrialRequest(name, None, rho)], _bearing(generator, rho)
        names = names[::-1]


def _dirty(generator: np.random.Generator) -> Iterator[Draw]:
    options = replace(_bearing(generator, 1.0), dirty=True)
    names = _names(options)
    while True:
        for k in range(5):
            yield [TrialRequest(str(generator.choice(names)), None, 0.5)] if k else [], options


def _noise(generator: np.random.Generator) -> Iterator[Draw]:
    names = _names(Options())
    while True:
        for kind in ("coloured", "process", "quieter", "louder", "process"):
            hidden = [TrialRequest(str(generator.choice(names)), None, 0.3)] if generator.random() < 0.5 else []
            yield hidden, replace(_bearing(generator, 1.0), noise=kind)


def _excitation(generator: np.random.Generator) -> Iterator[Draw]:
    names = _names(Options())
    while True:
        for kind in ("sine", "operation", "one_level"):
            yield [TrialRequest(str(generator.choice(names)), None, 0.3)], replace(_bearing(generator, 1.0), excitation=kind)


PARTS = {
    "bearing": _on_bearing, "axis": _on_axis, "nothing": _nothing, "change": _change, "two": _two, "outside": _outside,
    "dirty": _dirty, "noise": _noise, "excitation": _excitation,
}
