"""A rehearsal leaves a machine's pipeline as it was, and takes the design of its burst out of the worker's way."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from afdsvc.app import commissioning
from afdsvc.app.pipelines import diagnosis_burst, pipeline_of
from afdsvc.files.site import parse_site
from afdsvc.plugins.manager import load
from afdsvc.service.warm_up import WarmUp, warm_up


def machine():
    site = parse_site('site = "t"\n[[machines]]\nid = "m"\nplant = "gas_bearing"\nbursts = {seconds = 0.5}\n', "test")
    made = commissioning.commission(site.machines[0], load())
    pipeline = pipeline_of(made, load())
    return pipeline, diagnosis_burst(made)(pipeline.problem)


def test_the_pipeline_is_not_touched_and_the_design_is_there(monkeypatch):
    pipeline, burst = machine()
    warm_up(pipeline, burst)
    assert pipeline.ready_at is None
    assert not pipeline.bursts
    detector = next(d for d in pipeline.detectors if d.name == "cusum")
    first, second = (detector.statistic.start(replace(burst, name=name), pipeline.dt) for name in ("the first real one", "the next"))
    assert first.plan is second.plan, "a burst of another name is designed anew"
    monkeypatch.setattr(type(detector.statistic), "plan", None)
    assert detector.statistic.start(burst, pipeline.dt).plan is first.plan


def test_what_fails_is_reported_and_the_others_are_rehearsed(caplog):
    pipeline, burst = machine()
    broken = replace(burst, waveform=np.zeros((burst.samples, burst.inputs)), lines=(), samples=burst.samples)
    rehearsals = WarmUp([(replace_expected(pipeline), broken), (pipeline, burst)])
    rehearsals.start()
    deadline = time.monotonic() + 30
    while rehearsals._thread.is_alive() and time.monotonic() < deadline:
        time.sleep(0.02)
    rehearsals.close()
    assert "machine 'm': its burst could not be rehearsed" in caplog.text


def replace_expected(pipeline):
    """Return a pipeline that expects one channel, which no block of the machine has."""
    from afdsvc.diagnosis.pipeline import Pipeline

    expected = replace(pipeline.expected, channels=pipeline.expected.channels[:1])
    return Pipeline(pipeline.problem, pipeline.detectors, expected)
