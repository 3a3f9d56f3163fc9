"""Which fault: how often the right one comes out on top, and how often one is named with confidence, against amplitude."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from bursts import Played, Player
from counting import Share, share
from machines import LOOSE, Case
from scores import Clairvoyant, line_weights, statistic

from afdsvc.api.bursts import Burst
from afdsvc.detect.features.demodulation import BasisSums, project
from afdsvc.detect.isolation import NONE, anything_log_evidence, linear_fit, weights
from afdsvc.detect.statistics.regression import Regression, averaged_out, regression
from afdsvc.excite.diagnosis_burst import second_burst
from afdsvc.lti.statespace import Array

SURE = 0.99
KNOWN = "severity known"


@dataclass
class Isolation:
    """Shares by detector over the amplitude ``factors``: right fault on top, right fault named (weight above `SURE`), wrong
    fault named. ``two_step`` by step: named right, named wrong, left open."""

    case: Case
    factors: tuple[float, ...]
    output: tuple[float, ...]
    top: dict[str, list[Share]] = field(default_factory=dict)
    named: dict[str, list[Share]] = field(default_factory=dict)
    wrong: dict[str, list[Share]] = field(default_factory=dict)
    two_step: dict[str, tuple[Share, Share, Share]] = field(default_factory=dict)
    second_output: float = 0.0
    short_cuts: float = 0.0


Weighing = Callable[[Played], list[Mapping[str, float]]]


def study(case: Case, each: int, second: int = 0) -> Isolation:
    """Return the study of one case with ``each`` bursts for every fault and amplitude; ``second`` bursts for the two steps."""
    factors = (1.0, 2.5, 6.0, 15.0)
    base = float(case.burst.notes["output_amplitude"])
    out = Isolation(case, factors, tuple(base * f for f in factors))
    for factor in factors:
        _at(Player(case, factor), each, out)
    if second:
        _two_steps(case, second, out)
    return out


def weighers(player: Player) -> dict[str, Weighing]:
    """Return the detectors that weigh the faults."""
    def stepped(name: str) -> Weighing:
        found = statistic(name, player.problem)

        def each(played: Played) -> list[Mapping[str, float]]:
            rows = []
            for shown in played.shown:
                sums, early = found.step(found.start(player.burst, shown.dt), shown)  # type: ignore[attr-defined]
                decided = [early] if early is not None else found.decide(sums, player.burst, shown.dt)  # type: ignore[attr-defined]
                best = max(decided, key=lambda f: f.statistic / f.threshold)
                rows.append(best.weights)
            return rows

        return each

    return {
        "fault_curves": line_weights("fault_curves", player), "regression": _regression_weights(player), "cusum": stepped("cusum"),
        "published_a0": stepped("published_a0"), "model_bank": stepped("model_bank"),
    }  # fmt: skip


def _regression_weights(player: Player) -> Weighing:
    """Return what the regression's own ``decide`` weighs, without the threshold of every burst."""
    found: Regression = statistic("regression", player.problem)  # type: ignore[assignment]
    t = np.arange(player.burst.samples) * player.problem.plant.dt
    phi = np.concatenate([[np.sin(w * t), np.cos(w * t)] for w in player.basis.omega]).T

    def one(e: Array, b: Array, G: Array) -> Mapping[str, float]:
        b, G = averaged_out(b, G, found.sd)
        fits = tuple(linear_fit(n, float(v), float(g), found.bounds) for n, v, g in zip(found.names, b, np.diag(G), strict=True))
        lines = project(BasisSums(len(e), phi.T @ phi, phi.T @ e), player.basis)
        return weights(fits, anything_log_evidence(lines.z))

    return lambda played: [one(e, b, G) for e, b, G in zip(played.E, played.b, played.G, strict=True)]


def check(player: Player, played: Played) -> float:
    """Return the largest difference between these weights and those the detectors report themselves, over two bursts."""
    off = 0.0
    for name, weigh in (("regression", _regression_weights(player)), ("fault_curves", line_weights("fault_curves", player))):
        found = regression(player.problem, player.filters) if name == "regression" else statistic(name, player.problem)
        for shown, fast in zip(played.shown[:2], weigh(played)[:2], strict=True):
            sums, _ = found.step(found.start(player.burst, shown.dt), shown)  # type: ignore[attr-defined]
            slow = found.decide(sums, player.burst, shown.dt)[0].weights  # type: ignore[attr-defined]
            off = max(off, *(abs(slow[n] - fast[n]) for n in slow))
    return off


