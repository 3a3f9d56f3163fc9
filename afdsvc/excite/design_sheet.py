"""The design sheet: expected detection and isolation of every fault of a machine with its diagnosis burst."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import brentq

from afdsvc.api.bursts import Burst
from afdsvc.api.detection import DetectionProblem, FalseAlarms
from afdsvc.detect.features.whiteness_gate import Gate
from afdsvc.detect.statistics.active_cusum import ActiveCusum
from afdsvc.detect.statistics.fault_curves import LoopResponse, loop_response
from afdsvc.detect.statistics.passive_cusum import passive_detector, unpromised
from afdsvc.detect.thresholds import maximum
from afdsvc.detect.thresholds.power import pair_confusion
from afdsvc.detect.thresholds.regressor_information import noise_driven
from afdsvc.excite.amplitude_budget import costs
from afdsvc.excite.efficiency import efficiency
from afdsvc.excite.expected_detection import ExpectedDetection, burst_detection
from afdsvc.excite.isolation import isolable_pairs
from afdsvc.excite.settings import BURST
from afdsvc.lti.statespace import Array

SEVERITIES = (-0.1, -0.25, -0.5, -1.0)
RARE = 1e-6  # confusions less likely than this are not listed


def design_sheet(
    problem: DetectionProblem,
    bursts: Sequence[Burst],
    alarms: Mapping[str, FalseAlarms],
    bursts_per_hour: float,
    severities: Sequence[float] = SEVERITIES,
) -> dict[str, Any]:
    """Return the sheet as a JSON document.

    ``alarms`` are the promised rates of the machine's detectors by name. Probabilities are those of the first burst
    and of the matched filter at the first burst detector's rate; ``p_detect`` counts the noise the faulty loop makes,
    ``confused_with`` is the probability that the other fault comes out likelier, ``smallest_detectable`` the severity
    that is found with probability 0.99. Documented keys: bursts, false_alarms_per_hour, thresholds, faults; beyond
    these ``unseen``, ``blind_pairs``, ``isolation`` and ``best_single_frequency`` say what the burst cannot do, and
    why. ``uncertain`` names the parameters of the model whose stated uncertainty is allowed for,
    ``unpromised`` says why no rate of alarms between bursts can be promised ("" where one can). ``isolation.pairs`` states for every two faults with which burst, or burst and second burst, they are separated
    (see `isolation`); so does ``isolated_by`` of every fault.
    """
    burst, seen = bursts[0], burst_detection(problem, bursts[0])
    rate = next((a.per_burst for n, a in alarms.items() if not n.startswith("passive")), problem.false_alarms.per_burst)
    h = seen.threshold(rate)
    omega = np.geomspace(math.pi / problem.plant.dt / 1000, 0.6 * math.pi / problem.plant.dt, 200)
    response = loop_response(problem, omega)
    efficient = efficiency(problem, omega, min(severities), response)
    best = efficient.best_single()
    typical = -0.5 if -0.5 in severities else severities[0]
    pairs = isolable_pairs(problem, burst, typical)
    return {
        "machine": problem.machine,
        "bursts": [entry for b in bursts for entry in _burst_entries(problem, b)],
        "false_alarms_per_hour": alarms_per_hour(alarms, bursts_per_hour),
        "thresholds": thresholds(problem, burst, alarms),
        "faults": [
            {**entry, "isolated_by": _isolated_by(fault, pairs)}
            for fault in problem.fault_names
            for entry in _fault_entries(problem, seen, fault, severities, h)
        ],
        "uncertain": sorted(problem.uncertainty),
        "unpromised": unpromised(problem) if any(name.startswith("passive") for name in alarms) else "",
        "unseen": [{"fault": name, "why": why} for name, why in unseen(problem, response).items()],
        "blind_pairs": blind_pairs(problem, efficient.pairs, problem.excitation_names),
        "isolation": {**_isolation(seen, typical, burst), "pairs": pairs},
        "best_single_frequency": {
            "input": _name(problem.excitation_names, best[1]), "rad_s": best[0], "efficiency": best[2],
        },
    }  # fmt: skip


def _burst_entries(problem: DetectionProblem, burst: Burst) -> list[dict[str, Any]]:
    """Return one entry for every input the burst plays on."""
    entries = []
    for j in sorted({line.input for line in burst.lines}):
        lines = [line for line in burst.lines if line.input == j]
        peak = sum(line.amplitude * costs(problem, [line.omega]).output[0, :, j] for line in lines)
        entries.append({
            "burst": burst.name, "input": _name(problem.excitation_names, j),
            "frequencies_rad_s": [line.omega for line in lines], "amplitudes": [line.amplitude for line in lines],
            "seconds": burst.samples * problem.plant.dt, "peak_output": float(np.max(peak)), "notes": dict(burst.notes),
        })  # fmt: skip
    return entries


def _fault_entries(
    problem: DetectionProblem, seen: ExpectedDetection, fault: str, severities: Sequence[float], h: float
) -> list[dict[str, Any]]:
    smallest, entries = smallest_detectable(seen, fault, h), []
    for severity in severities:
        gain, phase, channel = _strongest(problem, seen, fault, severity)
        entries.append({
            "fault": fault, "severity": severity, "gain": gain, "phase_deg": phase, "channel": channel,
            "p_detect": seen.detection(fault, severity, h), "deflection": seen.deflection(fault, severity),
            "smallest_detectable": smallest, "confused_with": _confusions(seen, fault, severity),
            "cramer_rao_sd": _finite(seen.deviation(fault, severity)),
        })  # fmt: skip
    return entries


def smallest_detectable(seen: ExpectedDetection, fault: str, threshold: float) -> float | None:
    """Return the severity found with probability 0.99, or None when even total loss is not."""
    low, high = seen.reach[fault]
    if seen.detection(fault, low, threshold) < BURST.detected:
        return None
    return float(brentq(lambda s: seen.detection(fault, s, threshold) - BURST.detected, low, high - 1e-6 * (high - low)))


def _confusions(seen: ExpectedDetection, fault: str, severity: float) -> dict[str, float]:
    others = {o: pair_confusion(seen.separation(fault, severity, o)) for o in seen.curves.names if o != fault}
    return {o: p for o, p in others.items() if p > RARE}


def _strongest(problem: DetectionProblem, seen: ExpectedDetection, fault: str, severity: float) -> tuple[float, float, str]:
    """Return gain and phase [deg] of the whitened residual per unit alpha on the line and output that show the fault
    most, and their names."""
    r = seen.curves.response.paths(fault, [severity]).r[0]
    picked = np.stack([r[k, :, j] for k, j in enumerate(seen.curves.inputs)])
    shown = np.abs(picked * seen.curves.drive[:, None]) / np.sqrt(np.diag(problem.covariance))
    k, i = np.unravel_index(int(np.argmax(shown)), shown.shape)
    value = complex(picked[k, i])
    channel = f"{_name(problem.excitation_names, seen.curves.inputs[k])} to {_name(problem.output_names, int(i))}"
    return abs(value), float(np.degrees(np.angle(value)) % 360), channel


def _isolation(seen: ExpectedDetection, severity: float, burst: Burst) -> dict[str, Any]:
    table = seen.separations(severity)
    rows = {
        a: {b: _finite(float(table[i, j])) for j, b in enumerate(seen.curves.names) if j != i}
        for i, a in enumerate(seen.curves.names)
    }
    return {"severity": severity, "separations": rows, "not_separated": burst.notes.get("not_separated", "")}


def _isolated_by(fault: str, pairs: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Return for every other fault the burst or bursts that tell it from this one."""
    own = [pair for pair in pairs if fault in pair["faults"]]
    return {next(n for n in pair["faults"] if n != fault): pair["isolated_by"] for pair in own}


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _name(names: Sequence[str], index: int) -> str:
    return names[index] if index < len(names) else str(index)


