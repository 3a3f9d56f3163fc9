"""The written model is the model that was fitted: every law of the library, stepped in Python, against the compiled engine."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from afdsvc.api.model import Model, Quantity, Variable
from afdsvc.api.physics import Axis, Coefficient, Hypothesis, Machine, Signal, Size
from afdsvc.dataset.experiment import Run
from afdsvc.explain.gap.finding import Gap
from afdsvc.explain.report.explanation import Estimate, Explanation, Named
from afdsvc.explain.search.problem import Point
from afdsvc.explain.simulate.effects import PlacedEffect
from afdsvc.explain.simulate.nominal import Nominal, nominal
from afdsvc.explain.simulate.simulator import Simulator
from afdsvc.files.model.improved import linear_plant, write_improved
from afdsvc.files.model.model_file import read_model, write_model
from afdsvc.identify.parameters.structure import model_structure
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics import afdsvc_physics

DT, N = 1e-3, 240
AUX = {"angle": 1.5, "pressure": 6.0}


def spring() -> Model:
    A = [[0, 0, 1, 0], [0, 0, 0, 1], [-4e4, 500, -30, 0], [300, -5e4, 0, -40.0]]
    plant = StateSpace(np.array(A, float), np.array([[0, 0], [0, 0], [4e4, 0], [0, 5e4]], float), np.eye(2, 4), np.zeros((2, 2)))
    states = (Variable("q", "mm"), Variable("r", "mm"), Variable("v", "mm/s", rate_of="q"), Variable("w", "mm/s", rate_of="r"))
    both = (Variable("a", "N"), Variable("b", "N")), (Variable("q", "mm"), Variable("r", "mm"))
    return Model("spring", *both, states, plant)


def machine(plant: StateSpace) -> Machine:
    def size(i: int, name: str, unit: str, rms: float) -> Size:
        return Size(i, name, unit, 0.0, rms, 3 * rms, 0.05 if unit == "mm" else 0.0)

    q, r, v, w = (size(i, s.name, s.unit, z) for i, (s, z) in enumerate(zip(spring().states, (1, 1, 200, 200), strict=True)))
    return Machine(
        inputs=tuple(size(i, n, "N", 1.0) for i, n in enumerate("ab")), outputs=(q, r), states=(q, r, v, w),
        axes=(Axis("q", q, v, 4e4, 0, 4e4, "N"), Axis("r", r, w, 4e4, 1, 5e4, "N")),
        aux={"angle": Size(0, "angle", "rad", 3.0, 1.8, 6.3), "pressure": Size(1, "pressure", "bar", 6.0, 0.3, 7.0)},
        dt=DT, duration=N * DT, bandwidth=600.0, plant=plant, residual=np.array([0.1, 0.1]), tones=(314.0,), peaks=(150.0,), limited="model",
        deflections={(0, 1): size(0, "q - r", "mm", 1.0)},
    )


def hypotheses() -> Iterator[Hypothesis]:
    plant = spring().plant
    assert plant is not None
    for physics in afdsvc_physics():
        seen: set[tuple[str, bool]] = set()
        for h in physics.hypotheses(machine(plant)):
            kind = h.site.partition(":")[0], h.notes.get("variant") == "turned"
            if kind not in seen:  # one site of each sort, as the others differ by numbers only; a turned loop is another law
                seen.add(kind)
                yield h


LIBRARY = {h.key: h for h in hypotheses()}


def to_come(h: Hypothesis) -> bool:
    """Whether a law reads an input that is to come, as a clock that is late does."""
    return any(s.ahead for s in h.reads)


def values(h: Hypothesis) -> np.ndarray:
    """A law that is felt: its start, with what starts at nothing moved by half a step."""
    moved = [v if v or not c.free else min(max(0.5 * c.scale, c.low), c.high) for v, c in zip(h.starts[0], h.parameters, strict=True)]
    return np.array(moved, float)


def run(rng: np.random.Generator) -> Run:
    u = 0.8 * np.cumsum(rng.standard_normal((N, 2)), axis=0) / 5
    aux = np.column_stack([np.linspace(0, 6, N), 6 + 0.3 * np.sin(np.arange(N) / 20)])
    return Run("r", DT, 3.0, u, np.zeros((N, 2)), aux, np.zeros((N, 2)), tuple(AUX))


def explanation(*effects: PlacedEffect, named: tuple[Named, ...] = (), nom: Nominal | None = None) -> Explanation:
    nom = nom or nominal(spring(), DT)
    point = Point(0.3 * np.ones(len(nom.entries)), (), np.zeros(2), effects)
    gap = Gap(
        present=True, r2=(0.9,), total=0.9, linear=0.5, whitened=(0.5,), p_value=0.01, threshold=(0.1,), blocks=20, blocks_won=0.9, enough=True,
        correlation_time=(1.0,), depends_on=(), repeats=None, offset=(0.0,), sentence="Gap.",
    )
    return Explanation(
        verdict="omitted_physics", located=(), named=named, rejected=(), fit=(), heldout=("held",), whiteness_p=(0.0, 0.5), simulated="from the inputs",
        explained=(0.9, 0.01), gap=gap, remainder=None, candidates=(), law=None, check=(), sentences=(), next_experiment=None,
        noise_floor=(0.01, 0.02)[: nom.plant.outputs], courses=(), spectra=(), nominal=nom, point=point,
    )


def stepped(path: Path, r: Run, substeps: int = 1) -> np.ndarray:
    """Play the written model: sample by sample where it is sampled, by classical Runge-Kutta where it is continuous."""
    m = read_model(path, allow_code=True)
    if m.dynamics is None:
        raise AssertionError("no simulator was written")
    p: dict[str, float] = {name: q.value for name, q in m.parameters.items()}
    x, y, h, f = np.zeros(len(m.states)), [], DT / substeps, m.dynamics.f
    for k in range(len(r)):
        p |= {f"aux_{name}": value for name, value in zip(AUX, r.AUX[k], strict=True)}
        t, u = r.t0 + k * DT, r.U[k]
        y.append(m.dynamics.h(t, x, u, p))
        if m.sample_time:
            x = f(t, x, u, p)
            continue
        for s in range(substeps):
            at = t + s * h
            a = f(at, x, u, p)
            b = f(at + h / 2, x + h / 2 * a, u, p)
            c = f(at + h / 2, x + h / 2 * b, u, p)
            x = x + h / 6 * (a + 2 * b + 2 * c + f(at + h, x + h * c, u, p))
    return np.array(y)


@pytest.mark.parametrize("key", [k for k, h in LIBRARY.items() if h.linear is None and not h.lasting and not to_come(h)])
def test_every_law_is_written_as_it_was_fitted(key, tmp_path):
    e = explanation(PlacedEffect(LIBRARY[key], values(LIBRARY[key])))
    r = run(np.random.default_rng(1))
    engine = Simulator(e.nominal, np.zeros((4, 2))).run(r, e.point.theta, np.zeros(4), e.point.effects).y
    plain = Simulator(e.nominal, np.zeros((4, 2))).run(r, e.point.theta, np.zeros(4)).y
    files = write_improved(e, tmp_path / "MODEL.toml", AUX)
    assert [f.name for f in files] == ["MODEL.toml", "MODEL.py"]
    mine = stepped(files[0], r, 2)
    felt = np.linalg.norm(engine - plain)
    assert felt > 1e-4 * np.linalg.norm(plain)
    sampled = read_model(files[0], allow_code=True).sample_time > 0
    # sampled: the same arithmetic; continuous: the engine holds a force over each sample, Runge-Kutta does not
    assert np.linalg.norm(mine - engine) < (1e-9 * np.linalg.norm(engine) if sampled else 0.05 * felt)


LIBRARY_OF_V = {h.key: h for p in afdsvc_physics() for h in p.hypotheses(machine(spring().plant)) if h.site == "state:v"}


@pytest.mark.parametrize(
    ("key", "apart"), [("cubic_stiffness@state:v", 0.02), ("coulomb_friction@state:v", 0.02), ("coulomb_friction@state:v#presliding", 0.06), ("hysteresis@state:v", 0.02)]
)
def test_what_an_accelerometer_reads_of_a_force_is_written_as_it_was_fitted(key, apart, tmp_path):
    """A law that remembers is written by samples, and its memory moves once in each; it is read in the step after the sample, by the engine in those before and after."""
    m = spring()
    plant = replace(m.plant, C=np.vstack([m.plant.C[0], m.plant.A[2] / 1000]), D=np.array([[0, 0], [40.0, 0]]))
    nom = nominal(replace(m, plant=plant, outputs=(m.outputs[0], Variable("a", "m/s^2"))), DT)
    h = LIBRARY_OF_V[key]
    point = Point(np.zeros(len(nom.entries)), (), np.zeros(2), (PlacedEffect(h, values(h)),))
    e = replace(explanation(PlacedEffect(h, values(h)), nom=nom), point=point, substeps=4)
    r = run(np.random.default_rng(1))
    engine, plain = (Simulator(nom, np.zeros((4, 2)), substeps=4).run(r, e.point.theta, np.zeros(4), effects).y for effects in (e.point.effects, ()))
    blind = Simulator(replace(nom, felt=np.zeros((2, 4))), np.zeros((4, 2)), substeps=4).run(r, e.point.theta, np.zeros(4), e.point.effects).y
    mine = stepped(write_improved(e, tmp_path / "MODEL.toml", AUX)[0], r, 4)
    size = np.linalg.norm(engine - plain, axis=0)
    assert np.linalg.norm(blind - engine, axis=0)[1] > 0.1 * size[1]
    different = np.linalg.norm(mine - engine, axis=0) / size
    assert different[0] < (1e-9 if h.memory else apart)
    assert different[1] < apart


def test_a_linear_force_is_built_into_what_an_accelerometer_reads(tmp_path):
    m = spring()
    plant = replace(m.plant, C=np.vstack([m.plant.C[0], m.plant.A[2] / 1000]), D=np.array([[0, 0], [40.0, 0]]))
    nom = nominal(replace(m, plant=plant, outputs=(m.outputs[0], Variable("a", "m/s^2"))), DT)
    forces = [h for h in LIBRARY.values() if h.linear is not None and h.stage == "force"]
    assert forces
    for h in forces:
        effect = PlacedEffect(h, values(h))
        built = linear_plant(nom, Point(np.zeros(len(nom.entries)), (), np.zeros(2), (effect,)))
        assert built.C[1] == pytest.approx(built.A[2] / 1000)
        assert built.D[1] == pytest.approx(built.B[2] / 1000)


POLE = """import math


