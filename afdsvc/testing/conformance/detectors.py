"""Detectors: shown bursts of a simulated gas bearing, healthy and faulty, in blocks of any size, with gaps."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from afdsvc.api.bursts import Burst
from afdsvc.api.detection import DetectionProblem, Detector, ResidualBlock
from afdsvc.api.evidence import Evidence
from afdsvc.excite.diagnosis_burst import default_burst
from afdsvc.excite.simulated_burst import SimulatedBurst, played, simulate_burst
from afdsvc.testing.conformance.named import settings_check
from afdsvc.testing.machines import bearing_problem

BEFORE = 2000  # quiet samples in which filters settle
HEALTHY_BURSTS = 20


@lru_cache(maxsize=1)
def _problem() -> DetectionProblem:
    return bearing_problem()


@lru_cache(maxsize=1)
def _burst() -> Burst:
    problem = _problem()
    assert problem.limits is not None
    return default_burst(problem, problem.limits, seconds=1.0)


@lru_cache(maxsize=64)
def _record(seed: int, fault: str = "", severity: float = 0.0) -> SimulatedBurst:
    problem, burst = _problem(), _burst()
    alpha = played(burst, problem.plant.dt, BEFORE, 500)
    noise = np.random.default_rng(seed).normal(size=(len(alpha), 2)) @ np.linalg.cholesky(problem.covariance).T
    return simulate_burst(problem, alpha, noise, {fault: severity} if fault else {})


def _blocks(record: SimulatedBurst, size: int = 250) -> Iterator[ResidualBlock]:
    return record.blocks(size, _burst(), BEFORE)


def _said(detector: Detector, record: SimulatedBurst, size: int = 250) -> list[Evidence]:
    state, said = detector.start(), []
    for block in _blocks(record, size):
        state, evidence = detector.step(state, block)
        said += list(evidence)
    return said


def finds_a_large_fault(thing: Any) -> None:
    """Detects at least one of the bearing's faults at -50 % in one burst."""
    detector = thing.design(_problem(), {})
    found = [n for n in _problem().fault_names if any(e.detected for e in _said(detector, _record(1, n, -0.5)))]
    assert found, "none of the four faults at -50 % was detected in a burst of 1 s made for them"


def is_quiet_on_a_healthy_machine(thing: Any) -> None:
    """Raises no more than two alarms in twenty bursts of a healthy machine."""
    detector = thing.design(_problem(), {})
    alarms = sum(any(e.detected and e.trustworthy for e in _said(detector, _record(s))) for s in range(HEALTHY_BURSTS))
    assert alarms <= 2, f"{alarms} alarms in {HEALTHY_BURSTS} healthy bursts, at 1 per 1000 promised"


def decides_the_same_however_the_samples_are_cut(thing: Any) -> None:
    """Gives the same decisions for blocks of 250 and of 97 samples."""
    detector, record = thing.design(_problem(), {}), _record(2, _problem().fault_names[0], -0.3)
    a, b = _said(detector, record, 250), _said(detector, record, 97)
    finals = [[e for e in said if e.burst] for said in (a, b)]
    assert len(finals[0]) == len(finals[1]), f"{len(finals[0])} decisions in blocks of 250, {len(finals[1])} in blocks of 97"
    for x, y in zip(*finals, strict=True):
        close = np.isclose(x.statistic, y.statistic, rtol=1e-6, equal_nan=True)
        assert close, f"statistic {x.statistic} in blocks of 250, {y.statistic} in blocks of 97"
        assert (x.detected, x.fault) == (y.detected, y.fault), "the decision depends on how the samples are cut"


def steps_are_functions(thing: Any) -> None:
    """A step changes neither its block nor the state it was given, and gives the same when it is repeated."""
    detector, record = thing.design(_problem(), {}), _record(3)
    state = detector.start()
    for block in _blocks(record):
        for array in (block.r, block.u, block.y, block.alpha, block.beta):
            array.setflags(write=False)
        before = pickle.dumps(state)
        once, first = detector.step(state, block)
        assert pickle.dumps(state) == before, "the step changed the state it was given; expected a new one"
        _, second = detector.step(state, block)
        assert [e.statistic for e in first] == [e.statistic for e in second], "the same step gave two different results"
        state = once


def keeps_its_memory_bounded(thing: Any) -> None:
    """The state does not grow with time."""
    detector, record = thing.design(_problem(), {}), _record(4)
    state, sizes = detector.start(), []
    for _ in range(4):
        for block in _blocks(record):
            state, _ = detector.step(state, block)
        sizes.append(len(pickle.dumps(state)))
    assert sizes[-1] <= 1.05 * sizes[1] + 1000, f"the state grew from {sizes[1]} to {sizes[-1]} bytes over two more bursts"


def throws_away_a_burst_with_a_gap(thing: Any) -> None:
    """Does not decide on a burst in which samples are missing, or says that it cannot be trusted."""
    detector, record = thing.design(_problem(), {}), _record(5, _problem().fault_names[0], -0.5)
    state, said = detector.start(), []
    for block in _blocks(record):
        broken = BEFORE + 1000 <= block.k0 < BEFORE + 2000
        if broken:
            continue
        gap = block.k0 >= BEFORE + 2000 and block.k0 - len(block) < BEFORE + 2000
        state, evidence = detector.step(state, replace(block, gap=gap))
        said += [e for e in evidence if e.burst and e.k >= BEFORE + 1000]  # before the gap it may have decided already
    wrong = [e for e in said if e.trustworthy and e.detected]
    assert not wrong, "a burst with a thousand samples missing was judged as if nothing were missing"


def says_all_of_what_it_decides(thing: Any) -> None:
    """Evidence has a finite threshold, weights that add up to one, a reason where it cannot be trusted."""
    detector = thing.design(_problem(), {})
    for e in _said(detector, _record(6, _problem().fault_names[1], -0.5)):
        assert e.detector == detector.name, f"evidence says detector '{e.detector}'; expected '{detector.name}'"
        assert np.isfinite(e.threshold), f"threshold {e.threshold}; expected a number"
        assert e.trustworthy or e.reason, "evidence that cannot be trusted gives no reason"
        assert not e.weights or abs(sum(e.weights.values()) - 1) < 1e-6, f"weights add up to {sum(e.weights.values())}"
        assert e.fault is None or e.fault in _problem().fault_names, f"fault '{e.fault}' is not one of the machine's"
        assert e.severity is None or e.severity.sd >= 0, f"severity with standard error {e.severity and e.severity.sd}"


CHECKS = (
    settings_check(lambda thing, settings: thing.design(_problem(), settings)),
    finds_a_large_fault, is_quiet_on_a_healthy_machine, decides_the_same_however_the_samples_are_cut,
    steps_are_functions, keeps_its_memory_bounded, throws_away_a_burst_with_a_gap, says_all_of_what_it_decides,
)
