"""Uncertainty of a frequency response by leaving groups of the data out, whatever the method and the noise.

The estimate is repeated G times, each time without one of G consecutive stretches of the recordings. The spread of the
repetitions, times G - 1, is the covariance (delete-a-group jackknife; Kott, J. Official Statistics 17, 2001). Stretches
must be much longer than the memory of noise and plant.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from afdsvc.dataset.arrays import Recording
from afdsvc.errors import AfdsvcError, BadInput
from afdsvc.identify.fit import ResponseBand
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.statespace import Array, StateSpace

Estimator = Callable[[Sequence[Recording]], StateSpace]


def jackknife_band(
    estimate: Estimator,
    recordings: Sequence[Recording],
    omega: Array,
    groups: int = 16,
    whole: StateSpace | None = None,
) -> ResponseBand:
    """Return the response of the estimate on all data (or ``whole``, when already known) with its covariance.

    Raises `BadInput` for fewer than three groups, or when more than a tenth of the repetitions fail.
    """
    if groups < 3:
        raise BadInput(f"{groups} groups; expected at least 3")
    value = frequency_response(estimate(recordings) if whole is None else whole, omega)
    repeated, failures = [], []
    for left_out in range(groups):
        try:
            repeated.append(frequency_response(estimate(without_group(recordings, left_out, groups)), omega))
        except AfdsvcError as error:
            failures.append(str(error))
    if len(failures) > groups // 10:
        raise BadInput(
            f"{len(failures)} of {groups} repetitions of the fit failed ({failures[0]}); the order is too high "
            "for the data"
        )
    spread = np.stack(repeated) - np.mean(repeated, axis=0)
    parts = np.stack([spread.real, spread.imag], axis=-1)
    covariance = np.einsum("gkpmi,gkpmj->kpmij", parts, parts) * (len(repeated) - 1) / len(repeated)
    return ResponseBand(omega, value, covariance, freedom=len(repeated) - 1)


def without_group(recordings: Sequence[Recording], left_out: int, groups: int) -> list[Recording]:
    """Return the recordings without one of ``groups`` equal stretches of their concatenation; a cut makes two of
    one."""
    total = sum(map(len, recordings))
    start, stop = left_out * total // groups, (left_out + 1) * total // groups
    kept, offset = [], 0
    for r in recordings:
        for a, b in ((0, min(start - offset, len(r))), (max(stop - offset, 0), len(r))):
            if b > a:
                kept.append(r.span(a, b))
        offset += len(r)
    return kept
