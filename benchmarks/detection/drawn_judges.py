"""All detectors on one burst: does each alarm at every promised rate? Waves, boundaries and thresholds are the detectors' own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from rates_baselines import BASELINES
from rates_cases import RATES, RateCase
from rates_lines import LINE_DETECTORS, alarm_region
from rates_real import coordinates
from rates_regression import correlation, threshold
from rates_sequential import cusum_blocks

from afdsvc.detect.features.regressors import regressors
from afdsvc.detect.model_uncertainty import model_doubt
from afdsvc.detect.statistics.regression import averaged_out
from afdsvc.detect.thresholds.regressor_information import noise_driven
from afdsvc.lti.statespace import Array


class Judges:
    """The detectors of one case, prepared once."""

    names = (*LINE_DETECTORS, "regression", "cusum", *BASELINES)

    def __init__(self, case: RateCase) -> None:
        self.case, self.filters = case, regressors(case.problem)
        self.regions = {name: [alarm_region(case, name, rate) for rate in RATES] for name in LINE_DETECTORS}
        self.cusums = [cusum_blocks(case, rate) for rate in RATES]
        root = noise_driven(case.problem).signed_root(case.burst.samples, case.burst)
        self.mean, self.sd = (v[: self.filters.faults] for v in root)
        self.levels = {name: self._levels(name) for name in BASELINES}
        lines = tuple(sorted(case.burst.lines, key=lambda line: line.omega))
        doubt = model_doubt(case.problem, lines, np.linalg.cholesky(case.line_sums().G).T)
        self.factor = np.linalg.cholesky(np.eye(len(doubt)) + doubt)

    def _levels(self, name: str) -> list[float]:
        found = [self.case.statistic(name, rate) for rate in RATES]
        full = [replace(f.start(self.case.burst, self.case.dt), n=self.case.burst.samples) for f in found]  # type: ignore[attr-defined]
        return [f.decide(s, self.case.burst, self.case.dt)[0].threshold for f, s in zip(found, full, strict=True)]  # type: ignore[attr-defined]

    def alarms(self, series: Array) -> Array:
        """Return truth values ``(detectors, rates)`` for the series ``(n, 1 + K, p)`` of a burst."""
        e = np.ascontiguousarray(series[:, 0])
        z = np.linalg.solve(self.factor, coordinates(self.case, e))
        out = [[bool((d @ z > h).any()) for d, h in self.regions[name]] for name in LINE_DETECTORS]
        out.append(self._regression(self.own(series)))
        blocks = self.cusums[0].coordinates(self.case, e)
        out.append([found.first_crossing(blocks) >= 0 for found in self.cusums])
        out.append([float(np.sum(e**2)) > h for h in self.levels["chi_square"]])
        out.append([float(np.abs(e).max()) > h for h in self.levels["limit_check"]])
        return np.array(out)

    def own(self, series: Array) -> Array:
        """Return residual and the regressors this detector has: those of uncertain parameters come last."""
        return series[:, : 1 + self.filters.faults + len(self.filters.sd)]

    def learn(self, bursts: Sequence[Array]) -> None:
        """Take the band of the regression's thresholds from some bursts; it is widened threefold."""
        h = np.array([[threshold(self._tested(self.own(series))[1], rate) for rate in RATES] for series in bursts])
        low, high = h.min(axis=0), h.max(axis=0)
        self.band = low - (high - low) - 1e-9, high + (high - low) + 1e-9

    def _tested(self, series: Array) -> tuple[float, Array]:
        """Return the regression's statistic and the correlations its threshold follows from."""
        psi = np.moveaxis(series[:, 1:], 1, 0).reshape(series.shape[1] - 1, -1)
        b, G = averaged_out(psi @ series[:, 0].ravel(), psi @ psi.T, self.filters.sd)
        return float(np.max((-b / np.sqrt(np.diag(G)) - self.mean) / self.sd)), correlation(G)

    def _regression(self, series: Array) -> list[bool]:
        """Return the regression's alarms; its threshold is found only where the statistic falls inside the band."""
        statistic, related = self._tested(series)
        low, high = self.band
        near = (statistic > low) & (statistic <= high)
        exact = [threshold(related, rate) if close else h for rate, close, h in zip(RATES, near, high, strict=True)]
        return [statistic > h for h in exact]
