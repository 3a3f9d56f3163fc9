"""A machine that changes its speed: its parts change with it, and nothing is judged in between."""

from __future__ import annotations

from concurrent.futures import Future
from types import SimpleNamespace

import numpy as np
import pytest

from afdsvc.api.bursts import Burst
from afdsvc.api.signals import Block, Channel
from afdsvc.diagnosis.pipeline import Outcome
from afdsvc.diagnosis.speed_schedule import SpeedPipeline
from afdsvc.errors import BadInput, Refused

CHANNELS = (Channel("u_a", "A"), Channel("y_a", "um"), Channel("aux_speed", "rad/s"))


class Parts:
    """Stands for a pipeline: notes the blocks it sees."""

    def __init__(self, node: float) -> None:
        self.node, self.seen, self.known = node, [], []
        self.problem = SimpleNamespace(plant=SimpleNamespace(dt=0.01))

    def announce(self, burst: Burst) -> None:
        self.known.append(burst.name)

    def step(self, block: Block) -> Outcome:
        self.seen.append(block.seq)
        return Outcome((), (), block.role("y"))


class Machine:
    """Runs a pipeline over blocks of ten samples at given speeds."""

    def __init__(self, speed: float = 100.0, highest: float = 1e9, later=None) -> None:
        self.made: list[Parts] = []
        self.highest, self.seq, self.residuals = highest, 0, []
        self.pipeline = SpeedPipeline(self.design, 20.0, speed, still_seconds=0.3, later=later)

    def design(self, node: float) -> Parts:
        if node > self.highest:
            raise BadInput("there is no model at this speed")
        self.made.append(Parts(node))
        return self.made[-1]

    def run(self, *speeds: float, burst: str = "") -> list[str]:
        said = []
        for speed in speeds:
            values = np.column_stack([np.zeros(10), np.zeros(10), np.linspace(self.last, speed, 11)[1:] if self.seq else np.full(10, speed)])
            self.last = speed
            outcome = self.pipeline.step(Block("m", "s", self.seq, 10 * self.seq, 0.01, 0, CHANNELS, values, burst))
            said += [f.message for f in outcome.findings]
            self.residuals.append(outcome.residual is not None)
            self.seq += 1
        return said


def test_parts_follow_the_speed_and_nothing_is_judged_in_between() -> None:
    m = Machine()
    assert m.run(100, 101, 108, 95) == []
    left = m.run(118, 139)
    assert left == ["the speed leaves 955 rpm: decisions are suspended until it is steady"]
    with pytest.raises(Refused, match="the speed has left 955 rpm and is not steady yet; a burst could not be evaluated"):
        _ = m.pipeline.problem
    m.pipeline.announce(Burst("later", 1, 10, 1))
    assert m.run(139, 139.5) == []
    assert m.run(139, 139, 139) == ["model, thresholds and detectors are those of 1337 rpm now"]
    assert m.run(140, 140) == []
    assert [p.node for p in m.made] == [100.0, 140.0]
    assert m.made[0].seen == [0, 1, 2, 3]
    assert m.made[1].seen == [9, 10, 11, 12]
    assert m.made[1].known == ["later"]
    assert m.pipeline.problem is m.made[1].problem


def test_a_burst_on_the_way_is_named_and_not_judged() -> None:
    m = Machine()
    m.run(100)
    assert m.run(130, burst="b7") == ["the speed leaves 955 rpm: decisions are suspended until it is steady; burst b7 is not judged"]
    assert m.run(140, 140, 140, 140, 140, burst="b7") == []
    assert m.run(140) == ["model, thresholds and detectors are those of 1337 rpm now"]


def test_a_speed_without_model_is_said_once_and_tried_again_at_the_next() -> None:
    m = Machine(highest=150.0)
    m.run(100)
    said = m.run(200, *[200.0] * 15)
    assert said[1:] == ["at 1910 rpm no decision is possible: there is no model at this speed"]
    assert len(m.made) == 1
    assert m.run(100, *[100.0] * 5)[-1] == "model, thresholds and detectors are those of 955 rpm now"


def test_a_speed_that_is_no_number_is_no_speed() -> None:
    m = Machine()
    m.run(100)
    assert "the speed leaves" in m.run(float("nan"))[0]
    block = Block("m", "s", 9, 90, 0.01, 0, CHANNELS[:2], np.zeros((10, 2)))
    assert m.pipeline.step(block).findings[0].message.startswith("block 9 of 'm': block has no channel 'aux_speed'")


class Beside:
    """Takes what is to be made later, and makes it when asked."""

    def __init__(self) -> None:
        self.asked: list[tuple] = []

    def __call__(self, make) -> Future:
        self.asked.append((make, Future()))
        return self.asked[-1][1]

    def finish(self) -> None:
        make, promise = self.asked.pop()
        try:
            promise.set_result(make())
        except BadInput as error:
            promise.set_exception(error)


COURSE = (100.0, 139.0, *[140.0] * 40, 170.0, *[180.0] * 30)


def test_parts_made_beside_the_worker_see_the_same_blocks_and_say_the_same() -> None:
    at_once, beside = Machine(), Beside()
    said = at_once.run(*COURSE)
    m = Machine(later=beside)
    reported = m.run(*COURSE[:12])
    assert len(m.made) == 1  # nothing made yet: blocks wait
    with pytest.raises(Refused):
        _ = m.pipeline.problem
    beside.finish()
    reported += m.run(*COURSE[12:60])
    assert not beside.asked[1:]
    beside.finish()
    reported += m.run(*COURSE[60:])
    assert reported == said
    assert [p.seen for p in m.made] == [p.seen for p in at_once.made]
    assert m.residuals[-1]


def test_no_model_there_is_said_when_it_is_known() -> None:
    beside = Beside()
    m = Machine(highest=150.0, later=beside)
    m.run(100)
    assert m.run(200, *[200.0] * 15)[1:] == []
    beside.finish()
    assert m.run(200.0, 200.0) == ["at 1910 rpm no decision is possible: there is no model at this speed"]


def test_too_many_blocks_make_the_worker_wait(monkeypatch) -> None:
    monkeypatch.setattr("afdsvc.diagnosis.speed_schedule.WAITING", 5)
    m = Machine(later=lambda make: SimpleNamespace(done=lambda: False, result=make))
    m.run(100, 139, *[140.0] * 20)
    assert [p.node for p in m.made] == [100.0, 140.0]
    assert m.made[1].seen[-1] == 21
