"""How a trial is staged: which machine under which controller, what is played, how noisy, how dirty."""

from __future__ import annotations

from dataclasses import dataclass

from afdsvc.errors import BadInput
from afdsvc.trial.machines.bearing import gas_bearing_machine
from afdsvc.trial.machines.machine import TrialMachine
from afdsvc.trial.machines.positioning_axis import positioning_axis

CHOICES = {
    "machine": ("gas_bearing", "positioning_axis"),
    "controller": ("lqg", "proportional"),
    "injection": ("youla", "added"),
    "excitation": ("multisine", "one_level", "sine", "operation"),
    "measure": ("auto", "commands", "loop"),
    "noise": ("white", "coloured", "process", "quieter", "louder"),
}


@dataclass(frozen=True, slots=True)
class Options:
    """Settings of one trial; the names are those of `CHOICES`.

    ``controller`` and ``injection`` (alpha through the observer as in J_K, or added to the command) concern the bearing.
    ``noise``: white as the model says, coloured of the same variance, driving the states too (process), or white of half
    or twice the stated standard deviation. ``dirty`` hides four small unrelated effects (rho 0.04 each) besides.
    ``parameter_error`` is the standard deviation of the plant's own errors in units of the stated one. ``known_controller``
    says whether the MODEL.toml carries the controller. ``periods`` of the excitation are recorded (0: as the machine has it).
    ``measure`` is how rho is measured (`afdsvc.trial.effects.severity.effect_visibility`); auto: by commands where the plant is stable.
    """

    machine: str = "gas_bearing"
    controller: str = "lqg"
    injection: str = "youla"
    excitation: str = "multisine"
    noise: str = "white"
    dirty: bool = False
    parameter_error: float = 1.0
    known_controller: bool = True
    periods: int = 0
    measure: str = "auto"

    def __post_init__(self) -> None:
        for name, allowed in CHOICES.items():
            if getattr(self, name) not in allowed:
                raise BadInput(f"option {name} is '{getattr(self, name)}'; one of {', '.join(allowed)} is wanted")

    def build(self) -> TrialMachine:
        """Return the machine."""
        if self.machine == "positioning_axis":
            return positioning_axis()
        return gas_bearing_machine(self.controller, self.injection)

    def measured(self, machine: TrialMachine) -> str:
        """Return how rho is measured on the machine."""
        if self.measure != "auto":
            return self.measure
        return "commands" if machine.stable else "loop"
