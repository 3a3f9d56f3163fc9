"""The whole check before any fit: findings, measured against simulated, and what `identify` and `explain` will try."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from afdsvc.api.model import Model
from afdsvc.api.physics import Physics
from afdsvc.api.signals import Trace
from afdsvc.dataset.experiment import Run, prepare
from afdsvc.dataset.sample_checks import Finding
from afdsvc.errors import BadInput
from afdsvc.explain.check.check import check
from afdsvc.explain.check.comparison import Compared, compared
from afdsvc.explain.check.information import noise_sd, posterior_sd
from afdsvc.explain.check.offers import Offers, offers
from afdsvc.explain.search.build import build
from afdsvc.explain.search.problem import Problem
from afdsvc.explain.settings import Settings
from afdsvc.explain.simulate.nominal import mean_input, nominal
from afdsvc.identify.pipeline import MethodPlan, planned

MOST = 20_000  # samples of a recording that are simulated here
NOTHING = Offers((), {}, {})


@dataclass(frozen=True, slots=True, eq=False)
class CheckResult:
    """What can be said of a model and its recordings before any fit.

    ``findings`` are sentences of kind "ok", "warning" or "stop"; ``outputs`` measured against simulated; ``offers`` what `explain` will
    try; ``plan`` what `identify` will do; ``parameters`` by name the standard deviation after the recordings over the one stated.
    """

    model: Model
    findings: tuple[Finding, ...]
    outputs: tuple[Compared, ...] = ()
    offers: Offers = NOTHING
    plan: MethodPlan = field(default_factory=MethodPlan)
    parameters: Mapping[str, float] = field(default_factory=dict)

    @property
    def verdict(self) -> str:
        """"refused" where a finding forbids a conclusion, "limited" where one limits it, else "ready"."""
        kinds = {f.kind for f in self.findings}
        return "refused" if "stop" in kinds else "limited" if "warning" in kinds else "ready"

    def json(self) -> dict[str, Any]:
        """Return the document of ``check --json``."""
        return {
            "verdict": self.verdict,
            "findings": [{"kind": f.kind, "topic": f.topic, "sentence": f.sentence} for f in self.findings],
            "outputs": {
                c.output: {"r2": c.r2, "gain": c.gain, "delay_s": c.delay, "offset": c.offset, "unit": c.unit, "how": c.how} for c in self.outputs
            },
            "explain": {"axes": list(self.offers.axes), "tried": {k: list(v) for k, v in self.offers.tried.items()}, "not_tried": dict(self.offers.absent)},
            "identify": {"method": self.plan.method, "sentence": self.plan.sentence},
            "parameters": dict(self.parameters),
        }


def check_all(model: Model, traces: Sequence[Trace], library: Sequence[Physics]) -> CheckResult:
    """Return the check of recordings against a model; what does not fit is a finding, nothing is raised for it."""
    findings = check(model, traces)
    plan = planned(model, traces)
    try:
        problem = _problem(model, prepare(model, traces))
    except BadInput:  # a finding says why
        return CheckResult(model, findings, plan=plan)
    return CheckResult(model, findings, compared(problem), offers(problem, library), plan, _parameters(problem))


def _problem(model: Model, runs: Sequence[Run]) -> Problem:
    short = [r.span(0, MOST) if len(r) > MOST else r for r in runs]
    return build(nominal(model, runs[0].dt, mean_input(runs)), short, Settings(), short)


def _parameters(problem: Problem) -> dict[str, float]:
    nominal = problem.nominal
    shares = posterior_sd(problem, noise_sd(nominal, problem.runs))
    return {e.name: float(s) for e, s in zip(nominal.entries, shares, strict=True)}
