"""Evidence: statistic, threshold, estimates and weights of one decision."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

SMALLEST_P = 1e-9  # below, the distributions of the tests, exact only for many samples, say no more than this


def p_value_text(p: float) -> str:
    """Return a p-value in words: ``p = 0.03``, or a bound (``p < 1e-09``) where it is too small to be a number."""
    return f"p < {SMALLEST_P:.0e}" if p < SMALLEST_P else f"p = {p:.2g}"


@dataclass(frozen=True, slots=True)
class Severity:
    """An estimated fault severity (0 healthy, -1 total loss) with its standard error.

    ``low`` and ``high`` are the ends of its 95 % interval, None where only the standard error is known. Of a detected fault all four
    are conditional on the detection.
    """

    value: float
    sd: float
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True, slots=True)
class Evidence:
    """One decision of one detector, with everything it rests on.

    ``statistic`` against ``threshold`` decides ``detected``; ``weights`` are the posterior weights of the fault
    hypotheses (with ``none_of_these`` when no fault fits), ``fault`` the likeliest or None when nothing was detected or
    the weights do not single one out. ``output`` names the output the statistic was computed from, "" for all together.
    ``trustworthy`` is False when a gate failed (residual not white, saturated actuator, excitation absent); then
    ``reason`` says which, in one sentence, and ``detected`` must not raise an alarm. ``k`` is the sample index of the
    decision, ``seconds`` its time since the session started, ``p_white`` the p-value of the whiteness test.
    """

    detector: str
    machine: str
    k: int
    seconds: float
    statistic: float
    threshold: float
    detected: bool
    burst: str = ""
    output: str = ""
    fault: str | None = None
    severity: Severity | None = None
    weights: Mapping[str, float] = field(default_factory=dict)
    trustworthy: bool = True
    reason: str = ""
    p_white: float | None = None
    parts: Mapping[str, float] = field(default_factory=dict)
