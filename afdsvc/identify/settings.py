"""Settings that decide whether recordings support a model, and which route identification takes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class IdentificationSettings:
    """Thresholds of identification: shares and ratios without unit unless stated.

    Shares and significance levels are design choices; the numerical limits follow from double precision (relative rounding 1e-16).
    """

    #: Share of the controller's own action that recorded excitation may leave unexplained.
    controller_mismatch: float = 1e-3
    #: Power of a spectral bin, relative to the strongest, above which it counts as excited.
    line_level: float = 1e-5
    #: Movement relative to that of the plant's input below which an excitation counts as none (filter transients remain).
    least_movement: float = 3e-3
    #: Share of an input's power that the other inputs may explain (95 % would still separate them, poorly).
    largest_dependence: float = 0.999
    #: Largest modulus of a continuous pole times the sample time for which sampling is meaningful.
    largest_rate: float = 30.0
    #: Significance level of the test whether the outputs respond to the inputs.
    response_level: float = 1e-4
    #: Significance level of the test for feedback when no controller is stated.
    feedback_level: float = 0.01
    #: Share of an input's power that the noise of the outputs causes, above which a recording counts as made in closed loop: the larger part.
    feedback_share: float = 0.5
    #: Largest order that is tried where nothing is known of the plant.
    largest_order: int = 30
    #: Growth of an unstable mode over a recording up to which a simulation in open loop is evaluated.
    largest_growth: float = 1e3
    #: Largest condition number of the data matrix for the Gram route: relative error about 1e-16 times its square.
    gram_condition: float = 1e4
    #: Smallest share of the information about a parameter that is independent of the others.
    independent_share: float = 1e-10
    #: Fewest samples of a recording for a fit of physical parameters.
    parametric_samples: int = 100
    #: Error held out of the identified model, over that of the model that was given, from which it is reported as worse.
    worse: float = 1.1
    #: Groups of windows in the cross-validation of the order.
    order_groups: int = 10


SETTINGS = IdentificationSettings()
