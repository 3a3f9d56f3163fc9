"""Tables, figures and HTML."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from jinja2 import Environment, PackageLoader, select_autoescape
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.ticker import FuncFormatter, NullFormatter
from matplotlib.transforms import ScaledTranslation

from afdsvc.api.evidence import p_value_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

PHONE = 4.1  # inches; a wider figure is drawn once more for phones


def render(template: str, filters: Mapping[str, Callable[..., str]] | None = None, **values: Any) -> str:
    """Return a page from one of the templates beside this file."""
    page = Environment(loader=PackageLoader("afdsvc.present.html", "."), autoescape=select_autoescape(["j2"]))
    page.filters.update({"p_value": p_value_text, **(filters or {})})
    return page.get_template(template).render(**values)


def svg(figure: Figure) -> str:
    """Return the figure as an SVG element; the same figure gives the same text. Names are free text: ``$`` in one begins no formula."""
    for ax in figure.axes:
        legend = ax.get_legend()
        for text in (ax.title, ax.xaxis.label, ax.yaxis.label, *ax.texts, *(legend.get_texts() if legend else ())):
            text.set_parse_math(False)
        for axis in (ax.xaxis, ax.yaxis):
            if axis.get_scale() == "log":
                _plain_numbers(axis)
    out, dpi = io.StringIO(), figure.dpi
    FigureCanvasSVG(figure).print_svg(out, metadata={"Date": None})  # type: ignore[no-untyped-call]  # `savefig` would draw it twice
    figure.dpi = dpi
    return out.getvalue()[out.getvalue().index("<svg") :]


def _plain_numbers(axis: Axis) -> None:
    """Write the numbers of a logarithmic axis as text: formulas take most of the time of a page. Less than a decade has numbers between."""
    low, high = sorted(axis.get_view_interval())
    text = FuncFormatter(lambda value, _: f"{value:g}")
    axis.set_major_formatter(text)
    axis.set_minor_formatter(NullFormatter() if high > 10 * low else text)


def zoomable(figure: Figure) -> str:
    """Return the figure as an SVG element with its data: on a page with ``figures.js.j2`` it zooms and is saved as PNG or CSV.

    A figure that is wider than a phone is drawn twice, at its own width and with one column of axes; the page shows the one that fits.
    """
    if figure.get_size_inches()[0] <= PHONE:
        return _plot(figure, "plot")
    whole = _plot(figure, "plot wide")
    _narrow(figure)
    return whole + _plot(figure, "plot phone", series=False)


def _plot(figure: Figure, kind: str, series: bool = True) -> str:
    for number, ax in enumerate(figure.axes):
        ax.set_gid(f"axes-{number}")
    drawn = svg(figure)  # lays the axes out
    data = json.dumps([_axes_data(ax, series) for ax in figure.axes], separators=(",", ":")).replace("<", "\\u003c")
    return f'<figure class="{kind}">{drawn}<script type="application/json">{data}</script></figure>'


def _narrow(figure: Figure) -> None:
    """Make a figure as wide as a phone: its axes one below the other, its legends below them, where they hide no curve."""
    own = [(ax, place) for ax in figure.axes if (place := ax.get_subplotspec()) is not None]
    rows = max((place.get_gridspec().nrows for _, place in own), default=1)
    legends = {ax: [(h, t.get_text()) for h, t in zip(old.legend_handles, old.get_texts(), strict=True) if h is not None] for ax, _ in own if (old := ax.get_legend())}
    columns = {ax: 2 if all(len(words) < 28 for _, words in entries) else 1 for ax, entries in legends.items()}
    high = sum(0.15 * -(-len(entries) // columns[ax]) + 0.1 for ax, entries in legends.items())
    figure.set_size_inches(PHONE, figure.get_size_inches()[1] / rows * max(len(own), 1) + high)
    grid = figure.add_gridspec(max(len(own), 1), 1)
    for row, (ax, _) in enumerate(own):
        ax.set_subplotspec(grid[row])
        if legends.get(ax):
            below = ScaledTranslation(0, -(0.44 if ax.get_xlabel() else 0.25), figure.dpi_scale_trans)  # inches: the numbers and the name of the axis
            ax.legend(
                *zip(*legends[ax], strict=True), fontsize=7, frameon=False, ncols=columns[ax], loc="upper left",
                bbox_to_anchor=(0, 0), bbox_transform=ax.transAxes + below, borderaxespad=0,
            )  # fmt: skip


def _axes_data(ax: Axes, series: bool) -> dict[str, Any]:
    """Return where the axes stand [points], what they span, and, unless the figure before has it, what is drawn in them."""
    place, (width, height) = ax.get_position(), 72 * ax.figure.get_size_inches()  # type: ignore[union-attr]
    box = [place.x0 * width, (1 - place.y1) * height, place.width * width, place.height * height]
    return {
        "id": ax.get_gid(), "box": _short(np.array(box)), "name": ax.get_title() or ax.get_ylabel(), "x_name": ax.get_xlabel(), "y_name": ax.get_ylabel(),
        "x": list(map(float, ax.get_xlim())), "y": list(map(float, ax.get_ylim())), "log": [ax.get_xscale() == "log", ax.get_yscale() == "log"],
        "series": [{"name": name, "x": _short(x), "y": _short(y)} for name, x, y in _series(ax)] if series else None, "fixed": bool(ax.images),
    }  # fmt: skip


def _series(ax: Axes) -> Iterator[tuple[str, Any, Any]]:
    """Yield name, x and y of every curve, bar and band; lines across the whole axes are none."""
    for line in ax.lines:
        if all(line.get_transform().contains_branch_seperately(ax.transData)):
            x, y = line.get_data(orig=False)
            yield str(line.get_label()).lstrip("_"), x, y
    for collection in ax.collections:
        paths = collection.get_paths()
        if paths and collection.get_offset_transform() is not ax.transData:
            points = np.vstack([path.vertices for path in paths])
            yield str(collection.get_label()).lstrip("_"), points[:, 0], points[:, 1]


def _short(values: Any) -> list[float | None]:
    return [float(f"{v:.6g}") if np.isfinite(v) else None for v in np.asarray(values, dtype=np.float64).ravel().tolist()]
