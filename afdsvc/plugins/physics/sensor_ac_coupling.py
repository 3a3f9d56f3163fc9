"""AC coupling: a reading that loses what is slow, behind a capacitor or in a charge amplifier."""

from __future__ import annotations

from collections.abc import Iterable

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_output, constant
from afdsvc.plugins.physics.sensor_lag import lagged, with_sensor_lag


class SensorAcCoupling:
    """A high-pass of first order at every output, from the slowest that the recordings show to the fastest that is excited."""

    name = "sensor_ac_coupling"
    summary = "a first-order high-pass between the motion and the reading: AC coupling, a charge amplifier"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per output."""
        fast, slow = 0.1 / machine.bandwidth, max(machine.duration, 10 / machine.bandwidth)
        for port in machine.outputs:
            yield at_output(
                port, lagged, physics=self.name, family="timing", memory=3, unsettled=1,
                parameters=[Coefficient("time constant", "s", fast, slow, 0.1 * fast), constant("high-pass", "", 1.0)],
                starts=[(fast ** (1 - s) * slow**s, 1.0) for s in (0.25, 0.5, 0.75)],
                linear=lambda plant, values, row=port.index: with_sensor_lag(plant, values, row, high=True),
                predicts="phase lead and loss of gain towards low frequency in this output, whatever drives it", refuted_by="a reading that holds a constant value",
            )
