"""The field trials of a study: families in turn; nothing hidden, laws in the vocabulary, laws outside of it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from afdsvc.trial.field.catalogue import FAMILIES, apart, laws_at
from afdsvc.trial.field.law import Law
from afdsvc.trial.field.options import FieldOptions

NOTHING_SHARE, OUTSIDE_SHARE = 0.15, 1 / 3  # of the trials; of those in which something is hidden
COUNTS, CHANCES = (1, 2, 3), (0.6, 0.28, 0.12)  # laws in one machine
SHARES = (0.2, 0.9)  # of the held-out error
STREAM = 20  # separates the numbers drawn here from those of the other parts


def draws(seed: int) -> Iterator[tuple[FieldOptions, float, tuple[str, ...]]]:
    """Yield options, the share asked for, and the first right name of every law (or "outside"), without end."""
    g = np.random.default_rng([seed, STREAM])
    while True:
        for family in g.permutation(list(FAMILIES)):
            laws = () if g.random() < NOTHING_SHARE else _laws(str(family), g)
            options = FieldOptions(str(family), tuple(law.name for law in laws), bool(g.random() < 0.5))
            yield options, float(g.uniform(*SHARES)) if laws else 0.0, tuple(law.label for law in laws)


def _laws(family: str, g: np.random.Generator) -> tuple[Law, ...]:
    """Return one to three laws that make sense on the family and cannot be taken for one another."""
    outside = bool(g.random() < OUTSIDE_SHARE)
    possible = laws_at(family)
    first = [law for law in possible if law.outside == outside] or possible
    chosen = [first[int(g.integers(len(first)))]]
    for _ in range(int(g.choice(COUNTS, p=CHANCES)) - 1):
        others = [law for law in possible if law not in chosen and (outside or not law.outside) and all(apart(law, c) for c in chosen)]
        if others:
            chosen.append(others[int(g.integers(len(others)))])
    return tuple(chosen)
