"""Bursts that enter through references: a site-file choice, from the design to the recording and its diagnosis."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.app import commissioning, pipelines, ports
from afdsvc.app.pipelines import pipeline_of
from afdsvc.diagnosis.verdict import conclude
from afdsvc.errors import BadInput, Refused
from afdsvc.files.site import parse_site
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.manager import load
from afdsvc.service.clock import FastClock

SITE = """site = "t"
[[machines]]
id = "m"
plant = "gas_bearing"
controller = {{kind = "{controller}", settings = {{{settings}}}}}
driver = {{seed = 3, real_time = false, faults = [{{name = "vertical_actuator", severity = -0.3, at_seconds = 0.0}}]}}
bursts = {{seconds = 1.0, through = "{through}"}}
"""


def machine(through, controller="lqg", settings=""):
    text = SITE.format(through=through, controller=controller, settings=settings)
    return commissioning.commission(parse_site(text, "site.toml").machines[0], load())


@pytest.mark.parametrize("through", ["input", "setpoint"])
def test_a_burst_through_references_finds_a_fault_and_keeps_the_limits(through):
    made, plugins = machine(through), load()
    pipeline = pipeline_of(made, plugins)
    burst = pipelines.diagnosis_burst(made)(pipeline.problem)
    pipeline.announce(burst)
    port = ports.open_port(made, "s", FastClock(0), plugins)
    evidence, largest, block = [], np.zeros(2), port.read()
    while pipeline.ready_at is None or block.k0 < pipeline.ready_at:
        pipeline.step(block)
        block = port.read()
    pipeline.step(block)
    with port.arm(made.limits) as drive:
        drive.play(burst)
        while drive.playing:
            block = port.read()
            evidence += pipeline.step(block).evidence
            largest = np.maximum(largest, np.abs(block.role("y")).max(axis=0))
            assert not block.role("alpha").size
            assert block.role("ref").any() == bool(block.burst)
    port.close()
    assert (largest < made.limits.output).all()
    verdict = conclude(evidence)
    assert verdict.fault == "vertical_actuator"
    assert abs(verdict.severity.value + 0.3) < 4 * verdict.severity.sd


def test_references_need_a_square_machine_and_leave_no_place_for_q():
    made = machine("setpoint")
    with pytest.raises(Refused, match=r"excited through its references .* Q needs 'alpha'"):
        pipeline_of(made, load()).announce_tuning("q", StateSpace.gain(np.zeros((2, 2)), made.plant.dt))
    with pytest.raises(BadInput, match=r"bursts\.through"):
        machine("elsewhere")
