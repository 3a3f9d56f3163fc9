"""An identification as one self-contained HTML page: what was found, how well it predicts, and how far to trust it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from afdsvc.identify import IdentifyResult
from afdsvc.identify.fit import ResponseBand
from afdsvc.lti.frequency import frequency_response
from afdsvc.present.html import render, zoomable

BEFORE, AFTER, FULL = "#999999", "#1b6ca8", "#c8553d"


def identify_page(result: IdentifyResult, model_path: str | None = None, data: Sequence[str] = ()) -> str:
    """Return the page of an identification; ``model_path`` is where the improved model was written, ``data`` what was done to
    the recordings."""
    figures = [
        ("Frequency response", "Identified plant with its 95 % band, the model it started from, and the plant before its "
         "order was reduced where that was done.", zoomable(bode(result))),
        ("On a recording not used", "Measured output and the predictions of both models.", _time(result)),
        ("Order", result.fit.order_reason or "The structure fixes the order.", _singular_values(result)),
        ("Residuals", "Correlations of the residual on held-out recordings; dashed lines contain 95 % of them when it is white and independent "
         "of the input. Autocorrelations outside: coloured noise (expected of a simulation error). Cross-correlations outside at "
         "positive lags: the plant model is incomplete; at negative lags: the input depends on the noise (feedback).", _residuals(result)),
    ]  # fmt: skip
    return render(
        "identify_page.html.j2", result=result, document=result.json(model_path), data=data, figures=[f for f in figures if f[2]]
    )


def bode(result: IdentifyResult, nominal_given: bool = True) -> Figure:
    """Return the magnitude of the frequency response with its 95 % band, beside the model it started from where one was given."""
    band = response_band(result)
    outputs, inputs = band.value.shape[1:]
    figure, axes = _axes(outputs, inputs, 2.6)
    hz = band.omega / (2 * np.pi)
    low, high = band.magnitude_band()
    nominal = np.abs(frequency_response(result.nominal, band.omega))
    full = None if result.full is None else np.abs(frequency_response(result.full, band.omega))
    for n, ax in enumerate(axes):
        i, j = divmod(n, inputs)
        value = np.abs(band.value[:, i, j])
        ax.fill_between(hz, np.maximum(low[:, i, j], value * 1e-3), high[:, i, j], color=AFTER, alpha=0.25, lw=0)
        if nominal_given:
            ax.loglog(hz, nominal[:, i, j], color=BEFORE, label="before", lw=1.2)
        if full is not None:
            ax.loglog(hz, full[:, i, j], color=FULL, label="before reduction", lw=0.8, ls=":")
        ax.loglog(hz, value, color=AFTER, label="identified", lw=1.3)
        ax.set_title(f"{_variable(result, 'inputs', j)} to {_variable(result, 'outputs', i)}", fontsize=8)
        ax.set_xlabel("frequency [Hz]", fontsize=8)
        units = [side[at].unit or "1" for side, at in ((result.model.outputs, i), (result.model.inputs, j))]
        ax.set_ylabel(f"magnitude [{' / '.join(units)}]", fontsize=8)
    axes[0].legend(fontsize=7, frameon=False)
    return figure


def response_band(result: IdentifyResult) -> ResponseBand:
    """Return the frequency response of what was identified with its band, of no width where none is known."""
    if result.fit.band is not None:
        return result.fit.band
    omega = result.nominal_band.omega
    value = frequency_response(result.fit.system, omega)
    return ResponseBand(omega, value, np.zeros((*value.shape, 2, 2)))


def _time(result: IdentifyResult) -> str:
    shown = result.preview
    if shown is None:
        return ""
    figure, axes = _axes(shown.measured.shape[1], 1, 1.8, width=9.5)
    for i, ax in enumerate(axes):
        ax.plot(shown.t, shown.measured[:, i], color="0.2", lw=0.7, label="measured")
        if shown.before is not None:
            ax.plot(shown.t, shown.before[:, i], color=BEFORE, lw=1.0, label="before")
        ax.plot(shown.t, shown.after[:, i], color=AFTER, lw=1.1, label="identified")
        ax.set_ylabel(_variable(result, "outputs", i), fontsize=8)
    axes[-1].set_xlabel(f"time [s], {shown.recording}", fontsize=8)
    axes[0].legend(fontsize=7, frameon=False, ncols=3)
    return zoomable(figure)


def _singular_values(result: IdentifyResult) -> str:
    values = result.fit.singular_values[:40]
    if not len(values):
        return ""
    order = result.fit.deviation.order if result.fit.deviation is not None else result.fit.order
    figure, (ax,) = _axes(1, 1, 2.6)
    n = np.arange(1, len(values) + 1)
    ax.semilogy(n[:order], values[:order], "o", color=AFTER, ms=4, label=f"kept: {order}")
    ax.semilogy(n[order:], values[order:], "o", color=BEFORE, ms=4, mfc="none", label="left out")
    ax.set(xlabel="state [number]", ylabel="singular value [1]")
    ax.legend(fontsize=7, frameon=False)
    return zoomable(figure)


def _residuals(result: IdentifyResult) -> str:
    tests = result.fit.tests
    if tests is None:
        return ""
    outputs, inputs = tests.crosscorrelation.shape[1:]
    figure, axes = _axes(outputs, 1 + inputs, 2.2)
    lags = np.arange(-tests.lags, tests.lags + 1)
    for i in range(outputs):
        own = axes[i * (1 + inputs)]
        own.vlines(np.arange(1, tests.lags + 1), 0, tests.autocorrelation[1:, i], color=AFTER, lw=1.2)
        _limits(own, tests.band)
        own.set_title(f"{_variable(result, 'outputs', i)}: autocorrelation", fontsize=8)
        for j in range(inputs):
            ax = axes[i * (1 + inputs) + 1 + j]
            ax.vlines(lags, 0, tests.crosscorrelation[:, i, j], color=AFTER, lw=1.0)
            _limits(ax, float(tests.cross_band[i, j]))
            ax.set_title(f"with input {_variable(result, 'inputs', j)}", fontsize=8)
    return zoomable(figure)


def _limits(ax: Axes, band: float) -> None:
    for level in (-band, band):
        ax.axhline(level, color="0.5", ls="--", lw=0.8)
    ax.axhline(0, color="0.3", lw=0.6)


def _variable(result: IdentifyResult, side: str, index: int) -> str:
    variable = getattr(result.model, side)[index]
    return f"{variable.name} [{variable.unit}]" if variable.unit else str(variable.name)


def _axes(rows: int, columns: int, height: float, width: float = 0.0) -> tuple[Figure, Sequence[Axes]]:
    figure = Figure(figsize=(width or min(3.4 * columns + 1.0, 11), height * rows), layout="constrained")
    return figure, list(np.atleast_1d(figure.subplots(rows, columns)).ravel())
