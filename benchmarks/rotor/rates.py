"""How often a healthy turboexpander at 31,500 rpm raises an alarm in a burst, at rates too small to be counted directly.

Every burst goes through the service's own pipeline. The sensor noise of a burst is drawn from a mixture: as it is, or with
a wave added that looks like one of the faults to the residual. What a burst counts for is the ratio of the densities of its
noise, which is known exactly (importance sampling), so rates of one in a thousand are found from hundreds of bursts.

    python benchmarks/rotor/rates.py --bursts 500                      promised: 1 in 1000, LQG and PID
    python benchmarks/rotor/rates.py --bursts 200 --rate 0.1 --direct  no waves added: plain counting
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.stats import beta, norm

sys.path.insert(0, str(Path(__file__).parent))
from loop import closed
from machine import machine, plugins

from afdsvc.api.bursts import Burst
from afdsvc.api.evidence import Evidence
from afdsvc.api.signals import Block
from afdsvc.app.commissioning import Commissioned
from afdsvc.app.pipelines import burst_design, pipeline_of
from afdsvc.detect.statistics.matched_filter import window
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.whitening import innovations
from afdsvc.service.scheduler import BurstOrder

KINDS = ("matched_filter", "regression", "fault_curves")
LEAD, START = 2500, 8000  # quiet samples before every burst, and before the first
PLAIN = 0.2  # share of bursts whose noise is left as it is
SEVERITIES = (0.1, -0.1, -0.25, -0.5)  # of the faults that the waves look like


@dataclass(frozen=True, eq=False)
class Waves:
    """Waves ``(k, n)`` of unit energy in the noise of a burst, added ``size`` standard deviations high."""

    waves: np.ndarray
    size: float

    def draw(self, rng: np.random.Generator, shape: tuple[int, int]) -> tuple[np.ndarray, float]:
        """Return white noise of a burst and what the burst counts for."""
        d = rng.standard_normal(shape)
        if not len(self.waves):
            return d, 1.0
        if rng.random() > PLAIN:
            d += self.size * self.waves[rng.integers(len(self.waves))].reshape(shape)
        ratios = np.exp(self.size * (self.waves @ d.ravel()) - self.size**2 / 2)
        return d, 1 / (PLAIN + (1 - PLAIN) * float(ratios.mean()))


def noise_to_residual(parts: Commissioned) -> StateSpace:
    """Return the healthy loop from sensor noise to the normalised innovations."""
    found = innovations(parts.plant, parts.output_cov)
    p, m = parts.plant.outputs, parts.plant.inputs
    loop = closed(parts.plant, parts.controller.interconnection)  # (noise, force, alpha) to (u, y without noise, beta)
    C, D = loop.C[: m + p], loop.D[: m + p, :p].copy()
    D[m:] += np.eye(p)
    seen = StateSpace(loop.A, loop.B[:, :p], np.vstack([C[m:], C[:m]]), np.vstack([D[m:], D[:m]]), loop.dt)
    whiten = StateSpace.gain(np.linalg.inv(np.linalg.cholesky(found.covariance)), loop.dt)
    return whiten @ found.filter @ seen @ StateSpace.gain(np.linalg.cholesky(parts.output_cov), loop.dt)


def waves(parts: Commissioned, burst: Burst, size: float, severities: Sequence[float]) -> Waves:
    """Return for every fault and severity the noise that leaves in the residual what the fault would."""
    path, alpha = noise_to_residual(parts), burst.play(parts.plant.dt)
    found, p, m = innovations(parts.plant, parts.output_cov), parts.plant.outputs, parts.plant.inputs
    whiten = np.linalg.inv(np.linalg.cholesky(found.covariance)).T
    back, shapes = StateSpace(path.A.T, path.C.T, path.B.T, path.D.T, path.dt), []
    seen = np.zeros((len(alpha), 1))
    seen[slice(*window(burst))] = 1.0
    for name in parts.augmented.fault_names:
        for severity in severities:
            loop = closed(parts.augmented.close({name: severity}), parts.controller.interconnection)
            if not loop.is_stable():
                continue
            out, _ = simulate(loop, np.hstack([np.zeros((len(alpha), p + m)), alpha]))
            r, _ = simulate(found.filter, np.hstack([out[:, m : m + p], out[:, :m]]))
            shape = simulate(back, (seen * (r @ whiten))[::-1])[0][::-1].ravel()
            shapes.append(shape / np.linalg.norm(shape))
    return Waves(np.array(shapes), size)


def played(parts: Commissioned, burst: Burst, drawn: Waves, bursts: int, rng: np.random.Generator) -> Iterator[tuple[list[Block], float]]:
    """Return the blocks of one quiet stretch and one burst after the other, and what each counts for."""
    plant, dt = parts.plant, parts.plant.dt
    loop, root, alpha = closed(plant, parts.controller.interconnection), np.linalg.cholesky(parts.output_cov), burst.play(dt)
    x, k, seq = np.zeros(loop.order), 0, 0
    for number in range(bursts):
        quiet = LEAD if number else START
        d, counts = drawn.draw(rng, (burst.samples, plant.outputs))
        noise = np.vstack([rng.standard_normal((quiet, plant.outputs)), d]) @ root.T
        excitation = np.vstack([np.zeros((quiet, plant.inputs)), alpha])
        angle = parts.speed * dt * np.arange(k, k + len(noise))
        force = np.real(np.exp(1j * angle)[:, None] * parts.physical.unbalance)
        out, x = simulate(loop, np.hstack([noise, force, excitation]), x)
        m, p = plant.inputs, plant.outputs
        turning = np.column_stack([np.full(len(noise), parts.speed), np.mod(angle, 2 * np.pi)])
        values = np.hstack([out[:, :m], out[:, m : m + p] + noise, excitation, out[:, m + p :], turning])
        blocks = []
        for first, last, name in ((0, quiet, ""), (quiet, len(noise), f"burst {number}")):
            for a in range(first, last, 1000):
                cut = values[a : min(a + 1000, last)]
                blocks.append(Block("expander", "s", seq, k + a, dt, round((k + a) * dt * 1e9), parts.channels, cut, name))
                seq += 1
        k += len(noise)
        yield blocks, counts


def judged(
    controller: str, kinds: Sequence[str], bursts: int, rate: float, severities: Sequence[float], seed: int, seconds: float
) -> dict[str, list[tuple[Evidence, float]]]:
    """Return every evidence of every detector and what its burst counts for; without severities no waves are added."""
    installed = plugins()
    detectors = [{"kind": k, "false_alarms_per_1000_bursts": 1000 * rate} for k in kinds]
    wanted = {"controller": {"kind": controller}, "detectors": detectors, "bursts": {"severity": -0.2, "seconds": seconds}}
    parts = machine(installed, **wanted)
    stream = pipeline_of(parts, installed)
    burst = burst_design(parts, stream)(BurstOrder("study"))
    size = float(norm.isf(rate / len(parts.augmented.fault_names)))
    drawn = waves(parts, burst, size, severities) if severities else Waves(np.zeros((0, 0)), 0.0)
    found: dict[str, list[tuple[Evidence, float]]] = {kind: [] for kind in kinds}
    pending = 0.0
    for number, (blocks, counts) in enumerate(played(parts, burst, drawn, bursts, np.random.default_rng(seed))):
        stream.announce(replace(burst, name=f"burst {number}"))
        for block in blocks:
            for e in stream.step(block).evidence:
                found[e.detector].append((e, pending if not block.burst else counts))
        pending = counts
    return found


def reported(evidence: list[tuple[Evidence, float]], direct: bool) -> str:
    """Return the rate of alarms with its 99 % interval, in words."""
    alarms = np.array([counts if e.statistic > e.threshold else 0.0 for e, counts in evidence])
    refused, n = sum(not e.trustworthy for e, _ in evidence), len(evidence)
    hits = int((alarms > 0).sum())
    if direct:
        low, high = beta.ppf([0.005, 0.995], [hits, hits + 1], [n - hits + 1, n - hits])
    else:
        reach = norm.isf(0.005) * alarms.std(ddof=1) / np.sqrt(n)
        low, high = alarms.mean() - reach, alarms.mean() + reach
    return f"{alarms.mean():.3g} | {low:.3g} to {high:.3g} | {hits} of {n} | {refused}"


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--bursts", type=int, default=500)
    parser.add_argument("--rate", type=float, default=1e-3)
    parser.add_argument("--direct", action="store_true")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=0.5)
    parser.add_argument("--controllers", nargs="+", default=["lqg", "pid"])
    parser.add_argument("--severities", nargs="+", type=float, default=list(SEVERITIES), help="of the faults the waves look like")
    parser.add_argument("--detectors", nargs="+", default=list(KINDS))
    wanted = parser.parse_args()
    print(f"promised {wanted.rate:g} per burst of {wanted.seconds:g} s, 31,500 rpm, G2.5")
    print("controller | detector | alarms per burst | 99 % interval | bursts with alarm | refused")
    for controller in wanted.controllers:
        severities = () if wanted.direct else tuple(wanted.severities)
        options = (wanted.detectors, wanted.bursts, wanted.rate, severities, wanted.seed, wanted.seconds)
        for kind, evidence in judged(controller, *options).items():
            print(f"{controller} | {kind} | {reported(evidence, wanted.direct)}", flush=True)
