"""Voltage drop: a constant voltage lost against the current, in brushes, diodes or the dead time of an inverter."""

from __future__ import annotations

from collections.abc import Iterable

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_state, decaying, quantity, state
from afdsvc.plugins.physics.coulomb_friction import coulomb_force, rounding


class VoltageDrop:
    """A voltage against every current that is a state and takes both signs, beside each input that acts on it at once."""

    name = "voltage_drop"
    summary = "a voltage that is lost against the current, in brushes, diodes or the dead time of an inverter"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per current and input; it fades where the current is small."""
        if machine.plant is None:
            return
        for x, _ in decaying(machine):
            for u in machine.inputs:
                size = abs(float(machine.plant.B[x.index, u.index])) * u.rms
                if size and x.reverses and (quantity(x.unit) == "current" or quantity(u.unit) == "voltage"):
                    yield at_state(
                        x, coulomb_force, [state(x)], physics=self.name, family="friction", starts=[(0.0, share * x.rms) for share in (0.02, 0.2)],
                        parameters=[
                            Coefficient("voltage", u.unit, 0.0, 20 * size, 0.05 * size, linear=True, through=(x.index, u.index), unsigned=True),
                            rounding(x),
                        ],
                        notes={"variant": u.name, "of": u.name},
                        predicts="a jump of the voltage where the current changes sign; its share falls as the amplitude grows",
                        refuted_by="a residual that does not depend on the sign of the current",
                    )
