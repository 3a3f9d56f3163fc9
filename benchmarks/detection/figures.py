"""Pictures of the comparison. Every axis has its unit, every point its 95 per cent interval."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from counting import Share
from delay import Delays
from isolation import KNOWN, Isolation
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from power import AVERAGE, BOUND, RATES, Powers

STYLE: dict[str, tuple[str, str, str]] = {
    BOUND: ("black", "-", ""),
    AVERAGE: ("black", "--", ""),
    "regression": ("#0b6e4f", "-", "o"),
    "iterated_regression": ("#0b6e4f", ":", "P"),
    "fault_curves": ("#1f5fbf", "-", "s"),
    "matched_filter": ("#6fa8dc", "-", "^"),
    "cusum": ("#8e44ad", "-", "v"),
    "cusum, deflection 5": ("#8e44ad", "--", "v"),
    "published_a0": ("#c0392b", "-", "x"),
    "published_a_phi": ("#c0392b", ":", "+"),
    "model_bank": ("#b7950b", "-", "D"),
    "chi_square": ("#7f8c8d", "-", "h"),
    "limit_check": ("#7f8c8d", ":", "h"),
    "ruptures normal": ("#e67e22", ":", "<"),
    "ruptures l2, demodulated": ("#e67e22", "-", "<"),
    "river PageHinkley, energy": ("#d81b60", ":", ">"),
    "river PageHinkley, demodulated": ("#d81b60", "-", ">"),
    "river ADWIN, energy": ("#ad1457", ":", "d"),
}
HIDDEN = {"published_a_phi"}  # the same numbers as published_a0


def save(figure: Figure, folder: Path, name: str) -> str:
    """Write a PNG and return its file name."""
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / f"{name}.png", dpi=110, metadata={"Software": None})
    plt.close(figure)
    return f"{name}.png"


def severity_figure(found: Powers, rate: float) -> Figure:
    """Return detection probability against severity beside detection probability against alarm rate."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(12.5, 5.6), layout="constrained")
    percent = -100 * np.array(found.case.severities)
    for name, shares in _drawn(found.power):
        _line(left, percent, shares, name)
    for name, shares in _drawn(found.roc):
        _line(right, RATES, shares, name)
    right.plot(RATES, RATES, color="0.8", lw=1, zorder=0)
    left.set(xscale="log", xlabel="gain lost to the fault [%]", ylabel="detection probability [1]", ylim=(-0.02, 1.02))
    left.set_xticks(percent, [f"{v:g}" for v in percent], minor=False)
    left.minorticks_off()
    left.set_title(f"{found.case.title}: all at {rate:g} false alarms per burst", fontsize=10)
    right.set(xscale="log", xlabel="false alarms per burst [1]", ylabel="detection probability [1]", ylim=(-0.02, 1.02))
    right.set_title(f"{-100 * found.roc_severity:g} % of the gain lost", fontsize=10)
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, fontsize=8, frameon=False)
    return figure


def _drawn(curves: dict[str, list[Share]]) -> list[tuple[str, list[Share]]]:
    order = [name for name in STYLE if name in curves and name not in HIDDEN]
    return [(name, curves[name]) for name in order]


def _line(axes: Axes, x: np.ndarray, shares: list[Share], name: str) -> None:
    colour, line, marker = STYLE[name]
    y = np.array([s.value for s in shares])
    low, high = (np.array([getattr(s, end) for s in shares]) for end in ("low", "high"))
    x = x * _aside(name)
    axes.plot(x, y, color=colour, ls=line, marker=marker or None, ms=4.5, lw=1.6 if name == BOUND else 1.2, label=name)
    known = np.isfinite(y)
    axes.vlines(x[known], low[known], high[known], color=colour, lw=0.9, alpha=0.6)


def _aside(name: str) -> float:
    """Return a factor on the abscissa that keeps points of different detectors apart."""
    return 1 + 0.006 * (list(STYLE).index(name) - len(STYLE) / 2)


