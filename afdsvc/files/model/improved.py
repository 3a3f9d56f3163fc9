"""Writing the improved model: MODEL.toml alone where the result is linear, otherwise with a Python simulator beside it."""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from afdsvc.api.model import Model, Quantity, Variable
from afdsvc.api.physics import Coefficient, Hypothesis, Signal
from afdsvc.explain.report.explanation import Explanation
from afdsvc.explain.search.problem import NUISANCE, Point
from afdsvc.explain.simulate.effects import PlacedEffect
from afdsvc.explain.simulate.nominal import Nominal
from afdsvc.explain.simulate.predictor import driven
from afdsvc.explain.simulate.steps import Steps, ways
from afdsvc.files.model.model_file import DYNAMICS, relative_code, write_model
from afdsvc.lti.statespace import Array, StateSpace


def write_improved(explanation: Explanation, path: Path, aux: Mapping[str, float]) -> list[Path]:
    """Write the improved model as ``path`` (and ``path`` with the suffix .py when it is not linear); return what was written.

    A Python simulator stays the code it is: its parameters move, and laws are added to it in a file that names it. Offsets,
    unknown loads, tones from outside and clocks out of step belong to the recordings and are not written. ``aux`` holds the mean of every auxiliary signal of the
    recordings, sorted by name as the laws count them.
    """
    effects = tuple(_later(e) for e in explanation.point.effects if not _of_recordings(e.hypothesis))
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


def _of_recordings(h: Hypothesis) -> bool:
    return h.family == NUISANCE or h.lasting or any(s.ahead for s in h.reads)


def _later(effect: PlacedEffect) -> PlacedEffect:
    values = [v if c.later is None else c.later for v, c in zip(effect.values, effect.hypothesis.parameters, strict=True)]
    return replace(effect, values=np.array(values))


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
        grown = build(plant, [float(v) for v in effect.values])
        plant = _felt(nominal.felt, plant, grown) if effect.hypothesis.stage == "force" and nominal.felt.any() else grown
    return plant


def _felt(felt: Array, plant: StateSpace, grown: StateSpace) -> StateSpace:
    """Return the plant with a force built in, as outputs that are accelerations read it."""
    n, order = felt.shape[1], plant.order
    more = grown.A[:n].copy()
    more[:, :order] -= plant.A[:n]
    return replace(grown, C=grown.C + felt @ more, D=grown.D + felt @ (grown.B - np.pad(plant.B, ((0, grown.order - order), (0, 0))))[:n])


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
    steps = nominal.steps(point.theta, max([explanation.substeps, *(e.hypothesis.substeps for e in effects)]))
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
                shown = float(value) / c.per(plant.B)
                sd = sds.get((h.physics, h.site, c.name))
                found[name] = Quantity(shown, c.unit, 0.05 if sd is None or not shown else float(sd / abs(shown)))
    return found


OBJECT = "model"
ROUNDED = 0.5  # friction rounds its jump so that Runge-Kutta steps of twice this length can follow it


def goes_by_samples(plant: StateSpace, effects: Sequence[PlacedEffect]) -> bool:
    """Whether the simulator goes by samples: a law remembers, or follows time or a recorded signal, or the plant is sampled."""
    return plant.discrete or any(e.hypothesis.memory or any(s.kind in ("t", "aux") for s in e.hypothesis.reads) for e in effects)


def key(h: Hypothesis, c: Coefficient) -> str:
    """Return the name of a parameter in MODEL.toml, "" for constants and shapes, which stay in the text."""
    return f"{c.name} of {h.physics} at {h.site}" if c.free and not c.nuisance else ""


