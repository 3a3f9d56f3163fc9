"""How often the gap test reports a gap that is not there, and how often it misses one.

    python benchmarks/explain/gap_rates.py --controls 400 --power 20 --seed 1
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from scipy.stats import beta

sys.path.insert(0, str(Path(__file__).parent))
from gap_controls import GAPS, NOISES, Control, control

from afdsvc.explain.gap.decision import gap_test
from afdsvc.explain.gap.finding import Gap


def judged(c: Control, rng: np.random.Generator, surrogates: int) -> Gap:
    """Return the finding for one control."""
    names = [[f"{k}{i}" for i in range(n)] for k, n in (("x", c.states), ("u", c.inputs), ("y", c.outputs))]
    return gap_test(c.recordings, *names, [], rng, surrogates)


def interval(k: int, n: int) -> str:
    """Return a share with its 95 % interval (Clopper-Pearson)."""
    low = beta.ppf(0.025, k, n - k + 1) if k else 0.0
    high = beta.ppf(0.975, k + 1, n - k) if k < n else 1.0
    return f"{100 * k / n:.1f} % ({100 * low:.1f} to {100 * high:.1f}), {k} of {n}"


def main() -> None:
    """Print the rates."""
    parser = argparse.ArgumentParser()
    for name, default in (("controls", 200), ("power", 10), ("seed", 1), ("surrogates", 99)):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--verbose", action="store_true")
    a = parser.parse_args()
    rows = []
    for i in range(a.controls):
        rng = np.random.default_rng([a.seed, i])
        c = control(rng, noises=(NOISES[i % len(NOISES)],))
        start = time.process_time()
        g = judged(c, rng, a.surrogates)
        rows.append((c, g, time.process_time() - start))
        if a.verbose or g.present or i % 40 == 39:
            print(f"{i} {c.plant}/{c.excitation}/{c.noise} n {[len(r) for r in c.recordings]} present {g.present} p {g.p_value:.3f} r2 {np.round(g.r2, 3)} "
                  f"threshold {np.round(g.threshold, 3)} whitened {np.round(g.whitened, 3)} won {g.blocks_won:.2f} enough {g.enough} tau {np.round(g.correlation_time)} repeats {g.repeats}", flush=True)
    if rows:
        summary(rows)
    for name in GAPS:
        for share in (0.05, 0.2, 0.5):
            found = [judged(control(rng := np.random.default_rng([a.seed, 7, i]), name, share), rng, a.surrogates) for i in range(a.power)]
            if found:
                print(f"power, {name}, gap {share:g} of the residual: {sum(g.present for g in found)} of {len(found)}; enough data: "
                      f"{sum(g.present and g.enough for g in found)} of {sum(g.enough for g in found)}; median r2 {np.median([g.total for g in found]):.2f}", flush=True)


def summary(rows: list[tuple[Control, Gap, float]]) -> None:
    """Print the false gaps by kind, the distribution of p-values and the time."""
    print("false gaps, all:", interval(sum(g.present for _, g, _ in rows), len(rows)))
    for what in ("noise", "excitation", "plant"):
        for value in sorted({getattr(c, what) for c, _, _ in rows}):
            chosen = [g for c, g, _ in rows if getattr(c, what) == value]
            print(f"  {what} {value}: {interval(sum(g.present for g in chosen), len(chosen))}")
    for enough in (True, False):
        chosen = [g for _, g, _ in rows if g.enough == enough]
        print(f"  enough {enough}: {interval(sum(g.present for g in chosen), len(chosen))}" if chosen else "")
    p = np.array([g.p_value for _, g, _ in rows])
    print("share of p-values below 0.01, 0.02, 0.05, 0.1, 0.2, 0.5:", [round(float((p <= v).mean()), 3) for v in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5)])
    print(f"r2 of controls: median {np.median([g.total for _, g, _ in rows]):.3f}; seconds: median {np.median([s for *_, s in rows]):.2f}, largest {max(s for *_, s in rows):.2f}")


if __name__ == "__main__":
    main()
