"""Estimates of severity: bias, and standard error against the Cramer-Rao bound.

    python benchmarks/detection/severity.py [--runs N] [--docs]

Every setting is one machine with one fault, its burst played ``--runs`` times (3000 by default, which gives the standard
deviation to 1.3 per cent). ``--docs`` writes docs/reference/detection-severity.md and the table beside it as CSV.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # benchmarks.support
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402
from severity_page import write  # noqa: E402
from severity_settings import ITERATED, LINEAR, LINES, SETTINGS, Setting, information  # noqa: E402

from afdsvc.api.detection import DetectionProblem  # noqa: E402
from afdsvc.detect.burst_detector import BurstSamples  # noqa: E402
from afdsvc.detect.features.demodulation import Basis, BasisSums, project, window  # noqa: E402
from afdsvc.detect.features.regressors import regressors  # noqa: E402
from afdsvc.detect.isolation import Fit, curve_fit, linear_fit  # noqa: E402
from afdsvc.detect.stability_range import reachable  # noqa: E402
from afdsvc.detect.statistics.iterated_regression import Iterated, iterated  # noqa: E402
from afdsvc.excite.expected_detection import ExpectedDetection, expected_detection  # noqa: E402
from afdsvc.lti.statespace import Array  # noqa: E402
from benchmarks.support.trials import trials  # noqa: E402

SEED = 1
ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Found:
    """One estimator in one setting: errors and stated standard errors of all runs, the bound, whether bias is meant to be 0."""

    setting: Setting
    estimator: str
    error: Array
    stated: Array
    bound: float
    meant: bool

    @property
    def bias(self) -> float:
        """Mean error in standard errors."""
        return float(self.error.mean() / self.error.std())

    @property
    def spread(self) -> float:
        """Standard deviation of the estimates over the bound."""
        return float(self.error.std() / self.bound)

    @property
    def reported(self) -> float:
        """Mean stated standard error over the bound."""
        return float(self.stated.mean() / self.bound)


class Estimators:
    """The estimators of the detectors on one machine, each asked for one fault only."""

    def __init__(self, problem: DetectionProblem, setting: Setting) -> None:
        self.problem, self.setting, self.burst = problem, setting, setting.burst(problem)
        self.filters = regressors(problem)
        self.index, self.reach = problem.fault_names.index(setting.fault), reachable(problem)[setting.fault]
        self.lines = tuple(sorted(self.burst.lines, key=lambda line: line.omega))
        self.basis, self.window = Basis(tuple(line.omega for line in self.lines)), window(self.burst)
        self.again: Iterated = iterated(problem, self.filters.settling(1e-3))

    def prospect(self) -> ExpectedDetection:
        """Return the burst's prospect with the very samples that are analysed."""
        found = expected_detection(self.problem, self.lines, 1)
        first, last = self.window
        zero = np.zeros((last - first, self.problem.plant.outputs))
        R = np.linalg.cholesky(
            BasisSums.empty(self.basis, zero.shape[1]).add(self.basis, first, self.problem.plant.dt, zero).G
        ).T
        return ExpectedDetection(found.curves, R, found.reach, np.zeros((zero.shape[1] * len(R),) * 2))

    def on_curve(self, seen: ExpectedDetection, shown: BurstSamples) -> Fit:
        """Return the nearest point of the fault's curve."""
        first, last = self.window
        sums = BasisSums.empty(self.basis, self.problem.plant.outputs)
        found = project(sums.add(self.basis, first, shown.dt, np.ascontiguousarray(shown.series[first:last, 0])), self.basis)
        return curve_fit(seen.curves, self.setting.fault, seen.data(found.z), self.reach)

    def linear(self, shown: BurstSamples) -> Fit:
        """Return the regression's fit."""
        psi, e = shown.series[:, 1 + self.index], shown.series[:, 0]
        return linear_fit(self.setting.fault, float(np.sum(psi * e)), float(np.sum(psi**2)), self.problem.severity_range)

    def iterate(self, shown: BurstSamples) -> Fit:
        """Return the iterated regression's fit."""
        healthy = self.again._error(self.problem.augmented.plant, shown.block)  # noqa: SLF001 - one fault of the detector's own fits
        assert healthy is not None
        return self.again._fit(self.setting.fault, shown.block, healthy)  # noqa: SLF001


def study(setting: Setting, runs: int) -> list[Found]:
    """Return what every estimator of a setting found."""
    problem = setting.problem()
    its = Estimators(problem, setting)
    source = trials(problem, its.burst, {setting.fault: setting.severity}, filters=its.filters)
    seen, asked = its.prospect(), setting.estimators
    fits: dict[str, list[Fit]] = {name: [] for name in asked}
    rng = np.random.default_rng([SEED, SETTINGS.index(setting)])
    for _ in range(runs):
        shown = source.samples(rng.normal(size=(len(source.alpha), len(source.root))))
        for name in asked:
            found = its.on_curve(seen, shown) if name == LINES else its.linear(shown) if name == LINEAR else its.iterate(shown)
            fits[name].append(found)
    exact = its.filters.exact[its.index]
    whole, settled = information(setting, problem, its.burst, its.again.settle)
    bounds = {LINES: seen_bound(seen, setting), LINEAR: whole**-0.5, ITERATED: settled**-0.5}
    return [_found(setting, name, fits[name], bounds[name], name != LINEAR or exact) for name in asked]


def _found(setting: Setting, name: str, fits: list[Fit], bound: float, meant: bool) -> Found:
    theta, sd = np.array([f.severity for f in fits]), np.array([f.sd for f in fits])
    return Found(setting, name, theta - setting.severity, sd, bound, meant)


def seen_bound(seen: ExpectedDetection, setting: Setting) -> float:
    """Return the Cramer-Rao bound of the excited lines, what their covariance tells about the fault included."""
    h, fault, theta = 1e-4, setting.fault, setting.severity
    low, here, high = seen.curves.coloured(fault, [theta - h, theta, theta + h])[1]
    slope = (seen.R @ seen.curves.slope(fault, theta)).ravel()
    changed = np.linalg.solve(here, (high - low) / (2 * h))
    return float(slope @ np.linalg.solve(here, slope) + 0.5 * np.trace(changed @ changed)) ** -0.5


def main() -> None:
    """Count biases and standard errors."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=int, default=3000, help="bursts per setting")
    parser.add_argument("--docs", action="store_true", help="write docs/reference/detection-severity.md and .csv")
    wanted = parser.parse_args()
    started, found = time.process_time(), []
    for setting in SETTINGS:
        at = time.process_time()
        for one in study(setting, wanted.runs):
            found.append(one)
            print(
                f"{setting.title:45s} {one.estimator:30s} bias {one.bias:+.3f} sd/bound {one.spread:.3f} stated/bound {one.reported:.3f}"
            )
        print(f"  {time.process_time() - at:.0f} CPU seconds", flush=True)
    if wanted.docs:
        write(found, time.process_time() - started, wanted.runs, ROOT / "docs" / "reference")


if __name__ == "__main__":
    main()
