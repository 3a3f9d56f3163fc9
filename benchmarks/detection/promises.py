"""Every promise of detection counted on the ten drawn machines, by a simulator that shares no code with the package.

    python -m benchmarks.detection.promises --out COUNTS.csv [--only MACHINE ..] [--studies NAME ..] [--size SHARE] [--seed N]
    python -m benchmarks.detection.promises --page COUNTS.csv

The first adds rows ``promise, detector, machine, hits, of, promised`` to the file (about three minutes of processor for each machine), the
second prints the table of the page.
"""

from __future__ import annotations

import argparse
import csv
import json
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations, product
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import numpy as np
from scipy.signal import lfilter

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.detection import DetectionProblem, Detector, FalseAlarms, Noise
from afdsvc.api.evidence import Evidence
from afdsvc.api.model import Model
from afdsvc.app import diagnose
from afdsvc.app.commissioning import RecordedMachine, commission
from afdsvc.detect.combinations import JOINED
from afdsvc.detect.features.noise_calibration import calibrate_noise
from afdsvc.detect.stability_range import reachable
from afdsvc.detect.statistics.passive_cusum import unpromised
from afdsvc.detect.uncertain_parameters import uncertain_entries
from afdsvc.diagnosis.verdict import alarm_decisions, informed, strongest
from afdsvc.errors import AfdsvcError
from afdsvc.excite.diagnosis_burst import Aim, default_burst
from afdsvc.excite.recorded_bursts import marked
from afdsvc.files.model.model_file import parse_model
from afdsvc.files.open import Naming, open_file
from afdsvc.files.site import DetectorSection
from afdsvc.hal.replay import blocks_of
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.whitening import innovations
from afdsvc.plugins.manager import load
from benchmarks.detection.counting import share
from benchmarks.detection.judged import quiet, shown
from benchmarks.detection.truth import TrueMachine, machines
from benchmarks.detection.truth_problem import alpha_of, loss_of, problem_of

SAMPLES, CALIBRATED = 2000, 20_000
EVERY = ("matched_filter", "fault_curves", "regression", "iterated_regression", "cusum")
TWO = ("matched_filter", "regression")
DEFAULT = (*TWO, "cusum")  # detectors of bursts that a site has where it names none
RATES = (1e-2, 1e-3)  # alarms per healthy burst that are promised
PASSIVE_EVERY = 20_000  # samples in which the passive detector promises one alarm here
Row = tuple[str, str, int, int, float]


def broad(machine: TrueMachine) -> Burst:
    """Return a burst of two lines per input, five standard deviations of the loop's own input large."""
    m, size = machine.shape[1], 5 * np.maximum(machine.spread()[1], 1e-2 * machine.spread()[1].max())
    rate = 2 * np.pi / (SAMPLES * machine.dt)
    lines = tuple(Line(i, rate * (70 + 22 * i + 124 * j), float(size[i]), 1.0 * j) for i in range(m) for j in range(2))
    return Burst("b", m, SAMPLES, 100, lines, settle=100)


def designed(problem: DetectionProblem, kinds: Sequence[str], settings: Mapping[str, float] | None = None) -> list[Detector]:
    """Return detectors by name."""
    return [load().get("detectors", kind).design(problem, dict(settings or {})) for kind in kinds]


def at_rates(problem: DetectionProblem, rates: Sequence[float] = RATES) -> list[Detector]:
    """Return `TWO` detectors for every rate of alarms per healthy burst."""
    return [d for rate in rates for d in designed(replace(problem, false_alarms=FalseAlarms(rate)), TWO)]


def _alarms(words: str, hits: np.ndarray, bursts: int, rates: Sequence[float] = RATES) -> Iterator[Row]:
    for (rate, kind), count in zip(product(rates, TWO), hits.tolist(), strict=True):
        yield f"alarms, {words}", kind, count, bursts, rate


def exceeded(e: Evidence) -> bool:
    """Whether the statistic exceeds its threshold, whatever the gate says."""
    return bool(e.statistic > e.threshold)