def _at(player: Player, each: int, out: Isolation) -> None:
    faults, severity, bound = player.problem.fault_names, player.case.isolation_severity, Clairvoyant(player)
    all_ = weighers(player)
    rows: dict[str, list[tuple[bool, bool, bool]]] = {name: [] for name in all_}
    right = 0
    for i, fault in enumerate(faults):
        for played in player.chunks({fault: severity}, each, 300 + i):
            if not i:
                out.short_cuts = max(out.short_cuts, check(player, played))
            for name, weigh in all_.items():
                rows[name] += [_judged(w, fault) for w in weigh(played)]
            ratios = np.array([bound(played, other, severity) for other in faults])
            right += int(np.sum(np.argmax(ratios, axis=0) == i))
    of = each * len(faults)
    for name, found in rows.items():
        counts = np.sum(found, axis=0)
        for target, count in zip((out.top, out.named, out.wrong), counts, strict=True):
            target.setdefault(name, []).append(share(int(count), of))
    out.top.setdefault(KNOWN, []).append(share(right, of))


def _judged(found: Mapping[str, float], fault: str) -> tuple[bool, bool, bool]:
    """Return whether the right fault is on top, named, and whether another one is named."""
    if not found:
        return False, False, False
    best = max(found, key=lambda name: found[name])
    sure = found[best] >= SURE and best != NONE
    return best == fault, sure and best == fault, sure and best != fault


def _two_steps(case: Case, bursts: int, out: Isolation) -> None:
    """Play the burst; where it leaves two faults open, play the one designed to separate them (by fault curves)."""
    player, severity = Player(case, 2.5), case.isolation_severity
    first, weigh = np.zeros(3, dtype=int), line_weights("fault_curves", player)
    both, seconds = np.zeros(3, dtype=int), _Seconds(case)
    for i, fault in enumerate(case.problem.fault_names):
        for played in player.chunks({fault: severity}, bursts, 500 + i):
            for k, found in enumerate(weigh(played)):
                _, right, wrong = _judged(found, fault)
                first += [right, wrong, not right and not wrong]
                if not right and not wrong:
                    _, right, wrong = _judged(seconds.weights(found, fault, severity, 900 + 50 * i + k), fault)
                both += [right, wrong, not right and not wrong]
    of = bursts * len(case.problem.fault_names)
    out.two_step = {
        "after the first burst": _shares(first, of), "after the second": _shares(both, of),
    }  # fmt: skip
    out.second_output = seconds.largest


def _shares(counts: Array, of: int) -> tuple[Share, Share, Share]:
    right, wrong, open_ = (share(int(c), of) for c in counts)
    return right, wrong, open_


class _Seconds:
    """Second bursts by pair of suspects, designed once each, and what they say."""

    def __init__(self, case: Case) -> None:
        self.case, self.largest = case, 0.0
        self._players: dict[tuple[str, ...], tuple[Player, Weighing]] = {}

    def weights(self, found: Mapping[str, float], fault: str, severity: float, seed: int) -> Mapping[str, float]:
        pair = tuple(sorted(sorted((n for n in found if n != NONE), key=lambda n: -found[n])[:2]))
        if pair not in self._players:
            burst = self._designed(found, severity)
            self.largest = max(self.largest, float(burst.notes["output_amplitude"]))
            player = Player(_with_burst(self.case, burst))
            self._players[pair] = player, line_weights("fault_curves", player)
        player, weigh = self._players[pair]
        played = next(player.chunks({fault: severity}, 1, seed))
        new = weigh(played)[0]
        return new

    def _designed(self, found: Mapping[str, float], severity: float) -> Burst:
        limits = self.case.problem.limits or LOOSE
        return second_burst(self.case.problem, limits, found, severity, self.case.burst.samples * self.case.problem.plant.dt)


def _with_burst(case: Case, burst: Burst) -> Case:
    from dataclasses import replace

    return replace(case, burst=burst)
