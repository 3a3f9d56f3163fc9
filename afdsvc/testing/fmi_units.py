"""FMI units for tests and examples, built on the spot by pythonfmu (FMI 2) or pythonfmu3 (FMI 3)."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

SLIDE = '''
from {package} import DefaultExperiment, Fmi{v}Causality, Fmi{v}Slave, Fmi{v}Variability, {real}


class {name}(Fmi{v}Slave):
    """A slide on a spring: force in N, position in mm; friction [N] unless it is 0; fails or answers NaN after a while on request."""

    default_experiment = DefaultExperiment(start_time=0.0, stop_time=1.0, step_size={step})

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.author = ""
        self.force = self.position = self.velocity = self.friction = self.fail_after = self.nan_after = 0.0
        self.stiffness = 4000.0
        self.register_variable({real}("force", causality=Fmi{v}Causality.input{continuous}))
        self.register_variable({real}("position", causality=Fmi{v}Causality.output{continuous}))
        self.register_variable({real}("velocity", causality=Fmi{v}Causality.local{continuous}))
        for name in ("stiffness", "friction", "fail_after", "nan_after"):
            self.register_variable({real}(name, causality=Fmi{v}Causality.parameter, variability=Fmi{v}Variability.fixed))

    def do_step(self, current_time, step_size):
        if self.fail_after and current_time > self.fail_after:
            raise RuntimeError("the mesh is torn")
        h = step_size / 20
        for _ in range(20):
            sign = (self.velocity > 0) - (self.velocity < 0)
            push = self.force - self.friction * sign
            self.velocity += h * (-self.stiffness * self.position - 20 * self.velocity + 500 * push)
            self.position += h * self.velocity
        if self.nan_after and current_time > self.nan_after:
            self.position = float("nan")
        return True
'''


def build_slide(folder: Path, fmi: int = 2, step: float = 2e-3) -> Path:
    """Build the slide as ``Slide2.fmu`` or ``Slide3.fmu``; raises ImportError where pythonfmu (pythonfmu3) is not installed.

    Python units in one process share its modules by name, so the two have different ones.
    """
    name = f"Slide{fmi}"
    package = "pythonfmu" if fmi == 2 else "pythonfmu3"
    builder = import_module(f"{package}.builder").FmuBuilder
    words = {"package": package, "v": fmi, "name": name, "step": step, "real": "Real" if fmi == 2 else "Float64"}
    words["continuous"] = "" if fmi == 2 else ", variability=Fmi3Variability.continuous"
    script = folder / f"{name.lower()}_unit.py"
    script.write_text(SLIDE.format(**words), encoding="utf-8")
    builder.build_FMU(str(script), dest=str(folder))
    return folder / f"{name}.fmu"