def given_noise(machine: TrueMachine, rng: np.random.Generator, size: float) -> Iterator[Row]:
    """Healthy bursts, stated noise: alarms of every detector at 1e-2, of two at 1e-3, and quiet data that are not trusted."""
    problem, burst, bursts = problem_of(machine, FalseAlarms(1e-2)), broad(machine), round(300 * size)
    rarer = replace(problem, false_alarms=FalseAlarms(1e-3))
    detectors, hits, doubted = [*designed(problem, EVERY), *designed(rarer, TWO)], np.zeros(len(EVERY) + len(TWO), int), 0
    for _ in range(bursts):
        decisions = [t[-1] for t in shown(problem, detectors, machine.run(rng, alpha_of(burst, machine.dt, quiet(problem))), burst)]
        hits += [exceeded(e) for e in decisions]
        doubted += not decisions[0].trustworthy
    for kind, rate, count in zip((*EVERY, *TWO), [1e-2] * len(EVERY) + [1e-3] * len(TWO), hits, strict=True):
        yield "alarms, stated noise", kind, int(count), bursts, rate
    yield "not trusted, stated noise", "gate", doubted, bursts, 2e-3  # the quiet data and the burst, each at 1e-3


def calibrated_noise(machine: TrueMachine, rng: np.random.Generator, size: float) -> Iterator[Row]:
    """Noise from quiet data, new ones for every burst: trusted and alarms; refused when the noise is a tenth larger, everywhere or in bursts
    only; alarms between bursts."""
    plant, burst, spans = StateSpace(machine.A, machine.B, machine.C, machine.D, machine.dt), broad(machine), round(100 * size)
    counts, hits, passive = np.zeros(3, int), np.zeros(len(RATES) * len(TWO), int), np.zeros(2, int)
    for k in range(spans):
        learnt = machine.run(rng, np.zeros((CALIBRATED, burst.inputs)))
        problem = with_noise(problem_of(machine, FalseAlarms(1e-2)), calibrate_noise(plant, learnt["u"], learnt["y"]))
        detectors, before = at_rates(problem), quiet(problem)
        alpha = alpha_of(burst, machine.dt, before)
        decisions = [t[-1] for t in shown(problem, detectors, machine.run(rng, alpha), burst)]
        counts[0] += decisions[0].trustworthy
        hits += [exceeded(e) for e in decisions]
        for j, where in enumerate((1.1, np.r_[np.ones(before), np.full(burst.samples, 1.1)])):
            counts[1 + j] += not shown(problem, detectors[:1], machine.run(rng, alpha, noisier=where), burst)[0][-1].trustworthy
        if k % 5 == 0:
            passive += between_bursts(problem, machine.run(rng, np.zeros((2 * PASSIVE_EVERY, burst.inputs))))
    yield "trusted, calibrated noise", "gate", int(counts[0]), spans, 0.95
    yield from _alarms("calibrated noise", hits, spans)
    yield "refused, noise 10 % larger", "gate", int(counts[1]), spans, 0.95
    yield "refused, noise 10 % larger in the burst", "gate", int(counts[2]), spans, 0.95
    yield from _between("calibrated noise", passive, len(range(0, spans, 5)))


