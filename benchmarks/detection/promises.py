"""Every promise of detection counted on the ten drawn machines, by a simulator that shares no code with the package.

    python -m benchmarks.detection.promises --out COUNTS.csv [--only MACHINE ..] [--size SHARE] [--seed N]
    python -m benchmarks.detection.promises --page COUNTS.csv > docs/reference/detection-promises.md

The first adds rows ``promise, detector, machine, hits, of, promised`` to the file (about a minute of processor for each machine).
"""

from __future__ import annotations

import argparse
import csv
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.detection import DetectionProblem, Detector, FalseAlarms, Noise, ResidualBlock
from afdsvc.api.evidence import Evidence
from afdsvc.detect.combinations import JOINED
from afdsvc.detect.features.noise_calibration import calibrate_noise
from afdsvc.detect.stability_range import reachable
from afdsvc.detect.uncertain_parameters import uncertain_entries
from afdsvc.errors import AfdsvcError
from afdsvc.excite.diagnosis_burst import Aim, default_burst
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.whitening import innovations
from afdsvc.plugins.manager import load
from benchmarks.detection.counting import share
from benchmarks.detection.judged import quiet
from benchmarks.detection.truth import TrueMachine, machines
from benchmarks.detection.truth_problem import alpha_of, loss_of, problem_of

SAMPLES, CALIBRATED = 2000, 20_000
EVERY = ("matched_filter", "fault_curves", "regression", "iterated_regression", "cusum")
TWO = ("matched_filter", "regression")
PASSIVE_EVERY = 20_000  # samples in which the passive detector promises one alarm here
Row = tuple[str, str, int, int, float]


def broad(machine: TrueMachine) -> Burst:
    """Return a burst of two lines per input, five standard deviations of the loop's own input large."""
    m, size = machine.shape[1], 5 * np.maximum(machine.spread()[1], 1e-2 * machine.spread()[1].max())
    rate = 2 * np.pi / (SAMPLES * machine.dt)
    lines = tuple(Line(i, rate * (70 + 22 * i + 124 * j), float(size[i]), 1.0 * j) for i in range(m) for j in range(2))
    return Burst("b", m, SAMPLES, 100, lines, settle=100)


def shown(problem: DetectionProblem, detectors: Sequence[Detector], run: Mapping[str, np.ndarray], burst: Burst | None) -> list[list[Evidence]]:
    """Return the evidence of every detector for a run: quiet samples, then the burst (None: all of it is quiet)."""
    r, _ = simulate(problem.innovations, np.hstack([run["y"], run["u"]]))
    end = len(r) if burst is None else quiet(problem)
    parts = (r, run["beta"], run["u"], run["y"], run["alpha"])
    edges = [(k, min(k + 5000, end), None) for k in range(0, end, 5000)] + ([] if burst is None else [(end, len(r), burst)])
    blocks = [ResidualBlock(a, problem.plant.dt, *(x[a:b] for x in parts), playing, "b" if playing else "", end) for a, b, playing in edges]
    found = []
    for detector in detectors:
        state, told = detector.start(), []
        for block in blocks:
            state, evidence = detector.step(state, block)
            told += evidence
        found.append(told)
    return found


def designed(problem: DetectionProblem, kinds: Sequence[str], settings: Mapping[str, float] | None = None) -> list[Detector]:
    """Return detectors by name."""
    return [load().get("detectors", kind).design(problem, dict(settings or {})) for kind in kinds]


def exceeded(e: Evidence) -> bool:
    """Whether the statistic exceeds its threshold, whatever the gate says."""
    return bool(e.statistic > e.threshold)


def given_noise(machine: TrueMachine, rng: np.random.Generator, size: float) -> Iterator[Row]:
    """Healthy bursts, stated noise: alarms of every detector at 1e-2, of two at 1e-3, and quiet data that are not trusted."""
    problem, burst, bursts = problem_of(machine, FalseAlarms(1e-2)), broad(machine), round(200 * size)
    rarer = replace(problem, false_alarms=FalseAlarms(1e-3))
    detectors, hits, doubted = [*designed(problem, EVERY), *designed(rarer, TWO)], np.zeros(len(EVERY) + len(TWO), int), 0
    for _ in range(bursts):
        told = [t[-1] for t in shown(problem, detectors, machine.run(rng, alpha_of(burst, machine.dt, quiet(problem))), burst)]
        hits += [exceeded(e) for e in told]
        doubted += not told[0].trustworthy
    for kind, rate, count in zip((*EVERY, *TWO), [1e-2] * len(EVERY) + [1e-3] * len(TWO), hits, strict=True):
        yield "alarms, stated noise", kind, int(count), bursts, rate
    yield "not trusted, stated noise", "gate", doubted, bursts, 2e-3  # the quiet data and the burst, each at 1e-3


