"""From rulings to names: look-alikes with weights, parameters with standard deviations, sentences; and who was rejected."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from afdsvc.api.physics import Hypothesis
from afdsvc.explain.estimates import deviations, estimates
from afdsvc.explain.explanation import Estimate, Named, Rejected
from afdsvc.explain.forward import Found, Step
from afdsvc.explain.judge import CHANGE, Rival
from afdsvc.explain.objective import Point

LEAST_WEIGHT = 1e-3
MOST_NAMES = 8


def names(found: Found, summaries: Mapping[str, str]) -> tuple[Named, ...]:
    """Return the names of every accepted effect with their look-alikes, the largest effect first, likeliest first."""
    listed: list[Named] = []
    final = {e.hypothesis.key: (e, sd) for e, sd in zip(found.end.point.effects, deviations(found.end.objective, found.end.point), strict=True)}
    B = found.end.nominal.plant.B
    for count, number in enumerate(sorted(found.order, key=lambda k: -found.steps[k].share), start=1):
        step = found.steps[number]
        for rival in _told(step):
            h = _law(rival)
            effect, sd = final.get(h.key, (rival.candidate.effect, None))
            if sd is None:
                sd = deviations(found.start.objective, rival.candidate.point)[rival.candidate.place]
            listed.append(_named(h, rival, step, count, estimates(effect, sd, B), summaries))
    return tuple(listed)


def _told(step: Step) -> list[Rival]:
    rivals = _each_once(step.ruling.rivals)
    return [r for r in rivals if r.weight >= LEAST_WEIGHT or r is rivals[0]][:MOST_NAMES]


def _each_once(rivals: Sequence[Rival]) -> list[Rival]:
    """Return the rivals with the shapes of one thing told as one, the first of them, with their weights added."""
    first: dict[tuple[str, ...], Rival] = {}
    for r in rivals:
        h = _law(r)
        what = (h.physics, h.site, h.notes.get("of", h.notes.get("variant", "")))
        first[what] = replace(first[what], weight=first[what].weight + r.weight) if what in first else r
    return list(first.values())


def _named(
    h: Hypothesis, rival: Rival, step: Step, count: int, parameters: Mapping[str, Estimate], summaries: Mapping[str, str]
) -> Named:
    what = h.notes.get("variant", "") if h.physics == CHANGE else ""
    told = "; ".join(_value(name, e) for name, e in parameters.items())
    law = what + " other than stated" if what else summaries.get(h.physics, h.physics.replace("_", " "))
    sentence = (
        f"{place(h)}: {law}{' (' + told + ')' if told else ''}; closes {100 * min(max(step.share, 0.0), 1.0):.0f} % of the gap, "
        f"weight {rival.weight:.2f} among {len(_told(step))} that fit alike"
    )
    return Named(h.physics, h.site, rival.weight, parameters, sentence, count, min(max(float(step.share), 0.0), 1.0), h.family, what)


def _value(name: str, e: Estimate) -> str:
    spread = "" if e.sd is None else f" +- {e.sd:.2g}"
    return f"{name} {e.value:.4g}{spread}{' ' + e.unit if e.unit else ''}"


def place(h: Hypothesis) -> str:
    """Return a site in words."""
    kind, _, name = h.site.partition(":")
    return {"input": f"input {name}", "state": f"force on {name}", "output": f"sensor {name}"}.get(kind, "machine")


def rejections(found: Found, error: Callable[[Point], float], most: int = 6) -> tuple[Rejected, ...]:
    """Return the hypotheses that were refined and lost, round by round; ``error`` gives a point's held-out nrmse."""
    listed: dict[tuple[str, str], Rejected] = {}
    for step in found.steps:
        winner = step.ruling.rivals[0]
        least = error(winner.candidate.point)
        for rival in step.ruling.beaten[:most]:
            h = _law(rival)
            if (h.physics, h.site) not in listed:
                e = error(rival.candidate.point)
                listed[h.physics, h.site] = Rejected(h.physics, h.site, e, _why(rival, winner, e / max(least, 1e-300) - 1))
    for rival in found.last.rivals[:1] if found.last is not None and not found.last.accepted else ():
        h = _law(rival)
        listed.setdefault((h.physics, h.site), Rejected(h.physics, h.site, error(rival.candidate.point), found.last.reason))  # type: ignore[union-attr]
    return tuple(listed.values())


def _law(rival: Rival) -> Hypothesis:
    assert rival.candidate.hypothesis is not None  # noqa: S101
    return rival.candidate.hypothesis


def _why(rival: Rival, winner: Rival, more: float) -> str:
    """Return the held-out error beside the winner's, and by how much the recordings that chose tell the two apart."""
    beside = f"held-out error {100 * more:.2g} % higher" if more >= 5e-4 else "held-out error no higher"
    return f"{beside} than with {winner.candidate.key}; the recordings for fitting and choosing differ by {rival.z:.1f} standard errors"


def is_change(hypotheses: Sequence[Hypothesis]) -> bool:
    """Whether all that was found are parameters off their stated value."""
    return bool(hypotheses) and all(h.physics == CHANGE for h in hypotheses)
