"""The experiments behind the figures, run through the system: rig agent and service in two processes, zenoh, a recording (MCAP).

The rig is the simulator; a recording of a real rig that played the same lines serves as well: what is read from it are inputs, outputs, beta
and alpha, and when the burst and the fault began.
"""

from __future__ import annotations

import itertools
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import of_role
from afdsvc.app.demo import rig_process
from afdsvc.app.demo_site import free_port
from afdsvc.app.serve import serving
from afdsvc.errors import BadInput
from afdsvc.files.model.model_file import write_model
from afdsvc.files.recording.reader import Recording
from afdsvc.files.site import read_site
from afdsvc.lti.simulate import simulate
from afdsvc.plants.gas_bearing import gas_bearing
from afdsvc.wire.messages import EventKind
from benchmarks.thesis.machines import HALF, Detected, Loop, detect_in, wrong

QUIET, BURST, FAULT_AFTER = 6.0, 13.5, 7.0  # s before the burst, of it, and from the start to the fault
AXES = ("horizontal", "vertical")


PROPORTIONAL = 'controller = {kind = "proportional", settings = {gain = 0.2}}'
REST, TURNING, LQG = f'plant = "gas_bearing"\n{PROPORTIONAL}', f'plant = "gas_bearing"\noptions = {{rpm = 1100}}\n{PROPORTIONAL}', 'plant = "gas_bearing"'
UNSTABLE = """plant = "unstable_second_order"
controller = {kind = "lqg", settings = {state_weight = 1.0, input_weight = 0.1, process_weight = 1.0, noise_weight = 1.0}}
limits = {output = [100.0], input = [100.0], alpha = [100.0]}"""  # P4 has none


@dataclass(frozen=True)
class Experiment:
    """One sine on one input, and a fault while it is played; ``machine``: the plant and controller of the site file.

    Without a fault it is one of identification: sines on every input from 50 to 10,000 rad/s, of together ``alpha`` rms each.
    """

    machine: str
    source: int
    rad_s: float
    alpha: float
    fault: str
    severity: float = HALF

    @property
    def input(self) -> str:
        """Name of the input that is excited."""
        return "input" if self.machine is UNSTABLE else AXES[self.source]

    def site(self, folder: Path) -> str:
        """Return the site file."""
        faults = f'{{name = "{self.fault}", severity = {self.severity}, at_seconds = {QUIET + FAULT_AFTER}}}' if self.fault else ""
        machine = self.machine if self.fault else wrong_machine(folder.parent)
        return f"""site = "thesis"
[transport]
listen = ["tcp/127.0.0.1:{free_port()}"]
[recording]
folder = "{folder.resolve().as_posix()}"
[[machines]]
id = "bearing"
{machine}
[machines.driver]
seed = 1
faults = [{faults}]
{"" if self.fault else FUNCTION}
[machines.bursts]
every_seconds = 1000
first_after_seconds = {QUIET}
isolate = false
seconds = {BURST}
lines = [{", ".join(f'{{input = "{name}", rad_s = {rad_s}, alpha = {alpha}}}' for name, rad_s, alpha in self.lines)}]
"""

    @property
    def lines(self) -> list[tuple[str, float, float]]:
        """Input, frequency [rad/s] and amplitude of every sine."""
        if self.fault:
            return [(self.input, self.rad_s, self.alpha)]
        rad_s = np.geomspace(50, 10_000, 2 * SINES)
        return [(AXES[i % 2], float(w), self.alpha * (2 / SINES) ** 0.5) for i, w in enumerate(rad_s)]


SINES = 30  # on each input
FUNCTION = 'kind = "function"\nunit = "bearing.py:bearing"'


def wrong_machine(folder: Path) -> str:
    """Write the true bearing as a function, and the model with half of its sampled A, into a folder; return what the site file says of them."""
    plant = gas_bearing()
    G, sd = plant.discrete(), np.sqrt(np.diag(plant.output_cov))
    matrices = "".join(f"{name} = np.array({getattr(G, name).tolist()})\n" for name in "ABC")
    (folder / "bearing.py").write_text(
        f"import numpy as np\n\n{matrices}\n\ndef bearing(x, u, dt):\n    x = np.zeros({G.order}) if x is None else A @ x + B @ u\n    return x, C @ x\n", encoding="utf-8"
    )
    write_model(Model("half of A", plant.inputs, plant.outputs, tuple(Variable(f"x{i}") for i in range(G.order)), wrong(0.5).plant, sample_time=G.dt), folder / "half.toml")
    weights = ", ".join(f"{name} = {value}" for name, value in plant.recommended["lqg"].items())
    return f"""model = "half.toml"
output_sd = {sd.tolist()}
controller = {{kind = "lqg", settings = {{{weights}}}}}
limits = {{output = [50.0, 50.0], input = [10.0, 10.0], alpha = [30.0, 30.0]}}"""