def between_bursts(problem: DetectionProblem, run: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the alarms of the passive detector in quiet data, and how often it doubts them, from `PASSIVE_EVERY` samples after its start on:
    a run length is the mean time between alarms of a detector that runs, and the first alarm comes later."""
    hourly = replace(problem, false_alarms=FalseAlarms(per_hour=3600 / (PASSIVE_EVERY * problem.plant.dt)))
    (decisions,) = shown(hourly, designed(hourly, ["passive_cusum"], {"silence_seconds": 0.0}), run, None)
    running = [e for e in decisions if e.k >= PASSIVE_EVERY]
    return np.array([sum(e.detected for e in running), sum(not e.trustworthy for e in running)])


def _between(words: str, found: np.ndarray, stretches: int) -> Iterator[Row]:
    for what, hits in zip(("alarms", "doubts"), found.tolist(), strict=True):
        yield f"{what} between bursts, {words}", "passive_cusum", hits, stretches, 1.0


def with_noise(problem: DetectionProblem, noise: Noise) -> DetectionProblem:
    """Return the problem with another noise."""
    found = innovations(problem.plant, noise.output_cov, noise.process_cov, noise.cross_cov)
    return replace(
        problem, innovations=found.filter, covariance=found.covariance, output_cov=noise.output_cov, process_cov=noise.process_cov,
        cross_cov=noise.cross_cov, noise_samples=noise.samples,
    )


def references(machine: TrueMachine, rng: np.random.Generator, size: float) -> Iterator[Row]:
    """References that wander, five standard deviations of the outputs: alarms of bursts, and between bursts with them and without."""
    problem, burst, (y_sd, _) = problem_of(machine, FalseAlarms(1e-2)), broad(machine), machine.spread()
    bursts, samples = round(200 * size), PASSIVE_EVERY * round(20 * size)

    def wandering(n: int) -> np.ndarray:
        slow = lfilter([0.02], [1, -0.98], rng.standard_normal((n, len(y_sd))), axis=0)
        return np.asarray(5 * y_sd * slow / slow.std())

    detectors, alpha = at_rates(problem), alpha_of(burst, machine.dt, quiet(problem))
    hits = np.zeros(len(detectors), int)
    for _ in range(bursts):
        hits += [exceeded(t[-1]) for t in shown(problem, detectors, machine.run(rng, alpha, ref=wandering(len(alpha))), burst)]
    yield from _alarms("moving references", hits, bursts)
    for words, ref in (("at rest", np.zeros((PASSIVE_EVERY + samples, len(y_sd)))), ("moving references", wandering(PASSIVE_EVERY + samples))):
        yield from _between(words, between_bursts(problem, machine.run(rng, np.zeros((len(ref), burst.inputs)), ref=ref)), samples // PASSIVE_EVERY)


def uncertain(machine: TrueMachine, rng: np.random.Generator, size: float, sd: float = 0.005) -> Iterator[Row]:
    """Entries of A and B off by a share with this standard deviation, as stated; every draw is another machine: alarms, those at 5e-2 too."""
    off = f"parameters off by their stated {100 * sd:g} %"
    entries = {"A": sd * np.abs(machine.A), "B": sd * np.abs(machine.B)}
    plain = problem_of(machine, FalseAlarms(5e-2))
    pulled = uncertain_entries(plain.plant, entries, machine.dt)
    problem = replace(plain, uncertain=pulled, uncertainty=dict.fromkeys(pulled.fault_names, 1.0))
    burst, rates, n, passive, stretches = broad(machine), (5e-2, *RATES), 0, np.zeros(2, int), 0
    detectors, hits = at_rates(problem, rates), np.zeros(len(rates) * len(TWO), int)
    for k in range(round(200 * size)):
        A, B = (M * (1 + sd * rng.standard_normal(M.shape)) for M in (machine.A, machine.B))
        run = machine.run(rng, alpha_of(burst, machine.dt, quiet(problem)), plant=(A, B))
        if held(machine, run):
            n += 1
            hits += [exceeded(t[-1]) for t in shown(problem, detectors, run, burst)]
            if k % 10 == 0 and held(machine, long := machine.run(rng, np.zeros((2 * PASSIVE_EVERY, burst.inputs)), plant=(A, B))):
                passive, stretches = passive + between_bursts(problem, long), stretches + 1
    if unpromised(problem):
        yield f"alarms between bursts, {off}, no rate promised", "passive_cusum", int(passive[0]), stretches, 0.0
        yield "reports between bursts that no rate is promised or data are doubted", "passive_cusum", int(passive[1]), stretches, 1.0
    else:
        yield from _between(off, passive, stretches)
    yield from _alarms(off, hits, n, rates)


def margins(machine: TrueMachine, rng: np.random.Generator, size: float, sd: float = 0.005) -> Iterator[Row]:
    """Entries of A and B off as in `uncertain`: loops that are lost, and loops that keep less than half of their stability margin."""
    g, draws = machine, round(4000 * size)

    def margin(A: np.ndarray, B: np.ndarray) -> float:
        observer = g.A + g.B @ g.F + g.L @ g.C
        return 1 - float(np.abs(np.linalg.eigvals(np.block([[A, B @ g.F], [-g.L @ g.C, observer]]))).max())

    found = np.array([margin(*(M * (1 + sd * rng.standard_normal(M.shape)) for M in (g.A, g.B))) for _ in range(draws)])
    for words, bound in (("lost", 0.0), ("with less than half of its stability margin", 0.5 * margin(g.A, g.B))):
        yield f"loop {words}, parameters off by their stated {100 * sd:g} %", "", int(np.sum(found < bound)), draws, np.nan


def held(machine: TrueMachine, run: Mapping[str, np.ndarray]) -> bool:
    """Whether the loop has not been lost."""
    return bool(np.isfinite(run["y"]).all() and np.abs(run["y"]).max() < 1e3 * machine.spread()[0].max())


def together(machine: TrueMachine, rng: np.random.Generator, size: float, loss: float = -0.2) -> Iterator[Row]:
    """One fault and every pair of faults of -20 %, with the burst designed for -20 % and with the one for -50 % that is the default."""
    problem = problem_of(machine, FalseAlarms(1e-3))
    assert problem.limits is not None
    detectors, names = designed(problem, DEFAULT), [n for n, (low, _) in reachable(problem).items() if low < loss]
    for which, aim in (("burst for -20 %", Aim(severity=loss)), ("default burst", Aim())):
        try:
            burst = default_burst(problem, problem.limits, aim=aim)
        except AfdsvcError:
            continue
        for words, truths in (("one fault", [(n,) for n in names]), ("two faults", list(combinations(names, 2)))):
            counts, concluded, n = np.zeros((len(TWO), 5), int), 0, 0
            for truth in truths:
                severities = dict.fromkeys(truth, loss)
                if not problem_survives(problem, severities):
                    continue
                for _ in range(round(20 * size)):
                    n += 1
                    run = machine.run(rng, alpha_of(burst, machine.dt, quiet(problem)), loss_of(problem, severities))
                    decisions = [t[-1] for t in shown(problem, detectors, run, burst)]
                    counts[:, :3] += [[e.detected, e.fault == JOINED.join(truth), e.detected and reported(e, truth, loss)] for e in decisions[: len(TWO)]]
                    decisive = deciding(decisions)
                    concluded += decisive is not None and reported(decisive, truth, loss)
                    if len(truth) == 1:
                        counts[:, 3:] += singles_only(problem, detectors[: len(TWO)], run, burst, truth[0])
            for kind, (detected, named, stated, alone, alone_named) in zip(TWO, counts.tolist(), strict=True):
                yield f"{words} of -20 %, {which}: detected", kind, detected, n, np.nan
                yield f"{words} of -20 %, {which}: named", kind, named, n, np.nan
                yield f"{words} of -20 %, {which}, detected: named, or the ambiguity stated", kind, stated, detected, 0.95
                if words == "one fault":
                    yield f"{words} of -20 %, {which}: detected, pairs not looked for", kind, alone, n, np.nan
                    yield f"{words} of -20 %, {which}: named, pairs not looked for", kind, alone_named, n, np.nan
            yield f"{words} of -20 %, {which}, all that were played: named in the verdict, or the ambiguity stated", "verdict", concluded, n, 0.95


def deciding(decisions: Sequence[Evidence]) -> Evidence | None:
    """Return the decision that the verdict of a burst is taken from: the strongest that names something, else the last with weights."""
    found = alarm_decisions(decisions)
    return strongest(found) or next((e for e in reversed(informed(found)) if e.weights), None)


def reported(e: Evidence, truth: Sequence[str], loss: float) -> bool:
    """Whether faults are named, share the weight, are listed as doing what the named fault does, or, being two, one of them has weight and
    the other one's loss is inside the bound stated besides it."""
    name = JOINED.join(truth)
    shared = e.fault is None and e.weights.get(name, 0.0) > 0.01
    besides = len(truth) == 2 and any(e.weights.get(a, 0.0) > 0.01 and e.parts.get(f"besides.{b}", 0.0) <= loss for a, b in (truth, truth[::-1]))
    return e.fault == name or shared or f"alike.{name}" in e.parts or besides


def singles_only(problem: DetectionProblem, detectors: Sequence[Detector], run: Mapping[str, np.ndarray], burst: Burst, truth: str) -> list[list[bool]]:
    """Return whether each detector detects and names one fault where no pair can win."""
    with patch("afdsvc.detect.combinations.TOGETHER", 1e-300):
        return [[t[-1].detected, t[-1].fault == truth] for t in shown(problem, detectors, run, burst)]


def problem_survives(problem: DetectionProblem, severities: Mapping[str, float]) -> bool:
    """Whether the loop is stable with these faults."""
    g = problem.augmented.close(severities)
    n, k = g.order, problem.interconnection
    A = np.block([[g.A + g.B @ k.D[: g.inputs, : g.outputs] @ g.C, g.B @ k.C[: g.inputs]], [k.B[:, : g.outputs] @ g.C, k.A]])
    if g.D.any():  # u = Kuy (C x + D u) + Ck xk
        inner = np.linalg.inv(np.eye(g.inputs) - k.D[: g.inputs, : g.outputs] @ g.D)
        u = np.hstack([inner @ k.D[: g.inputs, : g.outputs] @ g.C, inner @ k.C[: g.inputs]])
        y = np.hstack([g.C, np.zeros((g.outputs, k.order))]) + g.D @ u
        A = np.vstack([np.hstack([g.A, np.zeros((n, k.order))]) + g.B @ u, np.hstack([np.zeros((k.order, n)), k.A]) + k.B[:, : g.outputs] @ y])
    return bool(np.abs(np.linalg.eigvals(A)).max() < 0.999)


def units(machine: TrueMachine, rng: np.random.Generator, size: float) -> Iterator[Row]:
    """States, inputs and outputs in units of 1e-12 to 1e12, healthy and with a fault: decisions that are others than in units of 1."""
    n, m, p = machine.shape
    problem, burst = problem_of(machine, FalseAlarms(1e-2)), broad(machine)
    scales = [(1e-12, 1, 1), (1e12, 1, 1), (1, 1e-12, 1e-12), (1, 1e12, 1e12), (1e9, 1e-9, 1e-12)]
    others = [problem_of(machine.scaled(s * np.logspace(-0.5, 0.5, n), np.full(m, i), np.full(p, o)), FalseAlarms(1e-2)) for s, i, o in scales]
    detectors, changed, of = [designed(q, EVERY) for q in (problem, *others)], np.zeros(len(EVERY), int), 0
    for k in range(round(20 * size)):
        fault = problem.fault_names[k % len(problem.fault_names)]
        loss = loss_of(problem, {fault: 0.0 if k % 2 else max(-0.1, 0.5 * reachable(problem)[fault][0])})
        run = machine.run(rng, alpha_of(burst, machine.dt, quiet(problem)), loss)
        decisions = []
        for q, own, (_, i, o) in zip((problem, *others), detectors, [(1, 1, 1), *scales], strict=True):
            same = {name: v * (i if name in ("u", "alpha") else o) for name, v in run.items()}
            scaled = replace(burst, lines=tuple(replace(line, amplitude=i * line.amplitude) for line in burst.lines))
            decisions.append([(e.detected, e.fault, e.trustworthy) for e in (t[-1] for t in shown(q, own, same, scaled))])
        of += len(scales)
        changed += [sum(other[j] != decisions[0][j] for other in decisions[1:]) for j in range(len(EVERY))]
    for kind, count in zip(EVERY, changed.tolist(), strict=True):
        yield "decisions changed by units of 1e-12 to 1e12", kind, count, of, 0.0


def recorded(machine: TrueMachine, rng: np.random.Generator, size: float) -> Iterator[Row]:
    """Tables of a healthy machine with bursts in their alpha columns, judged by `diagnose` with the controller that the model states, the noise
    learnt from the first two thirds of the quiet data; and quiet tables, their controller stated or not."""
    burst, hits, n = broad(machine), np.zeros((len(RATES), len(TWO)), int), 0
    model, unstated = (model_of(machine, stated) for stated in (True, False))
    for _ in range(round(10 * size)):
        alpha = np.vstack([np.zeros((CALIBRATED, burst.inputs)), *[alpha_of(burst, machine.dt, 3000)] * 10, np.zeros((1000, burst.inputs))])
        run = machine.run(rng, alpha)
        evidence = [judged_table(model, machine.dt, run, TWO, rate) for rate in RATES]
        n += sum(e.detector == TWO[0] for e in evidence[0])
        hits += [[sum(exceeded(e) for e in found if e.detector == kind) for kind in TWO] for found in evidence]
    yield from _alarms("recorded controller, noise from the table", hits.ravel(), n)
    for words, used in (("recorded controller", model), ("controller not recorded", unstated)):
        found, stretches = np.zeros(2, int), 0
        for _ in range(round(5 * size)):
            evidence = judged_table(used, machine.dt, machine.run(rng, np.zeros((8 * PASSIVE_EVERY, burst.inputs))), ["passive_cusum"])
            found, stretches = found + [sum(e.detected for e in evidence), sum(not e.trustworthy for e in evidence)], stretches + 4
        yield from _between(words, found, stretches)


def model_of(machine: TrueMachine, stated: bool) -> Model:
    """Return the model file's content, with the controller where it is ``stated``."""
    g = machine
    K = g.A + g.B @ g.F + g.L @ (g.C + g.D @ g.F), -g.L, g.F, np.zeros(g.D.T.shape)

    def rows(*named: tuple[str, np.ndarray]) -> str:
        return "".join(f"{name} = {json.dumps(v.tolist())}\n" for name, v in named)

    def variables(letter: str, count: int) -> str:
        return ", ".join(f'{{name = "{letter}{i}"}}' for i in range(count))

    names = f"inputs = [{variables('a', g.shape[1])}]\noutputs = [{variables('c', g.shape[2])}]\n"
    time = f'time = "discrete"\nsample_time = {g.dt}\n'
    text = f'name = "truth"\n{time}{names}' + rows(*zip("ABCD", (g.A, g.B, g.C, g.D), strict=True))
    return parse_model(text + (f"[controller]\n{time}" + rows(*zip("ABCD", K, strict=True)) if stated else ""), "truth.toml")


def judged_table(model: Model, dt: float, run: Mapping[str, np.ndarray], kinds: Sequence[str], rate: float = RATES[0]) -> list[Evidence]:
    """Return the decisions of `diagnose` on a table, at a rate of alarms per burst, or one in `PASSIVE_EVERY` samples of quiet data."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.npz"
        own = {"u": model.inputs, "y": model.outputs, "alpha": model.inputs, "beta": model.outputs}
        columns = {f"{role}_{v.name}": run[role][:, i] for role, variables in own.items() for i, v in enumerate(variables)}
        np.savez(path, t=dt * np.arange(len(run["u"])), **columns)
        (trace,) = open_file(path, Naming()).traces(model)
    config = diagnose._bare("table", len(trace) * trace.dt / 2)  # noqa: SLF001
    per_day = 86400 / (PASSIVE_EVERY * trace.dt)
    sections = [DetectorSection(kind=k, false_alarms_per_1000_bursts=1000 * rate, false_alarms_per_day=per_day, settings={"silence_seconds": 0.0} if k == "passive_cusum" else {}) for k in kinds]
    machine = commission(config.model_copy(update={"detectors": sections}), load(), RecordedMachine(model, trace.dt, trace.channels))
    machine, played = diagnose._excited(machine, [trace], None)  # noqa: SLF001
    bursts = {burst.name: burst for _, burst in played}
    return diagnose.evidence_of(machine, marked(blocks_of(trace, "table", "table", 0), played), bursts.values(), load()).evidence


STUDIES = (given_noise, calibrated_noise, references, uncertain, together, units, recorded, margins)


AT_LEAST, AT_MOST = ("trusted", "refused", "one fault", "two faults"), ("not trusted", "doubts", "reports")  # how promises that are bounds begin


def page(rows: Sequence[Mapping[str, str]]) -> str:
    """Return the table of counts: one line per promise and detector over all machines."""
    sums: dict[tuple[str, str, str], list[tuple[str, int, int]]] = defaultdict(list)
    for row in rows:
        if int(row["of"]):
            sums[row["promise"], row["detector"], row["promised"]].append((row["machine"], int(row["hits"]), int(row["of"])))
    lines = ["| promise | detector | promised | counted | 99 % interval | machines whose own interval does not hold it |", "|---|---|---|---|---|---|"]
    return "\n".join([*lines, *(_line(promise, detector, float(rate), found) for (promise, detector, rate), found in sums.items())])


def _line(promise: str, detector: str, promised: float, found: Sequence[tuple[str, int, int]]) -> str:
    hits, of = sum(h for _, h, _ in found), sum(n for _, _, n in found)
    least, most, poisson = promise.startswith(AT_LEAST), promise.startswith(AT_MOST), " between bursts" in promise

    def interval(h: int, n: int) -> tuple[float, float]:
        both = _poisson(h) if poisson else (share(h, n, 0.99).low, share(h, n, 0.99).high)
        return (both[0] / n, both[1] / n) if poisson else both

    apart = [m for m, h, n in found if (interval(h, n)[1] < promised and not most) or (interval(h, n)[0] > promised and not least)]
    words = "" if np.isnan(promised) else f"{'at least ' * least}{'at most ' * most}{promised:g}{f' in {PASSIVE_EVERY:,} samples' * poisson}"
    low, high = interval(hits, of)
    return f"| {promise} | `{detector}` | {words} | {hits:,} of {of:,}: {hits / of:.4g} | {low:.4f} to {high:.4f} | {', '.join(apart)} |"


def _poisson(hits: int) -> tuple[float, float]:
    from scipy.stats import chi2

    return (0.0 if hits == 0 else float(chi2.ppf(0.005, 2 * hits) / 2)), float(chi2.ppf(0.995, 2 * hits + 2) / 2)


def main() -> None:
    """Count, or print the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--page", type=Path)
    parser.add_argument("--only", type=int, nargs="*", default=range(10), help="machines by number")
    parser.add_argument("--studies", nargs="*", default=[s.__name__ for s in STUDIES])
    parser.add_argument("--size", type=float, default=1.0, help="share of the bursts and spans of a full count")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--sd", type=float, default=0.005, help="of uncertain parameters, a share")
    asked = parser.parse_args()
    if asked.page:
        with asked.page.open() as stream:
            print(page(list(csv.DictReader(stream))))
        return
    for i in asked.only:
        for k, study in enumerate(STUDIES):
            if study.__name__ not in asked.studies:
                continue
            more = {"sd": asked.sd} if study in (uncertain, margins) else {}
            found = list(study(machines()[i], np.random.default_rng([asked.seed, i, k]), asked.size, **more))
            fresh = not asked.out.exists()
            with asked.out.open("a", newline="") as stream:
                writer = csv.writer(stream)
                writer.writerows([("promise", "detector", "machine", "hits", "of", "promised")] if fresh else [])
                writer.writerows((row[0], row[1], machines()[i].name, *row[2:]) for row in found)


if __name__ == "__main__":
    main()