class Pole:
    @staticmethod
    def f(t, x, u, p):
        return [x[2], x[3], -p["k"] * x[0] - 30 * x[2] + 4e4 * u[0], -5e4 * x[1] - 40 * x[3] + 5e4 * u[1] - 2e4 * math.cos(x[1]) * u[0]]

    @staticmethod
    def h(t, x, u, p):
        return [x[0], x[1]]
"""


def test_a_law_at_an_input_reads_the_states_of_its_substep(tmp_path):
    h = replace(next(h for key, h in LIBRARY.items() if key.startswith("back_emf")), linear=None)
    e = replace(explanation(PlacedEffect(h, values(h))), substeps=h.substeps)
    r = run(np.random.default_rng(3))
    engine = Simulator(e.nominal, np.zeros((4, 2)), substeps=h.substeps).run(r, e.point.theta, np.zeros(4), e.point.effects).y
    assert np.linalg.norm(stepped(write_improved(e, tmp_path / "MODEL.toml", AUX)[0], r) - engine) < 1e-9 * np.linalg.norm(engine)


def test_a_parameter_that_changed_at_a_moment_is_written_as_it_is_after_it(pendulum, tmp_path):
    nom = nominal(pendulum, DT)
    h = next(h for physics in afdsvc_physics() for h in physics.hypotheses(swinging(nom.plant)) if h.key == "parameter_step@parameter:weight#weight")
    e = explanation(PlacedEffect(h, np.array([-0.4, 0.5 * N * DT, 0.2, 1.0])), nom=nom)
    drive = run(np.random.default_rng(3))
    r = Run("r", DT, 0.0, 3 * drive.U[:, :1], np.zeros((N, 1)), drive.AUX, np.zeros((N, 1)), drive.aux)
    engine, later = (Simulator(nom, np.zeros((2, 1))).run(x, e.point.theta, np.zeros(2), e.point.effects).y for x in (r, replace(r, clock=N * DT)))
    mine = stepped(write_improved(e, tmp_path / "MODEL.toml", AUX)[0], r)
    assert np.linalg.norm(mine - later) < 1e-6 * np.linalg.norm(later)
    assert np.linalg.norm(engine - later) > 0.01 * np.linalg.norm(later)


@pytest.mark.parametrize("key", ["cubic_stiffness@state:v", "coulomb_friction@state:v", "hysteresis@state:v"])
@pytest.mark.parametrize("along", [Signal("u", 0), Signal("x", 0), None])
def test_a_force_along_a_signal_is_written_as_it_was_fitted(key, along, tmp_path):
    """As matrices along an input or a state, as code (None) along an input; sampled where the law remembers."""
    plant = spring().plant
    assert plant is not None
    plant.A[3, 0], plant.B[3, 0] = 2e4, -2e4
    nom = nominal(replace(spring(), plant=plant), DT)
    if along is None:
        (tmp_path / "pole.py").write_text(POLE)
        write_model(replace(spring(), plant=None, parameters={"k": Quantity(4e4, relative_sd=0.1)}, extra={"dynamics": "pole.py:Pole"}), tmp_path / "pole.toml")
        nom = nominal(read_model(tmp_path / "pole.toml", allow_code=True), DT)
    h = replace(LIBRARY[key], along=along or Signal("u", 0))
    e = explanation(PlacedEffect(h, values(h)), nom=nom)
    r = run(np.random.default_rng(1))
    engine, alone, plain = (
        Simulator(e.nominal, np.zeros((4, 2))).run(r, e.point.theta, np.zeros(4), [PlacedEffect(x, values(h)) for x in effects]).y for effects in ((h,), (LIBRARY[key],), ())
    )
    mine = stepped(write_improved(e, tmp_path / "MODEL.toml", AUX)[0], r, 2)
    felt = np.linalg.norm(engine - plain)
    assert np.linalg.norm(engine - alone) > 0.01 * felt > 1e-6 * np.linalg.norm(plain)
    assert np.linalg.norm(mine - engine) < (1e-9 * np.linalg.norm(engine) if h.memory else 0.05 * felt)


def test_what_was_fitted_in_finer_steps_is_written_in_them(tmp_path):
    h = LIBRARY["slew_limit@input:a"]
    e = replace(explanation(PlacedEffect(h, values(h))), substeps=4)
    r = run(np.random.default_rng(1))
    engine = Simulator(e.nominal, np.zeros((4, 2)), substeps=4).run(r, e.point.theta, np.zeros(4), e.point.effects).y
    coarse = Simulator(e.nominal, np.zeros((4, 2))).run(r, e.point.theta, np.zeros(4), e.point.effects).y
    mine = stepped(write_improved(e, tmp_path / "MODEL.toml", AUX)[0], r)
    assert np.linalg.norm(mine - engine) < 1e-9 * np.linalg.norm(engine) < 1e-3 * np.linalg.norm(coarse - engine)


def test_written_and_engine_meet_as_the_engine_takes_smaller_steps(tmp_path):
    h = LIBRARY["cubic_stiffness@state:v"]
    e = explanation(PlacedEffect(h, values(h)))
    r = run(np.random.default_rng(2))
    mine = stepped(write_improved(e, tmp_path / "MODEL.toml", AUX)[0], r, 4)
    apart = []
    for substeps in (1, 4, 20):
        finer = type(h)(**{**{f: getattr(h, f) for f in h.__slots__}, "substeps": substeps})
        y = Simulator(e.nominal, np.zeros((4, 2))).run(r, e.point.theta, np.zeros(4), [PlacedEffect(finer, values(h))]).y
        apart.append(np.linalg.norm(y - mine) / np.linalg.norm(mine))
    assert apart[1] < apart[0] / 10
    assert apart[2] < 1e-6 < apart[0] < 1e-3


@pytest.mark.parametrize("end", ['"""', "\\", '\\"""'])
def test_names_in_a_model_file_do_not_become_code(end, tmp_path):
    """Whoever hands over a MODEL.toml without code must not have some in what is written from it."""
    name = f"spring{end}\nopen({str(tmp_path / 'ran')!r}, 'w')\n{end}"
    h = LIBRARY["cubic_stiffness@state:v"]
    e = explanation(PlacedEffect(h, values(h)), nom=nominal(replace(spring(), name=name), DT))
    model = read_model(write_improved(e, tmp_path / "MODEL.toml", AUX)[0], allow_code=True)
    assert model.name.startswith(name)
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize("key", [k for k, h in LIBRARY.items() if h.lasting or to_come(h)])
def test_tones_from_outside_and_late_clocks_are_no_part_of_the_machine(key, tmp_path):
    e = explanation(PlacedEffect(LIBRARY[key], values(LIBRARY[key]), (np.ones(2),)))
    assert [f.name for f in write_improved(e, tmp_path / "MODEL.toml", AUX)] == ["MODEL.toml"]


@pytest.mark.parametrize("key", [k for k, h in LIBRARY.items() if h.linear is not None])
def test_a_linear_law_becomes_matrices_and_needs_no_code(key, tmp_path):
    e = explanation(PlacedEffect(LIBRARY[key], values(LIBRARY[key])))
    files = write_improved(e, tmp_path / "MODEL.toml", AUX)
    assert [f.name for f in files] == ["MODEL.toml"]
    m = read_model(files[0])
    improved = linear_plant(e.nominal, e.point)
    assert improved is not None
    assert m.plant is not None
    assert all(np.array_equal(getattr(m.plant, k), getattr(improved, k)) for k in "ABCD")
    assert len(m.states) == m.plant.order
    assert m.output_sd == pytest.approx([0.01, 0.02])


def test_parameters_are_reported_in_the_units_of_people_with_their_deviation(tmp_path):
    h = LIBRARY["coulomb_friction@state:v"]
    found = Named("coulomb_friction", "state:v", 1.0, {"force": Estimate(0.2, 0.01, "N")}, "")
    gain = explanation().nominal.at(0.3 * np.ones(len(explanation().nominal.entries))).B[2, 0]
    e = explanation(PlacedEffect(h, np.array([0.2 * gain, 4.0])), named=(found,))
    m = read_model(write_improved(e, tmp_path / "MODEL.toml", AUX)[0], allow_code=True)
    (q,) = m.parameters.values()
    assert q.value == pytest.approx(0.2)
    assert q.unit == "N"
    assert q.relative_sd == pytest.approx(0.05)


def test_a_nonlinear_model_offers_its_linear_part_and_is_identified_by_its_parameters(tmp_path):
    h = LIBRARY["cubic_stiffness@state:v"]
    e = explanation(PlacedEffect(h, values(h)))
    m = read_model(write_improved(e, tmp_path / "MODEL.toml", AUX)[0], allow_code=True)
    assert m.plant is not None
    at_point = e.nominal.at(e.point.theta)
    assert np.array_equal(m.plant.A, at_point.A)
    structure = model_structure(m)
    assert [p.name for p in structure.parameters] == ["stiffness of cubic_stiffness at state:v"]
    assert structure.build(np.array([0.0])).A == pytest.approx(at_point.A, rel=1e-6, abs=1e-6)
    write_model(m, tmp_path / "again.toml")
    again = read_model(tmp_path / "again.toml", allow_code=True)
    assert again.dynamics is not None
    assert again.parameters == m.parameters


CODE = '''
import numpy as np

class Pendulum:
    def f(self, t, x, u, p):
        return np.array([x[1], (u[0] - p["weight"] * np.sin(x[0]) - p["damping"] * x[1]) / p["inertia"]])

    def h(self, t, x, u, p):
        return x[:1]

model = Pendulum()
'''
TOML = """
name = "pendulum"
time = "continuous"
inputs = [{ name = "torque", unit = "N*m" }]
outputs = [{ name = "angle", unit = "rad" }]
states = [{ name = "angle", unit = "rad" }, { name = "rate", unit = "rad/s", rate_of = "angle" }]
dynamics = "code/pendulum.py:model"

