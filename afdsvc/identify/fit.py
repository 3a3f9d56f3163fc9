"""The one result type of every method, so that methods can be compared line by line.

Uncertainty of a frequency response by leaving groups of the data out, whatever the method and the noise.

The estimate is repeated G times, each time without one of G consecutive stretches of the recordings. The spread of the
repetitions, times G - 1, is the covariance (delete-a-group jackknife; Kott, J. Official Statistics 17, 2001). Stretches
must be much longer than the memory of noise and plant.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import stats

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.errors import AfdsvcError, BadInput
from afdsvc.identify.numerics.innovations_form import InnovationsForm
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.statespace import Array, ComplexArray, StateSpace
from afdsvc.stats.fit_measures import Measures
from afdsvc.stats.portmanteau import ResidualTests


@dataclass(frozen=True, slots=True)
class ParameterEstimate:
    """A physical parameter: value, standard error, unit, and what was believed before."""

    name: str
    value: float
    sd: float
    unit: str = ""
    prior: float | None = None
    prior_sd: float | None = None

    def interval(self, confidence: float = 0.95) -> tuple[float, float]:
        """Return the confidence interval of a normal estimate."""
        reach = float(stats.norm.ppf(0.5 + confidence / 2)) * self.sd
        return self.value - reach, self.value + reach


@dataclass(frozen=True, slots=True, eq=False)
class ResponseBand:
    """A frequency response with its uncertainty.

    ``omega (k,)`` in rad/s, ``value (k, p, m)`` complex, ``covariance (k, p, m, 2, 2)`` that of real and imaginary part
    of every entry, ``freedom`` the degrees of freedom the covariance was estimated with (inf when derived).
    """

    omega: Array
    value: ComplexArray
    covariance: Array
    freedom: float = float("inf")

    @property
    def sd(self) -> Array:
        """Root mean square error of every complex entry, shape ``(k, p, m)``."""
        return np.asarray(np.sqrt(self.covariance[..., 0, 0] + self.covariance[..., 1, 1]))

    def magnitude_band(self, confidence: float = 0.95) -> tuple[Array, Array]:
        """Return lower and upper bound of the magnitude, each ``(k, p, m)``: the error along the response's own
        phase."""
        magnitude = np.abs(self.value)
        phase = np.where(magnitude > 0, self.value / np.where(magnitude > 0, magnitude, 1), 1)
        along = np.stack([phase.real, phase.imag], axis=-1)
        sd = np.sqrt(np.einsum("kpmi,kpmij,kpmj->kpm", along, self.covariance, along))
        reach = float(stats.t.ppf(0.5 + confidence / 2, self.freedom)) * sd
        return np.maximum(magnitude - reach, 0.0), magnitude + reach

    def covers(self, truth: ComplexArray, confidence: float = 0.95) -> Array:
        """Whether the joint confidence ellipse of every entry holds the true value, shape ``(k, p, m)``."""
        error = np.stack([(truth - self.value).real, (truth - self.value).imag], axis=-1)
        distance = np.einsum("kpmi,kpmi->kpm", error, np.linalg.solve(self.covariance, error[..., None])[..., 0])
        nu = self.freedom
        limit = (
            stats.chi2.ppf(confidence, 2) if np.isinf(nu) else 2 * nu / (nu - 1) * stats.f.ppf(confidence, 2, nu - 1)
        )
        return np.asarray(distance <= limit)


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """What one method found.

    ``model`` is the plant with its noise model (gain zero when none was estimated); ``singular_values`` and
    ``order_reason`` say where the order came from; ``band`` is the frequency response with its uncertainty; ``heldout``
    the measures per output on recordings never used, ``tests`` those of the residuals there. ``deviation`` is the
    identified S where a Hansen scheme found the plant through it. ``parameters`` is empty for black boxes;
    ``covariance`` is that of the parameters, in their order.
    """

    method: str
    model: InnovationsForm
    singular_values: Array = field(default_factory=lambda: np.zeros(0))
    order_reason: str = ""
    band: ResponseBand | None = None
    tests: ResidualTests | None = None
    heldout: Mapping[str, Measures] = field(default_factory=dict)
    deviation: StateSpace | None = None
    parameters: tuple[ParameterEstimate, ...] = ()
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    notes: tuple[str, ...] = ()

    @property
    def system(self) -> StateSpace:
        """The identified plant, discrete."""
        return self.model.system

    @property
    def order(self) -> int:
        """Number of states of the identified plant."""
        return self.model.system.order


def jackknife_band(whole: StateSpace, repeated: Sequence[Callable[[], StateSpace]], omega: Array) -> ResponseBand:
    """Return the response of the estimate from all the data with its covariance; ``repeated`` are estimates without one of as many groups each.

    Raises `BadInput` for fewer than three groups, or when more than a tenth of the repetitions fail.
    """
    groups = len(repeated)
    if groups < 3:
        raise BadInput(f"{groups} groups; expected at least 3")
    value = frequency_response(whole, omega)
    responses, failures = [], []
    for estimate in repeated:
        try:
            responses.append(frequency_response(estimate(), omega))
        except AfdsvcError as error:
            failures.append(str(error))
    if len(failures) > groups // 10:
        raise BadInput(
            f"{len(failures)} of {groups} repetitions of the fit failed ({failures[0]}); the order is too high "
            "for the data"
        )
    spread = np.stack(responses) - np.mean(responses, axis=0)
    parts = np.stack([spread.real, spread.imag], axis=-1)
    covariance = np.einsum("gkpmi,gkpmj->kpmij", parts, parts) * (len(responses) - 1) / len(responses)
    return ResponseBand(omega, value, covariance, freedom=len(responses) - 1)


def sandwich_band(
    response: Callable[[Array], ComplexArray], curvature: Array, parts: Array, omega: Array, step: float = 1e-3
) -> ResponseBand:
    """Return the response at a minimum (the origin of its coordinates) with its covariance, valid for noise of any colour.

    ``parts (groups, q)`` are gradients of groups of samples, long against the memory of the noise: they tell how much the minimum would move
    without each, ``H^-1 (sum g g') H^-1`` with the ``curvature`` H. ``step`` is that of the central differences of the response.
    """
    count = len(parts)
    moves = np.linalg.lstsq(curvature, (parts - parts.mean(axis=0)).T, rcond=1e-14)[0].T * np.sqrt(count / (count - 1))
    slopes = np.stack([(response(h) - response(-h)) / (2 * step) for h in step * np.eye(len(curvature))])
    shifts = np.tensordot(moves, slopes, axes=1)
    split = np.stack([shifts.real, shifts.imag], axis=-1)
    value = response(np.zeros(len(curvature))).astype(np.complex128)
    return ResponseBand(omega, value, np.einsum("gkpmi,gkpmj->kpmij", split, split), freedom=count - 1)


def repetitions(
    estimate: Callable[[Sequence[InputOutputData]], StateSpace], recordings: Sequence[InputOutputData], groups: int
) -> list[Callable[[], StateSpace]]:
    """Return the repetitions of an estimate that leave one of ``groups`` equal stretches out each (see `jackknife_band`)."""

    def without(group: int) -> Callable[[], StateSpace]:
        return lambda: estimate(without_group(recordings, group, groups))

    return [without(g) for g in range(groups)]


def without_group(recordings: Sequence[InputOutputData], left_out: int, groups: int) -> list[InputOutputData]:
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