def calibrated_noise(machine: TrueMachine, rng: np.random.Generator, size: float) -> Iterator[Row]:
    """Noise from quiet data: trusted and alarms; refused when the noise is a tenth larger, everywhere or in bursts only."""
    plant, burst, spans, bursts = StateSpace(machine.A, machine.B, machine.C, machine.D, machine.dt), broad(machine), round(12 * size), 4
    counts = np.zeros(5, int)
    for _ in range(spans):
        learnt = machine.run(rng, np.zeros((CALIBRATED, burst.inputs)))
        problem = with_noise(problem_of(machine, FalseAlarms(1e-2)), calibrate_noise(plant, learnt["u"], learnt["y"]))
        detectors, before = designed(problem, TWO), quiet(problem)
        alpha = alpha_of(burst, machine.dt, before)
        for _ in range(bursts):
            first, second = (t[-1] for t in shown(problem, detectors, machine.run(rng, alpha), burst))
            counts[:3] += [first.trustworthy, exceeded(first), exceeded(second)]
            for k, where in enumerate((1.1, np.r_[np.ones(before), np.full(burst.samples, 1.1)])):
                counts[3 + k] += not shown(problem, detectors[:1], machine.run(rng, alpha, noisier=where), burst)[0][-1].trustworthy
    n = spans * bursts
    yield "trusted, calibrated noise", "gate", int(counts[0]), n, 0.95
    yield "alarms, calibrated noise", TWO[0], int(counts[1]), n, 1e-2
    yield "alarms, calibrated noise", TWO[1], int(counts[2]), n, 1e-2
    yield "refused, noise 10 % larger", "gate", int(counts[3]), n, 0.95
    yield "refused, noise 10 % larger in the burst", "gate", int(counts[4]), n, 0.95


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
    bursts, samples = round(60 * size), PASSIVE_EVERY * round(10 * size)

    def wandering(n: int) -> np.ndarray:
        slow = lfilter([0.02], [1, -0.98], rng.standard_normal((n, len(y_sd))), axis=0)
        return np.asarray(5 * y_sd * slow / slow.std())

    detectors, hits, alpha = designed(problem, TWO), np.zeros(2, int), alpha_of(burst, machine.dt, quiet(problem))
    for _ in range(bursts):
        hits += [exceeded(t[-1]) for t in shown(problem, detectors, machine.run(rng, alpha, ref=wandering(len(alpha))), burst)]
    for kind, count in zip(TWO, hits, strict=True):
        yield "alarms, moving references", kind, int(count), bursts, 1e-2
    hourly = replace(problem, false_alarms=FalseAlarms(per_hour=3600 / (PASSIVE_EVERY * machine.dt)))
    for words, ref in (("at rest", None), ("moving references", wandering(samples))):
        try:
            (passive,) = designed(hourly, ["passive_cusum"], {"silence_seconds": 0.0})
        except AfdsvcError:
            return
        (told,) = shown(hourly, [passive], machine.run(rng, np.zeros((samples, burst.inputs)), ref=ref), None)
        yield f"alarms between bursts, {words}", "passive_cusum", sum(e.detected for e in told), samples // PASSIVE_EVERY, 1.0
        yield f"doubts between bursts, {words}", "passive_cusum", sum(not e.trustworthy for e in told), samples // PASSIVE_EVERY, 1.0


def uncertain(machine: TrueMachine, rng: np.random.Generator, size: float, sd: float = 0.005) -> Iterator[Row]:
    """Entries of A and B off by half a per cent, as stated; every draw is another machine: alarms at 5e-2."""
    entries = {"A": sd * np.abs(machine.A), "B": sd * np.abs(machine.B)}
    plain = problem_of(machine, FalseAlarms(5e-2))
    pulled = uncertain_entries(plain.plant, entries, machine.dt)
    problem = replace(plain, uncertain=pulled, uncertainty=dict.fromkeys(pulled.fault_names, 1.0))
    burst, detectors, hits, n = broad(machine), designed(problem, TWO), np.zeros(2, int), 0
    for _ in range(round(40 * size)):
        A, B = (M * (1 + sd * rng.standard_normal(M.shape)) for M in (machine.A, machine.B))
        run = Mistaken(machine, A, B).run(rng, alpha_of(burst, machine.dt, quiet(problem)))
        if np.isfinite(run["y"]).all() and np.abs(run["y"]).max() < 1e3 * machine.spread()[0].max():
            n += 1
            hits += [exceeded(t[-1]) for t in shown(problem, detectors, run, burst)]
    for kind, count in zip(TWO, hits, strict=True):
        yield "alarms, parameters off by their stated 0.5 %", kind, int(count), n, 5e-2