@dataclass(frozen=True, slots=True, eq=False)
class Parts:
    """What the text is made of: the refitted model, its effects, the steps of the fit, means of auxiliary signals, foreign code.

    ``reference`` is ``file.py:name`` of a nominal model that is Python code itself, "" for matrices.
    """

    nominal: Nominal
    plant: StateSpace
    effects: tuple[PlacedEffect, ...]
    steps: Steps
    aux: Mapping[str, float]
    reference: str

    @property
    def direct(self) -> bool:
        """Whether the inputs reach the outputs at once, so that laws at the inputs come first."""
        return bool(self.plant.D.any())

    @property
    def felt(self) -> bool:
        """Whether outputs feel forces of laws at once."""
        return bool(self.of("force")) and bool(self.nominal.felt.any())

    def number(self, s: Signal) -> str:
        """Return the name of a parameter of the nominal model's code."""
        return list(self.nominal.model.parameters)[s.index]

    def of(self, stage: str) -> list[tuple[int, PlacedEffect]]:
        """Return the effects of a stage with their numbers."""
        return [(i, e) for i, e in enumerate(self.effects) if e.hypothesis.stage == stage]


def text(parts: Parts) -> str:
    """Return the text of the simulator."""
    effects = ", ".join(f"{e.hypothesis.physics} at {e.hypothesis.site}" for e in parts.effects)
    title = f"{parts.nominal.model.name} with what its model left out: {effects}."
    laws = dict.fromkeys((_label(e), _source(e)) for e in parts.effects)
    return "\n".join([
        f'"""{_inside_quotes(title)}', "",
        "Written by `afdsvc explain`. Parameters come from the MODEL.toml beside this file, by name; matrices are the refitted ones.", '"""', "",
        "from __future__ import annotations", "", "import math", *_imports(parts), "", "import numpy as np", "", *_nominal(parts), *_constants(parts), "", "",
        *(line for _, source in laws for line in (source, "", "")), *(_sampled(parts) if goes_by_samples(parts.plant, parts.effects) else _continuous(parts)), "", "",
        f"{OBJECT} = Model()", "",
    ])


def _inside_quotes(words: str) -> str:
    """Return words of others as they may stand in a string literal: names in a MODEL.toml are free text, and must not become code."""
    return words.encode("unicode_escape").decode("ascii").replace('"', '\\"')


def _label(e: PlacedEffect) -> str:
    return f"{e.hypothesis.physics}_{e.hypothesis.law.__name__.lstrip('_')}"


def _source(e: PlacedEffect) -> str:
    """Return the source of a law under its name in the text, without annotations."""
    source = re.sub(rf"^def {e.hypothesis.law.__name__}\(.*\).*:$", f"def {_label(e)}(p, z, m, dt, out):", inspect.getsource(e.hypothesis.law), count=1, flags=re.M)
    return source.rstrip()


def _imports(parts: Parts) -> list[str]:
    return ["import importlib.util", "from pathlib import Path"] if parts.reference else []


def _nominal(parts: Parts) -> list[str]:
    """Return the lines that load the nominal model's own code."""
    if not parts.reference:
        return []
    file, name = parts.reference.rsplit(":", 1)
    return [
        f'spec = importlib.util.spec_from_file_location("nominal", Path(__file__).parent / {file!r})', "module = importlib.util.module_from_spec(spec)",
        "spec.loader.exec_module(module)", f"NOMINAL = module.{name}",
    ]


def _constants(parts: Parts) -> list[str]:
    steps = parts.steps
    found = [f"{name} = {_array(getattr(parts.plant, name))}" for name in "ABCD"]
    found += [f"{name.upper()} = {_array(getattr(steps, name))}" for name in ("phi", "gam", "gx", "phih", "gamh")] if goes_by_samples(parts.plant, parts.effects) else []
    found += [f"FELT = {_array(parts.nominal.felt)}  # of forces on the states, by outputs that are accelerations"] if parts.felt else []
    return [*found, f"DT, SUBSTEPS = {parts.nominal.dt!r}, {steps.nsub}  # of the recordings, and steps per sample", "STEP = DT / SUBSTEPS"]


def _array(matrix: Array) -> str:
    return f"np.array({matrix.tolist()!r}).reshape{matrix.shape!r}"