INVISIBLE = 1e-9  # gain, as a share of the largest, that is rounding


def unseen(problem: DetectionProblem, response: LoopResponse) -> dict[str, str]:
    """Return a sentence for every fault that no channel shows at any of the response's frequencies."""
    reached, shown = _into_faults(response), _out_of_faults(response)
    found = {}
    for name in problem.fault_names:
        own = problem.augmented.channels_of(name)
        into, out = float(reached[:, own].max(initial=0.0)), float(shown[:, :, own].max(initial=0.0))
        if into <= INVISIBLE * reached.max(initial=0.0):
            found[name] = "no excitation reaches the signal this fault multiplies"
        elif out <= INVISIBLE * shown.max(initial=0.0):
            found[name] = "the signal this fault multiplies is excited, but its change reaches no output"
    return found


def blind_pairs(problem: DetectionProblem, pairs: Array, inputs: tuple[str, ...]) -> list[dict[str, str]]:
    """Return the pairs of input and output that cannot show a fault; ``pairs (K, L, p, m)`` are efficiencies."""
    largest, blind = pairs.max(initial=0.0), []
    for k, name in enumerate(problem.fault_names):
        for i, output in enumerate(problem.output_names):
            for j, input_ in enumerate(inputs):
                if pairs[k, :, i, j].max(initial=0.0) <= INVISIBLE * largest:
                    blind.append({"fault": name, "input": input_, "output": output})
    return blind


