"""What every detector makes of a burst: one number, large when something is wrong.

The product's detectors are asked through their statistics. Where hundreds of bursts share what a detector would compute
anew for each (waves, thresholds), that is computed once; `check` compares such a short cut with the detector itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from bursts import Played, Player
from scipy.special import logsumexp

from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.features.demodulation import BasisSums
from afdsvc.detect.isolation import LineData, anything_log_evidence, curve_fit, weights
from afdsvc.detect.stability_range import reachable
from afdsvc.detect.statistics.active_cusum import ActiveSums
from afdsvc.detect.statistics.matched_filter import MatchedFilter
from afdsvc.detect.statistics.regression import Regression, averaged_out, regression
from afdsvc.detect.thresholds.power import tail_point
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import Array
from afdsvc.lti.whitening import innovations
from afdsvc.plugins.detectors import afdsvc_detectors
from afdsvc.testing.machines import with_rate

DESIGNS = {design.name: design for design in afdsvc_detectors()}


def statistic(name: str, problem: DetectionProblem, **settings: float) -> object:
    """Return the burst statistic of a detector plugin."""
    return DESIGNS[name].design(problem, settings).statistic  # type: ignore[attr-defined]


@dataclass(frozen=True)
class Scorer:
    """Scores of one detector for all bursts of a chunk, its own thresholds (one for each promised rate, None when it
    promises none), and the share of the bursts it is shown (slow ones see fewer)."""

    name: str
    score: Callable[[Played], Array]
    own: Callable[[Played, Array, float], Array] | None = None
    thin: int = 1


def line_scorer(name: str, player: Player) -> Scorer:
    """Return a detector on excited lines: waves and thresholds are those of its line test, found once."""
    found: MatchedFilter = statistic(name, player.problem)  # type: ignore[assignment]
    basis = found.basis(player.burst)
    n, q = player.last - player.first, basis.lines
    flat = BasisSums(n, player.phi.T @ player.phi, np.zeros((q, player.problem.plant.outputs)))
    _, curves, data = found._reduced(flat, player.burst)  # noqa: SLF001 - the detector's own preparation
    waves = found.line_test.waves(curves, data, reachable(player.problem))

    def score(played: Played) -> Array:
        z = np.linalg.solve(data.R.T, played.B).reshape(len(played), -1)
        return np.array([found.line_test.statistic(waves, row) for row in z])

    def own(played: Played, scores: Array, rate: float) -> Array:
        return scores > found.line_test.threshold(waves, data, None, rate)

    return Scorer(name, score, own)


def line_weights(name: str, player: Player) -> Callable[[Played], list[Mapping[str, float]]]:
    """Return the hypothesis weights of a line detector, without the threshold of every burst."""
    found: MatchedFilter = statistic(name, player.problem)  # type: ignore[assignment]
    basis = found.basis(player.burst)
    flat = BasisSums(player.last - player.first, player.phi.T @ player.phi, np.zeros((basis.lines, player.problem.plant.outputs)))
    _, curves, data = found._reduced(flat, player.burst)  # noqa: SLF001
    reach = reachable(player.problem)

    def each(B: Array) -> Mapping[str, float]:
        one = LineData(np.linalg.solve(data.R.T, B), data.R, data.doubt)
        fits = [curve_fit(curves, fault, one, reach[fault]) for fault in curves.names]
        return weights(fits, anything_log_evidence(one.z.ravel()))

    return lambda played: [each(B) for B in played.B]


def regression_scorer(player: Player) -> Scorer:
    """Return the exact regression: largest signed root, corrected for the random normaliser; thresholds depend on every
    burst's information and are only asked for where the smallest possible one is exceeded."""
    found: Regression = statistic("regression", player.problem)  # type: ignore[assignment]
    n, burst = player.burst.samples, player.burst
    mean, sd = found.noise.signed_root(n, burst)

    def score(played: Played) -> Array:
        information = np.diagonal(played.G, axis1=1, axis2=2)
        with np.errstate(invalid="ignore", divide="ignore"):
            t = (-played.b / np.sqrt(information) - mean) / sd
        return np.asarray(np.nanmax(t, axis=1))

    def own(played: Played, scores: Array, rate: float) -> Array:
        at = replace(found, false_alarm=rate)
        alarms = np.zeros(len(scores), dtype=bool)
        for i in np.flatnonzero(scores > tail_point(rate)):
            got, threshold = at.judged(n, *averaged_out(played.b[i], played.G[i], at.sd), burst)
            alarms[i] = got > threshold
        return alarms

    return Scorer("regression", score, own)


def stepped_scorer(name: str, player: Player, thin: int = 1, label: str = "", **settings: float) -> Scorer:
    """Return any detector that is simply shown each burst; several findings (one for each output) count by the largest
    share of their thresholds."""
    statistics = {player.problem.false_alarms.per_burst: statistic(name, player.problem, **settings)}

    def findings(played: Played, rate: float) -> list[list[tuple[float, float]]]:
        if rate not in statistics:
            statistics[rate] = statistic(name, with_rate(player.problem, rate), **settings)
        found = statistics[rate]
        out = []
        for shown in played.shown:
            sums, _ = found.step(_unbounded(found.start(player.burst, shown.dt)), shown)  # type: ignore[attr-defined]
            decided = found.decide(sums, player.burst, shown.dt)  # type: ignore[attr-defined]
            out.append([(f.statistic, f.threshold) for f in decided])
        return out

    def score(played: Played) -> Array:
        rate = player.problem.false_alarms.per_burst
        pairs = findings(played, rate)
        if len(pairs[0]) == 1:
            return np.array([p[0][0] for p in pairs])
        return np.array([max(s / h for s, h in p) for p in pairs]) * tail_point(rate)

    def own(played: Played, scores: Array, rate: float) -> Array:
        if name == "cusum":
            at = statistic(name, with_rate(player.problem, rate), **settings)
            return np.asarray(scores > at.start(player.burst, player.problem.plant.dt).boundary)  # type: ignore[attr-defined]
        return np.array([any(s > h for s, h in p) for p in findings(played, rate)])

    return Scorer(label or name, score, own, thin)


