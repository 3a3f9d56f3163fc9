"""Detection probability against severity and against alarm rate: every detector on the same bursts."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from bursts import Played, Player
from counting import Share, power, roc, share
from machines import Case
from rivals import rivals
from scores import (
    Clairvoyant,
    Scorer,
    check,
    energy_scorer,
    line_scorer,
    published_scorer,
    regression_scorer,
    stepped_scorer,
)

from afdsvc.lti.statespace import Array

BOUND, AVERAGE = "Neyman-Pearson, clairvoyant", "Neyman-Pearson, fault unknown"
PROMISED = (0.1, 0.01)
RATES = np.geomspace(2e-3, 0.5, 12)


@dataclass(frozen=True)
class Effort:
    """Numbers of bursts: healthy, faulty for each severity (shared among the faults), the alarm rate of the comparison, and
    the thinning of slow detectors."""

    healthy: int
    faulty: int
    rate: float
    cusum: int
    bank: int
    rivals: int
    iterated: int


FULL = Effort(3000, 480, 0.01, 2, 4, 6, 12)
QUICK = Effort(200, 40, 0.1, 1, 5, 10, 10)
ITERATED = ("lqg-0", "unstable")  # where the regression is exact, iterating gains nothing: one such case shows it


@dataclass
class Powers:
    """The study of one case: powers by detector and severity, with intervals; operating curves; held rates."""

    case: Case
    power: dict[str, list[Share]] = field(default_factory=dict)
    by_fault: dict[str, dict[str, list[Share]]] = field(default_factory=dict)
    roc: dict[str, list[Share]] = field(default_factory=dict)
    roc_severity: float = 0.0
    held: dict[str, dict[float, Share]] = field(default_factory=dict)
    short_cuts: dict[str, float] = field(default_factory=dict)
    bursts: int = 0
    cpu: dict[str, float] = field(default_factory=dict)


def scorers(player: Player, effort: Effort) -> list[Scorer]:
    """Return everybody who takes part."""
    out = [
        line_scorer("fault_curves", player), regression_scorer(player), line_scorer("matched_filter", player),
        stepped_scorer("cusum", player, effort.cusum),
        stepped_scorer("cusum", player, effort.cusum, "cusum, deflection 5", deflection=5.0),
        *(published_scorer(name, player) for name in ("published_a0", "published_a_phi")),
        energy_scorer("chi_square", player), energy_scorer("limit_check", player),
        stepped_scorer("model_bank", player, effort.bank), *rivals(player, effort.rivals),
    ]  # fmt: skip
    if player.case.key in ITERATED:
        out.append(stepped_scorer("iterated_regression", player, effort.iterated))
    return out


def study(case: Case, effort: Effort, say: Callable[[str], None] = print) -> Powers:
    """Return the powers of all detectors on one case."""
    player = Player(case)
    out, all_ = Powers(case), scorers(player, effort)
    clairvoyant, faults = Clairvoyant(player), case.problem.fault_names
    healthy = _healthy(player, all_, clairvoyant, effort, out)
    say(f"{case.title}: {effort.healthy} healthy bursts played")
    faulty: dict[tuple[str, float], dict[str, Array]] = {}
    each = effort.faulty // len(faults)
    for severity in case.severities:
        for fault in faults:
            found = _faulty(player, all_, clairvoyant, fault, severity, each, out)
            faulty[fault, severity] = found
    say(f"{case.title}: {each * len(faults) * len(case.severities)} faulty bursts played")
    out.bursts = effort.healthy + each * len(faults) * len(case.severities)
    _summarise(out, effort.rate, [s.name for s in all_], healthy, faulty)
    return out


def _collect(scorer: Scorer, played: Played, seen: int, out: Powers) -> Array:
    """Return scores of the bursts of this chunk that the detector is shown (every ``thin``-th)."""
    started = time.process_time()
    keep = [i for i in range(len(played)) if (seen + i) % scorer.thin == 0]
    few = played if scorer.thin == 1 else _picked(played, keep)
    scores = scorer.score(few) if len(few) else np.zeros(0)
    out.cpu[scorer.name] = out.cpu.get(scorer.name, 0.0) + time.process_time() - started
    return scores


def _picked(played: Played, keep: list[int]) -> Played:
    return Played(
        played.E[keep], played.b[keep], played.G[keep], played.B[keep], [played.shown[i] for i in keep], played.y[keep],
        played.u[keep], played.before,
    )


def _healthy(player: Player, all_: list[Scorer], bound: Clairvoyant, effort: Effort, out: Powers) -> dict[str, Array]:
    scores: dict[str, list[Array]] = {}
    alarms: dict[tuple[str, float], list[int]] = {}
    seen = 0
    for played in player.chunks({}, effort.healthy, 1):
        if not seen:
            out.short_cuts = check(player, played)
        for scorer in all_:
            got = _collect(scorer, played, seen, out)
            scores.setdefault(scorer.name, []).append(got)
            if scorer.own and (scorer.thin == 1 or seen < effort.healthy // 2):
                few = played if scorer.thin == 1 else _picked(played, [i for i in range(len(played)) if (seen + i) % scorer.thin == 0])
                for rate in PROMISED:
                    hit = alarms.setdefault((scorer.name, rate), [0, 0])
                    hit[0] += int(scorer.own(few, got, rate).sum())
                    hit[1] += len(got)
        for key, values in _bounds(player.case, bound, played):
            scores.setdefault(key, []).append(values)
        seen += len(played)
    for (name, rate), (hits, of) in alarms.items():
        out.held.setdefault(name, {})[rate] = share(hits, of)
    return {name: np.concatenate(parts) for name, parts in scores.items()}


def _bounds(case: Case, bound: Clairvoyant, played: Played) -> list[tuple[str, Array]]:
    """Return the log likelihood ratios of every fault and severity, and their averages over the faults."""
    found = []
    for severity in case.severities:
        found += [(f"{BOUND} {fault} {severity}", bound(played, fault, severity)) for fault in case.problem.fault_names]
        found.append((f"{AVERAGE} {severity}", bound.average(played, severity)))
    return found


def _faulty(
    player: Player, all_: list[Scorer], bound: Clairvoyant, fault: str, severity: float, count: int, out: Powers
) -> dict[str, Array]:
    scores: dict[str, list[Array]] = {}
    index, seen = player.problem.fault_names.index(fault), 0
    seed = 1000 * (index + 1) + round(-1000 * severity)
    for played in player.chunks({fault: severity}, count, seed):
        for scorer in all_:
            scores.setdefault(scorer.name, []).append(_collect(scorer, played, seen, out))
        scores.setdefault(BOUND, []).append(bound(played, fault, severity))
        scores.setdefault(AVERAGE, []).append(bound.average(played, severity))
        seen += len(played)
    return {name: np.concatenate(parts) for name, parts in scores.items()}


def _summarise(
    out: Powers, rate: float, names: list[str], healthy: dict[str, Array], faulty: dict[tuple[str, float], dict[str, Array]]
) -> None:
    faults, severities = out.case.problem.fault_names, out.case.severities

    def together(name: str, severity: float) -> Array:
        return np.concatenate([faulty[fault, severity][name] for fault in faults])

    for name in names:
        out.power[name] = [power(healthy[name], together(name, s), rate) for s in severities]
        out.by_fault[name] = {f: [power(healthy[name], faulty[f, s][name], rate) for s in severities] for f in faults}
    out.power[AVERAGE] = [power(healthy[f"{AVERAGE} {s}"], together(AVERAGE, s), rate) for s in severities]
    out.by_fault[BOUND] = {
        f: [power(healthy[f"{BOUND} {f} {s}"], faulty[f, s][BOUND], rate) for s in severities] for f in faults
    }
    out.power[BOUND] = [_mean([out.by_fault[BOUND][f][k] for f in faults]) for k in range(len(severities))]
    values = np.array([s.value for s in out.power[BOUND]])
    k = int(np.argmin(np.abs(values - 0.85)))
    out.roc_severity = severities[k]
    for name in names:
        out.roc[name] = roc(healthy[name], together(name, severities[k]), RATES)
    curves = [roc(healthy[f"{BOUND} {f} {severities[k]}"], faulty[f, severities[k]][BOUND], RATES) for f in faults]
    out.roc[BOUND] = [_mean(list(column)) for column in zip(*curves, strict=True)]
    out.roc[AVERAGE] = roc(healthy[f"{AVERAGE} {severities[k]}"], together(AVERAGE, severities[k]), RATES)


def _mean(shares: list[Share]) -> Share:
    """Return the mean of independent shares; half widths add in squares."""
    value = float(np.mean([s.value for s in shares]))
    down = float(np.sqrt(np.sum([(s.value - s.low) ** 2 for s in shares])) / len(shares))
    up = float(np.sqrt(np.sum([(s.high - s.value) ** 2 for s in shares])) / len(shares))
    return Share(value, value - down, min(value + up, 1.0))
