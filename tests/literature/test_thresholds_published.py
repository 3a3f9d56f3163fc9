"""Thresholds and detection probabilities printed in publications P3 and P5.

Source: A. K. Sekunda, "Fault Diagnosis and Identification of Electro-Mechanical Systems", PhD thesis, DTU 2017. P3 (45) and
(55) print 0.11^2 where 0.11 is the variance; P3 (42) prints sqrt(D) where the deflection itself belongs. With both mended
the printed numbers follow, with the misprints they do not.
"""

from __future__ import annotations

import math

import pytest

from afdsvc.detect.thresholds.power import detection_probability, tail_point

FALSE_ALARM = 2e-5  # a tenth of the sample time of 0.2 ms
VARIANCE = 0.11


def threshold(energy: float, variance: float = VARIANCE) -> float:
    return math.sqrt(variance * energy) * tail_point(FALSE_ALARM)


def deflection(energy: float) -> float:
    return math.sqrt(energy / VARIANCE)


def test_vertical_actuator_of_p3() -> None:
    """(54), (55): N = 60, amplitude 0.3: energy 2.7, threshold 2.2, detected with 80 %."""
    energy = 60 * 0.3**2 / 2
    assert energy == pytest.approx(2.7)
    assert threshold(energy) == pytest.approx(2.2, abs=0.05)
    assert detection_probability(FALSE_ALARM, deflection(energy)) == pytest.approx(0.80, abs=0.005)


def test_horizontal_actuator_of_p3() -> None:
    """(44), (45): window 420 as in the text (560 in the formula), printed energy 2.9, threshold 2.3, about 80 %."""
    assert 420 * 0.1175**2 / 2 == pytest.approx(2.9, abs=0.05)
    assert threshold(2.9) == pytest.approx(2.3, abs=0.05)
    assert detection_probability(FALSE_ALARM, deflection(2.9)) == pytest.approx(0.848, abs=0.001)


def test_misprints_of_p3_do_not_give_the_printed_numbers() -> None:
    assert threshold(2.7, 0.11**2) == pytest.approx(0.742, abs=0.001)  # the printed 0.11^2
    assert detection_probability(FALSE_ALARM, math.sqrt(deflection(2.7))) == pytest.approx(0.030, abs=0.001)  # sqrt(D)


def test_threshold_of_p5() -> None:
    """(33): sqrt(0.42^2 * 31275) Q^-1(2e-5) = 305 (the arithmetic; 0.42^2 contradicts the variances 0.12 and 0.15)."""
    assert threshold(31275, 0.42**2) == pytest.approx(305, abs=0.5)
