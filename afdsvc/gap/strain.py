"""Two more demands on an answer: it may not bend the model beyond what its owner allows, nor leave noise at its own place alone.

The free numbers of the model have a stated prior, so their squared distance from it is chi-square distributed when nothing is
wrong with the physics named: a sum far beyond is a lack of fit, even where the recordings are matched to the noise. And what
does not repeat beyond the stated noise, at the output of a named effect while another output is as quiet as stated, is something
that acts at random where the effect does: the effect is not the whole law.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import stats

from afdsvc.gap.baseline import Baseline

SURE = 1e-5  # p-value of the strain below which the owner's statement is contradicted
RANDOM = 1e-9  # p-value of an excess of noise
CALM = 1.03  # ratio of standard deviations up to which an output is as quiet as stated
FREQUENT = 0.5  # share of an effect's power in an output from which it acts there


def strained(base: Baseline) -> str:
    """Return why the model is bent too far at the end of a search, or ""."""
    theta = base.point.theta
    strain = float(theta @ theta)
    p = float(stats.chi2.sf(strain, max(len(theta), 1)))
    if base.limited != "noise" or len(theta) == 0 or p > SURE:
        return ""
    worst = int(np.argmax(np.abs(theta)))
    entry = base.nominal.entries[worst]
    return (
        f"the model's own numbers would have to move beyond what their owner states (chi-square {strain:.0f} for {len(theta)} of them, "
        f"p = {p:.1g}; {entry.matrix}[{entry.row},{entry.column}] by {theta[worst]:+.1f} standard deviations)"
    )


def irregular(base: Baseline) -> str:
    """Return why what does not repeat belongs to an effect of the final point, or ""."""
    stated = base.nominal.model.output_sd
    if base.limited != "noise" or not base.floor.known or stated is None or base.ratio == 0:
        return ""
    ratio = base.floor.sd / np.maximum(stated, 1e-300)
    calm = ratio < CALM
    for j in np.flatnonzero(~calm):
        n = base.floor.samples
        p = float(stats.f.sf(ratio[j] ** 2 / max(float(ratio.min()) ** 2, 1.0), n, n))
        if calm.any() and p < RANDOM and _acting_at(base, int(j)):
            name = base.nominal.model.outputs[j].name
            return (
                f"what does not repeat at {name}, where the named effect acts, is {ratio[j] ** 2:.3g} times as powerful as the stated noise "
                f"(p = {p:.1g}) while elsewhere the noise is as stated: something acts there at random"
            )
    return ""


def _acting_at(base: Baseline, output: int) -> bool:
    """Whether an effect of the final point acts mostly at this output."""
    final = base.objective.whitened(base.point)
    for k in range(len(base.point.effects)):
        without = replace(base.point, effects=base.point.effects[:k] + base.point.effects[k + 1 :])
        change = sum(((a - b) ** 2).sum(0) for a, b in zip(base.objective.whitened(without), final, strict=True))
        if change[output] > FREQUENT * float(np.sum(change)):
            return True
    return False
