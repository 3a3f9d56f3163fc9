"""Chapter 4 and publications P1, P2 and P6: identification through S."""

from __future__ import annotations

import csv
from functools import lru_cache
from pathlib import Path

import numpy as np

from afdsvc.api.model import Model
from afdsvc.api.signals import Channel, Trace
from afdsvc.dataset.arrays import InputOutputData
from afdsvc.identify.methods.hansen import rebuilt_plant
from afdsvc.identify.methods.subspace import decompose, realise
from afdsvc.lti.coprime import Factorisation, observer_factorisation
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.lft import fault_signature
from afdsvc.lti.reduce import balanced_truncation
from afdsvc.lti.riccati import kalman_predictor_gain, lqr
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.simulate import simulate
from afdsvc.lti.stability import is_stable
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.yjbk import closed_loop, deviation_system
from afdsvc.plants.amb_turboexpander import amb_turboexpander, turboexpander_rotor
from afdsvc.plants.examples import random_stable
from afdsvc.plants.gas_bearing import NOISE_VARIANCE, gas_bearing
from afdsvc.plugins.controllers.lqg import Lqg
from benchmarks.thesis.figure import Figure, Row
from benchmarks.thesis.machines import bearing, observed, wrong
from benchmarks.thesis.recorded import Measured

MONTE_CARLO = Path(__file__).resolve().parents[2] / "docs" / "reference" / "identification-monte-carlo.csv"
TABLE = MONTE_CARLO.with_name("identification-table-4-1.md")
OTHER = "excitation and noise of the rig are not printed; compared with the fit of the true plant"
AXES, STIFFNESS = ("horizontal", "vertical"), "stiffness_b_y"


def cost_plane() -> list[Row]:
    """J(theta) over two actuator faults: no other minimum than the true one, and a parabola around it."""
    loop, truth, grid = bearing(), (-0.3, -0.2), np.linspace(-0.6, 0.0, 13)
    alpha = np.random.default_rng(1).choice([-1.0, 1.0], size=(400, 2))

    def beta(a: float, b: float) -> np.ndarray:
        S = fault_signature(loop.problem.augmented, loop.problem.interconnection, {"horizontal_actuator": a, "vertical_actuator": b})
        return simulate(S, alpha)[0]

    wanted = beta(*truth)
    J = np.array([[0.5 * np.sum((beta(a, b) - wanted) ** 2) for b in grid] for a in grid])
    i, j = np.unravel_index(J.argmin(), J.shape)
    inner = J[1:-1, 1:-1]
    lowest = np.all([inner < J[1 + a : 12 + a, 1 + b : 12 + b] for a in (-1, 0, 1) for b in (-1, 0, 1) if (a, b) != (0, 0)], axis=0)
    return [Row("minimum at the true horizontal fault", truth[0], float(grid[i]), 1e-9), Row("and the vertical one", truth[1], float(grid[j]), 1e-9), Row("minima in the plane", 1, int(lowest.sum()))]


Identified = tuple[Factorisation, StateSpace, StateSpace, StateSpace]


@lru_cache(maxsize=1)
def identified() -> Identified:
    """Return factors of a nominal model with half of the sampled A, the true bearing, its S, and S identified from alpha and beta."""
    _, _, alpha, beta = _recorded(closed_loop(wrong(0.5), gas_bearing().discrete()).system, np.random.default_rng(1), 8000)
    return identified_from(alpha, beta)


def identified_from(alpha: np.ndarray, beta: np.ndarray) -> Identified:
    """Return the same from these signals."""
    true, fact = gas_bearing().discrete(), wrong(0.5)
    S = realise(decompose([InputOutputData.of(alpha, beta, true.dt)], 24), 8, stable=True).system
    return fact, true, deviation_system(fact, true), S


def apart(one: StateSpace, other: StateSpace) -> float:
    """Return the largest difference of the responses over 50 to 5000 rad/s, relative to the largest of ``one``."""
    w = np.geomspace(50, 5000, 100)
    a, b = frequency_response(one, w), frequency_response(other, w)
    return float(np.abs(a - b).max() / np.abs(a).max())


def bode_of_s(result: Identified | None = None) -> list[Row]:
    _, _, S, found = result or identified()
    return [Row("largest error of the identified S, relative to its peak ('similar gain')", 0.0, apart(S, found), 0.2)]


