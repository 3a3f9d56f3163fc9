"""Writing the improved model: MODEL.toml alone where the result is linear, otherwise with a Python simulator beside it."""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from afdsvc.api.model import Model, Quantity, Variable
from afdsvc.api.physics import Coefficient, Hypothesis
from afdsvc.explain.report.explanation import Explanation
from afdsvc.explain.search.nuisance import NUISANCE
from afdsvc.explain.search.problem import Point
from afdsvc.explain.simulate.effects import Effect
from afdsvc.explain.simulate.nominal import Nominal
from afdsvc.files.model import exported_dynamics
from afdsvc.files.model.model_file import DYNAMICS, relative_code, write_model
from afdsvc.lti.statespace import Array, StateSpace

OBJECT = "model"


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
    model, text = dynamics(explanation, file, aux)
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


def dynamics(explanation: Explanation, file: Path, aux: Mapping[str, float]) -> tuple[Model, str]:
    """Return the model whose dynamics are in ``file`` (beside it) and the text of that file."""
    old, effects = explanation.nominal.model, explanation.point.effects
    plant = explanation.nominal.at(explanation.point.theta)
    remembers = plant.discrete or any(_goes_by_samples(e.hypothesis) for e in effects)
    states = tuple(old.states)
    if remembers:
        count = sum(e.hypothesis.memory for e in effects)
        held = [Variable(f"{v.name} before", v.unit) for v in old.inputs]
        states = (*states, *(Variable(f"memory_{i + 1}") for i in range(count)), *held)
    model = replace(
        old, states=states, plant=None, sample_time=explanation.nominal.dt if remembers else 0.0,
        parameters=_parameters(explanation, plant), entry_sd={}, process_cov=None, output_sd=_noise(explanation),
        extra={DYNAMICS: f"{file.name}:{OBJECT}"}, raw="",
    )
    return model, _text(explanation, plant, "Sampled" if remembers else "Continuous", aux, file.parent)


def _goes_by_samples(hypothesis: Hypothesis) -> bool:
    """Whether a law remembers, or follows time or a recorded signal, which the fit held over every sample."""
    return bool(hypothesis.memory) or any(s.kind in ("t", "aux") for s in hypothesis.reads)


def _parameters(explanation: Explanation, plant: StateSpace) -> dict[str, Quantity]:
    """Return what was found, by name, in people's units, with its standard deviation relative to the value."""
    sds = {(n.physics, n.site, name): e.sd for n in explanation.named for name, e in n.parameters.items()}
    nominal = explanation.nominal
    found = dict(nominal.moved(explanation.point.theta).parameters) if nominal.python else {}
    for effect in explanation.point.effects:
        h = effect.hypothesis
        for name, c, value in zip(_names(effect), h.parameters, effect.values, strict=True):
            if name:
                shown = float(value) / _factor(c, plant)
                sd = sds.get((h.physics, h.site, c.name))
                found[name] = Quantity(shown, c.unit, 0.05 if sd is None or not shown else float(sd / abs(shown)))
    return found


def _names(effect: Effect) -> list[str]:
    """Return the key of every parameter that is a finding, "" for the others."""
    h = effect.hypothesis
    return [f"{c.name} of {h.physics} at {h.site}" if c.free and not c.nuisance else "" for c in h.parameters]


def _factor(c: Coefficient, plant: StateSpace) -> float:
    """Return what a value in people's units is multiplied by to become the law's."""
    return 1.0 if c.through is None or plant.B[c.through] == 0 else float(plant.B[c.through])


def _text(explanation: Explanation, plant: StateSpace, kind: str, aux: Mapping[str, float], folder: Path) -> str:
    nominal, effects = explanation.nominal, explanation.point.effects
    labels, sources = _sources(effects)
    least = max([1, *(e.hypothesis.substeps for e in effects)])
    what = ", ".join(f"{e.hypothesis.physics} at {e.hypothesis.site}" for e in effects)
    head = [
        f'"""{nominal.model.name} with what its model left out: {what}.',
        "",
        "Written by `afdsvc explain`. Parameters come from the MODEL.toml beside this file, by name; matrices are the refitted ones.",
        '"""',
        "", _runtime(), "", "import math", "", "", "\n\n\n".join(sources), "",
    ]
    laws = [_law(e, label, plant) for e, label in zip(effects, labels, strict=True)]
    matrices = [f"{name} = {_array(getattr(plant, name))}" for name in "ABCD"]
    steps = nominal.steps(explanation.point.theta, least)
    held = ", ".join(_array(getattr(steps, name)) for name in ("phi", "gam", "gx", "phih", "gamh"))
    base = f", nominal=code(Path(__file__).parent, {_reference(nominal.model, folder)!r})" if nominal.python else ""
    last = (
        f"{OBJECT} = {kind}(A, B, C, D, LAWS, dt={nominal.dt!r}, substeps={steps.nsub}, aux={dict(aux)!r}, plant_dt={plant.dt!r},\n"
        f"    held=({held}){base})"
    )
    return "\n".join([*head, "", *matrices, "LAWS = (", *laws, ")", last, ""])


def _array(matrix: Array) -> str:
    return f"np.array({matrix.tolist()!r}).reshape{matrix.shape!r}"


def _reference(model: Model, folder: Path) -> str:
    """Return where the code of the model is, seen from a folder."""
    return relative_code(str(model.extra[DYNAMICS]), model.origin, folder)


def _runtime() -> str:
    """Return the source of the simulator without its docstring."""
    return inspect.getsource(exported_dynamics).split('"""', 2)[2].strip() + "\n"


def _sources(effects: Sequence[Effect]) -> tuple[list[str], list[str]]:
    """Return the name of each effect's law in the file, and the sources, each law once."""
    labels: dict[object, str] = {}
    sources = []
    for e in effects:
        law = e.hypothesis.law
        if law not in labels:
            labels[law] = f"{e.hypothesis.physics}_{law.__name__}"
            sources.append(re.sub(rf"^def {law.__name__}\(", f"def {labels[law]}(", inspect.getsource(law), count=1).rstrip())
    return [labels[e.hypothesis.law] for e in effects], sources


def _law(effect: Effect, label: str, plant: StateSpace) -> str:
    h = effect.hypothesis
    reads = tuple((s.kind, s.index) for s in h.reads)
    writes = tuple(s.index for s in h.writes)
    factors = tuple(_factor(c, plant) for c in h.parameters)
    values = tuple(float(v) / f for v, f in zip(effect.values, factors, strict=True))
    return (
        f"    Law({h.stage!r}, {label}, {reads!r}, {writes!r}, {tuple(_names(effect))!r},\n"
        f"        {values!r}, {factors!r}, {h.memory}),"
    )

