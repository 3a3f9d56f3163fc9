"""Settings that decide which burst is designed and what counts as detected or isolated."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class BurstSettings:
    """Design of bursts; durations as shares of the burst, frequencies as shares of each other unless stated.

    All are design choices; `noise_peak` follows from the Gaussian tail.
    """

    #: Share of the burst taken by each ramp.
    ramp: float = 0.05
    #: Share of the transient to which the loop is left to settle before the lines are measured.
    settled: float = 1e-3
    #: Largest share of the burst left out while the loop settles.
    settling: float = 0.5
    #: Largest share of the transient that may remain then; a loop that rings longer is refused the burst.
    ringing: float = 0.05
    #: Number of candidate frequencies of the diagnosis burst, spaced geometrically.
    candidates: int = 48
    #: Fewest whole periods of the slowest line.
    fewest_periods: int = 8
    #: Highest frequency as a share of Nyquist's.
    highest: float = 0.5
    #: Smallest relative distance of two lines on one input.
    same_input_distance: float = 0.4
    #: Smallest relative distance of two lines, and of a line from a multiple of the rotor speed.
    distance: float = 0.02
    #: Multiples of the rotor speed from which lines keep away.
    rotor_orders: int = 4
    #: Smallest distance of a line from these multiples, in periods within the steady part.
    rotor_periods: int = 3
    #: Peak of the noise in standard deviations, kept free within the limits: exceeded with probability 4e-8 per sample.
    noise_peak: float = 5.5
    #: Share of the severities a loop survives up to which a burst is safe: closer to the loss of the loop no burst is small enough.
    survived: float = 0.9
    #: Probability of detection from which a severity counts as detectable.
    detected: float = 0.99
    #: Posterior weight that isolates a fault.
    isolating_weight: float = 0.99
    #: Probability of reaching that weight from which a pair of faults counts as isolated.
    isolation_probability: float = 0.99


BURST = BurstSettings()