def bode_of_g(result: Identified | None = None) -> list[Row]:
    fact, true, _, found = result or identified()
    G = rebuilt_plant(fact, found)
    return [Row("largest relative error of G(S) ('reaches the true system')", 0.0, apart(true, G), 0.1), Row("the nominal plant reaches it", False, apart(true, fact.plant) < 0.1), Row("the order of G(S) exceeds the nominal one's", True, G.order > fact.plant.order)]


def monte_carlo(low: float, high: float) -> dict[str, float]:
    """Return the median fit of both methods over the kept study (sampled A), for theta in an interval, both outputs together."""
    with MONTE_CARLO.open() as file:
        rows = [r for r in csv.DictReader(file) if r["kind"] == "discrete" and r["truth vertical"] and low <= float(r["theta"]) < high]
    return {m: float(np.nanmedian([float(r[f"{m} {o}"]) for r in rows for o in ("horizontal", "vertical") if r[f"{m} {o}"]])) for m in ("nominal", "PEM", "Hansen G(S)", "truth")}


def fit_against_theta() -> list[Row]:
    good, poor = monte_carlo(0.0, 0.1), monte_carlo(0.5, 1.0)
    return [
        Row("a good nominal model: median fit of PEM less that of Hansen ('similar')", 0.0, good["PEM"] - good["Hansen G(S)"], 0.05),
        Row("a poor one: the modified Hansen scheme is better", True, poor["Hansen G(S)"] > poor["PEM"]),
        Row("what it loses to the fit of the true plant", 0.0, poor["truth"] - poor["Hansen G(S)"], 0.05),
    ]


def kept_table() -> dict[tuple[str, str, str], list[float]]:
    """Return the fits of the kept study [%] by condition, variant and method, ours and then those printed."""
    lines = [[c.strip() for c in line.split("|")[1:-1]] for line in TABLE.read_text().splitlines() if line.startswith("| 0.")]
    return {(c[0], c[1], c[2]): [float(v) for half in c[3:] for v in half.split("/") if v.strip()] for c in lines}


def identified_fits() -> list[Row]:
    """The other columns, from the kept study: where the rig's noise limits the fit, identified models reach what the true plant does."""
    rows, kept = [], kept_table()
    for condition, variant in (("0.7 B, rotating", "no unbalance"), ("0.97 A, 0 rpm", "sampled A")):
        truth = kept[condition, variant, "truth"]
        for method in ("PEM", "Hansen G(S)", "Hansen, truncated"):
            ours = kept[condition, variant, method]
            rows += [Row(f"{condition}, {method}, {axis} [%]", ours[2 + i], ours[i], 3.0, OTHER, truth[i]) for i, axis in enumerate(AXES)]
    return rows


def table_4_1() -> list[Row]:
    """The worst column, in simulation: rows of docs/reference/identification-table-4-1.md made anew, without PEM."""
    fact, true, _, found = identified()
    u, y, _, _ = _recorded(closed_loop(fact, true).system, np.random.default_rng(2), 4000)
    full = rebuilt_plant(fact, found)
    ceiling, best, reduced, nominal = (_fit(G, u, y) for G in (true, full, balanced_truncation(full, 6).system, fact.plant))
    return [
        Row("nominal model below 4 %", True, bool((nominal < 0.04).all())), Row("Hansen within 3 points of the true plant", True, bool((ceiling - best < 0.03).all())),
        Row("reduction to the nominal order costs less than 2 points", True, bool((best - reduced < 0.02).all())),
        Row("horizontal fit of G(S)", 0.7676, float(best[0]), 0.03, OTHER, float(ceiling[0])), Row("vertical fit of G(S)", 0.8358, float(best[1]), 0.03, OTHER, float(ceiling[1])), *identified_fits(),
    ]  # fmt: skip


def subspace_fits(size: float = 0.3, models: int = 200) -> list[Row]:
    """P6 section 6: the bearing found directly from (u, y), and through S from (alpha, beta), with controllers of wrong nominal models."""
    direct, through = _compared(size, models)
    enough = "the size of the excitation is not printed: at 0.3 V as in print, at 3 V both reach the fit of the true plant"
    strong = np.subtract(*(f.mean(axis=0) for f in _compared(10 * size, 20)))
    rows = [Row(f"identifying S gives the higher mean fit, {axis}", True, bool(through[:, i].mean() > direct[:, i].mean())) for i, axis in enumerate(AXES)]
    rows += [Row(f"and the smaller variance, {axis}", True, bool(through[:, i].var() < direct[:, i].var())) for i, axis in enumerate(AXES)]
    return [*rows, *(Row(f"difference of the means at 3 V, {axis}", None, float(strong[i]), 0.01, enough, 0.0) for i, axis in enumerate(AXES))]