def _continuous(parts: Parts) -> list[str]:
    """Return the class of a continuous model: ``dx/dt = f``, ``y = h``."""
    read = {"u": "acting[{}]", "x": "x[{}]", "y": "y[{}]"}
    step = f"{ROUNDED} * STEP"
    inputs = [*_laws(parts, "parameter", read, step, "p"), *_laws(parts, "input", read, step, "acting")]
    return [
        *_head(parts), "", "    def f(self, t, x, u, p):", *_indented(["acting = np.copy(u)", *inputs, f"rates = {_rate(parts, 't', 'x')}"], 2),
        *_indented([*_laws(parts, "force", read, step, "rates"), "return rates"], 2), "",
        "    def h(self, t, x, u, p):", *_indented(["acting = np.copy(u)", *inputs, f"y = {_output(parts, 'x')}"], 2),
        *_indented([*_felt_forces(parts, _laws(parts, "force", read, step, "push"), "x"), *_laws(parts, "output", read, "DT", "y"), "return y"], 2),
    ]


def _sampled(parts: Parts) -> list[str]:
    """Return the class of a sampled model: ``x+ = f``, ``y = h``; its states are the plant's, the laws' memories, the input before."""
    n, k = parts.plant.order, sum(e.hypothesis.memory for e in parts.effects)
    read = {"u": "acting[{}]", "x": "seen[{}]", "y": "y[{}]", "t": "now", "aux": "aux[{}]"}
    inputs = _laws(parts, "input", read, "STEP", "acting", memory=True)
    numbers, outputs = (_laws(parts, stage, read | {"u": "before[{}]"}, "DT", target, memory=True) for stage, target in (("parameter", "p"), ("output", "y")))
    felt = ["kept = np.copy(memory)", *_felt_forces(parts, _laws(parts, "force", read, "STEP", "push", memory=True), "state"), "memory = kept"] if parts.felt else []
    values = ", ".join(f"p.get({'aux_' + name!r}, {mean!r})" for name, mean in parts.aux.items())
    used = any(s.kind == "aux" for e in parts.effects for s in e.hypothesis.reads)
    return [
        *_head(parts), "", "    def f(self, t, x, u, p):", "        return self.sample(t, x, u, p)[1]", "", "    def h(self, t, x, u, p):",
        "        return self.sample(t, x, u, p)[0]", "", "    def sample(self, t, x, u, p):",
        *_indented([
            *([f"aux = np.array([{values}])"] if used else []), f"now, state, memory, before = t, np.copy(x[:{n}]), np.copy(x[{n}:{n + k}]), np.copy(x[{n + k}:])",
            "seen, acting = np.copy(state), np.copy(u)", *numbers, *(inputs if parts.direct else []), f"y = {_output(parts, 'state', 'now')}", *felt, *outputs,
            *([] if parts.direct else inputs), "for k in range(SUBSTEPS):",
            *_indented([*(["if k > 0:", *_indented(["seen, acting = np.copy(state), np.copy(u)", *inputs], 1)] if inputs else []), *_step(parts, read), "now += STEP"], 1),
            "return y, np.concatenate((state, memory, acting))",
        ], 2),
    ]


def _felt_forces(parts: Parts, forces: Sequence[str], x: str) -> list[str]:
    """Return the lines that add to the outputs what they feel of forces at once."""
    return [f"push = np.zeros(len({x}))", *forces, "y = y + FELT @ push"] if parts.felt else []


def _step(parts: Parts, read: Mapping[str, str]) -> list[str]:
    """Return the lines that advance the plant: forces are taken at the predicted middle of the step and held over it."""
    forces = ["push = np.zeros(len(state))", *_laws(parts, "force", read, "STEP", "push", memory=True)]
    if not parts.nominal.python:
        rows = sorted({s.index for _, e in parts.of("force") for s in e.hypothesis.reads if s.kind == "x"})
        middle = ["middle = PHIH @ state" + (" + GAMH @ acting" if parts.plant.inputs else ""), *(f"seen[{i}] = middle[{i}]" for i in rows)]
        return [*(middle if rows else []), *forces, "state = PHI @ state" + (" + GAM @ acting" if parts.plant.inputs else "") + " + GX @ push"]
    rate = [f"a = {_rate(parts, 'now', 'state')}"]
    if parts.plant.discrete:
        return [*rate, "seen[:] = (state + a) / 2", *forces, "state = a + GX @ push"]
    stages = [f"{new} = {_rate(parts, at, point)} + push" for new, at, point in (
        ("b", "now + STEP / 2", "state + STEP / 2 * a"), ("c", "now + STEP / 2", "state + STEP / 2 * b"), ("d", "now + STEP", "state + STEP * c"),
    )]
    return [*rate, "seen[:] = state + STEP / 2 * a", *forces, "a = a + push", *stages, "state = state + STEP / 6 * (a + 2 * b + 2 * c + d)"]


