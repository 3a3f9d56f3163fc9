"""A Python function as a machine: design the burst, close the loop, play it to the healthy machine and to one whose actuator is weak.

    python simulator_function.py       # writes slide.toml and site.toml, and runs the machine as fast as it goes
    afdsvc rig site.toml --machine slide     # the same machine for a service: afdsvc serve site.toml
"""

from __future__ import annotations

from pathlib import Path

from afdsvc.app import commissioning, ports
from afdsvc.app.pipelines import diagnosis_burst, pipeline_of
from afdsvc.files.site import read_site
from afdsvc.plugins.manager import load
from afdsvc.service.clock import FastClock

FUNCTION = '''
"""The slide. x is the state (None at the start), u the inputs held for dt seconds; returned are state and outputs at the end."""


def slide(x, u, dt, stiffness=4000.0):
    q, v = (0.0, 0.0) if x is None else x
    h = dt / 20
    for _ in range(20):
        v += h * (-stiffness * q - 20 * v + 500 * u[0])
        q += h * v
    return (q, v), [q]
'''
MODEL = """
name = "slide"
time = "continuous"
inputs = [{name = "force", unit = "N"}]
outputs = [{name = "position", unit = "mm"}]
states = [{name = "q", unit = "mm"}, {name = "v", unit = "mm/s", rate_of = "q"}]
A = [[0, 1], [-4000, -20]]
B = [[0], [500]]
C = [[1, 0]]
D = [[0]]
"""
SITE = """
site = "hall"
[[machines]]
id = "slide"
model = "slide.toml"
options = {sample_time = 0.002}
output_sd = [0.01]
limits = {output = [6.0], input = [10.0], seconds = 4.0}
controller = {kind = "state_space", settings = {A = [], B = [], C = [], D = [[-1.0]]}}
faults = [{name = "force_actuator", kind = "actuator_gain", settings = {input = 0}}]
[machines.driver]
kind = "function"
unit = "slide.py:slide"
real_time = false
options = {stiffness = 4000.0}
faults = FAULTS
[machines.bursts]
seconds = 2.0
"""


def watch(weak: float) -> None:
    """Run the machine with a burst and print what the detectors say; ``weak`` is the severity of the actuator's fault."""
    faults = f'[{{name = "force_actuator", severity = {weak}}}]' if weak else "[]"
    Path("site.toml").write_text(SITE.replace("FAULTS", faults))
    plugins = load()
    machine = commissioning.commission(read_site(Path("site.toml")).machine("slide"), plugins, allow_code=True)
    stream = pipeline_of(machine, plugins)
    burst = diagnosis_burst(machine)(stream.problem)
    port = ports.open_port(machine, "first", FastClock(), plugins)
    stream.announce(burst)
    found = []
    for _ in range(12):  # six quiet seconds: without them no decision is to be trusted
        found += stream.step(port.read()).evidence
    with port.arm(machine.limits) as drive:
        drive.play(burst)
        while drive.playing:
            found += stream.step(port.read()).evidence
    for _ in range(2):
        found += stream.step(port.read()).evidence
    port.close()
    for e in (e for e in found if e.burst):
        severity = f", severity {e.severity.value:+.2f} +- {e.severity.sd:.2f}" if e.detected and e.severity else ""
        said = e.reason or ("CHANGED" if e.detected else "as modelled")
        print(f"actuator {weak:+.0%}: {e.detector} statistic {e.statistic:.3g}, threshold {e.threshold:.3g}, {said}{severity}")


if __name__ == "__main__":
    Path("slide.py").write_text(FUNCTION)
    Path("slide.toml").write_text(MODEL)
    watch(0.0)
    watch(-0.3)
