"""`afdsvc review`: the residual phasors of all bursts of a recording beside the fault curves of the site."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.detection import DetectionProblem, FalseAlarms
from afdsvc.api.signals import Block
from afdsvc.app import commissioning
from afdsvc.detect.features.demodulation import Basis, BasisSums, project, window
from afdsvc.detect.features.regressors import whitener
from afdsvc.detect.stability_range import reachable
from afdsvc.detect.statistics.fault_curves import FaultCurves, fault_curves
from afdsvc.errors import AfdsvcError
from afdsvc.files.recording.reader import Recording
from afdsvc.plugins.manager import load
from afdsvc.present.rerun.plane import PhasorPoint, Plane

SEVERITIES = 40
MOST = 2  # planes of one machine: those where something shows, then those where the faults would show most
LOUD = 5.0  # standard deviations beyond which something shows


def fault_planes(recording: Recording, machine: str) -> list[Plane]:
    """Return the planes of one machine of a recording; none when it carries no site, no residual or no bursts of sines."""
    bursts = {r.burst.name: r.burst for r in recording.requests(machine) if r.burst.lines and r.burst.waveform is None}
    if not bursts or not recording.site:
        return []
    try:
        problem = _problem(recording, machine)
    except AfdsvcError:
        return []  # a plant this computer does not know, say: the rest of the review stands without
    lines = _ordered(next(iter(bursts.values())))
    played = _amplitudes(recording, machine, {n: b for n, b in bursts.items() if _ordered(b) == lines}, problem)
    begin, end = window(next(iter(bursts.values())))
    scale = float(np.sqrt((end - begin) / 2))  # from amplitudes to standard deviations of their noise
    return _planes(fault_curves(problem, lines), lines, problem, played, scale) if played else []


def _problem(recording: Recording, machine: str) -> DetectionProblem:
    found = commissioning.commission_embedded(recording.site, f"{recording.path}:site.toml", machine, load())
    if found.noise is None:
        raise AfdsvcError(f"machine '{machine}': the noise is unknown")
    return commissioning.problem(found, found.noise, FalseAlarms())


def _ordered(burst: Burst) -> tuple[Line, ...]:
    return tuple(sorted(burst.lines, key=lambda line: line.omega))


def _amplitudes(recording: Recording, machine: str, bursts: dict[str, Burst], problem: DetectionProblem) -> list[tuple[PhasorPoint, np.ndarray]]:
    """Return for every whole burst when it ended and its sines and cosines ``(2 L, p)`` in the normalised residual."""
    Li, found = whitener(problem.covariance), []
    kinds = {b.k0: b.burst for b in recording.blocks(machine)}
    sums: dict[str, tuple[BasisSums, int, Block]] = {}
    for block in recording.residuals(machine):
        name = kinds.get(block.k0, "")
        if name in bursts:
            before, first, _ = sums.get(name, (BasisSums.empty(_basis(bursts[name]), block.values.shape[1]), block.k0, block))
            sums[name] = _added(before, bursts[name], first, block, Li), first, block
    for name, (total, _, last) in sums.items():
        begin, end = window(bursts[name])
        if total.n >= 0.9 * (end - begin):
            lines = project(total, _basis(bursts[name]))
            t_ns = last.t0_ns + round(len(last) * last.dt * 1e9)
            found.append((PhasorPoint(t_ns, name, (0.0, 0.0)), np.linalg.solve(lines.R, lines.z)))
    return found


def _basis(burst: Burst) -> Basis:
    return Basis(tuple(line.omega for line in _ordered(burst)))


def _added(sums: BasisSums, burst: Burst, start: int, block: Block, Li: np.ndarray) -> BasisSums:
    begin, end = window(burst)
    first = block.k0 - start
    a, b = max(begin - first, 0), min(max(end - first, 0), len(block))
    return sums.add(_basis(burst), first + a, block.dt, block.values[a:b] @ Li.T) if b > a else sums


def _planes(
    curves: FaultCurves, lines: Sequence[Line], problem: DetectionProblem, played: list[tuple[PhasorPoint, np.ndarray]], scale: float
) -> list[Plane]:
    severities = {name: np.linspace(0, 0.999 * reach[0], SEVERITIES) for name, reach in reachable(problem).items()}
    points = {name: scale * curves.at(name, severity) for name, severity in severities.items()}
    made = []
    for k, line in enumerate(lines):
        for j, output in enumerate(problem.output_names):
            shape = {name: found[:, 2 * k : 2 * k + 2, j] for name, found in points.items()}
            seen = [PhasorPoint(p.t_ns, p.burst, (scale * float(a[2 * k, j]), scale * float(a[2 * k + 1, j]))) for p, a in played]
            title = f"fault curves: {output}, {line.omega / 2 / np.pi:.3g} Hz [sd]"
            ends = {name: float(severity[-1]) for name, severity in severities.items()}
            severity = max(max(map(abs, p.value)) for p in seen)
            size = max(float(np.abs(c).max()) for c in shape.values())
            made.append(((severity > LOUD) * severity, size, Plane(title, shape, ends, seen)))
    return [plane for *_, plane in sorted(made, key=lambda row: row[:2], reverse=True)[:MOST]]