def _into_faults(response: LoopResponse) -> Array:
    """Return ``|Gzu u|`` per unit alpha in the healthy loop, shape ``(L, channels)``, the largest over inputs."""
    k = response.augmented.channels
    z = response.plant[:, :k, k:] @ response.healthy().u[0]
    return np.asarray(np.abs(z).max(axis=-1, initial=0.0))


def _out_of_faults(response: LoopResponse) -> Array:
    """Return the response of r to what faults add, in the healthy loop, shape ``(L, p, channels)``."""
    k = response.augmented.channels
    G, Gyw = response.plant[:, k:, k:], response.plant[:, k:, :k]
    m, p = G.shape[2], G.shape[1]
    Kuy = response.controller[:, :m, :p]
    y = np.linalg.solve(np.eye(p) - G @ Kuy, Gyw)
    return np.asarray(np.abs(response.residual[:, :, :p] @ y + response.residual[:, :, p:] @ (Kuy @ y)))


def thresholds(problem: DetectionProblem, burst: Burst, alarms: Mapping[str, FalseAlarms]) -> dict[str, float]:
    """Return the threshold of every detector in ``alarms`` at its own promised rate; foreign detectors are left out."""
    return {
        name: _THRESHOLDS[name](replace(problem, false_alarms=promised), burst)
        for name, promised in alarms.items()
        if name in _THRESHOLDS
    }


def alarms_per_hour(alarms: Mapping[str, FalseAlarms], bursts_per_hour: float) -> float:
    """Return the false alarms per hour of all detectors together; ``passive_...`` ones run always, others per burst."""
    rates = [
        promised.per_hour if name.startswith("passive") else promised.per_burst * bursts_per_hour
        for name, promised in alarms.items()
    ]
    return float(sum(rates))


def _largest(problem: DetectionProblem, burst: Burst) -> float:
    return burst_detection(problem, burst).threshold(problem.false_alarms.per_burst)


def _ratio(problem: DetectionProblem, burst: Burst) -> float:
    return burst_detection(problem, burst).ratio_threshold(problem.false_alarms.per_burst)


def _regression(problem: DetectionProblem, burst: Burst) -> float:
    """Return the threshold for the information expected; the detector uses what it finds."""
    noise, K = noise_driven(problem), len(problem.fault_names)
    gram = (noise.gram + noise.active_gram(burst))[:K, :K]
    seen = np.diag(gram) > 0
    gram = gram[np.ix_(seen, seen)]
    scale = np.sqrt(np.diag(gram))
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    return maximum.maximum_threshold(vectors * np.sqrt(np.maximum(values, 0.0)), problem.false_alarms.per_burst)


def _cusum(problem: DetectionProblem, burst: Burst) -> float:
    return ActiveCusum(problem).plan(burst, problem.plant.dt).boundary


def _passive(problem: DetectionProblem, burst: Burst) -> float:
    return passive_detector("passive_cusum", problem, Gate(), -0.3, 0.0, 0.99, 100).boundary


_THRESHOLDS: dict[str, Callable[[DetectionProblem, Burst], float]] = {
    "matched_filter": _largest,
    "fault_curves": _ratio,
    "regression": _regression,
    "cusum": _cusum,
    "passive_cusum": _passive,
}