class Mistaken:
    """A machine in the loop of the controller that was made for another."""

    def __init__(self, nominal: TrueMachine, A: np.ndarray, B: np.ndarray) -> None:
        self.nominal, self.A, self.B = nominal, A, B

    def run(self, rng: np.random.Generator, alpha: np.ndarray) -> dict[str, np.ndarray]:
        """Return u, y, alpha, beta of a run from rest."""
        g, n = self.nominal, len(alpha)
        w, v = (rng.standard_normal((n, len(cov))) @ np.linalg.cholesky(cov + 1e-14 * np.trace(cov) * np.eye(len(cov)) + 1e-300 * np.eye(len(cov))).T for cov in (g.Q, g.R))
        x, h = np.zeros(len(g.A)), np.zeros(len(g.A))
        u, y, beta = np.zeros((n, g.B.shape[1])), np.zeros((n, len(g.C))), np.zeros((n, len(g.C)))
        for k in range(n):
            u[k] = g.F @ h + alpha[k]
            y[k] = g.C @ x + g.D @ u[k] + v[k]
            beta[k] = y[k] - g.C @ h - g.D @ u[k]
            x, h = self.A @ x + self.B @ u[k] + w[k], g.A @ h + g.B @ u[k] - g.L @ beta[k]
        return {"u": u, "y": y, "alpha": alpha, "beta": beta}


def together(machine: TrueMachine, rng: np.random.Generator, size: float, loss: float = -0.2) -> Iterator[Row]:
    """One fault and every pair of faults of -20 %, with the burst designed for it: named, or reported among faults with the same effect."""
    problem = problem_of(machine, FalseAlarms(1e-3))
    assert problem.limits is not None
    try:
        burst = default_burst(problem, problem.limits, SAMPLES * machine.dt, aim=Aim(severity=loss))
    except AfdsvcError:
        return
    detectors, names = designed(problem, TWO), [n for n, (low, _) in reachable(problem).items() if low < loss]
    for words, truths in (("one fault", [(n,) for n in names]), ("two faults", list(combinations(names, 2)))):
        counts, n = np.zeros((len(TWO), 2), int), 0
        for truth in truths:
            severities = dict.fromkeys(truth, loss)
            if not problem_survives(problem, severities):
                continue
            for _ in range(round(6 * size)):
                n += 1
                run = machine.run(rng, alpha_of(burst, machine.dt, quiet(problem)), loss_of(problem, severities))
                for k, told in enumerate(shown(problem, detectors, run, burst)):
                    e, name = told[-1], JOINED.join(truth)
                    possible = (name, *truth) if problem.plant.inputs == problem.plant.outputs == 1 else (name,)  # one loop gain: no burst tells them apart
                    shared = e.fault is None and any(e.weights.get(n, 0.0) > 0.01 for n in possible)
                    counts[k] += [e.fault == name, e.fault == name or shared or f"alike.{name}" in e.parts]
        for kind, (named, listed) in zip(TWO, counts.tolist(), strict=True):
            yield f"{words} of -20 % named", kind, named, n, np.nan
            yield f"{words} of -20 % named or reported among faults with the same effect", kind, listed, n, 0.95


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


STUDIES = (given_noise, calibrated_noise, references, uncertain, together)


AT_LEAST, AT_MOST = ("trusted", "refused", "one fault", "two faults"), ("not trusted", "doubts")  # how promises that are bounds begin


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
    asked = parser.parse_args()
    if asked.page:
        with asked.page.open() as stream:
            print(page(list(csv.DictReader(stream))))
        return
    for i in asked.only:
        for k, study in enumerate(STUDIES):
            if study.__name__ not in asked.studies:
                continue
            found = list(study(machines()[i], np.random.default_rng([asked.seed, i, k]), asked.size))
            fresh = not asked.out.exists()
            with asked.out.open("a", newline="") as stream:
                writer = csv.writer(stream)
                writer.writerows([("promise", "detector", "machine", "hits", "of", "promised")] if fresh else [])
                writer.writerows((row[0], row[1], machines()[i].name, *row[2:]) for row in found)


if __name__ == "__main__":
    main()
