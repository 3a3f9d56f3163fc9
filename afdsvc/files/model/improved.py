"""Writing the improved model: MODEL.toml alone where the result is linear, otherwise with a Python simulator beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from afdsvc.api.model import Model, Quantity, Variable
from afdsvc.explain.report.explanation import Explanation
from afdsvc.explain.search.nuisance import NUISANCE
from afdsvc.explain.search.problem import Point
from afdsvc.explain.simulate.nominal import Nominal
from afdsvc.files.model.improved_code import OBJECT, Parts, factor, goes_by_samples, key, text
from afdsvc.files.model.model_file import DYNAMICS, relative_code, write_model
from afdsvc.lti.statespace import Array, StateSpace


def write_improved(explanation: Explanation, path: Path, aux: Mapping[str, float]) -> list[Path]:
    """Write the improved model as ``path`` (and ``path`` with the suffix .py when it is not linear); return what was written.

    A Python simulator stays the code it is: its parameters move, and laws are added to it in a file that names it. Offsets and
    unknown loads belong to the recordings and are not written. ``aux`` holds the mean of every auxiliary signal of the
    recordings, sorted by name as the laws count them.
    """
    effects = tuple(e for e in explanation.point.effects if e.hypothesis.family != NUISANCE)
    explanation = replace(explanation, point=replace(explanation.point, effects=effects))
    nominal, point = explanation.nominal, explanation.point
    if nominal.python and not point.effects:
        write_model(replace(nominal.moved(point.theta), output_sd=_noise(explanation), raw=""), path)
        return [path]
    plant = None if nominal.python else linear_plant(nominal, point)
    if plant is not None:
        write_model(_linear(explanation, plant), path)
        return [path]
    file = path.with_suffix(".py")
    model, text = _dynamics(explanation, file, aux)
    file.write_text(text, encoding="utf-8")
    write_model(replace(model, origin=str(path)), path)
    return [path, file]


def linear_plant(nominal: Nominal, point: Point) -> StateSpace | None:
    """Return the plant at a point with its linear effects built in; None when an effect is not linear.

    Effects are built in from the sensors inwards and from the inputs outwards, so that row and column numbers of the machine
    stay valid: extensions append states and keep the order of inputs and outputs.
    """
    plant = nominal.at(point.theta)
    order = {"force": 0, "input": 1, "output": 2}
    for effect in sorted(point.effects, key=lambda e: order[e.hypothesis.stage]):
        build = effect.hypothesis.linear
        if build is None or plant.discrete:
            return None
        plant = build(plant, [float(v) for v in effect.values])
    return plant


def _linear(explanation: Explanation, plant: StateSpace) -> Model:
    """Return the refitted plant with what was added; the stated uncertainty of known entries stays, new ones count as fitted."""
    old = explanation.nominal.model
    added = plant.order - len(old.states)
    states = (*old.states, *(Variable(f"added_{i + 1}") for i in range(added)))
    sds = {}
    for name, sd in old.entry_sd.items():
        grown = np.zeros(getattr(plant, name).shape)
        grown[: sd.shape[0], : sd.shape[1]] = sd
        sds[name] = grown
    cov = old.process_cov
    if cov is not None and added:
        cov = np.pad(cov, (0, added))
    return replace(old, states=states, plant=plant, entry_sd=sds, process_cov=cov, output_sd=_noise(explanation), extra={}, raw="")


def _noise(explanation: Explanation) -> Array | None:
    """Return the noise as measured, else as stated in the model."""
    floor = explanation.noise_floor
    if floor is None or not all(np.isfinite(v) and v > 0 for v in floor):
        return explanation.nominal.model.output_sd
    return np.array(floor, dtype=np.float64)


def _dynamics(explanation: Explanation, file: Path, aux: Mapping[str, float]) -> tuple[Model, str]:
    """Return the model whose dynamics are in ``file`` (beside it) and the text of that file."""
    nominal, point, old = explanation.nominal, explanation.point, explanation.nominal.model
    plant, effects = nominal.at(point.theta), point.effects
    by_samples = goes_by_samples(plant, effects)
    states = tuple(old.states)
    if by_samples:
        count = sum(e.hypothesis.memory for e in effects)
        held = [Variable(f"{v.name} before", v.unit) for v in old.inputs]
        states = (*states, *(Variable(f"memory_{i + 1}") for i in range(count)), *held)
    model = replace(
        old, states=states, plant=None, sample_time=nominal.dt if by_samples else 0.0, parameters=_parameters(explanation, plant), entry_sd={},
        process_cov=None, output_sd=_noise(explanation), extra={DYNAMICS: f"{file.name}:{OBJECT}"}, raw="",
    )
    steps = nominal.steps(point.theta, max([1, *(e.hypothesis.substeps for e in effects)]))
    reference = relative_code(str(old.extra[DYNAMICS]), old.origin, file.parent) if nominal.python else ""
    return model, text(Parts(nominal, plant, effects, steps, aux, reference))


def _parameters(explanation: Explanation, plant: StateSpace) -> dict[str, Quantity]:
    """Return what was found, by name, in people's units, with its standard deviation relative to the value."""
    sds = {(n.physics, n.site, name): e.sd for n in explanation.named for name, e in n.parameters.items()}
    nominal = explanation.nominal
    found = dict(nominal.moved(explanation.point.theta).parameters) if nominal.python else {}
    for effect in explanation.point.effects:
        h = effect.hypothesis
        for c, value in zip(h.parameters, effect.values, strict=True):
            if name := key(h, c):
                shown = float(value) / factor(c, plant)
                sd = sds.get((h.physics, h.site, c.name))
                found[name] = Quantity(shown, c.unit, 0.05 if sd is None or not shown else float(sd / abs(shown)))
    return found
