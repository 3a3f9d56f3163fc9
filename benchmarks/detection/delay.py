"""How soon: delays of sequential tests against the minimax bound, and of everybody at the same run length.

The delay is Lorden's: the change comes when the test stands at zero, the worst moment. To first order no test whose average
run length is gamma reacts sooner than ``ln(gamma) / I``, I being the information a sample of the *faulty* loop brings (G. Lorden,
*Ann. Math. Statist.* 42, 1971); the CUSUM that knows fault and severity attains the bound, its delay is ``b / I`` less what the
reflection at zero saves. Without excitation I is not what the healthy loop promises: a weakened loop is a quieter one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from bursts import Player
from machines import Case
from scores import DESIGNS

from afdsvc.api.detection import DetectionProblem, ResidualBlock
from afdsvc.detect.features.regressors import regressors
from afdsvc.detect.thresholds import average_run_length
from afdsvc.detect.thresholds.regressor_information import noise_driven
from afdsvc.excite.simulated_burst import faulty_loop
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import Array
from afdsvc.testing.machines import with_rate

PER_HOUR = {"1 per hour": 1.0, "1 per day": 1 / 24, "1 per 30 days": 1 / 720}


@dataclass(frozen=True)
class Mean:
    """A mean with its 95 per cent interval."""

    value: float
    half: float

    def __str__(self) -> str:
        return f"{self.value:.3g} ± {self.half:.2g}"


def mean(values: Array) -> Mean:
    """Return the mean and the half width of its normal interval."""
    return Mean(float(np.mean(values)), float(1.96 * np.std(values, ddof=1) / np.sqrt(len(values))))


@dataclass
class Delays:
    """Delays in seconds. ``passive[rate][severity] = (measured, minimax, Lorden's first order)``, ``active`` likewise by
    severity with the share of bursts that alarmed, ``same`` by detector at a common run length of ``arl_seconds``."""

    case: Case
    fault: str
    passive: dict[str, dict[float, tuple[Mean, float, float]]] = field(default_factory=dict)
    active: dict[float, tuple[Mean, float, float]] = field(default_factory=dict)
    same: dict[str, tuple[Mean, Mean]] = field(default_factory=dict)
    same_bound: float = 0.0
    arl_seconds: float = 0.0
    same_severity: float = 0.0


class Quiet:
    """The machine without excitation: a healthy run that turns faulty, the loop's state carried over."""

    def __init__(self, problem: DetectionProblem, fault: str) -> None:
        self.problem, self.fault = problem, fault
        self.root = np.linalg.cholesky(problem.covariance if problem.output_cov is None else problem.output_cov)

    def run(self, rng: np.random.Generator, healthy: int, faulty: int, severity: float) -> tuple[Array, Array, Array]:
        """Return ``r, y, u`` of a run whose fault begins after ``healthy`` samples."""
        p, m = self.problem.plant.outputs, self.problem.plant.inputs
        noise = rng.normal(size=(healthy + faulty, p)) @ self.root.T
        inputs = np.hstack([noise, np.zeros((len(noise), m))])
        first, state = simulate(faulty_loop(self.problem, {}), inputs[:healthy])
        second, _ = simulate(faulty_loop(self.problem, {self.fault: severity}), inputs[healthy:], state)
        out = np.vstack([first, second])
        u, y = out[:, :m], out[:, m : m + p] + noise
        r, _ = simulate(self.problem.innovations, np.hstack([y, u]))
        return r, y, u

    def block(self, r: Array, y: Array, u: Array, k0: int) -> ResidualBlock:
        """Return a quiet block."""
        return ResidualBlock(k0, self.problem.plant.dt, r, np.zeros((len(r), 0)), u, y, np.zeros_like(u))


def passive_delays(case: Case, fault: str, severities: tuple[float, ...], runs: int, out: Delays) -> None:
    """Fill in the delays of the passive CUSUM, tuned to each severity, for three promised rates."""
    for word, per_hour in PER_HOUR.items():
        problem = with_rate(case.problem, per_hour=per_hour)
        quiet, i = Quiet(problem, fault), problem.fault_names.index(fault)
        for severity in severities:
            detector = DESIGNS["passive_cusum"].design(problem, {"severity": severity})
            run_length = 3600 / per_hour / problem.plant.dt
            exact, first_order = known(quiet, i, severity, run_length)
            found = _passive_runs(quiet, detector, severity, runs, int(6 * first_order) + 500)
            dt = problem.plant.dt
            out.passive.setdefault(word, {})[severity] = (mean(found * dt), exact * dt, first_order * dt)


def known(quiet: Quiet, i: int, severity: float, run_length: float) -> tuple[float, float]:
    """Return delays in samples: of a CUSUM that knows fault ``i`` and severity, and Lorden's bound to first order."""
    healthy = abs(severity) * float(np.sqrt(noise_driven(quiet.problem).passive[i]))
    series = _series(quiet, np.random.default_rng(6), 3000, 60_000, severity)[5000:, 1 + i]
    faulty = abs(severity) * float(np.sqrt(np.mean(np.sum(series**2, axis=1))))
    delay = average_run_length.run_length(faulty, average_run_length.boundary(healthy, run_length), changed=True)
    return delay, float(np.log(run_length)) / (faulty**2 / 2)


def _passive_runs(quiet: Quiet, detector: object, severity: float, runs: int, longest: int) -> Array:
    """Return delays in samples: the gate is filled with healthy data, the CUSUMs put to zero, the fault switched on."""
    gate = detector.gate  # type: ignore[attr-defined]
    healthy = gate.settle + gate.needed + 400
    delays = []
    for k in range(runs):
        r, y, u = quiet.run(np.random.default_rng([7, k]), healthy, longest, severity)
        state, _ = detector.step(detector.start(), quiet.block(r[:healthy], y[:healthy], u[:healthy], 0))  # type: ignore[attr-defined]
        state = replace(state, cusum=detector.test.start(), silent=0)  # type: ignore[attr-defined]
        _, evidence = detector.step(state, quiet.block(r[healthy:], y[healthy:], u[healthy:], healthy))  # type: ignore[attr-defined]
        crossed = [e.k - healthy + 1 for e in evidence if e.statistic > e.threshold]
        delays.append(crossed[0] if crossed else longest)
    return np.array(delays, dtype=float)


def active_delays(case: Case, fault: str, severities: tuple[float, ...], runs: int, out: Delays) -> None:
    """Fill in when the active CUSUM speaks inside a burst: mean over the bursts that alarm, share of those, and the minimax
    delay of a CUSUM that knows fault and severity and alarms as rarely per burst."""
    player = Player(case)
    found = DESIGNS["cusum"].design(case.problem, {}).statistic  # type: ignore[attr-defined]
    dt, i = case.problem.plant.dt, case.problem.fault_names.index(fault)
    for severity in severities:
        samples = []
        for played in player.chunks({fault: severity}, runs, 77):
            for shown in played.shown:
                _, early = found.step(found.start(player.burst, dt), shown)
                samples.append(early.parts["sample"] + 1 if early is not None else np.nan)
        at = np.array(samples)
        mu = abs(severity) * np.sqrt(_active_information(player, fault, severity)[i] / case.burst.samples)
        best = average_run_length.run_length(mu, average_run_length.burst_boundary(mu, case.burst.samples, case.problem.false_alarms.per_burst), changed=True)
        share_ = float(np.mean(np.isfinite(at)))
        if share_ > 0.05:
            out.active[severity] = (mean(at[np.isfinite(at)] * dt), share_, best * dt)


def _active_information(player: Player, fault: str, severity: float) -> Array:
    from benchmarks.support.templates import templates

    K = len(player.problem.fault_names)
    found = templates(player.problem, player.burst.play(player.problem.plant.dt), np.full(K, severity))
    return np.asarray(np.diag(found.gram) / severity**2)


def same_run_length(case: Case, fault: str, severity: float, effort: tuple[int, int, int], out: Delays) -> None:
    """Fill in delays of everybody without excitation at one average run length, calibrated on healthy runs.

    ``effort`` holds healthy segments, samples in each (the run length wanted is half of it), and faulty runs.
    """
    segments, length, runs = effort
    wanted, quiet = length / 2, Quiet(case.problem, fault)
    warm, longest = 1500, 4000
    paths = _paths(case.problem, fault, severity)
    healthy = [_series(quiet, np.random.default_rng([8, k]), warm, length, 0.0) for k in range(segments)]
    faulty = [_series(quiet, np.random.default_rng([9, k]), warm, longest, severity) for k in range(runs)]
    dt = case.problem.plant.dt
    for name, path in paths.items():
        h, found = _calibrated([path(s, warm) for s in healthy], wanted)
        delays = np.array([_first(path(s, warm), h) or longest for s in faulty], dtype=float)
        out.same[name] = (mean(delays * dt), Mean(found.value * dt, found.half * dt))
    out.same_bound = known(quiet, case.problem.fault_names.index(fault), severity, wanted)[0] * dt
    out.arl_seconds, out.same_severity = wanted * dt, severity


def _series(quiet: Quiet, rng: np.random.Generator, warm: int, length: int, severity: float) -> Array:
    """Return normalised residual and regressors, shape ``(warm + length, 1 + K, p)``."""
    r, y, u = quiet.run(rng, warm, length, severity)
    filters = regressors(quiet.problem)
    return filters.step(filters.start(), r, y, u)[1]


def _calibrated(paths: list[Array], wanted: float) -> tuple[float, Mean]:
    """Return the threshold whose run length is nearest to the wanted one, and that run length (exponential, censored)."""
    tops = np.unique(np.concatenate([np.maximum.accumulate(p)[:: max(len(p) // 400, 1)] for p in paths]))
    low, high = 0, len(tops) - 1
    while high - low > 1:
        middle = (low + high) // 2
        if _run_length(paths, float(tops[middle])).value < wanted:
            low = middle
        else:
            high = middle
    return float(tops[high]), _run_length(paths, float(tops[high]))


def _run_length(paths: list[Array], h: float) -> Mean:
    crossings = [_first(p, h) for p in paths]
    alarms = sum(c is not None for c in crossings)
    total = sum(c if c is not None else len(p) for c, p in zip(crossings, paths, strict=True))
    value = total / max(alarms, 0.5)
    return Mean(value, 1.96 * value / max(alarms, 1) ** 0.5)


def _first(path: Array, h: float) -> int | None:
    over = np.flatnonzero(path > h)
    return int(over[0]) + 1 if len(over) else None


def _paths(problem: DetectionProblem, fault: str, severity: float) -> dict[str, Callable[[Array, int], Array]]:
    """Return statistics as functions of a series ``(warm + n, 1 + K, p)``, one value for each of the last n samples.

    Sequential sums begin at the change, the worst moment; windows reach back into the healthy data before it.
    """
    i, K = problem.fault_names.index(fault), len(problem.fault_names)
    paths: dict[str, Callable[[Array, int], Array]] = {
        "CUSUM, fault and severity known": lambda s, w: _cusum(s[w:], [i], severity),
        "passive_cusum, four faults": lambda s, w: _cusum(s[w:], list(range(K)), severity),
        "passive_cusum, tuned to three times the severity": lambda s, w: _cusum(s[w:], list(range(K)), 3 * severity),
        "regression over a sliding window of 400": lambda s, w: _regression(s, w, 400),
        "chi-square over a sliding window of 400": lambda s, w: _energy(s, w, 400),
        "chi-square over a sliding window of 100": lambda s, w: _energy(s, w, 100),
        "largest sample": lambda s, w: np.abs(s[w:, 0]).max(axis=1),
    }
    from rivals import page_hinkley_path, river_installed

    if river_installed():
        paths["river PageHinkley, energy"] = lambda s, w: page_hinkley_path(np.sum(s[w - 500 :, 0] ** 2, axis=1))[500:]
    return paths


def _cusum(series: Array, faults: list[int], severity: float) -> Array:
    psi, e = series[:, [1 + f for f in faults]], series[:, 0]
    steps = severity * np.einsum("tkp,tp->tk", psi, e) - 0.5 * severity**2 * np.einsum("tkp,tkp->tk", psi, psi)
    walk = np.vstack([np.zeros(len(faults)), np.cumsum(steps, axis=0)])
    return np.asarray((walk - np.minimum.accumulate(walk, axis=0))[1:].max(axis=1))


def _regression(series: Array, warm: int, window: int) -> Array:
    psi, e = series[:, 1:], series[:, 0]
    b = _moving(np.einsum("tkp,tp->tk", psi, e), window)
    G = _moving(np.einsum("tkp,tkp->tk", psi, psi), window)
    return np.asarray((-b / np.sqrt(np.maximum(G, 1e-12)))[warm - window :].max(axis=1)[window:])


def _energy(series: Array, warm: int, window: int) -> Array:
    return np.asarray(_moving(np.sum(series[:, 0] ** 2, axis=1), window)[warm:])


def _moving(values: Array, window: int) -> Array:
    """Return sums over the last ``window`` samples."""
    total = np.cumsum(values, axis=0)
    return np.concatenate([total[:window], total[window:] - total[:-window]])


def study(case: Case, fault: str, quick: bool) -> Delays:
    """Return all delays of one case."""
    out = Delays(case, fault)
    runs = 20 if quick else 200
    passive_delays(case, fault, (-0.3,) if quick else (-0.15, -0.3, -0.5), runs, out)
    active_delays(case, fault, (-0.5, -0.8), 20 if quick else 150, out)
    same_run_length(case, fault, -0.3, (20, 4000, 40) if quick else (150, 20000, 300), out)
    return out
