"""The thesis' Monte Carlo study (section 4.6, Fig 4.11; publication P6): identification from a wrong nominal model.

python benchmarks/identify/monte_carlo.py [models]     (default 500; 10 to 20 minutes of one processor)
python benchmarks/identify/monte_carlo.py page         (the page again, from the figures kept beside it)
"""

from __future__ import annotations

import csv
import itertools
import os
import sys

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np  # noqa: E402
from bearing import TRUE, binary, controller, run, stabilises  # noqa: E402
from contest import METHODS, OUTPUT_RMS, SAMPLES, amplitude, identify_all, r2, scaled_continuous, scaled_discrete  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402
from page import DOCS, picture, table, write  # noqa: E402

from afdsvc.errors import AfdsvcError  # noqa: E402

HELDOUT, STARTS_EVERY = 8000, 50
KINDS = {"discrete": (scaled_discrete, 0.01), "continuous": (scaled_continuous, 1e-6)}
FIGURES = DOCS / "reference" / "identification-monte-carlo.csv"
EDGES = np.linspace(0, 1, 11)
SHOWN = {"PEM": "#c8553d", "Hansen, refined": "#1b6ca8", "Hansen G(S)": "#588157", "nominal": "#999999", "truth": "#000000"}
Rows = list[tuple[float, dict[str, list[float]]]]


def sweep(kind: str, models: int, seed: int, keep) -> None:
    """Identify from ``models`` nominal models and hand every row (kind, theta, R2 of every method) to ``keep``."""
    rng, (nominal_of, observer_noise) = np.random.default_rng(seed), KINDS[kind]
    own = controller(TRUE)
    heldout = run(own, TRUE, binary(rng, HELDOUT, amplitude(own, TRUE)), rng)[0]
    for k in range(models):
        theta, rng_k = float(rng.uniform(0, 1)), np.random.default_rng((seed, k))
        nominal = nominal_of(theta)
        try:
            fact = controller(nominal, observer_noise)
            stable = stabilises(fact, TRUE)
        except AfdsvcError:
            stable = False
        if not stable:
            keep([kind, theta] + [""] * 2 * len(METHODS))
            continue
        training, signals = run(fact, TRUE, binary(rng_k, SAMPLES, amplitude(fact, TRUE)), rng_k)
        found = identify_all(fact, nominal, TRUE, [training], [signals], theta, rng_k, starts=k % STARTS_EVERY == 0)
        keep([kind, theta, *(f"{v:.4f}" for label in METHODS for v in r2(found.get(label), heldout))])


def study(models: dict[str, int]) -> None:
    """Run the sweeps, every row written as soon as it is there."""
    with FIGURES.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["kind", "theta", *(f"{label} {output}" for label in METHODS for output in ("horizontal", "vertical"))])

        def keep(row: list[object]) -> None:
            writer.writerow(row)
            file.flush()

        for kind, count in models.items():
            sweep(kind, count, 1, keep)


def read() -> tuple[dict[str, Rows], dict[str, int]]:
    """Return rows and the number of models left out, kind by kind."""
    rows: dict[str, Rows] = {kind: [] for kind in KINDS}
    skipped = dict.fromkeys(KINDS, 0)
    with FIGURES.open() as file:
        for kind, theta, *values in itertools.islice(csv.reader(file), 1, None):
            if values[0]:
                pairs = np.array(values, dtype=float).reshape(-1, 2).tolist()
                rows[kind].append((float(theta), dict(zip(METHODS, pairs, strict=True))))
            else:
                skipped[kind] += 1
    return rows, skipped


def medians(rows: Rows, label: str, output: int) -> np.ndarray:
    """Return the median of every tenth of theta, NaN where there is nothing."""
    theta = np.array([t for t, _ in rows])
    values = np.array([v[label][output] for _, v in rows])
    inside = [values[(theta >= a) & (theta < b) & np.isfinite(values)] for a, b in itertools.pairwise(EDGES)]
    return np.array([np.median(v) if v.size else np.nan for v in inside])


def figure(rows: Rows, title: str) -> Figure:
    """Return R2 of every model and the medians of the two methods, one panel per output."""
    fig = Figure(figsize=(9, 6), layout="constrained")
    theta = [t for t, _ in rows]
    for output, ax in enumerate(fig.subplots(2, 1, sharex=True)):
        for label, colour in SHOWN.items():
            ax.plot(theta, np.clip([v[label][output] for _, v in rows], -0.3, 1), ".", ms=1 if label == "truth" else 3, color=colour, label=label)
        for label in ("PEM", "Hansen, refined"):
            ax.step(EDGES, np.append(m := medians(rows, label, output), m[-1]), where="post", color=SHOWN[label], lw=1)
        ax.set(ylabel=f"R2 (Eq 4.38), {('horizontal', 'vertical')[output]}", ylim=(-0.32, 1))
        ax.grid(alpha=0.3)
    ax.set_xlabel("theta; lines: medians of every tenth; below -0.3 drawn at -0.3")
    fig.axes[0].legend(fontsize=8, frameon=False, ncols=5, loc="lower left")
    fig.axes[0].set_title(title, fontsize=9)
    return fig


