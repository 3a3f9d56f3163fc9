"""The design sheet as one self-contained HTML page with its plots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, select_autoescape
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from afdsvc.api.bursts import Burst
from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.thresholds.power import detection_probability, pair_confusion, tail
from afdsvc.excite.efficiency import efficiency
from afdsvc.excite.expected_detection import ExpectedDetection, burst_detection, expected_detection, steady_samples
from afdsvc.present.html import svg

COLOURS = ("#1b6ca8", "#c8553d", "#588157", "#7b4b94", "#c29200", "#3a3a3a", "#008b8b", "#a0522d")


Units = tuple[Sequence[str], Sequence[str]]


def design_page(problem: DetectionProblem, burst: Burst, sheet: Mapping[str, Any], units: Units = ((), ())) -> str:
    """Return the page for a burst and the document `afdsvc.excite.design_sheet.design_sheet` made of it.

    ``units`` are those of inputs and outputs, in the order of the problem's names.
    """
    seen = burst_detection(problem, burst)
    h = seen.threshold(problem.false_alarms.per_burst)
    figures = [
        ("Efficiency of excitation", "Residual against output disturbance for every fault and input, all outputs together; "
         "dashed lines mark the burst's frequencies.", _efficiency_figure(problem, burst)),
        ("Fault curves", "Residual phasor of each line as a function of severity, in standard deviations, for every output; "
         "the circle is one standard deviation of the noise, dots mark every quarter of severity.", _curve_figure(problem, seen)),
        ("Probability of detection against severity", "At the burst's length, including the noise of the faulty loop.",
         _severity_figure(seen, h)),
        ("Probability of detection against burst length", "For a loss of 10 %, without ramps and settling.",
         _length_figure(problem, burst, h)),
        ("Isolability", "Probability that the fault of the column is found more likely although the fault of the row is present, at severity -0.5.",
         _isolation_figure(seen)),
    ]  # fmt: skip
    page = Environment(loader=PackageLoader("afdsvc.present.html", "."), autoescape=select_autoescape(["j2"]))
    template = page.get_template("design_page.html.j2")
    by_input = dict(zip(problem.input_names, units[0], strict=False))
    shared = units[1][0] if len(set(units[1])) == 1 else ""
    return template.render(
        sheet=sheet, figures=figures, problem=problem, threshold=h, unit_of=lambda name: by_input.get(name, ""), output_unit=shared
    )


def _efficiency_figure(problem: DetectionProblem, burst: Burst) -> str:
    figure, axes = _axes(1, max(problem.plant.inputs, 1), 3.2)
    omega = np.geomspace(np.pi / problem.plant.dt / 1000, 0.6 * np.pi / problem.plant.dt, 300)
    found = efficiency(problem, omega, -0.5)
    for j, ax in enumerate(axes):
        for k, name in enumerate(found.faults):
            ax.loglog(omega, np.maximum(found.together[k, :, j], 1e-9), color=_colour(k), label=name, lw=1.4)
        for line in burst.lines:
            if line.input == j:
                ax.axvline(line.omega, color="0.4", ls="--", lw=0.9)
        ax.set(title=f"excited: {_name(problem.excitation_names, j)}", xlabel="frequency [rad/s]", ylabel="efficiency [1/output unit]")
        ax.set_ylim(bottom=max(1e-6, found.together.max() * 1e-5))
    axes[0].legend(fontsize=7, frameon=False)
    return svg(figure)


def _curve_figure(problem: DetectionProblem, seen: ExpectedDetection) -> str:
    lines, p = len(seen.curves.inputs), problem.plant.outputs
    figure, axes = _axes(p, lines, 2.9)
    for k, name in enumerate(seen.curves.names):
        severities = np.linspace(0, seen.reach[name][0], 81)
        points = seen.R @ seen.curves.at(name, severities)
        for column in range(lines):
            for i in range(p):
                ax = axes[i * lines + column]
                x, y = points[:, 2 * column, i], points[:, 2 * column + 1, i]
                ax.plot(x, y, color=_colour(k), lw=1.3, label=name)
                ax.plot(x[::20], y[::20], ".", color=_colour(k), ms=4)
    for n, ax in enumerate(axes):
        ax.add_patch(_circle())
        ax.set_aspect("equal", adjustable="datalim")
        ax.set(xlabel="real [sd]", ylabel="imaginary [sd]")
        ax.set_title(f"{_line_name(problem, seen, n % lines)} to {_name(problem.output_names, n // lines)}", fontsize=8)
    axes[0].legend(fontsize=6, frameon=False)
    return svg(figure)


def _severity_figure(seen: ExpectedDetection, h: float) -> str:
    figure, (ax,) = _axes(1, 1, 3.0)
    for k, name in enumerate(seen.curves.names):
        severities = -np.geomspace(1e-3, abs(seen.reach[name][0]), 80)
        ax.semilogx(-severities, [seen.detection(name, float(s), h) for s in severities], color=_colour(k), label=name)
    ax.set(xlabel="loss [share of the gain]", ylabel="probability of detection [1]", ylim=(0, 1.02))
    ax.legend(fontsize=7, frameon=False)
    return svg(figure)


def _length_figure(problem: DetectionProblem, burst: Burst, h: float) -> str:
    figure, (ax,) = _axes(1, 1, 3.0)
    ordered = sorted(burst.lines, key=lambda line: line.omega)
    steady = steady_samples(burst)
    lengths = np.geomspace(steady / 1000, 4 * steady, 60)
    for k, name in enumerate(problem.fault_names):
        d = expected_detection(problem, ordered, steady).deflection(name, -0.1)
        ax.semilogx(lengths * problem.plant.dt, [detection_probability(tail(h), d * np.sqrt(n / steady)) for n in lengths],
                    color=_colour(k), label=name)  # fmt: skip
    ax.axvline(steady * problem.plant.dt, color="0.4", ls="--", lw=0.9)
    ax.set(xlabel="steady excitation [s]", ylabel="probability of detection [1]", ylim=(0, 1.02))
    ax.legend(fontsize=7, frameon=False)
    return svg(figure)


def _isolation_figure(seen: ExpectedDetection) -> str:
    names = seen.curves.names
    table = seen.separations(-0.5)
    n = range(len(names))
    confusion = np.array([[0.5 if i == j else pair_confusion(table[i, j]) for j in n] for i in n])
    figure, (ax,) = _axes(1, 1, 1.2 + 0.5 * len(names))
    shades = np.log10(np.maximum(confusion, 1e-12))
    np.fill_diagonal(shades, np.nan)
    ax.imshow(shades, cmap="Reds", vmin=-8, vmax=0)
    for i, j in np.ndindex(len(names), len(names)):
        if i != j:
            words = f"{confusion[i, j]:.0e}" if confusion[i, j] > 1e-12 else "0"
            ax.text(j, i, words, ha="center", va="center", fontsize=7)
    ax.set_xticks(range(len(names)), names, rotation=30, ha="right", fontsize=7)
    ax.set_yticks(range(len(names)), names, fontsize=7)
    return svg(figure)


def _axes(rows: int, columns: int, height: float) -> tuple[Figure, Sequence[Axes]]:
    figure = Figure(figsize=(min(3.4 + 2.9 * (columns - 1) + 2.2 * (columns == 1), 12), height * rows), layout="constrained")
    return figure, list(np.atleast_1d(figure.subplots(rows, columns)).ravel())


def _circle() -> Any:
    from matplotlib.patches import Circle

    return Circle((0, 0), 1.0, fill=False, color="0.3", lw=1.0)


def _line_name(problem: DetectionProblem, seen: ExpectedDetection, k: int) -> str:
    return _name(problem.excitation_names, seen.curves.inputs[k])


def _name(names: Sequence[str], index: int) -> str:
    return names[index] if index < len(names) else str(index)


def _colour(k: int) -> str:
    return COLOURS[k % len(COLOURS)]