def _compared(size: float, models: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the fits ``(models, 2)`` found directly and through S, theta drawn from 0 to 1 where the loop is stable."""
    rng, true, fits = np.random.default_rng(6), gas_bearing().discrete(), []
    while len(fits) < models:
        fact = wrong(float(rng.uniform(0, 1)))
        loop = closed_loop(fact, true).system
        if loop.is_stable():
            (u, y, alpha, beta), (held_u, held_y, _, _) = _recorded(loop, rng, 2000, size), _recorded(loop, rng, 2000)
            direct, S = (realise(decompose([InputOutputData.of(*data, true.dt)], 24), order, stable=True).system for data, order in (((u, y), 6), ((alpha, beta), 8)))
            fits.append([_fit(G, held_u, held_y) for G in (direct, rebuilt_plant(fact, S))])
    found = np.array(fits)
    return found[:, 0], found[:, 1]


def _recorded(loop: StateSpace, rng: np.random.Generator, n: int, size: float = 2.0) -> tuple[np.ndarray, ...]:
    """Return u, y, alpha and beta of a run with a random binary alpha [V] and the bearing's noise."""
    alpha = size * np.repeat(rng.choice([-1.0, 1.0], size=(n // 4, 2)), 4, axis=0)
    out, _ = simulate(loop, np.hstack([np.sqrt(NOISE_VARIANCE) * rng.standard_normal((n, 2)), np.zeros((n, 4)), alpha]))
    return out[:, 4:6], out[:, 2:4], alpha, out[:, 6:]


def _fit(G: StateSpace, u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the fit of each output (4.38)."""
    return 1 - np.linalg.norm(y - simulate(G, u)[0], axis=0) / np.linalg.norm(y - y.mean(axis=0), axis=0)


# --- P1 --------------------------------------------------------------------------------------------------------------
@lru_cache(maxsize=1)
def expander() -> tuple:
    plant = amb_turboexpander(sample_time=1e-3)
    changed = plant.discrete(**{STIFFNESS: 0.5 * plant.parameters[STIFFNESS].value})
    fact = Lqg().design(plant.discrete(), plant.recommended["lqg"]).factorisation
    return plant, fact, changed, deviation_system(fact, changed)


def singular_values() -> list[Row]:
    rotor, values, w = turboexpander_rotor(), amb_turboexpander().values(), np.geomspace(10, 20e3, 400)
    full, reduced = (np.linalg.svd(frequency_response(s, w), compute_uv=False)[:, 0] for s in (rotor.full_system(values), rotor.reduced(values, 8)))
    apart_from = float(w[np.argmax(np.abs(full - reduced) > 0.1 * full)])
    return [Row("largest singular values within 10 % up to [rad/s] ('approx.')", 20e3, apart_from, 2000)]


def poles_of_g() -> list[Row]:
    changed = expander()[2]
    one_each = "plotted without a number; compared with the four axes that the magnets pull outwards"
    return [Row("the real plant has unstable poles", True, not changed.is_stable()), Row("how many", None, int((np.abs(changed.poles()) > 1).sum()), 0, one_each, 4)]


def poles_of_s() -> list[Row]:
    plant, S = expander()[0].discrete(), expander()[3]
    return [Row("S(theta) is stable", True, bool(is_stable(S.A, 1e-3))), Row("its order", None, S.order, 0, "plotted without a number; compared with plant and J_K", 2 * plant.order)]


def changed_response() -> list[Row]:
    plant, fact, changed, _ = expander()
    w = np.geomspace(10, 2000, 60)
    a, b = (np.linalg.svd(frequency_response(s, w), compute_uv=False)[:, 0] for s in (fact.plant, changed))
    values, rotor = {STIFFNESS: 0.5 * plant.parameters[STIFFNESS].value}, turboexpander_rotor()
    slow = [np.linalg.svd(frequency_response(s, [10.0]), compute_uv=False)[0, 0] for s in (plant.continuous(), plant.continuous(**values), rotor.full_system(plant.values()), rotor.full_system(plant.values(values)))]
    return [
        Row("gain at 10 rad/s, real over nominal", None, float(slow[1] / slow[0]), 0.005, "plotted without a number; compared with the 320 states", float(slow[3] / slow[2])),
        Row("half the stiffness changes the response by more than 10 % somewhere", True, bool((np.abs(a / b - 1) > 0.1).any())),
    ]


# --- P2 --------------------------------------------------------------------------------------------------------------
@lru_cache(maxsize=1)
def drawn() -> tuple:
    """Return factors, true plant, true S, and S identified with noise of a tenth of beta (P2 section 4)."""
    rng = np.random.default_rng(2)
    while True:
        true, nominal = random_stable(rng, dt=0.1)
        fact = observer_factorisation(nominal, lqr(nominal, np.eye(4), np.eye(2)), kalman_predictor_gain(nominal, np.eye(4), np.eye(2)))
        S = deviation_system(fact, true)
        if is_stable(S.A, 0.1):
            break
    alpha = rng.standard_normal((6000, 2))
    beta, _ = simulate(S, alpha)
    found = realise(decompose([InputOutputData.of(alpha, beta + 0.1 * beta.std(axis=0) * rng.standard_normal(beta.shape), 0.1)], 20), S.order, stable=True).system
    return fact, true, S, found


def p2_errors() -> list[Row]:
    fact, true, S, found = drawn()
    u = np.random.default_rng(3).standard_normal((2000, 2))
    truth = simulate(true, u)[0]
    before, after = ((truth - simulate(G, u)[0]).var(axis=0) for G in (fact.plant, rebuilt_plant(fact, found)))
    twelve = "12 counts a realisation that is not minimal: four states of the plant and four of J_K are enough"
    return [Row("variance of the error falls, output 1", True, bool(after[0] < before[0])), Row("output 2", True, bool(after[1] < before[1])),
            Row("to below a hundredth", None, bool((after < 0.01 * before).all()), 0, "no number is printed; ours, kept", True), Row("order of the true S", 12, S.order, 0, twelve, 8)]  # fmt: skip


def _relative(a: StateSpace, b: StateSpace) -> float:
    w = np.geomspace(0.05, 30, 100)
    x, y = frequency_response(a, w), frequency_response(b, w)
    return float(np.abs(x - y).max() / np.abs(x).max())


def p2_plants() -> list[Row]:
    fact, true, _, found = drawn()
    return [Row("largest relative error of the identified plant ('almost same frequency response')", 0.0, _relative(true, rebuilt_plant(fact, found)), 0.05), Row("the model agrees", False, _relative(true, fact.plant) < 0.05)]


def p2_deviation() -> list[Row]:
    _, _, S, found = drawn()
    return [Row("largest relative error of the identified S", 0.0, _relative(S, found), 0.05)]


def p1_theta() -> list[Row]:
    from afdsvc.identify.methods.indirect import fit_indirect
    from afdsvc.identify.parameters.structure import physical_structure

    plant, fact, _, _ = expander()
    nominal = plant.parameters[STIFFNESS].value
    full = sample_zoh(turboexpander_rotor(31500.0).full_system(plant.values({STIFFNESS: 0.5 * nominal})), 1e-3)
    alpha = 0.02 * np.random.default_rng(1).choice([-1.0, 1.0], size=(500, 4))
    beta, _ = simulate(deviation_system(fact, full), alpha)
    theta = fit_indirect(physical_structure(plant, [STIFFNESS]), fact, [InputOutputData.of(alpha, beta, 1e-3)]).parameters[0].value / nominal - 1
    return [Row("share of the stiffness that is lost", 0.502, -float(theta), 0.003)]


def several_at_once() -> list[Row]:
    """The outlook of P1: four stiffnesses at once, 0.5 um of noise and unbalance of grade G2.5, 1 s at 10 kHz."""
    from benchmarks.rotor.identify import FOUR, deviations

    found = deviations(3000, FOUR, full=False)
    return [
        *(Row(f"relative change of {name}", None, found[name][0], 3 * found[name][1], "P1 proposes it; compared with the simulated change, within three standard errors", change) for name, change in FOUR.items()),
        Row("largest standard error is below 0.15 % of the stiffness", None, max(found[name][1] for name in FOUR) < 0.0015, 0, "ours, kept", True),
    ]  # fmt: skip


def unbalanced() -> list[Row]:
    """The modified Hansen scheme on the turning bearing with 0.7 B, its rotor shaken by 1 um rms: error of G(S) with and without the rotor angle."""
    from afdsvc.identify import IdentifyOptions, identify

    rotating = gas_bearing(1100)
    true, weak = rotating.discrete(), rotating.continuous()
    nominal = sample_zoh(StateSpace(weak.A, 0.7 * weak.B, weak.C, weak.D, 0.0), rotating.sample_time)
    fact = observed(nominal, 1e-6)
    model = Model("bearing", rotating.inputs, rotating.outputs, rotating.states, nominal, sample_time=nominal.dt, output_sd=np.sqrt(NOISE_VARIANCE), controller=fact.K)
    error = {}
    for known in (True, False):
        trace = _shaken(fact, true, model, known)
        found = identify(model, [trace.span(1000, 7000)], [trace.span(7000, 9000)], IdentifyOptions(method="hansen", cross_check=False)).fit.system
        error[known] = apart(true, found)
    theirs = "print has no such comparison; compared with the true plant"
    return [Row(f"largest relative error, {where}", None, error[known], 0.1, theirs, 0.0) for known, where in ((True, "angle recorded"), (False, "without the angle"))]


def _shaken(fact: Factorisation, true: StateSpace, model: Model, angle_known: bool, n: int = 9000) -> Trace:
    """Return a recording of the loop whose rotor turns at 1100 rpm out of balance."""
    rng, angle = np.random.default_rng(4), 1100 * 2 * np.pi / 60 * true.dt * np.arange(n)
    d = np.sqrt(NOISE_VARIANCE) * rng.standard_normal((n, 2)) + np.sqrt(2) * np.column_stack([np.cos(angle), np.sin(angle)])
    alpha = 2.0 * np.repeat(rng.choice([-1.0, 1.0], size=(n // 4, 2)), 4, axis=0)
    out, _ = simulate(closed_loop(fact, true).system, np.hstack([d, np.zeros((n, 4)), alpha]))
    columns = {f"{role}_{v.name}": c for role, of, values in (("u", model.inputs, out[:, 4:6]), ("y", model.outputs, out[:, 2:4]), ("alpha", model.inputs, alpha))
               for v, c in zip(of, values.T, strict=True)}  # fmt: skip
    if angle_known:
        columns["aux_angle"] = np.mod(angle, 2 * np.pi)
    return Trace("run", true.dt, tuple(map(Channel, columns)), np.column_stack(list(columns.values())))


def _measured(m: Measured) -> Identified:
    _, _, alpha, beta = m.identification()
    return identified_from(alpha, beta)


FIGURES = [
    Figure("figure-4.5", "the cost J(theta) over two parameters", cost_plane),
    Figure("figure-4.9", "identified and true S", bode_of_s, recorded=lambda m: bode_of_s(_measured(m)), experiment="half-a"),
    Figure("figure-4.10", "identified, true and nominal plant", bode_of_g, recorded=lambda m: bode_of_g(_measured(m)), experiment="half-a"),
    Figure("figure-4.11", "fit against the error of the nominal model, from the kept study of benchmarks/identify/monte_carlo.py", fit_against_theta),
    Figure("table-4.1", "fit of the identified models, the column with half of A in simulation (all: benchmarks/identify/table_4_1.py)", table_4_1),
    Figure("p1-0.5", "singular values of full and reduced rotor", singular_values),
    Figure("p1-0.6", "poles and zeros of G(theta)", poles_of_g),
    Figure("p1-0.7", "poles and zeros of S(theta)", poles_of_s),
    Figure("p1-0.8", "singular values of the real and the nominal system", changed_response),
    Figure("p1-section-4", "the identified stiffness", p1_theta, long=True),
    Figure("p1-section-5", "several stiffnesses at once, with noise and unbalance (proposed in the outlook)", several_at_once),
    Figure("p2-0.8", "error of nominal and identified plant", p2_errors),
    Figure("p2-0.9", "responses of real, identified and nominal plant", p2_plants),
    Figure("p2-0.10", "real and identified S", p2_deviation),
    Figure("p6-0.4", "fit against the error of the nominal model, from the kept study of benchmarks/identify/monte_carlo.py", fit_against_theta),
    Figure("p6-0.5", "fits of direct subspace identification and of identification through S", subspace_fits),
    Figure("p6-section-7", "the modified Hansen scheme with unbalance, as on the turning rig", unbalanced, long=True),
    Figure("p6-table-0.1", "fit of the identified models, the column with half of A in simulation (all: benchmarks/identify/table_4_1.py)", table_4_1),
]
