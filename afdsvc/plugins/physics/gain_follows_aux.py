"""A gain that follows an auxiliary signal, such as pressure or temperature."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine, Signal, Size
from afdsvc.plugins.physics.attach import at_input, at_output


def _scaled(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``w (1 + c d + b d^2)`` with ``d = aux - mean``."""
    d = z[1] - p[1]
    out[0] += (p[0] + p[2] * d) * d * z[0]


def varying(machine: Machine) -> list[Size]:
    """Return the auxiliary signals that vary and are not angles."""
    return [a for name, a in machine.aux.items() if name != "angle" and a.rms > 1e-6 * max(abs(a.mean), 1e-300) and a.rms > 0]


def curvature(aux: Size, unit: str, scale: float) -> Coefficient:
    """Return the bend of what follows a signal: how its ``scale`` per unit of the signal changes with the signal."""
    per = scale / aux.rms
    return Coefficient("curvature", unit, -100 * per, 100 * per, per, linear=True, nuisance=True)


class GainFollowsAux:
    """An actuator or sensor whose gain depends on an auxiliary signal, for every place and signal."""

    name = "gain_follows_aux"
    summary = "a gain that follows a measured auxiliary signal"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per input or output and varying auxiliary signal."""
        places: list[tuple[Callable[..., Hypothesis], tuple[Size, ...], str]] = [
            (at_input, machine.inputs, "input"), (at_output, machine.outputs, "reading"),
        ]
        for attach, ports, word in places:
            for port in ports:
                for aux in varying(machine):
                    yield attach(port, _scaled, [Signal("aux", aux.index)], **_parts(self.name, aux, word))


def _parts(name: str, aux: Size, word: str) -> dict[str, Any]:
    scale = 0.05 / aux.rms
    unit = f"1/({aux.unit})" if aux.unit else ""
    return {
        "physics": name, "family": "follows aux",
        "parameters": [
            Coefficient(f"share per {aux.name}", unit, -100 * scale, 100 * scale, scale, linear=True),
            Coefficient("reference", aux.unit, aux.mean, aux.mean, 1.0, nuisance=True),
            curvature(aux, unit, scale),
        ],
        "starts": [(0.0, aux.mean, 0.0)], "notes": {"variant": aux.name},
        "predicts": f"a residual proportional to the {word} that changes sign with {aux.name} about its mean",
        "refuted_by": f"a gain that stays the same while {aux.name} varies",
    }
