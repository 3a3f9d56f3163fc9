"""Fits of one fault: the evidence averaged over the severities, against numerical integration."""

import math

import numpy as np
import pytest
from scipy.integrate import quad

from afdsvc.detect.isolation import linear_fit


@pytest.mark.parametrize("bounds", [(-1.0, 0.0), (-1e-9, 0.0), (-0.3, -0.3 + 1e-13), (0.0, 0.8)])
@pytest.mark.parametrize(("score", "information"), [(-3.0, 40.0), (-4e4, 1e6), (2e5, 1e8), (50.0, 1e-3)])
def test_the_evidence_is_the_average_likelihood(bounds, score, information):
    low, high = bounds
    fit = linear_fit("pump", score, information, bounds)
    top = fit.log_likelihood  # of the likeliest severity inside the bounds
    near = np.clip(fit.severity + np.array([-8.0, 8.0]) * fit.sd, low, high)
    steep = abs(score - information * fit.severity)
    if steep * fit.sd > 1:
        near = np.clip(fit.severity + np.array([-40.0, 40.0]) / steep, low, high)
    area, _ = quad(lambda x: math.exp(score * x - information * x * x / 2 - top), *near, epsabs=0)
    assert fit.log_evidence == pytest.approx(top + math.log(area / (high - low)), rel=1e-5, abs=1e-5)
    assert low <= fit.severity <= high


def test_of_a_single_severity_the_evidence_is_its_likelihood():
    fit = linear_fit("pump", -3.0, 40.0, (-0.2, -0.2))
    assert fit.log_evidence == fit.log_likelihood == pytest.approx(3.0 * 0.2 - 40 * 0.02)
