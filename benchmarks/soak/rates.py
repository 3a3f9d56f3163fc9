"""How often the burst detectors alarm on the healthy machines of a soak, in the service's own pipeline, without a soak.

    python benchmarks/soak/rates.py --bursts 12000 --kind default --seed 2

The loop is simulated here, sample by sample, with white noise of its own; blocks of 50 ms go through the pipeline of the service. Kinds of bursts: ``default``, 0.7 s apart;
``isolating``, for two faults of drawn weights and severity; ``live``: default bursts 0.05 to 2 s apart among what a soak does to them. Rigs and service start anew at any moment, blocks are
lost before, at the beginning of and inside bursts, readings are missing and the inputs held, bursts end early, and identification bursts come between. Prints the decisions
that could be trusted, the alarms among them, and the 99 % interval of their rate.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from numba import njit
from scipy.stats import beta

from afdsvc.api.bursts import Burst
from afdsvc.api.signals import Block
from afdsvc.app import commissioning
from afdsvc.app.pipelines import diagnosis_burst, identification_burst, pipeline_of
from afdsvc.diagnosis.pipeline import Pipeline
from afdsvc.excite.diagnosis_burst import second_burst
from afdsvc.files.site import parse_site
from afdsvc.plugins.manager import load

SITE = '[[machines]]\nid = "m1"\nplant = "gas_bearing"\nbursts = {seconds = 2.0}\n'
BLOCK = 250  # samples


@njit
def loop(A, B, C, KA, KB, KC, KD, x, xk, held, alpha, noise, missing, u, y, b):  # type: ignore[no-untyped-def]
    """Advance plant ``x`` and controller ``xk`` in place and fill u, y and beta; where readings are missing the inputs are held."""
    m = alpha.shape[1]
    for k in range(len(alpha)):
        if missing[k]:
            y[k], b[k] = np.nan, np.nan
        else:
            y[k] = C @ x + noise[k]
            seen = np.concatenate((y[k], alpha[k]))
            out = KC @ xk + KD @ seen
            held[:] = np.minimum(np.maximum(out[:m], -10.0), 10.0)
            b[k] = out[m:]
            xk[:] = KA @ xk + KB @ seen
        u[k] = held
        x[:] = A @ x + B @ held


class Watched:
    """A healthy machine and the service's pipeline, and what that decides."""

    def __init__(self, seed: int) -> None:
        plugins = load()
        self.machine = commissioning.commission(parse_site('site = "soak"\n' + SITE, "soak").machines[0], plugins)
        self.pipeline, self.rng = pipeline_of(self.machine, plugins), np.random.default_rng(seed)
        self.problem = self.pipeline.problem
        self.burst = diagnosis_burst(self.machine)(self.problem)
        self._root = np.linalg.cholesky(self.machine.output_cov)
        self.sessions = self._seq = 0
        self.decided: dict[str, dict[str, bool]] = defaultdict(dict)  # by detector and burst that could be judged: whether it alarmed
        self.start_rig()

    def start_rig(self) -> None:
        """Start the rig anew: loop at rest, samples counted from 0."""
        self._x, self._xk, self._held = (
            np.zeros(self.problem.plant.order),
            np.zeros(self.problem.interconnection.order),
            np.zeros(2),
        )
        self.sessions, self._k = self.sessions + 1, 0

    def start_service(self) -> None:
        """Start the service anew: of all that came before, and of the bursts that are played, it knows nothing."""
        self.pipeline = Pipeline(self.problem, self.pipeline.detectors, self.pipeline.expected)

    def run(
        self,
        alpha: np.ndarray,
        name: str = "",
        lost: tuple[int, int] = (0, 0),
        missing: tuple[int, int] = (0, 0),
        service_at: int = -1,
    ) -> None:
        """Run the loop; blocks ``lost`` (from, to) never arrive, readings of samples ``missing`` neither, and the service starts anew at a block."""
        n, dt, G, K = len(alpha), self.problem.plant.dt, self.problem.plant, self.problem.interconnection
        u, y, b, absent = np.empty((n, 2)), np.empty((n, 2)), np.empty((n, 2)), np.zeros(n, dtype=bool)
        absent[slice(*missing)] = True
        matrices = [np.ascontiguousarray(M) for M in (G.A, G.B, G.C, K.A, K.B, K.C, K.D)]
        loop(*matrices, self._x, self._xk, self._held, alpha, self.rng.standard_normal((n, 2)) @ self._root.T, absent, u, y, b)
        values = np.hstack([u, y, alpha, b])
        for i, a in enumerate(range(0, n, BLOCK)):
            block = Block(
                "m1", f"s{self.sessions}", self._seq, self._k + a, dt, 0, self.machine.channels, values[a : a + BLOCK], name
            )
            self._seq += 1
            if i == service_at:
                self.start_service()
            if not lost[0] <= i < lost[1]:
                self._count(block)
        self._k += n

    def _count(self, block: Block) -> None:
        for e in self.pipeline.step(block).evidence:
            if e.burst and e.trustworthy:
                for name in (e.detector, "any of them"):
                    self.decided[name][e.burst] = e.detected or self.decided[name].get(e.burst, False)

    def play(self, burst: Burst, name: str, **disturbed: object) -> None:
        """Play a burst that the service has asked for."""
        burst = replace(burst, name=name)
        self.pipeline.announce(burst)
        self.run(burst.play(self.problem.plant.dt), name, **disturbed)  # type: ignore[arg-type]

    def rest(self, seconds: float) -> None:
        """Play nothing for so long."""
        self.run(np.zeros((BLOCK * max(round(seconds / self.problem.plant.dt / BLOCK), 1), 2)))


