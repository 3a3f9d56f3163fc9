"""`afdsvc retune`: Q for what was diagnosed, with the machine's own retuner and cost, and its design sheet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from afdsvc.api.detection import DetectionProblem
from afdsvc.api.retuning import Diagnosed, LoopCost, Tuning
from afdsvc.app.commissioning import Commissioned, controller_settings
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.manager import Plugins
from afdsvc.retune.cost import WEIGHTS, loop_cost, signal_model, with_q
from afdsvc.retune.design import deviations
from afdsvc.retune.proof import Proof, proved_tuning
from afdsvc.service.retuning import Design


def tuning_design(machine: Commissioned, plugins: Plugins) -> Design:
    """Return the design of Q for the machine's faults: the site's retuner, then the proof; it raises `Refused` with the reason that binds.

    The cost has the weights of the running controller where it was designed with any, and those of key ``retune.cost`` before all.
    """
    wanted = machine.config.retune

    def design(problem: DetectionProblem, found: Diagnosed) -> tuple[Tuning, str, Mapping[str, Any]]:
        cost = loop_cost(problem, {**_own_weights(machine, problem), **wanted.cost})
        Q = plugins.get("retuners", wanted.kind).design(problem, found, cost, wanted.settings)
        tuning, proof = proved_tuning(problem, found, cost, Q)
        return tuning, proof_sentence(proof), {**asdict(proof), "signals": _signals(problem, found, cost, Q)}

    return design


def _own_weights(machine: Commissioned, problem: DetectionProblem) -> dict[str, Any]:
    """Return the weights that the running controller was designed with; a disturbance that is known comes before what was assumed."""
    used = {key: value for key, value in controller_settings(machine).items() if key in WEIGHTS}
    return used if problem.process_cov is None else {key: value for key, value in used.items() if key != "process_weight"}


def proof_sentence(proof: Proof) -> str:
    """Return what was proved in one sentence."""
    return (
        f"stable for every severity of the interval and in the healthy machine; cost {proof.cost_before:.4g} to {proof.cost_after:.4g} "
        f"({100 * proof.reached:.0f} % of the possible), sensitivity {proof.sensitivity_before:.3g} to {proof.sensitivity_after:.3g}"
    )


def _signals(problem: DetectionProblem, found: Diagnosed, cost: LoopCost, Q: StateSpace) -> list[dict[str, Any]]:
    """Return the standard deviation of every signal that has a limit, in the middle of the interval without and with Q."""
    model, m, p = signal_model(problem, cost, {found.fault: found.middle}), problem.plant.inputs, problem.plant.outputs
    names = [*(f"u_{n}" for n in problem.input_names or range(m)), *(f"y_{n}" for n in problem.output_names)]
    before, after = (deviations(with_q(model, Q, gain), m, p) for gain in (0.0, 1.0))
    return [{"signal": n, "before": float(a), "after": float(b)} for n, a, b in zip(names, before, after, strict=True)]