def _head(parts: Parts) -> list[str]:
    offered = f"    linear = (A, B, C, D, {parts.plant.dt!r})  # without the laws, for methods for linear models: matrices and sample time"
    return ["class Model:", '    """The nominal model with its laws; ``p`` holds the parameters by name."""', "", offered]


def _rate(parts: Parts, t: str, x: str) -> str:
    if parts.nominal.python:
        return f"np.asarray(NOMINAL.f({t}, {x}, acting, p)) + 0.0"
    return f"A @ {x}" + (" + B @ acting" if parts.plant.inputs else "")


def _output(parts: Parts, x: str, t: str = "t") -> str:
    if parts.nominal.python:
        return f"np.asarray(NOMINAL.h({t}, {x}, acting, p)) + 0.0"
    return f"C @ {x}" + (" + D @ acting" if parts.direct else "")


def _laws(parts: Parts, stage: str, read: Mapping[str, str], step: str, target: str, memory: bool = False) -> list[str]:
    """Return the lines that add to ``target`` what every law of a stage contributes, one law after the other."""
    lines = []
    for i, e in parts.of(stage):
        h = e.hypothesis
        first = sum(x.hypothesis.memory for x in parts.effects[:i])
        own = f"memory[{first}:{first + h.memory}]" if memory else "np.zeros(0)"
        values = ", ".join(_value(h, c, float(v), parts.plant) for c, v in zip(h.parameters, e.values, strict=True))
        lines += [f"out = np.zeros({len(h.writes)})", f"{_label(e)}(np.array([{values}]), np.array([{', '.join(_read(parts, s, read) for s in h.reads)}]), {own}, {step}, out)"]
        lines += _along(parts, h, h.along, target, memory) if h.along else [_written(parts, s, k, target) for k, s in enumerate(h.writes)]
    return lines


def _along(parts: Parts, h: Hypothesis, along: Signal, target: str, sampled: bool) -> list[str]:
    """Return the lines that add a force along a signal: as the rates follow the signal."""
    j, i = along.index, h.writes[0].index
    way, (gain,) = ways(parts.plant, driven(parts.nominal.model, parts.plant.order), np.array([[j, along.kind == "u", i]]))
    if not (parts.nominal.python and not parts.plant.discrete):
        return [f"{target} += out[0] * np.array({way[:, 0].tolist()!r})"]
    here = _rate(parts, "now" if sampled else "t", "state" if sampled else "x")
    moved = ["moved = np.copy(acting)", f"moved[{j}] += 1e-4 * max(1.0, abs(acting[{j}]))"]
    return [*moved, f"{target} += out[0] / {float(gain)!r} * ({here.replace('acting', 'moved')} - ({here})) / (moved[{j}] - acting[{j}])"]


def _value(h: Hypothesis, c: Coefficient, value: float, plant: StateSpace) -> str:
    scale, name = c.per(plant.B), key(h, c)
    return repr(value) if not name else f"p[{name!r}]" if scale == 1.0 else f"p[{name!r}] * {scale!r}"


def _read(parts: Parts, s: Signal, read: Mapping[str, str]) -> str:
    return f"p[{parts.number(s)!r}]" if s.kind == "p" else read[s.kind].format(s.index)


def _written(parts: Parts, s: Signal, k: int, target: str) -> str:
    """Return the line that adds what a law says of one signal; parameters belong to the caller, so they are copied."""
    return f"p = p | {{{parts.number(s)!r}: {_read(parts, s, {})} + out[{k}]}}" if s.kind == "p" else f"{target}[{s.index}] += out[{k}]"


def _indented(lines: Sequence[str], levels: int) -> list[str]:
    return [4 * levels * " " + line for line in lines]