WAVE = 2.2602  # V, see gas_bearing_figures.ALPHA
EXPERIMENTS = {
    "rest": Experiment(REST, 0, 62.0, WAVE, "horizontal_actuator"),
    "turning": Experiment(TURNING, 0, 62.0, WAVE, "horizontal_actuator"),
    "lqg": Experiment(LQG, 1, 62.0, WAVE, "vertical_sensor"),
    "p3": Experiment(REST, 1, 1030.0, 0.3, "vertical_actuator", -0.1),
    "half-a": Experiment("", 0, 0.0, 2.0, ""),
    "p4-b1": Experiment(UNSTABLE, 0, 125.0, 0.1, "b1", -0.1),
    "p4-b2": Experiment(UNSTABLE, 0, 125.0, 0.1, "b2", -0.1),
}


def record(name: str, folder: Path) -> Path:
    """Run an experiment in real time (25 s) and return its recording, ``folder/NAME.mcap``."""
    path = folder / f"{name}.mcap"
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as place:
        site = Path(place) / "site.toml"
        site.write_text(EXPERIMENTS[name].site(Path(place) / "recordings"), encoding="utf-8")
        with serving(read_site(site)) as hub, rig_process(site, "bearing", QUIET + BURST + 2.0) as rig:
            rig.wait(120)
            hub.drain()
            files = hub.files()
        next(f for f in files if f.suffix == ".mcap").replace(path)
    return path


@dataclass(frozen=True, eq=False)
class Measured:
    """A recording of an experiment as arrays from its first sample: ``beta, y, u, alpha (n, channels)``; ``begin``, ``end`` and ``steady`` samples
    of the burst, ``fault`` the sample from which the fault is there."""

    experiment: Experiment
    beta: np.ndarray
    y: np.ndarray
    u: np.ndarray
    alpha: np.ndarray
    begin: int
    end: int
    steady: int
    fault: int

    @classmethod
    def of(cls, path: Path, name: str, fault_at: float | None = None) -> Measured:
        """Read a recording; ``fault_at`` [s] from its first sample where no event tells (a rig's). Raises `BadInput` where a part is missing."""
        recording = Recording(path)
        blocks = list(recording.blocks())
        if not blocks or any(b.k0 != a.k0 + len(a) for a, b in itertools.pairwise(blocks)):
            raise BadInput(f"{path}: expected blocks without a gap, found {len(blocks)} with one" if blocks else f"{path}: no blocks")
        first, values = blocks[0].k0, np.vstack([b.values for b in blocks])
        parts = {role: values[:, of_role(blocks[0].channels, role)] for role in ("beta", "y", "u", "alpha")}
        request = next((r for r in recording.requests() if r.burst.lines), None)
        begun = next((e.k for e in recording.events() if e.kind is EventKind.BURST_STARTED), None)
        if request is None or begun is None:
            raise BadInput(f"{path}: no burst of stated lines was played; expected bursts.lines in the site file")
        reported = next((e.k for e in recording.events() if e.kind is EventKind.FAULT_INJECTED), None)
        if reported is None and fault_at is None and EXPERIMENTS[name].fault:
            raise BadInput(f"{path}: no event tells when the fault began; expected the second of the fault as a third argument")
        fault = reported - first if reported is not None else round((fault_at or 0.0) / blocks[0].dt)
        burst, begin = request.burst, begun - first
        return cls(EXPERIMENTS[name], **parts, begin=begin, end=begin + burst.samples - burst.ramp, steady=burst.ramp + burst.settle, fault=fault)

    def residual(self, loop: Loop) -> np.ndarray:
        """Return the white residual r of the whole recording, ``(n, outputs)``."""
        return simulate(loop.problem.innovations, np.hstack([self.y, self.u]))[0]

    def healthy(self, loop: Loop) -> tuple[np.ndarray, np.ndarray]:
        """Return beta and r before the burst, without the first half second."""
        skip = round(0.5 / loop.problem.plant.dt)
        return self.beta[skip : self.begin], self.residual(loop)[skip : self.begin]

    def identification(self) -> tuple[np.ndarray, ...]:
        """Return u, y, alpha and beta while the burst is played."""
        return tuple(signal[self.begin : self.end] for signal in (self.u, self.y, self.alpha, self.beta))

    def detect(self, loop: Loop, fault: str, seen: int, window: int, false_alarm: float = 2e-5) -> Detected:
        """Return what the published detector finds while the burst is played."""
        e = self.experiment
        r = self.residual(loop)[self.begin : self.end]
        return detect_in(r, loop, fault, e.rad_s, e.alpha, e.source, seen, window, self.steady, self.fault - self.begin, false_alarm, e.severity)