def isolating(seen: Watched) -> Burst:
    """Return a burst that tells two faults apart."""
    names, share = seen.rng.choice(seen.problem.fault_names, 2, replace=False), seen.rng.uniform(0.3, 0.7)
    severity = -float(seen.rng.choice([0.05, 0.1, 0.2, 0.5]))
    return second_burst(
        seen.problem, seen.machine.limits, dict(zip(names.tolist(), (share, 1 - share), strict=True)), severity, 2.0
    )


def live(seen: Watched, n: int, identifying: list[Burst]) -> None:
    """Play a default burst among what a soak does."""
    rng, blocks = seen.rng, seen.burst.samples // BLOCK
    if rng.random() < 0.1:
        seen.start_rig()
        seen.rest(rng.uniform(0.05, 2))
    if rng.random() < 0.03:
        seen.play(identifying[rng.integers(len(identifying))], f"i{n}")
    rest, first, reading = (
        np.zeros((BLOCK * int(rng.integers(1, 40)), 2)),
        int(rng.integers(-3, 3 * blocks)),
        int(rng.integers(3 * seen.burst.samples)),
    )
    lost = (max(first, 0), first + int(rng.integers(1, 6))) if rng.random() < 0.5 else (0, 0)
    missing = (reading, reading + int(rng.integers(1, 4))) if rng.random() < 0.5 else (0, 0)
    service = int(rng.integers(8 * blocks))
    if rng.random() < 0.5:
        seen.run(rest, lost=lost, missing=missing, service_at=service)
        seen.play(seen.burst, f"b{n}")
    else:
        seen.run(rest)
        seen.play(seen.burst, f"b{n}", lost=lost, missing=missing, service_at=service)
    if rng.random() < 0.05:
        burst, end = replace(seen.burst, name=f"e{n}"), BLOCK * int(rng.integers(1, blocks))
        fall = 0.5 + 0.5 * np.cos(np.pi * np.minimum(np.arange(end) / end, 1))
        seen.rest(0.7)
        seen.pipeline.announce(burst)
        seen.run(burst.play(seen.problem.plant.dt)[:end] * fall[:, None], burst.name)


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bursts", type=int, default=1000)
    parser.add_argument("--kind", choices=("default", "isolating", "live"), default="default")
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    seen = Watched(asked.seed)
    seen.rest(2.0)
    identifying = [identification_burst(seen.machine, "identify", seen.rng) for _ in range(3)] if asked.kind == "live" else []
    burst = seen.burst
    for n in range(asked.bursts):
        if asked.kind == "live":
            live(seen, n, identifying)
            continue
        if asked.kind == "isolating" and n % 50 == 0:
            burst = isolating(seen)
        seen.play(burst, f"b{n}")
        seen.rest(0.7)
    print(f"{asked.kind}: {asked.bursts} bursts, seed {asked.seed}, {seen.sessions} starts of the rig")
    for name, bursts in seen.decided.items():
        found, n = sum(bursts.values()), len(bursts)
        low, high = beta.ppf(0.005, found, n - found + 1) if found else 0.0, beta.ppf(0.995, found + 1, n - found)
        print(
            f"  {name}: {found} alarms in {n} decisions, {1000 * found / n:.2f} in 1000 ({1000 * low:.2f} to {1000 * high:.2f})"
        )


if __name__ == "__main__":
    main()
