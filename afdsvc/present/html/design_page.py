"""The design sheet as one self-contained HTML page with its plots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from afdsvc.api.bursts import Burst
from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.statistics.fault_curves import loop_response
from afdsvc.detect.thresholds.power import detection_probability, pair_confusion, tail
from afdsvc.excite.efficiency import efficiency
from afdsvc.excite.expected_detection import ExpectedDetection, burst_detection, expected_detection, steady_samples
from afdsvc.excite.loop_sheet import disturbance_gain, loop_poles, phasors
from afdsvc.lti.statespace import StateSpace
from afdsvc.present.html import render, zoomable

COLOURS = ("#1b6ca8", "#c8553d", "#588157", "#7b4b94", "#c29200", "#3a3a3a", "#008b8b", "#a0522d")


Units = tuple[Sequence[str], Sequence[str]]


def design_page(
    problem: DetectionProblem, burst: Burst, sheet: Mapping[str, Any], units: Units = ((), ()), controller: StateSpace | None = None
) -> str:
    """Return the page for a burst and the document `afdsvc.excite.design_sheet.design_sheet` made of it.

    ``units`` are those of inputs and outputs, in the order of the problem's names. With the ``controller`` (y to u) and the document's
    ``loop`` (`afdsvc.excite.loop_sheet.loop_sheet`) it also shows candidate frequencies, disturbance gain, nu-gap and root locus.
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
    if controller is not None:
        figures += _loop_figures(problem, burst, sheet["loop"], controller)
    by_input = dict(zip(problem.input_names, units[0], strict=False))
    shared = units[1][0] if len(set(units[1])) == 1 else ""
    return render(
        "design_page.html.j2", sheet=sheet, answer=answer_line(sheet), figures=figures, problem=problem, threshold=h, unit_of=lambda name: by_input.get(name, ""), output_unit=shared
    )


def answer_line(sheet: Mapping[str, Any]) -> str:
    """Return what one burst finds, fault by fault, and what it does not."""
    smallest = {f["fault"]: f["smallest_detectable"] for f in sheet["faults"]}
    found = ", ".join(f"{name} from {100 * abs(size):.2g} %" for name, size in smallest.items() if size is not None)
    missed = ", ".join(name for name, size in smallest.items() if size is None)
    sentences = f"One burst finds with probability 0.99: {found}." if found else "", f"At no severity with that probability: {missed}." if missed else ""
    return " ".join(s for s in sentences if s)


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
    return zoomable(figure)


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
    return zoomable(figure)


def _severity_figure(seen: ExpectedDetection, h: float) -> str:
    figure, (ax,) = _axes(1, 1, 3.0)
    for k, name in enumerate(seen.curves.names):
        severities = -np.geomspace(1e-3, abs(seen.reach[name][0]), 80)
        ax.semilogx(-severities, [seen.detection(name, float(s), h) for s in severities], color=_colour(k), label=name)
    ax.set(xlabel="loss [share of the gain]", ylabel="probability of detection [1]", ylim=(0, 1.02))
    ax.legend(fontsize=7, frameon=False)
    return zoomable(figure)


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
    return zoomable(figure)


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
    return zoomable(figure)


def _loop_figures(problem: DetectionProblem, burst: Burst, loop: Mapping[str, Any], controller: StateSpace) -> list[tuple[str, str, str]]:
    gap, gain = loop["nu_gap"], loop["controller_gain"]
    low, high = ("no limit tried" if gain[key] is None else f"{gain[key]:.3g}" for key in ("stable_from", "stable_to"))
    return [
        ("Amplitude and phase against severity", "Whitened residual per unit of alpha at candidate frequencies, in the output that shows the fault "
         "most. Faults with the same phase at a frequency are distinguished there by amplitude only.", _phase_figure(problem, burst, loop["candidates"])),
        ("Disturbance gain", "Largest gain from a disturbance at the inputs to the outputs, without and with the controller, and from alpha; "
         "dashed lines mark the burst's frequencies.", _disturbance_figure(problem, burst, controller)),
        ("Distance between healthy and faulty plant (nu-gap)", f"Signals counted in their limits. Below the margin of this loop, {gap['margin']:.3g} (dashed), "
         "it stays stable whatever the fault. The gap knows neither noise nor the length of a burst: it is not a probability of detection.", _gap_figure(gap)),
        ("Poles against the gain of the controller", f"Poles of the loop, as ln(z) / dt, for 0 to 2 times the controller (dark: small); crosses: as it is. "
         f"Stable from {low} to {high} times; least damping {gain['least_damping']:.3g}, at most {gain['best_damping']:.3g} with {gain['best_factor']:.3g} times.",
         _locus_figure(problem, controller)),
    ]  # fmt: skip


