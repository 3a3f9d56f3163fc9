"""Two more demands on an answer: it may not bend the model beyond what its owner allows, nor leave noise at its own place alone.

The free numbers of the model have a stated prior, so their distance from it, along the directions that the recordings know better
than the owner, is chi-square distributed when nothing is wrong with the physics named: a sum far beyond is a lack of fit, even where
the recordings are matched to the noise. And what does not repeat beyond the stated noise, at the place of an effect that grips and
lets go (friction, play, a loop) while elsewhere it is as quiet as stated, is something that acts at random where the effect does:
the effect is not the whole law.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from scipy import stats

from afdsvc.explain.baseline import WORTH_A_GAIN, Baseline, agitation, lower_edge
from afdsvc.explain.check_information import entry_name
from afdsvc.explain.objective import tangent
from afdsvc.explain.sizes import bandwidth
from afdsvc.lti.frequency import frequency_response

SHAPE = 0.01  # share of what a law explains that the model's numbers may take up: laws are right to a tenth of their answer
SURE = 1e-4  # p-value of the strain below which the owner's statement is contradicted
RANDOM = 1e-5  # p-value of an excess of noise
CALM = 1.03  # ratio of standard deviations up to which an output is as quiet as stated
BETTER_KNOWN = 0.5  # how far an estimate may move, over its prior's variance, from which the recordings know better than the owner
ELSEWHERE = 0.25  # evidence for noise at another input over that at the loudest from which the machine is restless everywhere
GRIPPING = ("friction", "memory")  # families of laws that hold on to where they were: dry friction; play and loops
FREQUENT = 0.5  # share of an effect's power in an output from which it acts there


def strained(base: Baseline, explained: float = 0.0) -> str:
    """Return why the model is bent too far at the end of a search, or "".

    ``explained`` is what the laws named take away of the whitened sum of squares; a changed constant is exact and takes no
    such allowance.
    """
    theta = base.point.theta
    if base.limited != "noise" or len(theta) == 0:
        return ""
    strain, count = distance(base)
    p = float(stats.chi2.sf(strain - SHAPE * explained, max(count, 1)))
    if p > SURE:
        return ""
    worst = int(np.argmax(np.abs(theta)))
    entry = base.nominal.entries[worst]
    return (
        f"the model's own numbers would have to move beyond what their owner states (chi-square {strain:.0f} for {count} of them, "
        f"p = {p:.1g}; {entry_name(base.nominal, entry)} by {theta[worst]:+.1f} standard deviations)"
    )


def distance(base: Baseline) -> tuple[float, int]:
    """Return how far the model's numbers are from their prior, as a sum of squares of independent deviates, and their count.

    A number the recordings say nothing about stays where its owner put it, and proves nothing: an estimate moves about its prior
    with the covariance ``I - P``, P its own after the recordings.
    """
    t, n = tangent(base.objective, base.point), len(base.point.theta)
    inverse = np.linalg.pinv(t.r.T @ t.r, rcond=1e-14, hermitian=True)[:n, :n]
    spread, directions = np.linalg.eigh(np.eye(n) - inverse)
    known = spread > BETTER_KNOWN
    deviates = (directions[:, known].T @ base.point.theta) / np.sqrt(spread[known])
    return float(deviates @ deviates), int(known.sum())


def irregular(base: Baseline, coloured: Collection[str] = ()) -> str:
    """Return why what does not repeat belongs to an effect of the final point, or ""; ``coloured`` are outputs of coloured noise."""
    outputs = [v.name for v in base.nominal.model.outputs]
    for j in {*_restless(base, [name in coloured for name in outputs]), *_shaken(base)}:
        if _grips_at(base, j):
            return (
                f"what does not repeat at {outputs[j]}, where the named effect grips and lets go, is no noise of the sensor as stated, while "
                f"elsewhere the noise is: something acts there at random"
            )
    return ""


def _restless(base: Baseline, coloured: Sequence[bool]) -> list[int]:
    """Return the outputs with noise of more power than stated, or of a colour, while another has neither."""
    stated, n = base.nominal.model.output_sd, base.floor.samples
    if base.limited != "noise" or not base.floor.known or stated is None:
        return []
    ratio = base.floor.sd / np.maximum(stated, 1e-300)
    louder = [r > CALM and float(stats.f.sf(r**2 / max(float(ratio.min()) ** 2, 1.0), n, n)) < RANDOM for r in ratio]
    found = [a or b for a, b in zip(louder, coloured, strict=True)]
    return [] if all(found) else [j for j, is_so in enumerate(found) if is_so]


def _shaken(base: Baseline) -> list[int]:
    """Return the output that follows most the one input at which noise enters the machine, while none does at the others; or none."""
    if base.limited != "noise" or base.ratio == 0 or base.nominal.plant.inputs < 2:
        return []
    evidence = agitation(base)
    loudest = int(np.argmax(evidence))
    others = float(np.delete(evidence, loudest).max())
    if not np.isfinite(evidence).all() or evidence[loudest] - max(others, 0.0) < WORTH_A_GAIN or others > ELSEWHERE * evidence[loudest]:
        return []
    omega = np.geomspace(lower_edge(base.objective.runs), bandwidth(base.objective.runs), 32)
    response = np.abs(frequency_response(base.nominal.at(base.point.theta), omega)[:, :, loudest]) / base.floor.sd
    return [int(np.argmax((response**2).sum(0)))]


def _grips_at(base: Baseline, output: int) -> bool:
    """Whether an effect that grips and lets go acts mostly at this output."""
    final = base.objective.whitened(base.point)
    for k, e in enumerate(base.point.effects):
        if e.hypothesis.family not in GRIPPING:
            continue
        without = replace(base.point, effects=base.point.effects[:k] + base.point.effects[k + 1 :])
        change = sum(((a - b) ** 2).sum(0) for a, b in zip(base.objective.whitened(without), final, strict=True))
        if change[output] > FREQUENT * float(np.sum(change)):
            return True
    return False