def fault_figure(found: Powers, rate: float) -> Figure:
    """Return detection probability against severity, one panel for every fault, ours against the bound."""
    faults = found.case.problem.fault_names
    figure, axes = plt.subplots(1, len(faults), figsize=(3.3 * len(faults), 3.9), sharey=True, layout="constrained", squeeze=False)
    percent = -100 * np.array(found.case.severities)
    for panel, fault in zip(axes[0], faults, strict=True):
        for name in (BOUND, "regression", "fault_curves", "published_a0", "chi_square"):
            _line(panel, percent, found.by_fault[name][fault], name)
        panel.set(xscale="log", xlabel="gain lost [%]", title=fault)
        panel.set_xticks(percent, [f"{v:g}" for v in percent], minor=False, fontsize=8)
        panel.minorticks_off()
    axes[0, 0].set_ylabel("detection probability [1]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.suptitle(f"{found.case.title}, {rate:g} false alarms per burst", fontsize=10)
    figure.legend(handles, labels, loc="outside lower center", ncols=5, fontsize=8, frameon=False)
    return figure


def delay_figure(found: Delays) -> Figure:
    """Return delays of the passive CUSUM against the bound, and of everybody at the same run length."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(12.5, 4.6), layout="constrained", width_ratios=(1, 1.25))
    colours = dict(zip(found.passive, ("#1f5fbf", "#0b6e4f", "#c0392b"), strict=False))
    for word, by_severity in found.passive.items():
        x = np.array([-100 * s for s in by_severity])
        value = np.array([m.value for m, _, _ in by_severity.values()])
        half = np.array([m.half for m, _, _ in by_severity.values()])
        left.errorbar(x, value, yerr=half, fmt="o", color=colours[word], ms=5, capsize=3, label=f"passive_cusum, {word}")
        left.plot(x, [b for _, b, _ in by_severity.values()], color=colours[word], lw=1.3)
        left.plot(x, [b for _, _, b in by_severity.values()], color=colours[word], lw=1, ls=":")
    left.plot([], [], color="0.3", lw=1.3, label="CUSUM that knows fault and severity, theory")
    left.plot([], [], color="0.3", lw=1, ls=":", label="ln(run length) / I, first order (Lorden)")
    left.set(xscale="log", yscale="log", xlabel="gain lost to the fault [%]", ylabel="mean delay [s]")
    left.set_title(f"{found.case.title}, no excitation, {found.fault}", fontsize=10)
    x_all = sorted({-100 * s for d in found.passive.values() for s in d})
    left.set_xticks(x_all, [f"{v:g}" for v in x_all], minor=False)
    left.xaxis.minorticks_off()
    seconds = np.array([0.05, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0])
    left.yaxis.minorticks_off()
    left.set_yticks(seconds, [f"{v:g}" for v in seconds], minor=False)
    left.grid(axis="y", color="0.9")
    left.legend(fontsize=7, frameon=False, loc="best")
    names = list(found.same)[::-1]
    values = [found.same[n][0] for n in names]
    right.barh(names, [m.value for m in values], xerr=[m.half for m in values], color="#6fa8dc", height=0.6, capsize=3)
    right.axvline(found.same_bound, color="black", lw=1.2, label="CUSUM that knows, theory")
    right.set(xlabel="mean delay [s], at most 0.8 s counted", xlim=(0, None))
    right.set_title(f"{-100 * found.same_severity:g} % lost, all at one false alarm in {found.arl_seconds:g} s", fontsize=10)
    right.legend(fontsize=8, frameon=False, loc="upper right")
    return figure


def isolation_figure(found: list[Isolation]) -> Figure:
    """Return the share of bursts with the right fault on top, and with the right one named, against the output amplitude."""
    figure, axes = plt.subplots(2, len(found), figsize=(3.1 * len(found), 6.2), sharey=True, layout="constrained", squeeze=False)
    for column, one in zip(axes.T, found, strict=True):
        x = np.array(one.output)
        for name, shares in one.top.items():
            _isolation_line(column[0], x, shares, name)
            if name in one.named:
                _isolation_line(column[1], x, one.named[name], name)
        column[0].set_title(f"{one.case.title}\n{-100 * one.case.isolation_severity:g} % lost", fontsize=9)
        column[1].set_xlabel(f"output amplitude of a line [{one.case.amplitude_unit}]", fontsize=9)
        for panel in column:
            panel.set(xscale="log", ylim=(-0.02, 1.04))
            panel.set_xticks(x, [f"{v:.3g}" for v in x], minor=False)
            panel.minorticks_off()
    axes[0, 0].set_ylabel("right fault on top [share of bursts]")
    axes[1, 0].set_ylabel("right fault named, weight above 0.99\n[share of bursts]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(6, 2 * len(found)), fontsize=8, frameon=False)
    return figure


def _isolation_line(axes: Axes, x: np.ndarray, shares: list[Share], name: str) -> None:
    colour, line, marker = STYLE.get(name, ("black", "-", ""))
    label = "clairvoyant: severity known" if name == KNOWN else name
    axes.plot(x, [s.value for s in shares], color=colour, ls=line, marker=marker or None, ms=4.5, lw=1.2, label=label)
    axes.vlines(x, [s.low for s in shares], [s.high for s in shares], color=colour, lw=0.9, alpha=0.6)