def _phase_figure(problem: DetectionProblem, burst: Burst, candidates: Sequence[Mapping[str, Any]]) -> str:
    lines = {(line.omega, _name(problem.input_names, line.input)) for line in burst.lines}
    shown = [c for c in candidates if (c["rad_s"], c["input"]) in lines] or list(candidates)[:6]
    figure, axes = _axes(2, len(shown), 2.6)
    severities = np.linspace(0.02 * problem.severity_range[0], problem.severity_range[0], 60)
    for column, c in enumerate(shown):
        r = phasors(problem, [c["rad_s"]], severities)[:, :, 0, :, problem.input_names.index(c["input"])]
        for k, name in enumerate(problem.fault_names):
            wave = r[k][:, int(np.abs(r[k][-1]).argmax())]
            axes[column].plot(severities, np.abs(wave), color=_colour(k), lw=1.3, label=name)
            axes[len(shown) + column].plot(severities, np.degrees(np.unwrap(np.angle(wave))), color=_colour(k), lw=1.3)
        axes[column].set_title(f"{c['input']}, {c['rad_s']:.4g} rad/s", fontsize=8)
        axes[len(shown) + column].set_xlabel("severity [1]")
    axes[0].set_ylabel("amplitude [output per alpha]")
    axes[len(shown)].set_ylabel("phase [deg]")
    axes[0].legend(fontsize=6, frameon=False)
    return zoomable(figure)


def _disturbance_figure(problem: DetectionProblem, burst: Burst, controller: StateSpace) -> str:
    figure, (ax,) = _axes(1, 1, 3.2)
    omega = np.geomspace(np.pi / problem.plant.dt / 1000, 0.99 * np.pi / problem.plant.dt, 300)
    without, within = disturbance_gain(problem.plant, controller, omega)
    ax.loglog(omega, without, color=_colour(0), label="without the controller")
    ax.loglog(omega, within, color=_colour(1), label="with it")
    from_alpha = np.linalg.norm(loop_response(problem, omega).healthy().y[0], 2, axis=(1, 2))
    ax.loglog(omega, from_alpha, color=_colour(2), ls=":", label="from alpha")
    for line in burst.lines:
        ax.axvline(line.omega, color="0.4", ls="--", lw=0.9)
    ax.set(xlabel="frequency [rad/s]", ylabel="gain [output per input]")
    ax.legend(fontsize=7, frameon=False)
    return zoomable(figure)


def _gap_figure(gap: Mapping[str, Any]) -> str:
    figure, (ax,) = _axes(1, 1, 3.0)
    for k, (name, values) in enumerate(gap["faults"].items()):
        ax.semilogy(gap["severities"], values, ".-", color=_colour(k), label=name)
    ax.axhline(gap["margin"], color="0.3", ls="--", lw=0.9)
    ax.set(xlabel="severity [1]", ylabel="nu-gap [1]")
    ax.legend(fontsize=7, frameon=False)
    return zoomable(figure)


def _locus_figure(problem: DetectionProblem, controller: StateSpace) -> str:
    figure, (ax,) = _axes(1, 1, 3.6)
    factors = np.linspace(0.0, 2.0, 81)

    def s(poles: np.ndarray) -> np.ndarray:
        return np.asarray(np.log(np.where(np.abs(poles) > 1e-9, poles, np.nan)) / problem.plant.dt)

    branches = s(loop_poles(problem.plant, controller, factors))
    ax.scatter(branches.real, branches.imag, c=np.broadcast_to(factors[:, None], branches.shape), cmap="viridis", s=3, lw=0)
    now = s(loop_poles(problem.plant, controller, [1.0])[0])
    ax.plot(now.real, now.imag, "x", color=_colour(1), ms=6)
    ax.axvline(0.0, color="0.4", lw=0.9)
    ax.set(xlabel="real [1/s]", ylabel="imaginary [rad/s]", xlim=(max(2 * float(np.nanmin(now.real)), -2 / problem.plant.dt), None))
    return zoomable(figure)


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