[parameters]
inertia = { value = 0.01, unit = "kg*m^2", relative_sd = 0.1 }
weight = { value = 4.0, unit = "N*m", relative_sd = 0.1 }
damping = { value = 0.02, unit = "N*m*s", relative_sd = 0.1 }
"""


@pytest.fixture
def pendulum(tmp_path) -> Model:
    (tmp_path / "code").mkdir()
    (tmp_path / "code" / "pendulum.py").write_text(CODE)
    (tmp_path / "pendulum.toml").write_text(TOML)
    return read_model(tmp_path / "pendulum.toml", allow_code=True)


def test_a_simulator_whose_numbers_move_names_the_same_code(pendulum, tmp_path):
    e = explanation(nom=nominal(pendulum, DT))
    (tmp_path / "out").mkdir()
    assert write_improved(e, tmp_path / "out" / "MODEL.toml", {}) == [tmp_path / "out" / "MODEL.toml"]
    m = read_model(tmp_path / "out" / "MODEL.toml", allow_code=True)
    assert m.extra["dynamics"] == "../code/pendulum.py:model"
    assert m.parameters["weight"].value == pytest.approx(4.0 * (1 + 0.3 * 0.1))


def swinging(plant: StateSpace) -> Machine:
    angle, rate, torque = Size(0, "angle", "rad", 0.0, 0.5, 1.5), Size(1, "rate", "rad/s", 0.0, 8.0, 24.0), Size(0, "torque", "N*m", 0.0, 2.0, 6.0)
    axis = Axis("rate", angle, rate, 200.0, 0, 100.0, "N*m")
    return Machine((torque,), (angle,), (angle, rate), (axis,), {}, DT, N * DT, 60.0, plant, np.array([0.1]), limited="model", code=True, parameters=(Size(1, "weight", "N*m", 4.0, 0.4, 4.0),))


@pytest.mark.parametrize(("key", "size"), [
    ("coulomb_friction@state:rate", [40.0, 0.1]), ("backlash@input:torque", [0.5]), ("sensor_saturation@output:angle", [-0.2, 0.2]),
    ("parameter_drift@parameter:weight#weight", [3.0, 0.2]),
])
def test_laws_are_added_to_a_simulator_that_stays_the_code_it_is(key, size, pendulum, tmp_path):
    nom = nominal(pendulum, DT)
    h = next(h for physics in afdsvc_physics() for h in physics.hypotheses(swinging(nom.plant)) if h.key == key)
    e = explanation(PlacedEffect(h, np.array([*size, *values(h)[len(size) :]])), nom=nom)
    drive = run(np.random.default_rng(3))
    r = Run("r", DT, 0.0, 3 * drive.U[:, :1], np.zeros((N, 1)), drive.AUX, np.zeros((N, 1)), drive.aux)
    engine, plain = (Simulator(nom, np.zeros((2, 1))).run(r, e.point.theta, np.zeros(2), x).y for x in (e.point.effects, ()))
    mine = stepped(write_improved(e, tmp_path / "MODEL.toml", AUX)[0], r, 2)
    felt = np.linalg.norm(engine - plain)
    assert felt > 0.01 * np.linalg.norm(plain)
    assert np.linalg.norm(mine - engine) < 0.05 * felt
    again = nominal(read_model(tmp_path / "MODEL.toml", allow_code=True), DT)
    assert Simulator(again, np.zeros((len(again.model.states), 1))).notes == ()


def heavier(p, z, m, dt, out):
    out[0] += p[0] * z[1] * z[1]


def test_a_parameter_that_follows_a_state_is_written_in_continuous_time(pendulum, tmp_path):
    nom = nominal(pendulum, DT)
    change = Coefficient("change", "", -9.0, 9.0, 0.1, linear=True)
    weight = Signal("p", 1)
    h = Hypothesis("heavier", "parameter:weight", "curve", "parameter", heavier, (weight, Signal("x", 0)), (weight,), (change,), ((0.0,),))
    e = explanation(PlacedEffect(h, np.array([3.0])), nom=nom)
    drive = run(np.random.default_rng(3))
    r = Run("r", DT, 0.0, 3 * drive.U[:, :1], np.zeros((N, 1)), drive.AUX, np.zeros((N, 1)), drive.aux)
    engine, plain = (Simulator(nom, np.zeros((2, 1))).run(r, e.point.theta, np.zeros(2), x).y for x in (e.point.effects, ()))
    file = write_improved(e, tmp_path / "MODEL.toml", AUX)[0]
    assert read_model(file, allow_code=True).sample_time == 0.0
    assert np.linalg.norm(stepped(file, r, 2) - engine) < 0.05 * np.linalg.norm(engine - plain)


def test_a_parameter_that_drifts_is_written_as_it_was_fitted_in_finer_steps(pendulum, tmp_path):
    nom = nominal(pendulum, DT)
    h = next(h for physics in afdsvc_physics() for h in physics.hypotheses(swinging(nom.plant)) if h.key == "parameter_drift@parameter:weight#weight")
    e = replace(explanation(PlacedEffect(h, np.array([3.0, 0.2])), nom=nom), substeps=4)
    drive = run(np.random.default_rng(3))
    r = Run("r", DT, 0.0, 3 * drive.U[:, :1], np.zeros((N, 1)), drive.AUX, np.zeros((N, 1)), drive.aux)
    engine = Simulator(nom, np.zeros((2, 1)), substeps=4).run(r, e.point.theta, np.zeros(2), e.point.effects).y
    mine = stepped(write_improved(e, tmp_path / "MODEL.toml", AUX)[0], r)
    assert np.linalg.norm(mine - engine) < 1e-9 * np.linalg.norm(engine)


@pytest.mark.parametrize("key", ["cubic_stiffness@state:v", "coulomb_friction@state:v", "backlash@input:a", "dead_zone@input:a", "transport_delay@input:a"])
def test_a_written_simulator_is_simple_enough_to_be_compiled(key, tmp_path):
    e = explanation(PlacedEffect(LIBRARY[key], values(LIBRARY[key])))
    m = read_model(write_improved(e, tmp_path / "MODEL.toml", AUX)[0], allow_code=True)
    found, r = nominal(m, DT), run(np.random.default_rng(4))
    simulator = Simulator(found, np.zeros((len(m.states), 2)))
    mine = simulator.run(r, np.zeros(len(found.entries)), np.zeros(len(m.states))).y
    assert simulator.notes == ()
    engine = Simulator(e.nominal, np.zeros((4, 2))).run(r, e.point.theta, np.zeros(4), e.point.effects).y
    plain = Simulator(e.nominal, np.zeros((4, 2))).run(r, e.point.theta, np.zeros(4)).y
    assert np.linalg.norm(mine - engine) < 0.05 * np.linalg.norm(engine - plain)