def _unbounded(sums: object) -> object:
    """Return sums of a sequential test that goes on to the end of the burst, so that its peak can be read."""
    if isinstance(sums, ActiveSums):
        return replace(sums, plan=replace(sums.plan, cusum=replace(sums.plan.cusum, boundary=math.inf)))
    return sums


def energy_scorer(name: str, player: Player) -> Scorer:
    """Return the detectors that know no faults, whose sums are one line each."""
    found = statistic(name, player.problem)

    def score(played: Played) -> Array:
        return np.asarray(np.abs(played.E).max(axis=(1, 2)) if name == "limit_check" else np.sum(played.E**2, axis=(1, 2)))

    def own(played: Played, scores: Array, rate: float) -> Array:
        at = replace(found, false_alarm=rate)  # type: ignore[type-var]
        empty = replace(at.start(player.burst, 1.0), n=player.burst.samples)
        return np.asarray(scores > at.decide(empty, player.burst, 1.0)[0].threshold)

    return Scorer(name, score, own)


def published_scorer(name: str, player: Player) -> Scorer:
    """Return the published filter; its sums are those of the excited lines of the residual, output by output."""
    back = np.linalg.cholesky(player.problem.covariance)
    n = player.last - player.first

    def ratios(played: Played, rate: float) -> Array:
        found = statistic(name, with_rate(player.problem, rate))
        waves = found._amplitudes(player.burst)  # type: ignore[attr-defined]  # noqa: SLF001
        G, p = player.phi.T @ player.phi, player.problem.plant.outputs
        every = [[found._output(BasisSums(n, G, B @ back.T), waves, i) for i in range(p)] for B in played.B]  # type: ignore[attr-defined]  # noqa: SLF001
        return np.array([max(f.statistic / f.threshold for f in row) for row in every])

    rate = player.problem.false_alarms.per_burst
    return Scorer(
        name, lambda played: ratios(played, rate) * tail_point(rate),
        lambda played, scores, at: scores > tail_point(at),
    )  # fmt: skip


class Clairvoyant:
    """The log likelihood ratio of one fault at one severity against the healthy machine: nothing is more powerful
    (Neyman and Pearson). With ``exact`` it follows from the regression's sums; otherwise two predictors are run."""

    def __init__(self, player: Player) -> None:
        self.player = player
        self._predictors: dict[tuple[str, float], tuple[object, Array]] = {}

    def __call__(self, played: Played, fault: str, severity: float) -> Array:
        if self.player.case.exact:
            i = self.player.problem.fault_names.index(fault)
            return np.asarray(severity * played.b[:, i] - 0.5 * severity**2 * played.G[:, i, i])
        return self._energy(played, "", 0.0) - self._energy(played, fault, severity)

    def average(self, played: Played, severity: float) -> Array:
        """Return the ratio averaged over the faults, equally likely: the best test that does not know which."""
        names = self.player.problem.fault_names
        return np.asarray(logsumexp([self(played, fault, severity) for fault in names], axis=0))

    def _energy(self, played: Played, fault: str, severity: float) -> Array:
        """Return minus the log likelihood of every burst under one machine."""
        key = (fault, severity)
        if key not in self._predictors:
            plant = self.player.problem.augmented.close({fault: severity} if fault else {})
            found = innovations(plant, self.player.problem.output_cov)
            self._predictors[key] = found.filter, np.linalg.cholesky(found.covariance)
        filter_, factor = self._predictors[key]
        r = np.array([simulate(filter_, np.hstack([y, u]))[0][played.before :] for y, u in zip(played.y, played.u, strict=True)])
        e = np.linalg.solve(factor, np.swapaxes(r, 1, 2))
        return np.asarray(0.5 * np.sum(e**2, axis=(1, 2)) + r.shape[1] * np.log(np.diag(factor)).sum())


def check(player: Player, played: Played) -> dict[str, float]:
    """Return the largest difference between the short cuts and the detectors themselves over the first bursts."""
    off = {}
    for scorer in (line_scorer("matched_filter", player), line_scorer("fault_curves", player), regression_scorer(player)):
        found, fast = statistic(scorer.name, player.problem), scorer.score(played)
        if scorer.name == "regression":  # bursts are shown with every regressor in its own column
            found = regression(player.problem, player.filters)
        for i, shown in enumerate(played.shown[:2]):
            sums, _ = found.step(found.start(player.burst, shown.dt), shown)  # type: ignore[attr-defined]
            slow = found.decide(sums, player.burst, shown.dt)[0].statistic  # type: ignore[attr-defined]
            off[scorer.name] = max(off.get(scorer.name, 0.0), abs(slow - fast[i]) / max(abs(slow), 1.0))
    return off