def summary(rows: Rows) -> tuple[str, list[float], dict[str, str]]:
    """Return the table of medians, the smallest ratio of the refined estimate up to theta = 0.5, and failure shares."""
    lines, truth = [], [medians(rows, "truth", o) for o in (0, 1)]
    for label in METHODS:
        both = [medians(rows, label, output) for output in (0, 1)]
        lines.append([label, *(f"{h:.2f} / {v:.2f}" for h, v in zip(*both, strict=True))])
    refined = [medians(rows, "Hansen, refined", o) for o in (0, 1)]
    holds = [float(np.nanmin(m[1:5]) / m[0]) for m in refined]
    lost = {}
    for label in ("PEM", "PEM, 5 starts", "Hansen G(S)", "Hansen, truncated", "Hansen, refined"):
        values = np.array([v[label] for _, v in rows if np.isfinite(v[label]).all()])
        lost[label] = f"{int((values < 0.9 * np.array([t[0] for t in truth])).any(axis=1).sum())} of {len(values)}"
    header = ["median R2 (hor. / vert.), theta in", *(f"{a:.1f}-{b:.1f}" for a, b in itertools.pairwise(EDGES))]
    return table(header, lines), holds, lost


def page() -> None:
    """Write docs/reference/identification-monte-carlo.md from the figures kept."""
    rows, skipped = read()
    parts = [INTRODUCTION]
    for kind, found in rows.items():
        if not found:
            continue
        words = {"discrete": "A of the sampled model scaled", "continuous": "A of the continuous model scaled"}[kind]
        text, holds, lost = summary(found)
        parts += [
            f"## {words}: A_model = (1 - theta) A, {len(found) + skipped[kind]} nominal models",
            picture(figure(found, words), f"identification-theta-{kind}"),
            text,
            f"{skipped[kind]} models left out: their controller does not stabilise the true plant, or none exists. Smallest "
            f"median of the refined Hansen estimate in the tenths of theta from 0.1 to 0.5, relative to 0 to 0.1 (whose middle is 0.05): "
            f"**{100 * holds[0]:.1f} % horizontal, {100 * holds[1]:.1f} % vertical** (target: at least 90 %).",
            "Models with less than 90 % of the truth's own R2 in either output: " + "; ".join(f"{k} {v}" for k, v in lost.items()) + ".",
        ]
    counts = " ".join(str(n) for k in KINDS if (n := len(rows[k]) + skipped[k]))
    write("identification-monte-carlo", "How a wrong nominal model harms identification", f"python benchmarks/identify/monte_carlo.py {counts}", [*parts, READING])


INTRODUCTION = f"""Gas bearing of P5 table 0.1 at 5 kHz with its output noise (variances 0.12 and 0.15 um^2; P5, section 6), in the loop of
P5's observer-based controller, designed anew for every nominal model. Random binary excitation in alpha (held for 4 samples) that
moves the outputs by {OUTPUT_RMS} um rms in every loop, {SAMPLES} samples to fit. R2 is Eq 4.38 of the thesis (1 - ratio of norms), of the
simulation of one recording of {HELDOUT} samples that no method saw; its noise is included, so that the truth itself does not reach 1.

- *PEM*: the 14 physical parameters by direct maximum likelihood with white output noise, started at (1 - theta) times their values;
  *5 starts* adds four random starting points, for every {STARTS_EVERY}th model.
- *Hansen*: S from alpha and beta by PO-MOESP, order by windows left out; *G(S)* as it comes; *truncated* to order 6 by the way that
  disturbs the loop least; *refined* from there on the recording (what `identify` does).

The figures of every single model are in [a table](identification-monte-carlo.csv)."""

READING = """## Reading it

The thesis (section 4.6, 300 models) found direct PEM to lose its way as theta grows while the modified Hansen scheme stays, and so it is
here. The scheme's estimate does not start from the nominal model: that only fixes which S is identified, so a wrong one costs
precision (S becomes large and of higher order) but cannot trap the search. PEM searches among physical parameters from the wrong
values, for at most 25 steps; beyond theta of about 0.6 half of the searches and more end in a model that cannot be simulated at all (drawn at -0.3, -1 in the
table). Longer searches and more starting points would rescue some of them; they were tried on too few models here to say how many. When it
does arrive, PEM is as good as the truth, because it estimates fewer numbers.

A page of fewer than 500 models is a run that was stopped: the models are drawn in the same order whatever their number.
"""

if __name__ == "__main__":
    if sys.argv[1:] != ["page"]:
        counts = [int(a) for a in sys.argv[1:]] or [500]
        study(dict(zip(KINDS, counts, strict=False)))
    page()
