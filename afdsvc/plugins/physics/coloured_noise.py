"""Coloured noise: what does not repeat with the excitation is not white."""

from __future__ import annotations

from collections.abc import Iterable

from afdsvc.api.physics import Hypothesis, Machine


class ColouredNoise:
    """Named from the spectrum of what does not repeat, not by a law: noise has no trajectory to be simulated."""

    name = "coloured_noise"
    summary = "noise whose spectrum is not flat, where the model assumes white noise"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return nothing: the noise analysis names this one itself."""
        return []
