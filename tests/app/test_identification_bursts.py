"""Bursts played for something else than detection, with hundreds of lines: recorded, never judged, and no detector breaks on them."""

from __future__ import annotations

import numpy as np

from afdsvc.app import commissioning, pipelines, ports, serve
from afdsvc.app.pipelines import pipeline_of
from afdsvc.files.site import parse_site
from afdsvc.plugins.manager import load


def test_an_identification_burst_is_not_judged_and_breaks_no_detector():
    text = """site = "t"
[[machines]]
id = "m"
plant = "gas_bearing"
driver = {seed = 3, real_time = false}
"""
    machine, plugins = commissioning.commission(parse_site(text, "site.toml").machines[0], load()), load()
    pipeline = pipeline_of(machine, plugins)
    burst = pipelines.identification_burst(machine, "identify", np.random.default_rng(0))
    assert len(burst.lines) > 100
    pipeline.announce(burst)
    port = ports.open_port(machine, "s", serve.RealClock(), plugins)
    found, blocks = [], 0
    with port.arm(machine.limits) as drive:
        drive.play(burst)
        while drive.playing:
            outcome = pipeline.step(port.read())
            found += outcome.evidence
            blocks += outcome.residual is not None
    port.close()
    assert blocks * 250 >= burst.samples
    assert found == []
    assert pipeline._broken == {}
