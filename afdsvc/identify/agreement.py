"""Do two independent routes to the same plant agree?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from afdsvc.identify.fit import ResponseBand
from afdsvc.lti.statespace import ComplexArray


@dataclass(frozen=True, slots=True)
class Agreement:
    """Two frequency responses against each other.

    ``relative`` is the median over frequency of ``|G1 - G2| / |G1|`` (spectral norms); ``deviations`` the median
    distance in combined standard deviations (about 0.8 expected when only noise separates them, far above 2 when one is
    biased).
    """

    relative: float
    deviations: float

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        verdict = (
            "agree within their uncertainty"
            if self.deviations < 2
            else "differ by more than their uncertainty: do not trust either"
        )
        return (
            f"the two routes differ by {100 * self.relative:.2g} % ({self.deviations:.2g} standard "
            f"deviations): they {verdict}"
        )


def agreement(first: ResponseBand, second: ResponseBand) -> Agreement:
    """Return how well two responses on the same frequencies agree."""
    relative = np.linalg.norm(first.value - second.value, ord=2, axis=(1, 2)) / np.linalg.norm(
        first.value, ord=2, axis=(1, 2)
    )
    spread = np.sqrt(first.sd**2 + second.sd**2)
    distance = np.abs(first.value - second.value) / np.where(spread > 0, spread, np.inf)
    return Agreement(float(np.median(relative)), float(np.median(distance)))


def relative_error(found: ComplexArray, truth: ComplexArray) -> float:
    """Return the median over frequency of ``|found - truth| / |truth|`` in spectral norms."""
    return float(
        np.median(np.linalg.norm(found - truth, ord=2, axis=(1, 2)) / np.linalg.norm(truth, ord=2, axis=(1, 2)))
    )
